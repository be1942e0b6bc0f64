"""Adds to DuckDB's errors what users of worlds' tables need to know."""

from __future__ import annotations

import re
from collections.abc import Collection

from ssduck.errors import SqlError, nearest

# DuckDB's errors of unknown tables, schemas and columns, and of a field of a number.
_TABLE = re.compile(r"Catalog Error: Table with name (\w+) does not exist!")
_SCHEMA = re.compile(
    r'Catalog Error: Table with name "[^"]*" does not exist because schema "(\w+)"'
)
_COLUMN = re.compile(r'column "(\w+)" not found|does not have a column named "(\w+)"')
_FIELD = re.compile(r"Cannot extract field '\w+' from expression \"(\w+)\"")
# The columns of what SelectScript has as a list.
_LISTS = {
    "position": "the columns x, y and z; positionOf(e) is a list of them",
    "orientation": "the columns qw, qx, qy and qz; orientation(e) is a list of them",
    "velocity": "the columns vx, vy and vz",
}
# The columns that are ids of entities.
_IDS = ("entity", "sensor", "a", "b")


def add_hint(error: SqlError, worlds: Collection[str]) -> None:
    """Adds a hint to the error of a user's statement, if there is one.

    Args:
        error: the error.
        worlds: the names of the worlds.
    """
    message = error.message
    if (match := _TABLE.match(message)) and (world := _world(match.group(1), worlds)):
        error.message = (
            f"there is no table {match.group(1)!r}; of the world, there are {world}.entities, "
            f"{world}.links, {world}.contacts and so on"
        )
    elif match := _SCHEMA.match(message):
        error.message = f"there is no world or schema {match.group(1)!r}"
        error.suggestions = tuple(nearest(match.group(1), worlds))
    elif match := _COLUMN.search(message):
        name = (match.group(1) or match.group(2)).lower()
        if name in _LISTS:
            error.message += f"\nThe {name} of an entity is in {_LISTS[name]}"
    elif (match := _FIELD.search(message)) and (name := match.group(1).lower()) in _IDS:
        join = f"JOIN entities e ON e.id = {name}"
        error.message += f"\n{name} is the id of an entity; a join has its columns: {join}"


def _world(name: str, worlds: Collection[str]) -> str | None:
    """Returns the world of a name, whose case does not matter."""
    return next((world for world in worlds if world.lower() == name.lower()), None)
