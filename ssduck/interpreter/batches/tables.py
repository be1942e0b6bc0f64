"""The tables of a batch for raw SQL: the rows of all environments at the last tick."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import pairwise

import numpy as np
import pyarrow as pa

from ssduck.columns.arrays import Array
from ssduck.columns.expressions import LeftToDuckDBError
from ssduck.errors import ArgumentError, UnsupportedError
from ssduck.formatting import joined_names
from ssduck.interpreter.batches.columns import EnvironmentColumns
from ssduck.interpreter.batches.evaluator import ENV
from ssduck.interpreter.batches.expressions import CHANGING
from ssduck.schema import TABLES
from ssduck.simulators.environments import NO_CONTACTS
from ssduck.simulators.interface import ContactPoints
from ssduck.world.batches.batch_world import BatchWorld
from ssduck.world.live_tables import LiveTable
from ssduck.world.rows import contact_rows


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
        own = ContactPoints(*(values[start:end] for values in vars(points).values()))
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
