"""The columns of entities and links over the environments of a batch, and its tables in raw SQL."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pyarrow as pa

from ssduck.columns.arrays import Array
from ssduck.columns.compiler import LeftToDuckDBError
from ssduck.errors import ArgumentError, UnsupportedError
from ssduck.formatting import joined_names
from ssduck.geometry.bounds import BoundingBoxes
from ssduck.geometry.poses import IDENTITY, flat_rotation_matrices
from ssduck.geometry.shapes import Geometry, PlacedGeometry
from ssduck.schema import BOX, LINK_FACTOR, POSE, TABLES, TWIST, entity_of, link_of
from ssduck.simulators.environments import NO_CONTACTS
from ssduck.simulators.interface import Body
from ssduck.world.batches.batch_world import BatchWorld
from ssduck.world.live_tables import LiveTable
from ssduck.world.rows import contact_rows

# The columns that differ from environment to environment.
CHANGING = frozenset((*POSE, *TWIST, *BOX))
# The number of an environment in programs.
ENV = "env"
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


def batch_table(world: BatchWorld, name: str) -> pa.Table:
    """Returns a table of a world, with the environment of each row as its first column.

    Numbers that the states lack are NULL.
    """
    if name not in _MADE_BY:
        raise UnsupportedError(
            f"raw SQL has {joined_names([*_MADE_BY])} of the batch {world.name!r}, and no {name}: "
            f"those of an environment are a world's, {world.name}.environment(0)"
        )
    with world.lock:
        return _MADE_BY[name](world)


def _entities(world: BatchWorld) -> pa.Table:
    columns, entities = EnvironmentColumns(world), world.snapshot.entities

    def values(name: str) -> Array:
        try:
            return np.stack([columns.column(one.id, name) for one in entities], axis=1)
        except ArgumentError:  # the states lack velocities
            return np.full((world.count, len(entities)), np.nan)
        except LeftToDuckDBError:
            raise UnsupportedError(
                f"raw SQL lacks the sensors of the batch {world.name!r}: ask "
                f"{world.name}.environment(0)"
            ) from None

    return _of_rows(world, "entities", {name: values(name) for name in CHANGING})


def _joints(world: BatchWorld) -> pa.Table:
    environments = world.environments
    bodies = [body for _, body in world.snapshot.layout.bodies]
    for body in bodies:
        environments.check_joints(body)
    parts = [np.zeros((world.count, 0, 3)), *map(environments.joints, bodies)]
    numbers = np.concatenate(parts, axis=1)
    names = ("position", "velocity", "effort")
    return _of_rows(world, "joints", {n: numbers[..., place] for place, n in enumerate(names)})


def _of_rows(world: BatchWorld, name: str, changing: Mapping[str, Array]) -> pa.Table:
    """Returns the rows that all environments have, with numbers (n, rows) of each."""
    with world.at(0), world.pinned((name,)):
        rows = world.snapshot.tables[name].arrow
        count = rows.num_rows
        table = rows.take(np.tile(np.arange(count), world.count))
    for column, values in changing.items():
        own = pa.array(values.ravel(), from_pandas=True)
        table = table.set_column(table.column_names.index(column), column, own)
    return _numbered(world, table, np.repeat(np.arange(world.count), count))


def _contacts(world: BatchWorld) -> pa.Table:
    contacts = world.environments.contacts
    if contacts is None:
        raise ArgumentError(NO_CONTACTS)
    points, layout = contacts.points, world.snapshot.layout
    table = LiveTable(TABLES["contacts"].columns)
    table.resize(len(points))
    ends = np.searchsorted(contacts.environments, np.arange(world.count + 1)).tolist()
    for start, end in pairwise(ends):
        own = points.only(slice(start, end))
        sides, numbers = contact_rows(own, layout.ids_of_handles[own.bodies])
        for column, side in zip(("a", "link_a", "b", "link_b"), sides, strict=True):
            table[column][start:end] = side
        table.doubles("ax", "fz")[:, start:end] = numbers
    table.publish()
    return _numbered(world, table.arrow, contacts.environments)


def _numbered(world: BatchWorld, table: pa.Table, environments: Array) -> pa.Table:
    """Returns rows with their environments, and the tick and the times of the batch."""
    times = {"tick": np.full(len(environments), world.version), "time": world.times[environments]}
    for column, values in times.items():
        table = table.set_column(table.column_names.index(column), column, pa.array(values))
    return table.add_column(0, ENV, pa.array(environments))


_MADE_BY: Mapping[str, Callable[[BatchWorld], pa.Table]] = {
    "entities": _entities,
    "joints": _joints,
    "contacts": _contacts,
}
