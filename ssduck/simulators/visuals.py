"""What is drawn of a body of which only the shapes are known that it collides with."""

from __future__ import annotations

from ssduck.simulators.interface import Body, VisualShape


def collision_visuals(body: Body) -> list[VisualShape]:
    """Returns the collision shapes of a body, without colours, where nothing else is known."""
    return [
        VisualShape(each.frame, each.geometry, each.position, each.orientation, None)
        for each in body.shapes
    ]


def stored_visuals(body: Body) -> list[VisualShape]:
    """Returns what is drawn of a body that no simulator tells of: as recorded, or what collides."""
    return collision_visuals(body) if body.visuals is None else list(body.visuals)
