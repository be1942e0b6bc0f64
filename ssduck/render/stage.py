"""What is drawn of a world: the shapes of its entities, with their poses and colours."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from ssduck.adapters.marks import Mark
from ssduck.geometry.arrays import Array
from ssduck.geometry.poses import rotation_matrices
from ssduck.geometry.shapes import Geometry
from ssduck.geometry.solids import solid_of
from ssduck.simulators.backends import drawn_shapes
from ssduck.view.frames import Frame
from ssduck.world.world import World

HIGHLIGHT = np.array([1.0, 0.416, 0.075])
DIMMED = np.array([0.765, 0.792, 0.827])
GROUND = (0.835, 0.859, 0.886, 1.0)
# Entities without colours get one of these, in turn.
PALETTE = np.array(
    [
        [0.435, 0.561, 0.702],
        [0.702, 0.561, 0.435],
        [0.498, 0.659, 0.541],
        [0.659, 0.541, 0.627],
        [0.604, 0.624, 0.427],
        [0.435, 0.639, 0.659],
        [0.702, 0.502, 0.478],
        [0.510, 0.525, 0.710],
        [0.639, 0.639, 0.639],
        [0.761, 0.659, 0.471],
    ]
)
# The part of its colour that a shape keeps when others stand out.
_KEPT = 0.25


@dataclass(frozen=True, eq=False)
class Stage:
    """The shapes of a world while its entities are the same.

    Attributes:
        frame: the tick that they are of.
        geometries: the geometry of each shape.
        links: (n,), the row of its link among the poses of a frame.
        entities: (n,), the id of its entity.
        numbers: (n,), the number of its link in its entity.
        local: (n, 4, 4), its pose in the link.
        colours: (n, 4), red, green, blue, alpha, 0 to 1.
    """

    frame: Frame
    geometries: list[Geometry]
    links: Array
    entities: Array
    numbers: Array
    local: Array
    colours: Array

    @classmethod
    def of(cls, world: World, frame: Frame) -> Stage:
        """Returns what is drawn of a world at a tick."""
        owners = {info.body: info for info in frame.layout.entities if info.body is not None}
        places = {info.id: place for place, info in enumerate(frame.layout.entities)}
        shapes, rows, first = [], [], 0
        for body in frame.bodies:
            info = owners[body]
            for shape in () if body in frame.hidden else drawn_shapes(world.simulator, body):
                colour = shape.colour
                if colour is None and shape.geometry.type == "plane":
                    colour = GROUND
                if colour is None:
                    red, green, blue = PALETTE[places[info.id] % len(PALETTE)]
                    colour = (red, green, blue, 1.0)
                shapes.append(shape)
                rows.append((first + shape.frame, info.id, shape.frame, *colour))
            first += len(body.links)
        table = np.array(rows, dtype=float).reshape(-1, 7)
        links, entities, numbers = table[:, :3].astype(np.intp).T
        local = _matrices(
            np.array([shape.position for shape in shapes]).reshape(-1, 3),
            np.array([shape.orientation for shape in shapes]).reshape(-1, 4),
        )
        geometries = [shape.geometry for shape in shapes]
        return cls(frame, geometries, links, entities, numbers, local, table[:, 3:])

    def matrices(self, frame: Frame) -> Array:
        """Returns the poses of the shapes in the world at a tick, (n, 4, 4)."""
        poses = frame.poses[self.links].astype(float)
        matrices = _matrices(poses[:, :3], poses[:, 3:])
        # A pose that is not a number has no place in a picture.
        matrices[~np.isfinite(matrices).all(axis=(1, 2))] = 0.0
        placed: Array = matrices @ self.local
        return placed

    def highlighted(self, marks: Iterable[Mark]) -> Array:
        """Returns the colours while some entities and links stand out; all do if there are none."""
        colours = self.colours.copy()
        found = list(marks)
        if not found:
            return colours
        chosen = np.zeros(len(colours), dtype=bool)
        for entity, link in found:
            chosen |= (self.entities == entity) & ((link < 0) | (self.numbers == link))
        colours[chosen, :3] = HIGHLIGHT
        colours[chosen, 3] = np.maximum(colours[chosen, 3], 0.6)
        colours[~chosen, :3] = _KEPT * colours[~chosen, :3] + (1 - _KEPT) * DIMMED
        return colours

    def bounds(self, matrices: Array) -> tuple[Array, Array]:
        """Returns the lower and upper corner, (3,) each, of the box of all finite shapes, m."""
        solids = [solid_of(each) for each in self.geometries]
        radii = np.array([solid.bounding_radius for solid in solids])
        middles = np.array([solid.centre for solid in solids]).reshape(-1, 3)
        centres = np.einsum("nij,nj->ni", matrices[:, :3, :3], middles) + matrices[:, :3, 3]
        kept = np.isfinite(centres).all(axis=1) & (radii > 0) & np.isfinite(radii)  # no planes
        if not kept.any():
            return np.array([-1.0, -1.0, 0.0]), np.array([1.0, 1.0, 1.0])
        low = (centres - radii[:, None])[kept].min(axis=0)
        high = (centres + radii[:, None])[kept].max(axis=0)
        return low, high


def _matrices(positions: Array, orientations: Array) -> Array:
    """Returns poses as matrices (n, 4, 4); orientations are w, x, y, z."""
    matrices = np.zeros((len(positions), 4, 4))
    matrices[:, :3, :3] = rotation_matrices(orientations)
    matrices[:, :3, 3], matrices[:, 3, 3] = positions, 1.0
    return matrices
