"""Shapes, poses, and what lies between shapes: distances, overlaps, lines of sight.

Pure functions of numpy arrays; they know no simulator, no world and no query. `shapes` defines the
kinds of shapes and their poses. `broad_phase` finds the pairs of shapes whose boxes meet.
`narrow_phase` compares the shapes of one pair, `batch` those of many pairs at once, and `queries`
answers for entities, by their ids. `rasterize` finds the cells of a `raster` that shapes occupy.
"""

from typing import TYPE_CHECKING

from ssduck.lazy import exports

if TYPE_CHECKING:
    from ssduck.geometry.bounds import BoundingBoxes
    from ssduck.geometry.line_of_sight import are_blocked
    from ssduck.geometry.queries import ShapeQueries
    from ssduck.geometry.rasterize import Rasterizer
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
        "line_of_sight": ("are_blocked",),
        "queries": ("ShapeQueries",),
        "rasterize": ("Rasterizer",),
        "bounds": ("BoundingBoxes",),
        "shapes": ("Geometry", "PlacedGeometry"),
    },
)
