"""Excerpts: new, running simulations of some bodies as they are at a tick."""

from __future__ import annotations

from collections.abc import Collection, Container, Iterator
from dataclasses import replace

import numpy as np

from ssduck.simulators.backends import BodyToCopy, TickToCopy, backend
from ssduck.simulators.interface import LinkPoses, Simulator
from ssduck.simulators.scenes import SensorSpec
from ssduck.world.snapshot import Snapshot


def excerpt(
    snapshot: Snapshot, chosen: Collection[int], source: Simulator
) -> tuple[Simulator, list[SensorSpec]]:
    """A new simulation of some entities of a tick, and the sensors that are among them.

    Args:
        snapshot: the tick.
        chosen: the ids of the entities; a sensor brings the body that it sits on.
        source: what runs them now.
    """
    members = {member.id: member for member in snapshot.load_order}
    everyone = {*chosen, *(members[id].mount[0] for id in chosen if members[id].sensor is not None)}
    sensors = sensors_of(snapshot, everyone)
    originals = list(originals_of(snapshot, everyone))
    return backend(source.backend).excerpt(source, originals, tick_of(snapshot)), sensors


def tick_of(snapshot: Snapshot) -> TickToCopy:
    """What a tick tells of all of its bodies."""
    return TickToCopy(snapshot.time, snapshot.disabled, snapshot.hidden)


def sensors_of(snapshot: Snapshot, chosen: Container[int]) -> list[SensorSpec]:
    """The sensors of a tick that are among these entities, on or off as they are."""
    return [
        replace(member.sensor, powered=snapshot.sensing.is_on(member.id))
        for member in snapshot.load_order
        if member.sensor is not None and member.id in chosen
    ]


def originals_of(snapshot: Snapshot, chosen: Container[int]) -> Iterator[BodyToCopy]:
    """What a tick tells of some bodies, in load order."""
    where = {body: (part, told) for part, told in snapshot.body_groups for body in part.bodies}
    joints = snapshot.joints() if snapshot.has("joints") else {}
    for member in snapshot.load_order:
        body = member.body
        if body is None or member.id not in chosen:
            continue
        part, told = where[body]
        run = part.runs[body]
        link_poses = LinkPoses(told.positions[run], told.matrices[run], told.states[run])
        unknown = np.full((len(body.joints), 3), np.nan)
        yield BodyToCopy(member.name, body, link_poses, joints.get(body, unknown)[:, :2])
