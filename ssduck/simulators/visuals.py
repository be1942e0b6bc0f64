"""What is drawn of a body: what is known of it, and planes in place of what stands for them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ssduck.geometry.shapes import Geometry
from ssduck.simulators.interface import Body, VisualShape

# The least width of a mesh that stands for a plane, m.
_GROUND = 20.0


def collision_visuals(body: Body) -> list[VisualShape]:
    """Returns the collision shapes of a body, without colours, where nothing else is known."""
    return [
        VisualShape(each.frame, each.geometry, each.position, each.orientation, None)
        for each in body.shapes
    ]


def stored_visuals(body: Body) -> list[VisualShape]:
    """Returns what is drawn of a body that no simulator tells of: as recorded, or what collides."""
    return collision_visuals(body) if body.visuals is None else list(body.visuals)


def with_grounds(shapes: Sequence[VisualShape]) -> list[VisualShape]:
    """Returns shapes with planes, in the colour of a ground, in place of large flat meshes.

    These are squares of 20 m or more in the xy plane of their frame, such as that of `plane.urdf`.
    """
    plane = Geometry.primitive("plane", (0.0, 0.0, 1.0))
    return [
        replace(shape, geometry=plane, colour=None) if _is_ground(shape.geometry) else shape
        for shape in shapes
    ]


def _is_ground(geometry: Geometry) -> bool:
    corners = geometry.vertices
    if geometry.type not in ("mesh", "hull") or len(corners) != 4 or np.any(corners[:, 2]):
        return False
    return bool((np.ptp(corners[:, :2], axis=0) >= _GROUND).all())
