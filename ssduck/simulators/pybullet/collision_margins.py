"""The collision margins of PyBullet's shapes: the distance at which they already touch.

Bullet grows hulls and the triangles of concave meshes by a margin. Boxes and cylinders shrink by it
first, spheres and capsules consist of margin, half-spaces have none: for these, contact begins at
the surface. PyBullet returns one number for each link. If the link is a compound (it has several
shapes, or one that is not in the frame of its centre of mass), the number is the compound's own
margin, which has no effect.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ssduck.geometry.shapes import PlacedGeometry
from ssduck.simulators.interface import Body
from ssduck.simulators.pybullet.console import pybullet

# PyBullet's default for hulls, compounds, and concave meshes that are made by a call, metres.
DEFAULT = 1e-3
_PADDED = ("hull", "mesh")
# The tolerance for a shape in the frame of its link's centre of mass.
_POSE_TOLERANCE = 1e-9


@dataclass(frozen=True)
class KnownMargins:
    """The margin of a link as PyBullet returns it.

    Attributes:
        margin: metres; None if PyBullet returns none.
        is_compound: whether it is the margin of a compound of the shapes.
        is_of_file: whether a shape comes from a mesh file; such a hull is a compound of its own.
    """

    margin: float | None
    is_compound: bool = False
    is_of_file: bool = False


def known_margins(
    dynamics: Sequence[Any], entries: Sequence[tuple[Any, ...]] | None
) -> KnownMargins:
    """Returns the margin of a link as PyBullet returns it.

    Args:
        dynamics: the result of `getDynamicsInfo`.
        entries: the result of `getCollisionShapeData`; None if that must not be called.
    """
    if entries is None:
        return KnownMargins(None)
    off = [np.abs((*entry[5], *entry[6][:3])).max() > _POSE_TOLERANCE for entry in entries]
    is_of_file = any(
        entry[2] == pybullet.GEOM_MESH and entry[4] not in (b"", b"unknown_file")
        for entry in entries
    )
    return KnownMargins(float(dynamics[11]), len(entries) > 1 or any(off), is_of_file)


def margin_of(type: str, known: KnownMargins) -> float:
    """Returns the margin of a shape, metres.

    `changeDynamics` does not reach the hulls of a mesh file in a compound. A margin of 0 of a
    compound of hulls may be set or not; it counts as not set.

    Args:
        type: of its geometry.
        known: the margin of its link.
    """
    if type not in _PADDED:
        return 0.0
    default = 0.0 if type == "mesh" and known.is_of_file else DEFAULT
    if known.margin is None:
        return default
    if not known.is_compound:
        return known.margin
    if known.margin in (0.0, DEFAULT) or (type == "hull" and known.is_of_file):
        return default
    return known.margin


def with_margins(shapes: Sequence[PlacedGeometry], known: KnownMargins) -> list[PlacedGeometry]:
    """Returns the shapes of a link with their margins."""
    return [replace(shape, margin=margin_of(shape.geometry.type, known)) for shape in shapes]


def margins_of(client: int, body: Body, known: Sequence[KnownMargins]) -> list[float]:
    """Returns the margins of a body's shapes as they are now, metres.

    Args:
        client: the client that has the body.
        body: the body.
        known: the margins of its links when it came; empty if its margins do not change.
    """
    links = {s.frame for s in body.shapes if s.geometry.type in _PADDED} if known else set()
    now = {
        link: replace(
            known[link], margin=float(pybullet.getDynamicsInfo(body.handle, link - 1, client)[11])
        )
        for link in links
        if known[link].margin is not None
    }
    return [
        margin_of(shape.geometry.type, now[shape.frame]) if shape.frame in now else shape.margin
        for shape in body.shapes
    ]
