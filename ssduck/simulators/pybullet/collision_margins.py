"""The collision margins of PyBullet's shapes: the distance at which they already touch.

Bullet grows hulls and the triangles of concave meshes by a margin. Boxes and cylinders shrink by it
first, spheres and capsules consist of margin, half-spaces have none: for these, contact begins at
the surface. PyBullet returns one number for each link. If the link is a compound (it has several
shapes, or one that is not in the frame of its centre of mass), the number is the compound's own
margin, which has no effect.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ssduck.geometry.shapes import PlacedGeometry
from ssduck.simulators.interface import Body
from ssduck.simulators.pybullet.clients import pybullet

# PyBullet's default for hulls, compounds, and concave meshes that are made by a call, metres.
DEFAULT = 1e-3
_PADDED = ("hull", "mesh")
# The tolerance for a shape in the frame of its link's centre of mass.
_POSE_TOLERANCE = 1e-9


@dataclass(frozen=True)
class LinkMargin:
    """The margin of a link as PyBullet returns it."""

    margin: float | None  # metres; None if PyBullet returns none
    is_compound: bool = False  # whether it is the margin of a compound of the shapes
    # Whether a shape comes from a mesh file; such a hull is a compound of its own.
    is_of_file: bool = False


def link_margin(dynamics: Sequence[Any], entries: Sequence[tuple[Any, ...]] | None) -> LinkMargin:
    """Returns the margin of a link by `getDynamicsInfo` and `getCollisionShapeData`, if called."""
    if entries is None:
        return LinkMargin(None)
    is_offset = [np.abs((*entry[5], *entry[6][:3])).max() > _POSE_TOLERANCE for entry in entries]
    is_of_file = any(
        entry[2] == pybullet.GEOM_MESH and entry[4] not in (b"", b"unknown_file")
        for entry in entries
    )
    return LinkMargin(float(dynamics[11]), len(entries) > 1 or any(is_offset), is_of_file)


def margin_of(type: str, link_margin: LinkMargin) -> float:
    """Returns the margin of a shape, metres.

    `changeDynamics` does not reach the hulls of a mesh file in a compound. A margin of 0 of
    a compound may have been set or not; it counts as not set.
    """
    if type not in _PADDED:
        return 0.0
    default = 0.0 if type == "mesh" and link_margin.is_of_file else DEFAULT
    if link_margin.margin is None:
        return default
    if not link_margin.is_compound:
        return link_margin.margin
    if link_margin.margin in (0.0, DEFAULT) or (type == "hull" and link_margin.is_of_file):
        return default
    return link_margin.margin


def with_margins(shapes: Sequence[PlacedGeometry], link_margin: LinkMargin) -> list[PlacedGeometry]:
    """Returns the shapes of a link with their margins."""
    return [replace(shape, margin=margin_of(shape.geometry.type, link_margin)) for shape in shapes]


def links_with_margins(
    shapes: Sequence[PlacedGeometry], link_margins: Sequence[LinkMargin]
) -> frozenset[int]:
    """Returns the links whose shapes have margins that PyBullet can change."""
    if not link_margins:
        return frozenset()
    links = {shape.frame for shape in shapes if shape.geometry.type in _PADDED}
    return frozenset(link for link in links if link_margins[link].margin is not None)


class MarginReader:
    """Reads the margins of the shapes of bodies, most of which never change.

    Args:
        bodies: the bodies.
        link_margins: the margins of the links of each body when it was described.
        links: the links of each body whose margins may have changed; see `links_with_margins`.
    """

    def __init__(
        self,
        bodies: Sequence[Body],
        link_margins: Sequence[Sequence[LinkMargin]],
        links: Sequence[Iterable[int]],
    ) -> None:
        self.bodies = tuple(bodies)
        self._link_margins = link_margins
        self._links = {place: tuple(some) for place, some in enumerate(links) if some}
        self.changeable = [bodies[place] for place in self._links]
        self._read: list[list[float] | None] = [None] * len(self._links)
        self._margins = [body.margins for body in bodies]

    def read(self, client: int, are_present: Sequence[bool]) -> list[list[float]]:
        """Returns the margins as they are now, metres; the same object if none has changed."""
        now = [
            self._read_now(client, place) if is_present else None
            for place, is_present in zip(self._links, are_present, strict=True)
        ]
        if now != self._read:
            self._read, self._margins = now, [body.margins for body in self.bodies]
            for place, margins in zip(self._links, now, strict=True):
                if margins is not None:
                    self._margins[place] = self._margins_of(place, margins)
        return self._margins

    def _read_now(self, client: int, place: int) -> list[float]:
        """Returns the margins of the links of a body that may have changed."""
        handle, get = self.bodies[place].handle, pybullet.getDynamicsInfo
        return [float(get(handle, link - 1, client)[11]) for link in self._links[place]]

    def _margins_of(self, place: int, margins: Sequence[float]) -> list[float]:
        """Returns the margins of a body's shapes, of those of some of its links."""
        known = self._link_margins[place]
        now = {
            link: replace(known[link], margin=margin)
            for link, margin in zip(self._links[place], margins, strict=True)
        }
        return [
            margin_of(shape.geometry.type, now[shape.frame]) if shape.frame in now else shape.margin
            for shape in self.bodies[place].shapes
        ]
