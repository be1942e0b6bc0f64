"""What of a world's ticks is kept: what `record` is asked for."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

from ssduck import validation
from ssduck.errors import ArgumentError, nearest
from ssduck.formatting import short_repr
from ssduck.schema import RECORDABLE
from ssduck.world.layout import EntityInfo

# Of what is kept, a quarter at a time is stored together, and dropped together.
QUARTERS = 4


@dataclass(frozen=True)
class Recording:
    """What is kept of a world's ticks.

    Where each link of a body is, is kept with the entities in any case: relations of shapes need
    it.

    Args:
        tables: which tables, `entities` always among them. The others are read from the simulator
            with every tick.
        entities: the names of those that are kept; None for all. A sensor brings the body that it
            sits on.
        every: only every n-th tick is kept, the first one among them.
        changed: whether a row that is as in the tick before is not stored again. The tables of
            history are the same; they take less memory and more time.
        seconds: of simulated time that are kept at least, and at most half as much more; None
            for all.
        ticks: that are kept at least, and at most half as many more; None for all. Where both are
            given, what is older than either may be dropped.

    Raises:
        ArgumentError: a table is none of these, a number is no number above 0, or nothing is
            to be kept.
    """

    tables: tuple[str, ...] = ("entities",)
    entities: tuple[str, ...] | None = None
    every: int = 1
    changed: bool = False
    seconds: float | None = None
    ticks: int | None = None

    def __post_init__(self) -> None:
        for name in ("tables", "entities"):
            value = getattr(self, name)
            is_list = isinstance(value, list | tuple | set | frozenset)
            if value is not None and not (is_list and all(isinstance(v, str) for v in value)):
                raise ArgumentError(f"{name} is to be a list of names, not {short_repr(value)}")
            if value is not None:
                object.__setattr__(self, name, tuple(value))
        for table in self.tables:
            if table not in RECORDABLE:
                raise ArgumentError(
                    f"there is no table {short_repr(table)} to be recorded",
                    suggestions=nearest(table, RECORDABLE),
                )
        if "entities" not in self.tables:
            object.__setattr__(self, "tables", ("entities", *self.tables))
        for name in ("every", "ticks"):
            value = getattr(self, name)
            if value is None and name == "ticks":
                continue
            rule = f"{name} is to be a whole number above 0"
            object.__setattr__(self, name, validation.integer_above_0(value, rule))
        if self.seconds is not None:
            seconds = validation.number_above_0(self.seconds, "seconds is to be a number above 0")
            object.__setattr__(self, "seconds", seconds)
        object.__setattr__(self, "changed", validation.boolean(self.changed, "changed"))

    @property
    def is_bounded(self) -> bool:
        """Whether older ticks are dropped."""
        return self.seconds is not None or self.ticks is not None


def chosen_members(members: Collection[EntityInfo], names: Collection[str]) -> list[EntityInfo]:
    """The entities of these names, and the bodies that sensors among them sit on."""
    hosts = {member.mount[0] for member in members if member.sensor and member.name in names}
    return [member for member in members if member.name in names or member.id in hosts]


def check_names(recording: Recording, members: Collection[EntityInfo]) -> None:
    """Complain of names that no entity has.

    Raises:
        ArgumentError: with the nearest right names.
    """
    known = [member.name for member in members]
    for name in recording.entities or ():
        if name not in known:
            raise ArgumentError(
                f"there is no entity {short_repr(name)} to be recorded",
                suggestions=nearest(name, known),
            )


def not_recorded(table: str, world: str) -> str:
    """The message that a table of a world has no history."""
    return (
        f"the table of {table} of {world!r} is not recorded: record it with "
        f"tables=('entities', '{table}')"
    )
