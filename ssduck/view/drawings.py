"""Describes values that are drawn where they are: grids on the floor, clouds in the scene."""

from __future__ import annotations

import base64
from typing import Any

import numpy as np
import numpy.typing as npt

from ssduck.adapters.grid_values import Grid
from ssduck.adapters.point_cloud import PointCloud

# More points are thinned out evenly: a page draws them at each frame.
MAX_POINTS = 200_000


def drawing_of(value: Any) -> dict[str, Any] | None:
    """Returns a description of a grid or a cloud; None for other values.

    A flat grid has the share of its largest value in each cell, from 0 to 255, row by row along the
    first axis. A cloud has points (float32 x y z), and a number for the entity of each.
    """
    if isinstance(value, PointCloud):
        return _cloud(value.points, value.owners, list(value.names), None)
    if not isinstance(value, Grid):
        return None
    cells = np.asarray(value.cells, dtype=float)
    shares = np.nan_to_num(cells / max(float(np.nanmax(np.abs(cells), initial=0.0)), 1e-12))
    if cells.ndim == 3:
        places = np.argwhere(shares > 0.0)
        points = np.array(value.origin) + (places + 0.5) * value.resolution
        return _cloud(points, np.zeros(len(points), np.intp), ["cells"], value.resolution)
    return {
        "kind": "grid",
        "origin": [float(number) for number in value.origin],
        "resolution": float(value.resolution),
        "shape": list(value.shape),
        "shares": _encoded((255 * np.clip(shares, 0.0, 1.0)).astype(np.uint8)),
    }


def _cloud(
    points: npt.NDArray[Any], owners: npt.NDArray[Any], names: list[str], size: float | None
) -> dict[str, Any]:
    step = -(-len(points) // MAX_POINTS) or 1
    return {
        "kind": "cloud",
        "points": _encoded(np.asarray(points[::step], dtype="<f4")),
        "owners": _encoded(np.asarray(owners[::step], dtype="<u4")),
        "names": names,
        "size": size,
    }


def _encoded(values: npt.NDArray[Any]) -> str:
    return base64.b64encode(np.ascontiguousarray(values).tobytes()).decode()
