"""The functions of `ssduck.simulators.backends.Backend` for MuJoCo."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from ssduck import validation
from ssduck.errors import (
    ArgumentError,
    SceneError,
    UnknownNameError,
    UnsupportedError,
    nearest,
    warn,
)
from ssduck.formatting import joined_names, short_repr
from ssduck.geometry.shapes import PlacedGeometry
from ssduck.simulators.backends import MJCF_FILE, BodyToCopy, ShapesByBody, TickToCopy, mjcf_scene
from ssduck.simulators.interface import Body, Kind, Simulator
from ssduck.simulators.model_xml import STATE_KEY
from ssduck.simulators.mujoco import rendering
from ssduck.simulators.mujoco.bodies import body_names, kind_by_joints, kinds_in, roots_of
from ssduck.simulators.mujoco.environments import environments_of as environments
from ssduck.simulators.mujoco.flexes import entity_roots
from ssduck.simulators.mujoco.interventions import add_spare_welds
from ssduck.simulators.mujoco.library import mujoco
from ssduck.simulators.mujoco.saving import excerpt, write_model
from ssduck.simulators.mujoco.scene_loader import load_bodies
from ssduck.simulators.mujoco.simulator import MuJoCoSimulator
from ssduck.simulators.recognition import MUJOCO, source_of
from ssduck.simulators.scene_bodies import MODEL_FILES
from ssduck.simulators.scenes import Scene

__all__ = ["attach", "environments", "excerpt", "load", "scene_of", "visual_shapes"]


def load(scene: Scene) -> MuJoCoSimulator:
    """Starts a simulation of a scene.

    An MJCF file by itself begins with the key `ssduck`, if it has one, as those that `World.save`
    writes.
    """
    file = _mjcf_file(scene)
    if file is None:
        return load_bodies(scene)
    try:
        # The specification is the source of the model, which is kept to save it.
        spec = mujoco.MjSpec.from_file(str(file))
        add_spare_welds(spec)
        compiled = spec.compile()
        data = mujoco.MjData(compiled)
    # MuJoCo's binding turns what it does not know, as an end of the memory, into a RuntimeError.
    except (ValueError, RuntimeError, MemoryError, mujoco.FatalError) as error:
        raise SceneError(f"{scene.path} cannot be loaded: {error}") from error
    if not (compiled.opt.timestep > 0 and math.isfinite(compiled.opt.timestep)):
        raise SceneError(f"{scene.path}: the timestep is not a number above 0")
    state = mujoco.mj_name2id(compiled, mujoco.mjtObj.mjOBJ_KEY, STATE_KEY)
    if state >= 0:
        mujoco.mj_resetDataKeyframe(compiled, data, state)
    mujoco.mj_forward(compiled, data)
    kinds = kinds_in(compiled)
    return MuJoCoSimulator(lambda: (compiled, data), owned=True, kinds=kinds, spec=spec)


def _mjcf_file(scene: Scene) -> Path | None:
    """Returns the MJCF file of a scene of that, sensors and a camera alone; None for others."""
    model = scene.bodies[0].model if len(scene.bodies) == 1 else None
    if not isinstance(model, Path) or model.suffix.lower() not in MODEL_FILES["mjcf"]:
        return None
    kept = ("name", "path", "description", "camera", "sensors", "simulator")
    plain = replace(mjcf_scene(model), **{key: getattr(scene, key) for key in kept})
    return model if scene == plain else None


def attach(
    client: Any,
    names: Mapping[int, str] | None,
    kinds: Mapping[int, Kind] | None,
    shapes: ShapesByBody | None = None,
    forward: bool = False,
) -> MuJoCoSimulator:
    """Wraps the user's own model and data."""
    if shapes:
        raise ArgumentError("attach: shapes: MuJoCo gives all of its shapes; leave them out")
    forward = validation.boolean(forward, "attach: forward")
    source = source_of(client)
    model, _ = source()
    named = dict(validation.mapping(names, "attach: names are given in a dict"))
    kinds_of = dict(validation.mapping(kinds, "attach: kinds are given in a dict"))
    for argument, keys in (("names", named), ("kinds", kinds_of)):
        for key in keys:
            _check_root(model, key, argument)
    for root, name in named.items():
        validation.text(name, f"attach: names: the name of body {root} must be a text")
    for root, kind in kinds_of.items():
        if kind not in ("robot", "kinbody"):
            raise ArgumentError(f"attach: kinds: body {root}: {kind!r} is no robot or kinbody")
    return MuJoCoSimulator(source, owned=False, names=named, kinds=kinds_of, forward=forward)


def _check_root(model: Any, key: Any, argument: str) -> None:
    """Checks that a number or a name is that of the root body of an entity."""
    names, roots = body_names(model), roots_of(model)
    if isinstance(key, str):
        if key not in names:
            message = f"attach: {argument}: MuJoCo has no body {key!r}"
            raise UnknownNameError(message, suggestions=nearest(key, [names[n] for n in roots]))
        number = names.index(key)
    elif validation.is_integer(key) and 0 <= key < model.nbody:
        number = int(key)
    else:
        raise ArgumentError(
            f"attach: {argument}: MuJoCo has no body {short_repr(key)}; its bodies are 0 to "
            f"{model.nbody - 1}, or given by name"
        )
    if number not in roots:
        root = int(entity_roots(model)[number])
        raise ArgumentError(
            f"attach: {argument}: the body {names[number]!r} is a link of the entity "
            f"{names[root]!r}; name that"
        )


def scene_of(
    simulator: Simulator,
    originals: Sequence[BodyToCopy],
    tick: TickToCopy,  # noqa: ARG001  # the copy is at the tick
    folder: Path,
    target: str,
) -> Scene:
    """Describes a simulation as a scene of an MJCF file, without its sensors."""
    assert isinstance(simulator, MuJoCoSimulator)
    if target != MUJOCO:
        raise UnsupportedError(
            "a MuJoCo world is saved as MJCF, of which PyBullet reads little: name no simulator"
        )
    model, data = simulator.switched_on(simulator.model), simulator.data
    names = body_names(model)
    off = simulator.disabled | simulator.hidden
    if off:
        switched = joined_names(sorted(names[body.handle] for body in off))
        warn(
            f"{switched}: MJCF has no bodies that are disabled or hidden; in the file they are not"
        )
    lost = set(roots_of(model)) - {0, *(one.body.handle for one in originals)}
    if lost:
        raise UnsupportedError(
            f"{joined_names([names[n] for n in sorted(lost)])}: a MuJoCo model still has bodies "
            "that were removed or left out, so that MJCF would have them"
        )
    told = {
        names[one.body.handle]: one.body.kind
        for one in originals
        if one.body.kind != kind_by_joints(one.body.joints)
    }
    file = folder / MJCF_FILE
    write_model(model, data, simulator.spec, told, file)
    return mjcf_scene(file)


def visual_shapes(simulator: Simulator, body: Body) -> list[PlacedGeometry]:
    """Returns what MuJoCo draws of a body; see `Backend.visual_shapes`."""
    if not isinstance(simulator, MuJoCoSimulator):
        raise UnsupportedError("this is no simulation of MuJoCo")
    return rendering.visual_shapes(simulator.model, body)
