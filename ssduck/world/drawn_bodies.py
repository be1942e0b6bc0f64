"""What a simulator draws of the bodies of a world, also of those that it no longer has."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from ssduck.errors import SimulatorError, warn
from ssduck.simulators.backends import drawn_shapes, stored_visuals
from ssduck.simulators.interface import Body, Simulator, VisualShape
from ssduck.world.entity_registry import EntityRegistry


class DrawnBodies:
    """Asks a simulator what it draws of a body, while it has the body.

    A simulator may give the number of a removed body to a new one. So a body that is gone has what
    was read last, or its collision shapes if nothing was. If the simulator is gone, all bodies are,
    and a warning says so.
    """

    def __init__(self, simulator: Simulator, registry: EntityRegistry) -> None:
        self._simulator, self._registry = simulator, registry
        self._read: dict[int, tuple[Body, Sequence[VisualShape]]] = {}
        self._has_told = False

    def __call__(self, body: Body) -> Sequence[VisualShape]:
        """Returns what is drawn of a body."""
        if any(entity.body is body for entity in self._registry.entities):
            with self._errors_as_a_warning():
                shapes = drawn_shapes(self._simulator, body)
                self._read[id(body)] = body, shapes
                return shapes
        known = self._read.get(id(body))
        if known is not None and known[0] is body:
            return known[1]
        return stored_visuals(body)

    @contextmanager
    def _errors_as_a_warning(self) -> Iterator[None]:
        """Turns the errors of a simulator that is gone into a warning, once."""
        try:
            yield
        except SimulatorError as error:
            if not self._has_told:
                self._has_told = True
                reason = error.message.partition(";")[0]
                warn(f"{reason}: collision shapes stand in for what it draws")
