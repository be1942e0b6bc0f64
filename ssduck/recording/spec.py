"""Specifies what is recorded of a world's ticks: `Recording`."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import asdict, dataclass, fields, replace
from typing import Any, Literal

from ssduck import validation
from ssduck.errors import ArgumentError, nearest
from ssduck.formatting import short_repr
from ssduck.schema import RECORDABLE, RECORDED_BY_DEFAULT
from ssduck.world.layout import EntityInfo

# Where older ticks are dropped, a quarter of the retained ones is stored and dropped at a time.
RETENTION_PARTS = 4
# The memory that the ticks of a world take at most by default, bytes.
DEFAULT_MAX_BYTES = 512 * 2**20
# The time after which a tick is on the disk by default, s of real time.
DEFAULT_FLUSH_EVERY = 1.0


@dataclass(frozen=True)
class Recording:
    """What is recorded of a world's ticks.

    The poses of links are always recorded with the entities: relations of shapes need them.

    Args:
        tables: the recorded tables, always with `entities`. The others are read from the simulator
            at every tick. By default entities, links and contacts.
        entities: the names of the recorded entities; None for all. The body that carries a recorded
            sensor is recorded, too. Contacts are recorded where both entities are. What depends on
            the others is told of by a warning: `force`, `torque`, `restsOn`, `supports`, `nextTo`
            and nested queries about a row.
        every: n, to record every n-th tick, beginning with the first.
        changed: whether rows that equal those of the previous tick are not stored again. The
            history tables are the same; they take less memory and more time.
        seconds: the simulated time that is retained, s, at least, and at most half as much more;
            None for all.
        ticks: the number of ticks that are retained, at least, and at most half as many more; None
            for all. Where both are given, ticks older than either may be dropped.
        max_bytes: the size of the retained rows, bytes, at most; the oldest ticks are dropped
            first. None for no limit. By default 512 MiB in memory unless `seconds` or `ticks` is
            given, and no limit in files.
        flush_every: in files and folders, the time after which a tick is on the disk, s of wall
            clock; None to store full buffers only.

    Raises:
        ArgumentError: a table is unknown, a number is not above 0, or a value is of the wrong
            type.
    """

    tables: tuple[str, ...] = RECORDED_BY_DEFAULT
    entities: tuple[str, ...] | None = None
    every: int = 1
    changed: bool = False
    seconds: float | None = None
    ticks: int | None = None
    max_bytes: int | Literal["default"] | None = "default"
    flush_every: float | None = DEFAULT_FLUSH_EVERY

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
        for name in ("every", "ticks", "max_bytes"):
            value = getattr(self, name)
            if name != "every" and (value is None or (name, value) == ("max_bytes", "default")):
                continue
            rule = f"{name} is to be a whole number above 0"
            object.__setattr__(self, name, validation.integer_above_0(value, rule))
        for name in ("seconds", "flush_every"):
            value = getattr(self, name)
            if value is not None:
                number = validation.number_above_0(value, f"{name} is to be a number above 0")
                object.__setattr__(self, name, number)
        object.__setattr__(self, "changed", validation.boolean(self.changed, "changed"))

    @property
    def is_bounded(self) -> bool:
        """Whether older ticks are dropped."""
        has_size_limit = isinstance(self.max_bytes, int)
        return has_size_limit or self.seconds is not None or self.ticks is not None


def description_of(recording: Recording) -> dict[str, Any]:
    """Returns what a stored recording says of itself, to be given to `Recording` again."""
    description = asdict(recording)
    del description["flush_every"]  # says nothing about the stored ticks
    return description


def with_size_limit(recording: Recording, *, in_memory: bool) -> Recording:
    """Returns a recording with `max_bytes` in place of its default."""
    if recording.max_bytes != "default":
        return recording
    is_limited = in_memory and not recording.is_bounded
    return replace(recording, max_bytes=DEFAULT_MAX_BYTES if is_limited else None)


def quarters_of(recording: Recording, ticks: int, seconds: float, size: float) -> float:
    """Returns how many quarters of what is retained some rows fill, by the nearest limit."""
    filled = [0.0]
    if recording.ticks is not None:
        filled.append(ticks / max(recording.ticks // RETENTION_PARTS, 1))
    if recording.seconds is not None:
        filled.append(seconds / (recording.seconds / RETENTION_PARTS))
    if isinstance(recording.max_bytes, int):
        filled.append(size / (recording.max_bytes / RETENTION_PARTS))
    return max(filled)


def bytes_before_dropping(recording: Recording) -> float:
    """Returns the largest size of stored rows, bytes, that leaves room for the buffered ones."""
    if not isinstance(recording.max_bytes, int):
        return math.inf
    return recording.max_bytes * (1 - 1 / RETENTION_PARTS)


def chosen_members(members: Collection[EntityInfo], names: Collection[str]) -> list[EntityInfo]:
    """Returns the entities of these names, and the bodies that carry the sensors among them."""
    hosts = {member.mount[0] for member in members if member.sensor and member.name in names}
    return [member for member in members if member.name in names or member.id in hosts]


def check_names(recording: Recording, members: Collection[EntityInfo]) -> None:
    """Checks that entities have the names of a recording."""
    known = [member.name for member in members]
    for name in recording.entities or ():
        if name not in known:
            raise ArgumentError(
                f"there is no entity {short_repr(name)} to be recorded",
                suggestions=nearest(name, known),
            )


def recording_call(world: str, recording: Recording) -> str:
    """Returns the call that starts a recording, as text.

    >>> recording_call("sim", Recording(tables=("entities", "joints"), seconds=5))
    "ss.record('sim', ssduck.Recording(tables=('entities', 'joints'), seconds=5.0))"
    """
    values = {field.name: getattr(recording, field.name) for field in fields(recording)}
    if values["max_bytes"] in (None, DEFAULT_MAX_BYTES):  # the default of a file, or of memory
        del values["max_bytes"]
    differing = [f"{n}={value!r}" for n, value in values.items() if value != getattr(Recording, n)]
    return f"ss.record({world!r}, ssduck.Recording({', '.join(differing)}))"


def no_ticks_message(world: str) -> str:
    """Returns the message that a world has no history."""
    call = recording_call(world, Recording())
    return f"the ticks of {world!r} are not recorded; {call} records them from then on"


def not_recorded_message(
    table: str, world: str, recording: Recording | None, *, is_live: bool = True
) -> str:
    """Returns the message that a table of a world has no history, with the call that records it."""
    recording = recording or Recording()
    tables = tuple(name for name in RECORDABLE if name in (*recording.tables, table))
    call = recording_call(world, replace(recording, tables=tables))
    what_to_do = f"record a run with {call}"
    if is_live:
        what_to_do = (
            f"{call} records it from then on; nothing brings back what is past: call it before the "
            "loop"
        )
    return f"the table of {table} of {world!r} is not recorded; {what_to_do}"


def longer_recording_message(world: str, recording: Recording) -> str:
    """Returns the message that older ticks were dropped, with the call that keeps twice as much."""
    limits = {name: getattr(recording, name) for name in ("seconds", "ticks", "max_bytes")}
    doubled: dict[str, Any] = {
        name: 2 * limit for name, limit in limits.items() if isinstance(limit, int | float)
    }
    call = recording_call(world, replace(recording, **doubled))
    return f"older ticks were dropped; {call} keeps more from then on"
