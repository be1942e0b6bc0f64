"""Visual shapes: what a simulator draws of a body, beside the shapes that it collides with."""

from __future__ import annotations

from dataclasses import dataclass

from ssduck.geometry.arrays import Array
from ssduck.geometry.shapes import Geometry
from ssduck.simulators.interface import Body


@dataclass(frozen=True, eq=False)
class VisualShape:
    """A shape that is drawn.

    Attributes:
        link: the index of its link; the base is 0.
        geometry: its form.
        position: (3,), in the link frame, m.
        orientation: (4,), in the link frame, w, x, y, z.
        colour: red, green, blue, alpha, from 0 to 1; None if the simulator has none.
    """

    link: int
    geometry: Geometry
    position: Array
    orientation: Array
    colour: tuple[float, float, float, float] | None


def collision_visuals(body: Body) -> list[VisualShape]:
    """Returns the collision shapes of a body, without colours, where nothing else is known."""
    return [
        VisualShape(each.frame, each.geometry, each.position, each.orientation, None)
        for each in body.shapes
    ]
