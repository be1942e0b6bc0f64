"""Finds the model and the data of a simulation, anew at each tick.

Environments may make a new model at each reset. So a simulation is given as an object that has
both, or as a function that returns them, and is asked whenever a tick is taken.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeAlias

from ssduck.errors import SimulatorError
from ssduck.formatting import short_repr
from ssduck.simulators.recognition import parts_finder, parts_of

# Returns the model and the data as they are now.
Source: TypeAlias = Callable[[], tuple[Any, Any]]


def source_of(simulation: Any) -> Source:
    """Returns the function that finds the model and the data of a simulation.

    Args:
        simulation: a pair of model and data, an object that has both, such as an environment, or a
            function that returns one of these.

    Raises:
        SimulatorError: there is no model with data.
    """
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
    find = parts_finder(simulation)
    return lambda: _checked(find(), simulation, simulation)


def _checked(parts: tuple[Any, Any] | None, found: Any, simulation: Any) -> tuple[Any, Any]:
    """Returns the model and the data of what was found.

    Raises:
        SimulatorError: there is no model with data.
    """
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
