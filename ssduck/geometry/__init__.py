"""Shapes, poses, and what lies between shapes: distances, overlaps, sight.

Pure functions of numpy arrays that know nothing of simulators, worlds or queries. `shapes` has the
kinds of shapes and their poses. `broad_phase` finds the pairs whose boxes meet, `narrow_phase` asks
such pairs for what their shapes say, one by one or in a `batch`, and `queries` answers by the ids
of entities. `rasterize` cuts shapes into cells of a `raster`.
"""

from typing import TYPE_CHECKING

from ssduck.lazy import exports

if TYPE_CHECKING:
    from ssduck.geometry.bounds import Boxer
    from ssduck.geometry.line_of_sight import are_blocked
    from ssduck.geometry.queries import ShapeQueries
    from ssduck.geometry.rasterize import Rasterizer
    from ssduck.geometry.shapes import Geometry, PlacedGeometry

__all__ = [
    "Boxer",
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
        "bounds": ("Boxer",),
        "shapes": ("Geometry", "PlacedGeometry"),
    },
)
