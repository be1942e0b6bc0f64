"""Builds the meshes of height fields."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from ssduck.errors import ArgumentError
from ssduck.geometry.arrays import Array, Triangles


def height_field(
    heights: npt.ArrayLike, rows: int, columns: int, scale: Sequence[float] = (1.0, 1.0, 1.0)
) -> tuple[Array, Triangles]:
    """Returns the surface of a height field as PyBullet builds it, to be passed as one of `shapes`.

    PyBullet puts the centre of the field's box at the origin of the body.

    >>> vertices, faces = height_field([0.0, 0.0, 0.0, 1.0], 2, 2)
    >>> vertices[:, 2].tolist(), faces.tolist()
    ([-0.5, -0.5, -0.5, 0.5], [[0, 1, 2], [1, 3, 2]])

    Args:
        heights: rows times columns numbers, as `heightfieldData` of `createCollisionShape`.
        rows: `numHeightfieldRows`: the number of heights along x.
        columns: `numHeightfieldColumns`: the number of heights along y.
        scale: `meshScale`: metres between two heights along x and y, and for one unit of height.

    Returns:
        The vertices (rows · columns, 3), metres, and the faces, (n, 3).

    Raises:
        ArgumentError: there are fewer than two rows or columns, the number of heights differs, or
            a number is not finite.
    """
    if min(rows, columns) < 2:
        raise ArgumentError(f"a height field has 2 rows and columns at least: {rows}, {columns}")
    values = _numbers(heights, rows * columns, f"heights are to be {rows} times {columns}")
    size = _numbers(scale, 3, "scale is to be three")
    # PyBullet stores heights in single precision.
    z = values.astype(np.float32).astype(np.float64)
    y, x = np.divmod(np.arange(rows * columns), rows)
    centre = (rows - 1) / 2, (columns - 1) / 2, (z.min() + z.max()) / 2
    vertices = (np.column_stack((x, y, z)) - centre) * size
    first = (np.arange(columns - 1)[:, None] * rows + np.arange(rows - 1)).reshape(-1)
    next_x, next_y, diagonal = first + 1, first + rows, first + rows + 1
    lower, upper = np.array((first, next_x, next_y)), np.array((next_x, diagonal, next_y))
    return vertices, np.hstack((lower, upper)).T.astype(np.int32)


def _numbers(values: npt.ArrayLike, count: int, rule: str) -> Array:
    try:
        numbers = np.asarray(values, dtype=np.float64).reshape(-1)
    except (TypeError, ValueError) as error:
        raise ArgumentError(f"{rule} finite numbers") from error
    if len(numbers) != count or not np.isfinite(numbers).all():
        raise ArgumentError(f"{rule} finite numbers")
    return numbers
