"""The poses of all links of a world at a tick, as they are shown."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from ssduck.simulators.interface import Body, LinkPoses
from ssduck.world.layout import TableLayout
from ssduck.world.snapshot import Snapshot

Poses = npt.NDArray[np.float32]

# The link poses of a frame: x y z, w x y z.
_POSE = 7


@dataclass(frozen=True, eq=False)
class Frame:
    """The poses of all links at a tick.

    Attributes:
        layout: the entities; the same object while they are the same.
        hidden: the bodies that are not drawn; the same object until they change.
        bodies: the bodies, in the order of their links among the poses.
        link_poses: the poses of the links, which are never written to.
        number: the number of the tick.
        time: its simulated time, s.
    """

    layout: TableLayout
    hidden: frozenset[Body]
    bodies: tuple[Body, ...]
    link_poses: tuple[LinkPoses, ...]
    number: int
    time: float

    @classmethod
    def of(cls, snapshot: Snapshot) -> Frame:
        """Returns the frame of a tick; it copies nothing, so that a step costs no more."""
        groups = tuple(snapshot.body_groups)
        bodies = tuple(body for group, _ in groups for body in group.bodies)
        poses = tuple(poses for _, poses in groups)
        layout, hidden = snapshot.layout, snapshot.hidden
        return cls(layout, hidden, bodies, poses, snapshot.number, snapshot.time)

    @cached_property
    def poses(self) -> Poses:
        """The poses of the links, (links, 7): x y z, w x y z."""
        parts = [np.hstack((each.positions, each.states[:, 3:7])) for each in self.link_poses]
        return np.concatenate([np.zeros((0, _POSE)), *parts]).astype(np.float32)

    @cached_property
    def ids(self) -> tuple[int, ...]:
        """The ids of the entities of the bodies."""
        ids = {body: id for id, body in self.layout.bodies}
        return tuple(ids[body] for body in self.bodies)

    @property
    def hidden_ids(self) -> frozenset[int]:
        """The ids of the entities that are not drawn."""
        return frozenset(
            id for id, body in zip(self.ids, self.bodies, strict=True) if body in self.hidden
        )

    def has_same_scene(self, other: Frame) -> bool:
        """Checks whether another frame has the same entities, with the same ones hidden."""
        if self.layout is other.layout and self.hidden is other.hidden:
            return True
        return self.ids == other.ids and self.hidden_ids == other.hidden_ids
