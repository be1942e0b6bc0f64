"""Copies entities of a tick into a new, running simulation."""

from __future__ import annotations

from collections.abc import Collection, Container, Iterator
from dataclasses import replace

import numpy as np

from ssduck.simulators.backends import BodyToCopy, TickToCopy, backend
from ssduck.simulators.interface import LinkPoses, Simulator
from ssduck.simulators.scenes import SensorSpec
from ssduck.world.snapshot import Snapshot


def excerpt(
    snapshot: Snapshot, ids: Collection[int], source: Simulator
) -> tuple[Simulator, list[SensorSpec]]:
    """Returns a new simulation of some entities of a tick, and the sensors among them.

    Args:
        snapshot: the tick.
        ids: the ids of the entities; with a sensor, its body is copied, too.
        source: the simulator to copy from.
    """
    by_id = {info.id: info for info in snapshot.load_order}
    with_hosts = {*ids, *(by_id[id].mount[0] for id in ids if by_id[id].sensor is not None)}
    sensors = sensors_of(snapshot, with_hosts)
    originals = list(originals_of(snapshot, with_hosts))
    return backend(source.backend).excerpt(source, originals, tick_of(snapshot)), sensors


def tick_of(snapshot: Snapshot) -> TickToCopy:
    """Returns the state of a tick as a whole, to be copied."""
    return TickToCopy(snapshot.time, snapshot.disabled, snapshot.hidden)


def sensors_of(snapshot: Snapshot, ids: Container[int]) -> list[SensorSpec]:
    """Returns the specifications of the sensors among some entities, powered as at the tick."""
    return [
        replace(info.sensor, powered=snapshot.sensing.is_on(info.id))
        for info in snapshot.load_order
        if info.sensor is not None and info.id in ids
    ]


def originals_of(snapshot: Snapshot, ids: Container[int]) -> Iterator[BodyToCopy]:
    """Yields the bodies among some entities with their states at a tick, in load order."""
    groups = {
        body: (group, poses) for group, poses in snapshot.body_groups for body in group.bodies
    }
    joints = snapshot.joints() if snapshot.has("joints") else {}
    for info in snapshot.load_order:
        body = info.body
        if body is None or info.id not in ids:
            continue
        group, poses = groups[body]
        run = group.runs[body]
        link_poses = LinkPoses(poses.positions[run], poses.matrices[run], poses.states[run])
        unknown = np.full((len(body.joints), 3), np.nan)
        yield BodyToCopy(info.name, body, link_poses, joints.get(body, unknown)[:, :2])
