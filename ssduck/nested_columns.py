"""Takes columns of Arrow apart."""

from __future__ import annotations

from typing import Any


def parts_of(values: Any) -> list[Any]:
    """Returns the columns within one of a nested type; those of a list are one after another.

    Args:
        values: a `pyarrow.Array`.

    Returns:
        The columns; none for another type.
    """
    import pyarrow as pa

    kind = values.type
    if pa.types.is_map(kind):
        return [values.keys, values.items]
    if pa.types.is_union(kind):
        return [values.field(place) for place in range(kind.num_fields)]
    if pa.types.is_struct(kind):
        return list(values.flatten())
    return [values.flatten()] if pa.types.is_nested(kind) else []
