"""Height fields as meshes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from ssduck.errors import ArgumentError
from ssduck.geometry.arrays import Array, Triangles


def height_field(
    heights: npt.ArrayLike, rows: int, columns: int, scale: Sequence[float] = (1.0, 1.0, 1.0)
) -> tuple[Array, Triangles]:
    """The surface of a height field, as PyBullet makes it, to be given as one of `shapes`.

    PyBullet puts the middle of the field's box at the body's origin.

    Args:
        heights: rows times columns numbers, as `heightfieldData` of `createCollisionShape`.
        rows: its `numHeightfieldRows`: how many heights follow each other along x.
        columns: its `numHeightfieldColumns`: how many along y.
        scale: its `meshScale`: metres between two heights along x and y, and of one unit of height.

    Returns:
        The vertices (rows · columns, 3), metres, and the faces, (n, 3).

    Raises:
        ArgumentError: there are fewer than two rows or columns, another number of heights, or a
            number is not finite.
    """
    if min(rows, columns) < 2:
        raise ArgumentError(f"a height field has 2 rows and columns at least: {rows}, {columns}")
    told = _numbers(heights, rows * columns, f"heights are to be {rows} times {columns}")
    size = _numbers(scale, 3, "scale is to be three")
    # PyBullet keeps heights as single floats.
    z = told.astype(np.float32).astype(np.float64)
    y, x = np.divmod(np.arange(rows * columns), rows)
    middle = (rows - 1) / 2, (columns - 1) / 2, (z.min() + z.max()) / 2
    vertices = (np.column_stack((x, y, z)) - middle) * size
    first = (np.arange(columns - 1)[:, None] * rows + np.arange(rows - 1)).reshape(-1)
    ahead, beside, across = first + 1, first + rows, first + rows + 1
    lower, upper = np.array((first, ahead, beside)), np.array((ahead, across, beside))
    return vertices, np.hstack((lower, upper)).T.astype(np.int32)


def _numbers(told: npt.ArrayLike, count: int, wanted: str) -> Array:
    try:
        numbers = np.asarray(told, dtype=np.float64).reshape(-1)
    except (TypeError, ValueError) as error:
        raise ArgumentError(f"{wanted} finite numbers") from error
    if len(numbers) != count or not np.isfinite(numbers).all():
        raise ArgumentError(f"{wanted} finite numbers")
    return numbers
