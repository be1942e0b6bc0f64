"""Shapes, poses and the distances between shapes, as functions of numpy arrays.

The package knows nothing of simulators, worlds or queries. `shapes`, `poses`, `bounds` and
`mesh_files` hold the kinds of shapes, their poses, their boxes and their files. `broad_phase`
finds the candidate pairs, and `narrow_phase` compares the shapes of a pair, one pair at a time. A
`batch` compares all pairs of a tick by `proofs`. `queries` answers by the ids of entities.
`rasters` finds the cells that shapes occupy, and `ray_casting` finds the points
that shapes hide.
"""

from typing import TYPE_CHECKING

from ssduck.lazy import exports

if TYPE_CHECKING:
    from ssduck.geometry.bounds import BoundingBoxes
    from ssduck.geometry.queries import ShapeQueries
    from ssduck.geometry.rasters import Rasterizer
    from ssduck.geometry.ray_casting import are_blocked
    from ssduck.geometry.shapes import Geometry, PlacedGeometry

__all__ = [
    "BoundingBoxes",
    "Geometry",
    "PlacedGeometry",
    "Rasterizer",
    "ShapeQueries",
    "are_blocked",
]

__getattr__, __dir__ = exports(
    __name__,
    {
        "ray_casting": ("are_blocked",),
        "queries": ("ShapeQueries",),
        "rasters": ("Rasterizer",),
        "bounds": ("BoundingBoxes",),
        "shapes": ("Geometry", "PlacedGeometry"),
    },
)
