"""Relations of shapes, contacts and joints over all environments of a batch in one call.

The shapes of two entities in each environment become pairs of one narrow phase, as those of two
entities at many recorded ticks do, so that nothing is compared across environments.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from ssduck.columns.arrays import Array, ArrayValues, Kernel
from ssduck.columns.compiler import LeftToDuckDBError
from ssduck.errors import ArgumentError
from ssduck.geometry.arrays import Flags, Indices
from ssduck.geometry.distance import CallCounter
from ssduck.geometry.pair_batch import PairQuestion
from ssduck.geometry.tick_shapes import depth
from ssduck.interpreter.batches.columns import EnvironmentColumns
from ssduck.recording.replay.batch_queries import EntityShapes, PairSide
from ssduck.schema import LINK_FACTOR, entity_of
from ssduck.simulators.contact_pairs import OPPOSING, are_at, are_of
from ssduck.simulators.environments import NO_CONTACTS, EnvironmentContacts
from ssduck.simulators.interface import SCALAR_JOINTS, Joint
from ssduck.simulators.kinematics import openness
from ssduck.sql.relations.geometry_query import GeometryUdf
from ssduck.sql.relations.motion import JOINT_UDFS
from ssduck.sql.relations.registry import RELATIONS
from ssduck.world.batches.batch_world import BatchWorld
from ssduck.world.layout import EntityInfo

# The questions that functions of shapes are about pairs.
_QUESTIONS = {
    relation.geometry.function: relation.geometry.over_ticks
    for relation in RELATIONS.values()
    if relation.geometry is not None and relation.geometry.over_ticks is not None
}


class EnvironmentShapes:
    """The narrow phase over environments; see `ssduck.columns.arrays.Calls`."""

    def __init__(self, world: BatchWorld, columns: EnvironmentColumns) -> None:
        self._world, self._columns = world, columns
        self._members: dict[int, EntityInfo] = {}
        self._shapes = EntityShapes(self._members)
        # The environment of each row; None where each is the row of its number.
        self._environments: Indices | None = None

    @property
    def environments(self) -> Indices:
        """The environment of each row."""
        return np.arange(self._world.count) if self._environments is None else self._environments

    def of_rows(self, values: Array) -> Array:
        """Returns the values of environments, (n, …), for each row."""
        return values if self._environments is None else values[self._environments]

    @contextmanager
    def with_rows(self, environments: Indices) -> Iterator[None]:
        """Lets rows be of other environments in a context.

        Args:
            environments: (rows,), the environment of each.
        """
        self._environments = environments
        try:
            yield
        finally:
            self._environments = None

    @property
    def margins(self) -> float:
        """The largest distance, m, of shapes that touch by their margins."""
        return self._world.snapshot.margins

    def values(self, udf: GeometryUdf, arguments: Sequence[Array], places: Indices) -> Array:
        """Returns the values of a function of two entities' shapes, (m,)."""
        kind = _QUESTIONS.get(udf.function)
        distances = [np.unique(argument) for argument in arguments[udf.entities :]]
        has_pair_margins = self._world.snapshot.margins_of_pairs is not None
        if kind is None or udf.entities != 2 or any(len(d) != 1 for d in distances):
            raise LeftToDuckDBError
        distance = float(distances[0][0]) if distances else 0.0
        if not distance >= 0.0 or (udf.uses_margins and has_pair_margins):
            raise LeftToDuckDBError
        question = PairQuestion(kind, depth(distance) if kind == "colliding" else distance)
        if question.needs_whole_tick:
            raise LeftToDuckDBError
        first, second = (self._side(ids, places) for ids in arguments[:2])
        answers = self._shapes.answers(first, second, question, CallCounter())
        if answers.is_open.any() or np.isnan(answers.values).any():
            raise LeftToDuckDBError
        return answers.values

    def _side(self, ids: Indices, rows: Indices) -> PairSide:
        environments = self.environments[rows]
        poses = np.zeros((len(rows), 7))
        for id in np.unique(ids).tolist():
            self._add(id)
            chosen = np.flatnonzero(ids == id)
            _, link = self._columns.body_of(id)
            poses[chosen] = self._link_poses(environments, chosen, id, link)
        return PairSide(ids.astype(np.int64), poses, partial(self._link_poses, environments))

    def _link_poses(self, environments: Indices, rows: Indices, id: int, link: int) -> Array:
        """Returns the poses of a link in the environments of some rows, (rows, 7)."""
        body, _ = self._columns.body_of(id)
        poses = self._world.environments.frames(body, link)
        return np.hstack([part[environments[rows]] for part in poses])

    def _add(self, id: int) -> None:
        """Notes an entity, or a link as an entity of its own, of which the shapes are compared."""
        if id in self._members:
            return
        snapshot = self._world.snapshot
        member = snapshot.entities[snapshot.rows[entity_of(id)]]
        if id >= LINK_FACTOR:
            body, link = self._columns.body_of(id)
            if body.links[link].region is not None:
                raise LeftToDuckDBError  # a site has its region as its shape
            shapes = [replace(shape, frame=0) for shape in body.shapes if shape.frame == link]
            alone = replace(body, links=(body.links[link],), joints=(), shapes=tuple(shapes))
            member = replace(member, body=alone)
        self._members[id] = member


def kernels_of(world: BatchWorld, columns: EnvironmentColumns) -> dict[str, Kernel]:
    """Returns the functions of joints and contacts over environments, by their names in SQL."""
    of_contacts = {
        "hasContact": _has_contact,
        "inContact": _in_contact,
        "contactForce": _contact_force,
        "grasped": _grasped,
    }
    assert of_contacts.keys() == {r.name for r in RELATIONS.values() if r.of_contacts is not None}
    kernels: dict[str, Kernel] = {
        name: partial(_of_contacts, world, function) for name, function in of_contacts.items()
    }
    return kernels | {name: partial(_of_joints, world, columns, name) for name in JOINT_UDFS}


def _of_joints(
    world: BatchWorld,
    columns: EnvironmentColumns,
    name: str,
    values: ArrayValues,
    arguments: Sequence[Array],
) -> Array:
    _, _, ids, *names = arguments
    if ids.size != 1 or any(each.size != 1 for each in names):
        raise LeftToDuckDBError
    body, link = columns.body_of(int(ids.item()))
    if link:
        raise LeftToDuckDBError
    world.environments.check_joints(body)
    positions = world.environments.joints(body)[..., 0]
    wanted = {str(each.item()) for each in names} or {joint.name for joint in body.joints}
    found = [(place, joint) for place, joint in enumerate(body.joints) if joint.name in wanted]
    if not found:
        raise LeftToDuckDBError
    if name == "joints position":
        ((place, joint),) = found
        if joint.type not in SCALAR_JOINTS:
            raise LeftToDuckDBError
        result: Array = positions[:, place]
    else:
        shares = [_openness(joint, positions[:, place]) for place, joint in found]
        if any(share is None for share in shares) and names:
            raise LeftToDuckDBError
        known = [share for share in shares if share is not None]
        result = np.max(known, axis=0) if known else np.full(world.count, -np.inf)
    result = result[_environments(values)][None, :]
    values.leave(np.isnan(result))
    return result


def _environments(values: ArrayValues) -> Indices:
    """Returns the environment of each row."""
    shapes = values.calls
    assert isinstance(shapes, EnvironmentShapes)
    return shapes.environments


def _openness(joint: Joint, positions: Array) -> Array | None:
    """Returns the openness of a joint at n positions, (n,); see `joints.openness`."""
    if openness(joint, 0.0) is None:
        return None
    assert joint.lower is not None
    assert joint.upper is not None
    is_closed_above = abs(joint.upper) < abs(joint.lower)
    distances = joint.upper - positions if is_closed_above else positions - joint.lower
    shares: Array = distances / (joint.upper - joint.lower)
    return shares


@dataclass(frozen=True, eq=False)
class _Between:
    """The m contacts of two entities or links in n environments."""

    count: int  # n
    environments: Indices  # (m,), ascending
    forces: Array  # (m,), N
    normals: Array  # (3, m), each of which points from the second of the two to the first

    def are_there(self, chosen: Flags | slice = slice(None)) -> Flags:
        """Checks in which environments some of them are, (n,)."""
        result = np.zeros(self.count, np.bool_)
        result[self.environments[chosen]] = True
        return result


def _has_contact(between: _Between) -> Flags:
    return between.are_there()


def _in_contact(between: _Between) -> Flags:
    return between.are_there(between.forces > 0.0)


def _contact_force(between: _Between) -> Array:
    return np.bincount(between.environments, between.forces, between.count)


def _grasped(between: _Between) -> Flags:
    """Checks in which environments two that press oppose each other."""
    pressing = between.forces > 0.0
    environments, normals = between.environments[pressing], between.normals[:, pressing]
    counts = np.bincount(environments, minlength=between.count)
    starts = np.cumsum(counts) - counts
    # The normals of each environment, and zeros behind them, which oppose nothing.
    table = np.zeros((3, between.count, int(counts.max(initial=0))))
    table[:, environments, np.arange(len(environments)) - starts[environments]] = normals
    x, y, z = table[..., None] * table[..., None, :]
    opposed: Flags = (x + y + z <= OPPOSING).any(axis=(1, 2))
    return opposed


_NEED_FORCES = (_in_contact, _contact_force, _grasped)


def _of_contacts(
    world: BatchWorld,
    function: Callable[[_Between], Array],
    values: ArrayValues,
    ids: Sequence[Array],
) -> Array:
    """Returns the values of a function of the contacts of two entities or links, (1, rows)."""
    contacts = world.environments.contacts
    if contacts is None:
        raise ArgumentError(NO_CONTACTS)
    for needed, is_known in (
        ("force", function not in _NEED_FORCES or contacts.has_forces),
        ("frame", function is not _grasped or contacts.has_normals),
    ):
        if not is_known:
            raise ArgumentError(
                f"the contacts of these environments have no {needed}: give tick "
                f"contact={{'geom': …, 'dist': …, '{needed}': …}}"
            )
    rows_of = _environments(values)
    a, b = (np.broadcast_to(id, (1, values.count)).ravel() for id in ids)
    if ids[0].size == ids[1].size == 1:
        of_all: Array = function(_between(world, contacts, int(a[0]), int(b[0])))
        return of_all[rows_of][None, :]
    kind = np.float64 if function is _contact_force else np.bool_
    result: Array = np.zeros((1, values.count), kind)
    touching = np.flatnonzero(_are_in_contact(world, contacts, rows_of, a, b))
    for first, second in np.unique(np.stack((a, b))[:, touching], axis=1).T.tolist():
        rows = touching[(a[touching] == first) & (b[touching] == second)]
        own = function(_between(world, contacts, first, second))
        result[0, rows] = own[rows_of[rows]]
    return result


def _are_in_contact(
    world: BatchWorld, contacts: EnvironmentContacts, environments: Indices, a: Indices, b: Indices
) -> Flags:
    """Checks which pairs of rows are of entities that have contacts in their environments."""
    layout = world.snapshot.layout
    touching = layout.ids_of_handles[contacts.points.bodies.T]
    own, given = (
        (where * LINK_FACTOR + np.minimum(*pair)) * LINK_FACTOR + np.maximum(*pair)
        for where, pair in (
            (contacts.environments, touching),
            (environments, (a % LINK_FACTOR, b % LINK_FACTOR)),
        )
    )
    return np.isin(given, own)


def _between(world: BatchWorld, contacts: EnvironmentContacts, a: int, b: int) -> _Between:
    """Returns the contacts of two entities or links; one has none with itself."""
    points = contacts.points
    entities = world.snapshot.layout.ids_of_handles[points.bodies.T]
    sides = entities, points.links.T
    rows = np.flatnonzero(are_of(sides, a, b) & (a != b))
    # Contacts have their sides in the order of the geoms.
    signs = np.where(are_at(sides, a)[0][rows], 1.0, -1.0)
    normals = signs * points.normals[rows].T
    return _Between(world.count, contacts.environments[rows], points.forces[rows], normals)
