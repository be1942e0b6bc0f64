"""The backends: which simulators ssduck knows by name, and how it makes simulations with each.

A backend is a module with the functions of the protocol `Backend`. `BACKENDS` lists the modules. A
module is imported when a world first needs it. To add a simulator, write its `Simulator`
(`ssduck.simulators.interface`), write its backend, and add a line to `BACKENDS`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import Any, Protocol, TypeAlias, cast

import numpy as np

from ssduck.errors import UnknownNameError, UnsupportedError, nearest
from ssduck.geometry.arrays import Array
from ssduck.geometry.shapes import Geometry, PlacedGeometry
from ssduck.simulators.environments import EnvironmentSimulator
from ssduck.simulators.interface import (
    DEFAULT_BACKEND,
    Body,
    Kind,
    LinkPoses,
    Simulator,
)
from ssduck.simulators.partial import StaticSimulator
from ssduck.simulators.recognition import MUJOCO
from ssduck.simulators.scene_bodies import BodySpec
from ssduck.simulators.scenes import Scene

# The least width of a mesh that stands for a plane, m.
_GROUND = 20.0


def stored_visuals(body: Body) -> list[PlacedGeometry]:
    """Returns what is drawn of a body that no simulator tells of: as recorded, or what collides."""
    return list(body.shapes if body.visuals is None else body.visuals)


def _is_ground(geometry: Geometry) -> bool:
    corners = geometry.vertices
    if geometry.type not in ("mesh", "hull") or len(corners) != 4 or np.any(corners[:, 2]):
        return False
    return bool((np.ptp(corners[:, :2], axis=0) >= _GROUND).all())


BACKENDS = {
    DEFAULT_BACKEND: "ssduck.simulators.pybullet.backend",
    MUJOCO: "ssduck.simulators.mujoco.backend",
}

# The file of the model in the folder of a scene that is saved for MuJoCo.
MJCF_FILE = "world.xml"

# A trimesh.Trimesh, (vertices, faces), or the path of a mesh file. Faces of None make the hull.
Mesh: TypeAlias = Any
# Meshes by body, (body, link) or (body, link, number), in the numbers of the simulator.
ShapesByBody: TypeAlias = Mapping[int | tuple[int, int] | tuple[int, int, int], Mesh]


@dataclass(frozen=True, eq=False)
class BodyToCopy:
    """A body at a tick, to be copied into another simulation or into a scene."""

    name: str  # the name of its entity
    body: Body  # its links, joints and shapes
    link_poses: LinkPoses  # the poses and velocities of its links
    joints: Array  # the positions and velocities of its joints, (joints, 2); NaN where unknown

    @property
    def base_state(self) -> Array:
        """The state of the base, (13,), at the origin of its link frame; see `LinkPoses.states`."""
        state: Array = self.link_poses.states_at(self.link_poses.positions[:1], np.zeros(1, int))[0]
        return state


@dataclass(frozen=True, eq=False)
class TickToCopy:
    """The state of a tick that belongs to no single body."""

    time: float  # simulated seconds
    disabled: frozenset[Body]  # the bodies that take no part in collisions
    hidden: frozenset[Body]  # the bodies that are not drawn


class Backend(Protocol):
    """The functions of a backend.

    A function that the simulator cannot support raises `UnsupportedError`.
    """

    def load(self, scene: Scene) -> Simulator:
        """Starts a simulation of a scene."""

    def attach(
        self,
        client: Any,
        names: Mapping[int, str] | None,
        kinds: Mapping[int, Kind] | None,
        shapes: ShapesByBody | None,
        forward: bool = False,
    ) -> Simulator:
        """Wraps a simulation that the user made and goes on using; see `World.attach`."""

    def environments(self, model: Any, count: int) -> EnvironmentSimulator:
        """Returns many simulations of a model, in its initial state; see `World.batch`."""

    def excerpt(
        self, source: Simulator | None, originals: Sequence[BodyToCopy], tick: TickToCopy
    ) -> Simulator:
        """Starts a simulation of some bodies, in load order, as they are at a tick.

        Args:
            source: the simulator of the world that the tick belongs to, as it is now; None if
                nothing runs that world any more.
            originals: the bodies.
            tick: the time of the tick and its flags.
        """

    def scene_of(
        self,
        simulator: Simulator,
        originals: Sequence[BodyToCopy],
        tick: TickToCopy,
        folder: Path,
        target: str,
    ) -> Scene:
        """Describes a simulation as a scene without sensors; writes its models into a folder.

        Args:
            simulator: the simulation.
            originals: its bodies.
            tick: the time of the tick and its flags.
            folder: the folder of the scene.
            target: the name of the simulator that is to load the scene.
        """

    def visual_shapes(self, simulator: Simulator, body: Body) -> list[PlacedGeometry]:
        """Returns what a simulation of this backend draws of a body; the mesh files are read."""


def backend(name: str = DEFAULT_BACKEND) -> Backend:
    """Returns the backend of a name in `BACKENDS`."""
    if name not in BACKENDS:
        raise UnknownNameError(
            f"there is no simulator {name!r}; the simulators are {', '.join(BACKENDS)}",
            suggestions=nearest(name, BACKENDS),
        )
    return cast("Backend", import_module(BACKENDS[name]))


def mjcf_scene(file: Path) -> Scene:
    """Returns the scene of a model file for MuJoCo, without sensors."""
    body = BodySpec(None, None, file)
    return Scene(name="world", path=file.parent, bodies=(body,), simulator=MUJOCO)


def drawn_shapes(simulator: Simulator, body: Body) -> list[PlacedGeometry]:
    """Returns what a simulator draws of a body; its collision shapes where that is not known.

    Planes in the colour of a ground are in place of large flat meshes: squares of 20 m or more in
    the xy plane of their frame, such as that of `plane.urdf`.

    It is not known of a simulator without a backend, or whose backend does not support it.
    """
    if isinstance(simulator, EnvironmentSimulator):
        simulator = simulator.template
    shapes = stored_visuals(body)
    # A static simulator has the bodies of a what-if world, or of an older record.
    is_told = body.visuals is not None or isinstance(simulator, StaticSimulator)
    if not is_told and simulator.backend in BACKENDS:
        with suppress(UnsupportedError):
            shapes = backend(simulator.backend).visual_shapes(simulator, body)
    plane = Geometry.primitive("plane", (0.0, 0.0, 1.0))
    return [
        replace(shape, geometry=plane, colour=None) if _is_ground(shape.geometry) else shape
        for shape in shapes
    ]
