"""The columns of entities and links over the environments of a batch."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ssduck.columns.arrays import Array
from ssduck.columns.expressions import LeftToDuckDBError
from ssduck.geometry.bounds import BoundingBoxes
from ssduck.geometry.poses import IDENTITY, flat_rotation_matrices
from ssduck.geometry.shapes import Geometry, PlacedGeometry
from ssduck.schema import BOX, LINK_FACTOR, POSE, TWIST, entity_of, link_of
from ssduck.simulators.interface import Body
from ssduck.world.batches.batch_world import BatchWorld

_POINT = Geometry.primitive("sphere", (0.0, 0.0, 0.0))


class EnvironmentColumns:
    """The numbers of entities and links at the last tick of a batch, each read when needed."""

    def __init__(self, world: BatchWorld) -> None:
        self._world = world
        self._version = -1
        self._known: dict[tuple[int, str], Array] = {}
        # The ids and columns of which some number is NaN, or one beside them.
        self._with_nan: set[tuple[int, str]] = set()
        # What computes the boxes of an entity or a link in all environments.
        self._boxers: dict[int, BoundingBoxes] = {}

    def column(self, id: int, name: str) -> Array:
        """Returns a column of an entity or a link, by its id, (n,)."""
        self._update()
        key = id, name
        if key not in self._known:
            body, link = self.body_of(id)
            environments = self._world.environments
            if name in POSE:
                self._note(id, POSE, *environments.frames(body, link))
            elif name in TWIST:
                self._note(id, TWIST, environments.velocities(body, link))
            elif name in BOX:
                self._note(id, BOX, self._boxes(id, body, link))
            else:
                raise LeftToDuckDBError
        return self._known[key]

    def _update(self) -> None:
        """Forgets the numbers of an earlier tick."""
        if self._version != self._world.version:
            self._version = self._world.version
            self._known.clear()
            self._with_nan.clear()

    def _note(self, id: int, names: tuple[str, ...], *parts: Array) -> None:
        """Notes columns, from parts of their rows, (n, columns) each."""
        keys = [(id, name) for name in names]
        columns = [column for part in parts for column in np.ascontiguousarray(part.T)]
        self._known.update(zip(keys, columns, strict=True))
        if any(np.isnan(part).any() for part in parts):
            self._with_nan.update(keys)

    def may_be_nan(self, id: int, name: str) -> bool:
        """Checks whether a number of a column that was read at this tick may be NaN."""
        return (id, name) in self._with_nan

    def body_of(self, id: int) -> tuple[Body, int]:
        """Returns the body of an entity or a link, and the number of its link there."""
        snapshot = self._world.snapshot
        body = snapshot.entities[snapshot.rows[entity_of(id)]].body
        if body is None:
            raise LeftToDuckDBError
        return body, link_of(id) if id >= LINK_FACTOR else 0

    def poses(self, body: Body, link: int) -> tuple[Array, Array]:
        """Returns the positions (n, 3) and the orientations (n, 4) of a link."""
        return self._world.environments.frames(body, link)

    def _boxes(self, id: int, body: Body, link: int) -> Array:
        """Returns the boxes of an entity or a link, (n, 6)."""
        shapes = [s for s in body.shapes if id < LINK_FACTOR or s.frame == link]
        if not shapes:
            region = body.links[link].region
            shapes = [PlacedGeometry(link, region or _POINT, np.zeros(3), IDENTITY)]
        links = sorted({shape.frame for shape in shapes})
        if id not in self._boxers:
            placed = [replace(shape, frame=links.index(shape.frame)) for shape in shapes]
            self._boxers[id] = BoundingBoxes(placed, [0] * len(placed), 1)
        frames = [self._world.environments.frames(body, number) for number in links]
        count = len(frames[0][0])
        if all((part == part[:1]).all() for frame in frames for part in frame):  # it stands still
            frames = [(position[:1], orientation[:1]) for position, orientation in frames]
        positions = np.stack([position.T for position, _ in frames], axis=-1)
        with np.errstate(invalid="ignore"):
            matrices = [flat_rotation_matrices(turn).reshape(3, 3, -1) for _, turn in frames]
            turns = np.stack(matrices, axis=-1)
            boxes = self._boxers[id].over(positions.transpose(1, 2, 0), turns.transpose(2, 3, 0, 1))
        return np.broadcast_to(boxes[..., 0], (count, 6))
