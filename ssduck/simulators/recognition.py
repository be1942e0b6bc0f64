"""Recognises the simulator of an object or of a scene, without importing any simulator.

Environments keep their simulation in different places. `parts_of` looks into those of gymnasium,
dm_control and robosuite. Environments may make a new model at each reset. So a simulation is given
as an object that has model and data, or as a function that returns them, and is asked whenever a
tick is taken.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any, TypeAlias

from ssduck import validation
from ssduck.errors import SimulatorError
from ssduck.formatting import short_repr
from ssduck.simulators.interface import DEFAULT_BACKEND
from ssduck.simulators.scenes import Scene

MUJOCO = "mujoco"
# The attributes under which an object keeps its model and data, or an object that has them:
# wrappers of gymnasium, physics of dm_control, `sim` of robosuite, and the bindings of both.
_INNER = ("unwrapped", "physics", "sim", "env", "_physics", "_sim")
# The attributes under which a binding keeps MuJoCo's own object.
_POINTERS = ("ptr", "_model", "_data")
# The attributes under which an environment keeps a PyBullet client.
_CLIENTS = ("_client", "physics_client", "_physics_client_id")
# The packages whose models and data are on a device.
_DEVICES = ("mujoco.mjx", "mujoco_warp")
_MAX_DEPTH = 4


def simulator_of(simulation: Any) -> str:
    """Returns the name of the simulator of a client, a model with its data, or an environment."""
    candidate = simulation
    if callable(simulation) and (isinstance(simulation, type) or parts_of(simulation) is None):
        candidate = simulation()
    if validation.is_integer(candidate) or any(hasattr(candidate, name) for name in _CLIENTS):
        return DEFAULT_BACKEND
    if parts_of(candidate) is not None:
        return MUJOCO
    raise SimulatorError(
        f"attach: {short_repr(simulation)} is no connected PyBullet client, and it has no MuJoCo "
        "model and data, neither itself (model, data) nor as unwrapped, physics or sim; give "
        "World.attach(client), World.attach(model, data), or a function that returns model and data"
        + _hint(candidate)
    )


def simulator_of_model(model: Any) -> str:
    """Returns the name of the simulator of a model without its data."""
    if _own(model, _NAMES[0]) is not None:
        return MUJOCO
    raise SimulatorError(
        f"batch: {short_repr(model)} is no MjModel of MuJoCo, and no loaded or attached world"
    )


def _hint(simulation: Any) -> str:
    """Returns what is missing or to be done with objects that are near to a model with its data."""
    parts = simulation if isinstance(simulation, tuple) else (simulation,)
    if any(type(part).__module__.startswith(_DEVICES) for part in parts):
        return (
            "; MJX and MuJoCo Warp keep their state on a device: copy it to an MjData, such as by "
            "mjx.get_data(model, data), and attach that with its MjModel"
        )
    if len(parts) == 1 and _own(parts[0], _NAMES[0]) is not None:
        return "; this is a model without its data"
    if len(parts) == 1 and _own(parts[0], _NAMES[1]) is not None:
        return "; this is data without its model"
    return ""


def parts_of(simulation: Any) -> tuple[Any, Any] | None:
    """Returns MuJoCo's model and data of a pair, an object or a part of it; None without."""
    if isinstance(simulation, tuple):
        if len(simulation) != 2:
            return None
        model, data = (_own(part, name) for part, name in zip(simulation, _NAMES, strict=True))
        return None if model is None or data is None else (model, data)
    for part in _kept_in(simulation):
        model, data = (
            _own(getattr(part, attribute, None), name)
            for attribute, name in zip(("model", "data"), _NAMES, strict=True)
        )
        if model is not None and data is not None:
            return model, data
    return None


def client_of(simulation: Any) -> int | None:
    """Returns the number of the PyBullet client of an environment; None if it has none."""
    for part in _kept_in(simulation):
        for name in _CLIENTS:
            client = getattr(part, name, None)
            for number in (client, getattr(client, _CLIENTS[0], None)):
                if number is not None and validation.is_integer(number):
                    return int(number)
    return None


def _kept_in(part: Any, depth: int = _MAX_DEPTH) -> Iterator[Any]:
    """Yields an object, and those that it keeps, the outermost first."""
    yield part
    if depth:
        for name in _INNER:
            inner = getattr(part, name, None)
            if inner is not None and inner is not part:
                yield from _kept_in(inner, depth - 1)


def simulator_of_scene(scene: Scene) -> str:
    """Returns the name of the simulator that loads a scene by default.

    A scene file may name one. Otherwise, MuJoCo loads an MJCF file by itself, if it is installed,
    and PyBullet everything else; one of them alone loads what it can.
    """
    if scene.simulator is not None:
        return scene.simulator
    if find_spec(MUJOCO) is None:
        return DEFAULT_BACKEND
    is_only = find_spec(DEFAULT_BACKEND) is None
    return MUJOCO if is_only or (scene.model_file and _is_mjcf(scene.path)) else DEFAULT_BACKEND


def _is_mjcf(path: Path) -> bool:
    """Checks whether a file has the root element of MJCF."""
    try:
        with path.open("rb") as file:
            for _, element in ET.iterparse(file, events=("start",)):  # noqa: S314  # only the root
                return bool(element.tag == "mujoco")
    except (OSError, ET.ParseError):
        return False
    return False


_NAMES = ("MjModel", "MjData")


def _own(part: Any, name: str) -> Any:
    """Returns MuJoCo's own object of a class, which a binding may wrap; None if it is none."""
    if _is_own(part, name):
        return part
    pointed = (getattr(part, pointer, None) for pointer in _POINTERS)
    return next((candidate for candidate in pointed if _is_own(candidate, name)), None)


def _is_own(candidate: Any, name: str) -> bool:
    kind = type(candidate)
    return kind.__name__ == name and kind.__module__.partition(".")[0] == MUJOCO


# Returns the model and the data as they are now.
Source: TypeAlias = Callable[[], tuple[Any, Any]]


def source_of(simulation: Any) -> Source:
    """Returns the function that finds the model and the data of a simulation: see `attach`."""
    parts = parts_of(simulation)
    if parts is None and callable(simulation):

        def made() -> tuple[Any, Any]:
            found = simulation()
            return _checked(parts_of(found), found, simulation)

        made()
        return made
    found = _checked(parts, simulation, simulation)
    if isinstance(simulation, tuple):
        return lambda: found
    return lambda: _checked(parts_of(simulation), simulation, simulation)


def _checked(parts: tuple[Any, Any] | None, found: Any, simulation: Any) -> tuple[Any, Any]:
    """Returns the model and the data of what was found."""
    if parts is None:
        returned = "" if found is simulation else f" returned {short_repr(found)}, which"
        raise SimulatorError(
            f"attach: {short_repr(simulation)}{returned} has no MuJoCo model with its data: give "
            "World.attach(model, data), an environment that has both, or a function that returns "
            "(model, data)"
        )
    model, data = parts
    if getattr(data, "model", model) is not model and data.model.nbody != model.nbody:
        raise SimulatorError(
            f"attach: the data is of another model: it has {data.model.nbody} bodies, "
            f"the model {model.nbody}"
        )
    return model, data
