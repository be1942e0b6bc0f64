"""The simulators that worlds run in: one entry each, and what each of them does (`Backend`).

A backend is a module. It is imported when the first world needs it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, Protocol, TypeAlias, cast

from ssduck.geometry.arrays import Array
from ssduck.simulators.interface import Body, Kind, LinkPoses, Simulator
from ssduck.simulators.scenes import Scene

BACKENDS = {"pybullet": "ssduck.simulators.pybullet.backend"}

# A trimesh.Trimesh, (vertices, faces), or the path of a mesh file; faces of None make the hull.
Mesh: TypeAlias = Any
# By a body, (body, link), or (body, link, number), in the simulator's numbers.
ShapesByBody: TypeAlias = Mapping[int | tuple[int, int] | tuple[int, int, int], Mesh]


@dataclass(frozen=True, eq=False)
class BodyToCopy:
    """A body that is to be copied, as a tick tells of it.

    Attributes:
        name: in its world.
        body: what it is made of.
        frames: where its links are.
        joints: their positions and velocities, (joints, 2); NaN for what nobody knows.
    """

    name: str
    body: Body
    frames: LinkPoses
    joints: Array


@dataclass(frozen=True, eq=False)
class TickToCopy:
    """What else a tick tells.

    Attributes:
        time: simulated seconds.
        disabled: the bodies that take no part in collisions.
        hidden: the bodies that are not drawn.
    """

    time: float
    disabled: frozenset[Body]
    hidden: frozenset[Body]


class Backend(Protocol):
    """What a simulator does for worlds."""

    def load(self, scene: Scene) -> Simulator:
        """A new simulation of a scene.

        Raises:
            SceneError: the scene cannot be loaded: key and reason.
        """

    def attach(
        self,
        client: Any,
        names: Mapping[int, str] | None,
        kinds: Mapping[int, Kind] | None,
        shapes: ShapesByBody | None,
    ) -> Simulator:
        """A user's own simulation; see `World.attach`."""

    def excerpt(
        self, source: Simulator | None, originals: Sequence[BodyToCopy], tick: TickToCopy
    ) -> Simulator:
        """A new simulation of some bodies as they are at a tick.

        Args:
            source: what runs them, or the world that the tick is of, now; None if nobody does
                any more.
            originals: the bodies, in load order.
            tick: when that is.

        Raises:
            SimulatorError: the source does not answer, or there is no room for another one.
            UnsupportedError: a body is soft.
            SceneError: a model's file cannot be loaded any more.
        """

    def scene_of(
        self, simulator: Simulator, originals: Sequence[BodyToCopy], tick: TickToCopy, folder: Path
    ) -> Scene:
        """The scene that a simulation of this backend is, without its sensors.

        Writes its models into a folder.
        """


def backend(name: str = "pybullet") -> Backend:
    """The backend of that name."""
    return cast("Backend", import_module(BACKENDS[name]))
