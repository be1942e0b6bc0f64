"""Measures what result forms make, for the limits of memory."""

from __future__ import annotations

from typing import Any

from ssduck.world.handles import Handle
from ssduck.world.world import World

# A simulation of its own takes so much at least, bytes.
WORLD_BYTES = 10_000_000
# A node or an edge of a graph, with its attributes, and a pixel of a picture, bytes.
_NODE_BYTES, _PIXEL_BYTES = 500, 4
# The types of values that are counted elsewhere.
_COUNTED = (type(None), str, int, float, list, tuple, dict, Handle)


def made_bytes(value: Any) -> int:
    """Returns the memory of a world, array, table, grid, mesh, picture or graph, bytes, roughly.

    Of other values, whose texts and lists are counted elsewhere, it is 0.
    """
    if isinstance(value, _COUNTED):
        return 0
    if isinstance(value, World):
        return WORLD_BYTES
    arrays = [getattr(value, name, None) for name in ("cells", "points", "normals", "owners")]
    if isinstance(geometry := getattr(value, "geometry", None), dict):  # of trimesh
        arrays += [getattr(mesh, name, None) for mesh in geometry.values() for name in _OF_MESH]
    size = sum(int(getattr(array, "nbytes", 0)) for array in [value, *arrays])
    if callable(measure := getattr(value, "memory_usage", None)):  # of pandas
        size += int(measure().sum())
    if callable(measure := getattr(value, "estimated_size", None)):  # of polars
        size += int(measure())
    if callable(count := getattr(value, "number_of_nodes", None)):  # of networkx
        size += _NODE_BYTES * (count() + value.number_of_edges())
    if isinstance(width := getattr(value, "width", None), int):  # of Pillow
        size += _PIXEL_BYTES * width * int(getattr(value, "height", 0))
    return size


_OF_MESH = ("vertices", "faces")
