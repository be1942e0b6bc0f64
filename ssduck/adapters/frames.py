"""Reads the frames that users hold: `arrow_of`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pyarrow as pa

from ssduck.adapters.result import Result
from ssduck.errors import ArgumentError
from ssduck.formatting import error_text, short_repr


def arrow_of(frame: Any) -> pa.Table:
    """Returns an Arrow table with a copy of the rows of a frame.

    Args:
        frame: a data frame of pandas or polars, an Arrow table, a `Result`, or columns by name.

    Raises:
        ArgumentError: it is something else, or a column has values of several types.
    """
    try:
        table = _table_of(frame)
    except (pa.ArrowException, TypeError, ValueError, AttributeError) as error:
        raise ArgumentError(
            f"register: {short_repr(frame)} is no table: {error_text(error)}"
        ) from error
    if table is None:
        raise ArgumentError(
            "register: give a data frame of pandas or polars, an Arrow table, a result of ss.sql, "
            f"or a dict of columns, not {short_repr(frame)}"
        )
    # Arrow shares the memory of numpy's arrays.
    copy = pa.BufferOutputStream()
    with pa.ipc.new_stream(copy, table.schema) as stream:
        stream.write_table(table)
    return pa.ipc.open_stream(copy.getvalue()).read_all()


def _table_of(frame: Any) -> pa.Table | None:
    """Returns an Arrow table with the rows of a frame; None for what is none."""
    match frame:
        case pa.Table():
            return frame
        case Result():
            return frame.arrow()
        case Mapping() if frame:
            return pa.table(dict(frame))
    if type(frame).__module__.partition(".")[0] == "pandas":
        return pa.Table.from_pandas(frame, preserve_index=False).replace_schema_metadata()
    return pa.table(frame) if hasattr(frame, "__arrow_c_stream__") else None
