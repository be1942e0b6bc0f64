"""Stands in the host for what stays in a worker: entities and worlds."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any, Never, Self, TypeAlias

from ssduck import validation
from ssduck.errors import UnsupportedError, nearest
from ssduck.formatting import joined_names

# Asks the worker, as `SandboxedInterpreter.ask` does.
Asking: TypeAlias = Callable[..., Any]
# The properties of entities that the host can read.
PROPERTIES = frozenset(("position", "orientation", "pose", "velocity", "aabb", "mass"))


class NotInSandboxError(UnsupportedError, AttributeError):
    """Something has no such attribute because it is in a sandbox, or stands for what is there."""


@dataclass(frozen=True)
class EntityReference:
    """An entity, a link or a site of a world in the sandbox; it can be a variable of programs.

    Its properties `position`, `orientation`, `pose`, `velocity`, `aabb` and `mass` are those of
    `Entity`, at its tick.

    Attributes:
        world: the name of the world.
        id: the number of the entity, or of the link.
        name: its name.
        kind: `"robot"`, `"kinbody"`, `"sensor"`, `"link"` or `"site"`.
        tick: the number of the past tick that it is of; None for the current tick.
        full_name: the name that is unique in the world, which stands for it where it is shown.
    """

    world: str
    id: int
    name: str
    kind: str
    tick: int | None = None
    full_name: str = field(default="", repr=False, compare=False)
    _ask: Asking | None = field(default=None, repr=False, compare=False, kw_only=True)

    def __str__(self) -> str:
        return self.full_name or self.name

    def __reduce__(self) -> tuple[Any, ...]:
        """A copy elsewhere tells what it is of, and asks nothing."""
        own = (self.world, self.id, self.name, self.kind, self.tick, self.full_name)
        return EntityReference, own

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        if name in PROPERTIES and self._ask is not None and self.tick is None:
            return self._ask(f"it.{name}", self)
        raise NotInSandboxError(
            f"{self.world}.{self.name} is in the sandbox, and its {name!r} is not known here: "
            f"{joined_names(sorted(PROPERTIES))} of the current tick are; programs ask for more",
            suggestions=nearest(name, PROPERTIES),
        )


class SandboxedWorld:
    """A world that lives in the sandbox.

    Args:
        name: the name of the variable that has it.
        ask: asks the worker.
    """

    def __init__(self, name: str, ask: Asking) -> None:
        self.name = name
        self._ask = ask

    @property
    def time(self) -> float:
        """The simulated time, s."""
        return float(self._ask("it.time", self))

    @property
    def tick_number(self) -> int:
        """The number of the current tick."""
        return int(self._ask("it.tick_number", self))

    @property
    def timestep(self) -> float:
        """The time step, s; 0 if the world cannot be stepped."""
        return float(self._ask("it.timestep", self))

    def step(self, count: int = 1, *, every: int | None = 1) -> Self:
        """Runs steps of the simulator, as `World.step` does."""
        count = validation.step_count(count, "step", "run({})")
        self._ask("it.step", self, count, every=every, seconds=count * _STEP_SECONDS)
        return self

    def run(self, seconds: float, *, every: int | None = 1) -> None:
        """Runs the world for a simulated time, s, as `World.run` does."""
        seconds = validation.duration(seconds, "run: seconds")
        self._ask("it.run", self, seconds, every=every, seconds=seconds * RUN_SECONDS)

    def tick(self) -> Self:
        """Takes a tick."""
        self._ask("it.tick", self)
        return self

    def table(self, name: str) -> Any:
        """Returns a table of the current tick, as `"entities"` or `"links"`, as an Arrow table."""
        return self._ask("worker.table", self.name, name)

    def __len__(self) -> int:
        return int(self._ask("it.__len__", self))

    def reference(self, *own: Any) -> EntityReference:
        """Returns the reference to an entity, a link or a site, with all that this has."""
        return EntityReference(self.name, *own, _ask=self._ask)

    def __iter__(self) -> Iterator[EntityReference]:
        """Iterates over the entities: sensors first, then bodies."""
        return iter(self._ask("worker.entities", self))

    def __getitem__(self, name: str) -> EntityReference:
        """Returns the entity of a name.

        Raises:
            UnknownNameError: no entity has the name; the error suggests the nearest names.
        """
        entity: EntityReference = self._ask("it.__getitem__", self, name)
        return entity

    def __str__(self) -> str:
        return self.name

    def __repr__(self) -> str:
        return f"<SandboxedWorld: {self.name!r}>"

    def __getattr__(self, name: str) -> Never:
        raise NotInSandboxError(
            f"{name}: the world {self.name!r} is in the sandbox, and has it not here; ask with "
            "programs and SQL, or load the world without Limits.strict()"
        )


# What a slow machine takes for a step and for a simulated second, s, beside the time of a program.
_STEP_SECONDS, RUN_SECONDS = 0.1, 30.0
