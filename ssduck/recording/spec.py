"""Specifies what is recorded of a world's ticks: `Recording`."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

from ssduck import validation
from ssduck.errors import ArgumentError, nearest
from ssduck.formatting import short_repr
from ssduck.schema import RECORDABLE
from ssduck.world.layout import EntityInfo

# Where older ticks are dropped, a quarter of the retained ones is stored and dropped at a time.
RETENTION_PARTS = 4


@dataclass(frozen=True)
class Recording:
    """What is recorded of a world's ticks.

    The poses of links are always recorded with the entities: relations of shapes need them.

    Args:
        tables: the recorded tables, always with `entities`. The others are read from the simulator
            at every tick.
        entities: the names of the recorded entities; None for all. The body that carries a recorded
            sensor is recorded, too.
        every: n, to record every n-th tick, beginning with the first.
        changed: whether rows that equal those of the previous tick are not stored again. The
            history tables are the same; they take less memory and more time.
        seconds: the simulated time that is retained, s, at least, and at most half as much more;
            None for all.
        ticks: the number of ticks that are retained, at least, and at most half as many more; None
            for all. Where both are given, ticks older than either may be dropped.

    Raises:
        ArgumentError: a table is unknown, a number is not above 0, or a value is of the wrong
            type.
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
    """Returns the entities of these names, and the bodies that carry the sensors among them."""
    hosts = {member.mount[0] for member in members if member.sensor and member.name in names}
    return [member for member in members if member.name in names or member.id in hosts]


def check_names(recording: Recording, members: Collection[EntityInfo]) -> None:
    """Checks that entities have the names of a recording.

    Raises:
        ArgumentError: no entity has one of the names; suggests the nearest ones.
    """
    known = [member.name for member in members]
    for name in recording.entities or ():
        if name not in known:
            raise ArgumentError(
                f"there is no entity {short_repr(name)} to be recorded",
                suggestions=nearest(name, known),
            )


def not_recorded_message(table: str, world: str) -> str:
    """Returns the message that a table of a world has no history."""
    return (
        f"the table of {table} of {world!r} is not recorded: record it with "
        f"tables=('entities', '{table}')"
    )
