"""Describes a recorded run of a world: `Episode`, with its tags: what users say of a run, by name.

    {"task": "pick", "success": True, "return": 12.5}

A tag is a text, True, False or a finite number, so that it fits into a column of a table.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeAlias
from uuid import uuid4

import numpy as np

from ssduck import validation
from ssduck.errors import ArgumentError, ProgramWarning, SelectScriptError, warn
from ssduck.formatting import short_repr
from ssduck.language import ast
from ssduck.language.parser import parse
from ssduck.recording.buffers import TickBuffer

Tag: TypeAlias = str | bool | int | float
Tags: TypeAlias = Mapping[str, Tag]
# The largest number of tags of an episode, and the longest name of one.
MAX_TAGS = 1000
_MAX_NAME = 200
# The longest text that may be taken for a program.
_MAX_PROGRAM = 2000


def checked_tags(tags: Any, argument: str = "tags") -> dict[str, Tag]:
    """Returns tags as plain values of Python; None for none.

    Args:
        tags: texts, True, False or finite numbers by name; None for no tags.
        argument: the name of the argument, to begin the message.

    Raises:
        ArgumentError: they are no dict of such values.

    >>> checked_tags({"task": "pick", "success": True, "return": 12.5})
    {'task': 'pick', 'success': True, 'return': 12.5}
    """
    if tags is None:
        return {}
    given = validation.mapping(tags, f"{argument}: give a dict of texts and numbers by name")
    if len(given) > MAX_TAGS:
        raise ArgumentError(f"{argument}: an episode has at most {MAX_TAGS:,} tags")
    for name in given:
        if not _is_name(name):
            raise ArgumentError(
                f"{argument}: {short_repr(name)} is no name: give 1 to {_MAX_NAME} letters"
            )
    return {name: _plain(value, f"{argument}[{name!r}]") for name, value in given.items()}


def given_tags(tags: Any) -> dict[str, Tag]:
    """Returns tags that a user gives, as `checked_tags`, and warns of programs among them."""
    checked = checked_tags(tags)
    for name, value in checked.items():
        if isinstance(value, str) and _is_program(value):
            warn(
                f"tags[{name!r}] is the text {short_repr(value)}, not the answer to it: "
                f"lake.tag({name!r}, program) and `ssduck tag RECORDS --program '{name}=…'` tag "
                "each episode with its answer to a program",
                ProgramWarning,
            )
    return checked


def _is_program(text: str) -> bool:
    """Checks whether a text is a query, or a condition or call with an entity such as sim.cup."""
    if len(text) > _MAX_PROGRAM:
        return False
    try:
        statements = parse(text).statements
    except (SelectScriptError, RecursionError):
        return False
    for statement in statements:
        parts = {type(part) for part in statement.walk()}
        if ast.Query in parts or (
            isinstance(statement, ast.Binary | ast.Call) and ast.Index in parts
        ):
            return True
    return False


def are_tags(value: Any) -> bool:
    """Checks a value of a description of an episode."""
    return (
        isinstance(value, dict)
        and len(value) <= MAX_TAGS
        and all(_is_name(name) and _is_tag(tag) for name, tag in value.items())
    )


def _is_name(name: Any) -> bool:
    return isinstance(name, str) and 0 < len(name) <= _MAX_NAME and name.isprintable()


def _is_tag(value: Any) -> bool:
    if isinstance(value, float):
        return math.isfinite(value)
    return isinstance(value, str | bool) or (isinstance(value, int) and abs(value) < 1 << 53)


def _plain(value: Any, what: str) -> Tag:
    if isinstance(value, bool | np.bool_):
        return bool(value)
    if validation.is_integer(value):
        value = int(value)
    elif validation.is_number(value):
        value = float(value)
    if not _is_tag(value):
        raise ArgumentError(
            f"{what} is {short_repr(value)}: a tag is a text, True, False or a finite number"
        )
    tag: Tag = value
    return tag


def parsed_tag(text: str) -> tuple[str, Tag]:
    """Returns the name and the value of a tag that is written as `name=value`.

    The value is a text, unless it is true, false, a number or a text in quotes, as in JSON.

    Raises:
        ArgumentError: there is no name, or no value.

    >>> parsed_tag("success=true"), parsed_tag("task=pick"), parsed_tag('batch="7"')
    (('success', True), ('task', 'pick'), ('batch', '7'))
    """
    name, separator, value = text.partition("=")
    if not separator:
        raise ArgumentError(f"tag: {short_repr(text)} has no value; write name=value")
    try:
        parsed = json.loads(value, parse_constant=_no_number)
    except ValueError:
        parsed = value
    ((name, tag),) = checked_tags({name: parsed if _is_tag(parsed) else value}, "tag").items()
    return name, tag


def _no_number(text: str) -> float:
    raise ValueError(text)


def new_id() -> str:
    """Returns a random UUID for an episode."""
    return str(uuid4())


@dataclass(frozen=True)
class Episode:
    """A run of a world that is recorded in a folder or in a DuckDB file.

    Attributes:
        path: the folder or the file.
        world: the name of the world.
        number: the number of the episode of that world, from 0.
        started: the date and time of the start, in ISO 8601.
        tables: the names of the recorded tables.
        every: n where every n-th tick of the world is recorded.
        entities: the names of the recorded entities; None for all.
        ticks: the number of stored ticks.
        first_tick: the number of the first stored tick; None if there is none.
        last_tick: the number of the last stored tick; None if there is none.
        start: the simulated time of the first stored tick, s; None if there is none.
        end: the simulated time of the last stored tick, s; None if there is none.
        complete: whether the recording was closed, and not killed.
        id: a UUID of the run, which no other episode has.
        tags: what the user says of the run: texts, True, False or numbers, by name.
    """

    path: Path
    world: str
    number: int
    started: str
    tables: tuple[str, ...]
    every: int
    entities: tuple[str, ...] | None
    ticks: int
    first_tick: int | None
    last_tick: int | None
    start: float | None
    end: float | None
    complete: bool
    id: str
    tags: Tags = field(default_factory=dict[str, Tag], hash=False)


def extent_of(ticks: TickBuffer) -> dict[str, Any]:
    """Returns what an episode says of its ticks: their number, the first, and the last one."""
    if not len(ticks):
        none = dict.fromkeys(("first_tick", "last_tick", "start", "end"))
        return {"ticks": 0, **none}
    first, last = ticks.numbers[[0, -1]].tolist()
    start, end = ticks.times[[0, -1]].tolist()
    return {"ticks": len(ticks), "first_tick": first, "last_tick": last, "start": start, "end": end}
