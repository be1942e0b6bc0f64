"""Makes the simulators of worlds: loads scenes, and attaches to simulations of the user's."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from ssduck import validation
from ssduck.errors import ArgumentError
from ssduck.formatting import short_repr
from ssduck.simulators.backends import ShapesByBody, backend
from ssduck.simulators.interface import Kind, Simulator
from ssduck.simulators.recognition import simulator_of, simulator_of_scene
from ssduck.simulators.scenes import Scene


def loaded(scene: Scene, simulator: str | None) -> Simulator:
    """Returns a new simulator with a scene; see `World.load`."""
    if not isinstance(scene, Scene):
        raise ArgumentError(
            f"load: {short_repr(scene)} is no Scene; find_scene of ssduck.simulators reads one"
        )
    return backend(simulator or simulator_of_scene(scene)).load(scene)


def attached(
    simulation: Sequence[Any],
    names: Mapping[Any, str] | None,
    kinds: Mapping[Any, Kind] | None,
    shapes: ShapesByBody | None,
    simulator: str | None,
    forward: bool,
) -> Simulator:
    """Returns the simulator of what a user simulates: a client, or a model and its data.

    The arguments are those of `World.attach`, of which some may have no name in a call.
    """
    forward = validation.boolean(forward, "attach: forward")
    client, (names, kinds) = _simulation(simulation[0], simulation[1:], names, kinds)
    _check_distinct(names)
    name_of_simulator = simulator_of(client) if simulator is None else simulator
    options: dict[str, bool] = {"forward": forward} if forward else {}
    return backend(name_of_simulator).attach(client, names, kinds, shapes, **options)


def _check_distinct(names: Any) -> None:
    """Checks that no two bodies have one name."""
    bodies: dict[str, Any] = {}
    for body, name in names.items() if isinstance(names, Mapping) else ():
        if isinstance(name, str) and bodies.setdefault(name, body) is not body:
            raise ArgumentError(
                f"attach: names: the bodies {short_repr(bodies[name])} and {short_repr(body)} "
                f"both have the name {short_repr(name)}: a name is that of one entity"
            )


def _simulation(
    client: Any, more: Sequence[Any], names: Any, kinds: Any
) -> tuple[Any, tuple[Any, Any]]:
    """Returns the simulation, names and kinds, of which some have no name in a call."""
    values = list(more)
    if values and not (values[0] is None or isinstance(values[0], Mapping)):
        client = client, values.pop(0)
    named = {"names": names, "kinds": kinds}
    if len(values) > len(named):
        raise ArgumentError(f"attach: too many values: {', '.join(map(short_repr, values))}")
    for (argument, known), value in zip(named.items(), values, strict=False):
        if known is not None:
            raise ArgumentError(f"attach: {argument} are given twice")
        validation.mapping(value, f"attach: {argument} are given in a dict")
        named[argument] = value
    return client, (named["names"], named["kinds"])
