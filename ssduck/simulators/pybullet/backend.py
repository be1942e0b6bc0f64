"""The functions of `ssduck.simulators.backends.Backend` for PyBullet."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NoReturn

from ssduck import validation
from ssduck.errors import ArgumentError, SelectScriptError, SimulatorError, UnsupportedError
from ssduck.formatting import short_repr
from ssduck.geometry.shapes import PlacedGeometry
from ssduck.simulators.backends import MJCF_FILE, BodyToCopy, ShapesByBody, TickToCopy, mjcf_scene
from ssduck.simulators.interface import Body, Kind, Simulator
from ssduck.simulators.pybullet import introspection
from ssduck.simulators.pybullet.clients import all_handles_of, new_client, pybullet
from ssduck.simulators.pybullet.excerpt import excerpt
from ssduck.simulators.pybullet.given_bodies import user_shapes
from ssduck.simulators.pybullet.mjcf_writer import write_mjcf
from ssduck.simulators.pybullet.scene_loader import load_models
from ssduck.simulators.pybullet.scene_writer import scene_of as describe_scene
from ssduck.simulators.pybullet.simulator import PyBulletSimulator
from ssduck.simulators.recognition import MUJOCO
from ssduck.simulators.scenes import Scene

__all__ = ["attach", "environments", "excerpt", "load", "scene_of", "visual_shapes"]


def load(scene: Scene) -> PyBulletSimulator:
    """Starts a PyBullet simulation of a scene."""
    with new_client() as client:
        loaded = load_models(scene, client)
        kinds = {handle: spec.kind for handle, spec in loaded.origins.items() if spec.kind}
        names = loaded.names
        return PyBulletSimulator(client, owned=True, names=names, kinds=kinds, loaded=loaded)


def environments(model: Any, count: int) -> NoReturn:
    """Raises `UnsupportedError`: PyBullet has clients, not models."""
    del model
    raise UnsupportedError(
        f"PyBullet has no models: World.batch(world, {count}) takes a loaded or attached world"
    )


def attach(
    client: Any,
    names: Mapping[int, str] | None,
    kinds: Mapping[int, Kind] | None,
    shapes: ShapesByBody | None = None,
    forward: bool = False,
) -> PyBulletSimulator:
    """Wraps the user's own client: its number, or an object that holds it as `_client`."""
    if forward:
        raise ArgumentError("attach: forward is for MuJoCo; PyBullet has the poses of its time")
    number = getattr(client, "_client", client)
    if not validation.is_integer(number) or not pybullet.isConnected(int(number)):
        raise SimulatorError(f"{client!r} is no connected PyBullet client")
    number = int(number)
    handles = all_handles_of(number)
    names = validation.mapping(names, "attach: names are given in a dict by body number")
    kinds = validation.mapping(kinds, "attach: kinds are given in a dict by body number")
    for handle in (*names, *kinds):
        if not validation.is_integer(handle) or handle not in handles:
            listed = ", ".join(map(str, handles)) or "none"
            raise SelectScriptError(
                f"PyBullet has no body {short_repr(handle)}; its bodies: {listed}"
            )
    for handle, kind in kinds.items():
        if kind not in ("robot", "kinbody"):
            raise SelectScriptError(f"body {handle}: {kind!r} is neither 'robot' nor 'kinbody'")
    for handle, name in names.items():
        validation.text(name, f"attach: names: the name of body {handle} must be a text")
    by_body = user_shapes(number, handles, shapes)
    return PyBulletSimulator(number, owned=False, names=names, kinds=kinds, shapes=by_body)


def scene_of(
    simulator: Simulator,
    originals: Sequence[BodyToCopy],
    tick: TickToCopy,
    folder: Path,
    target: str,
) -> Scene:
    """Describes a simulation as a scene, without its sensors; writes its models into a folder."""
    assert isinstance(simulator, PyBulletSimulator)
    if target == MUJOCO:
        model = folder / MJCF_FILE
        simulator.call(lambda: write_mjcf(simulator, originals, tick, model))
        return mjcf_scene(model)
    return simulator.call(lambda: describe_scene(simulator, originals, tick, folder))


def visual_shapes(simulator: Simulator, body: Body) -> list[PlacedGeometry]:
    """Returns what PyBullet draws of a body; see `Backend.visual_shapes`."""
    assert isinstance(simulator, PyBulletSimulator)
    return simulator.call(lambda: introspection.visual_shapes(simulator, body))
