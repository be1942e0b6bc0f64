"""Excerpts: new, running worlds of some entities of another."""

from __future__ import annotations

from collections.abc import Container, Iterable, Iterator
from dataclasses import replace

import numpy as np

from ssduck.entities import Entity
from ssduck.errors import ArgumentError
from ssduck.simulators import Frames
from ssduck.simulators.pybullet_copies import Original, Tick
from ssduck.simulators.pybullet_copies import excerpt as copied
from ssduck.world import World


def excerpt(world: World, entities: Iterable[str | Entity]) -> World:
    """A new world of some entities; see `World.excerpt`."""
    # Nothing is to move while it is read: neither here nor where the simulation is.
    # The tick of a client that others step cannot be taken anew for its joints.
    tables = () if world.simulator.watched else ("joints",)
    with world.held(tables), world.origin.lock:
        snapshot = world.snapshot
        members = {member.id: member for member in snapshot.listed}
        chosen = {_id(world, entity) for entity in entities}
        chosen |= {members[id].mount[0] for id in chosen if members[id].sensor is not None}
        sensors = [
            replace(member.sensor, powered=snapshot.sensing.is_on(member.id))
            for member in members.values()
            if member.sensor is not None and member.id in chosen
        ]
        tick = Tick(world.time, snapshot.disabled, snapshot.hidden)
        simulator = copied(world.origin.simulator, list(originals_of(world, chosen)), tick)
    return World.owning(simulator, world.name, sensors, world.camera)


def _id(world: World, entity: str | Entity) -> int:
    """The id of an entity of a world, which may be a past one.

    Raises:
        UnknownNameError: there is none of that name, with the nearest names.
        ArgumentError: it is of another world.
        RemovedEntityError: it is not in the world at its tick.
    """
    if not isinstance(entity, Entity):
        return world[entity].id
    if entity.world not in (world, world.origin):
        raise ArgumentError(f"{entity!r} is in world {entity.world.name!r}, not in {world.name!r}")
    if entity.id not in world.snapshot.rows:
        raise entity.removed()
    return entity.id


def originals_of(world: World, chosen: Container[int]) -> Iterator[Original]:
    """What the tick tells of some bodies, in load order."""
    snapshot = world.snapshot
    where = {body: (part, told) for part, told in snapshot.parts for body in part.bodies}
    joints = snapshot.joints() if snapshot.has("joints") else {}
    for member in snapshot.listed:
        body = member.body
        if body is None or member.id not in chosen:
            continue
        part, told = where[body]
        run = part.runs[body]
        frames = Frames(told.positions[run], told.matrices[run], told.states[run])
        unknown = np.full((len(body.joints), 3), np.nan)
        yield Original(member.name, body, frames, joints.get(body, unknown)[:, :2])
