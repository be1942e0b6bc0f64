"""Adds to DuckDB's errors what users of worlds' tables need to know."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from contextlib import suppress

import sqlglot
from sqlglot.dialects.duckdb import DuckDB

from ssduck.errors import SelectScriptError, SqlError, nearest
from ssduck.interpreter.over_time.expansions import EXPANSIONS
from ssduck.interpreter.over_time.functions import TEMPORAL_FUNCTIONS
from ssduck.language.parser import parse
from ssduck.schema import TABLES
from ssduck.sql.relations.registry import RELATIONS
from ssduck.world.world import World

# DuckDB's errors of unknown tables, schemas and columns, and of a field of a number.
_TABLE = re.compile(r"Catalog Error: Table with name (\w+) does not exist!")
_SCHEMA = re.compile(
    r'Catalog Error: Table with name "[^"]*" does not exist because schema "(\w+)"'
)
_COLUMN = re.compile(r'column "(\w+)" not found|does not have a column named "(\w+)"')
_FIELD = re.compile(r"Cannot extract field '\w+' from expression \"('[^']*'|\w+)\"")
_POINT = re.compile(r"Cannot extract field '[xyz]' from expression \"list_value\(")
_FUNCTION = re.compile(r"Function with name \"?(\w+|=>|=<)\"? does not exist")
_NUMBER = re.compile(r"Could not convert string '(.*)' to INT64")
_GUESS = "\nDid you mean"
_SYNTAX = re.compile(r'Parser Error: syntax error at or near "([^"]+)"')
_AMBIGUOUS = re.compile(r'Ambiguous reference to column name "(\w+)"')
_CHANGE = re.compile(r"Can only \w+( from)? base table|Catalog Error: \w+ is not an table")
_READ_ONLY = (
    "The tables of a world are read only: world['cup'].move([0, 0, 1]) moves an entity; set "
    "joints, add and remove bodies by the simulator's own calls, and the next tick has it"
)
_NO_SOURCE = re.compile(r'Referenced table "(\w+)" not found')
# The relations whose names are words of SQL, where they are called.
_RESERVED = {
    name.lower(): relation.aliases[0] for name, relation in RELATIONS.items() if relation.aliases
}
_CALLED = re.compile(rf"\b({'|'.join(_RESERVED)})\s*\(", re.IGNORECASE)
_OWN_TABLES = re.compile(rf"\b({'|'.join(TABLES)})\b", re.IGNORECASE)
# The columns whose names are words of SQL.
_QUOTED = {column.name for table in TABLES.values() for column in table.columns}
_QUOTED &= DuckDB.Generator.RESERVED_KEYWORDS
_NAMES = {name.lower(): name for name in RELATIONS}
# A table or a world with the braces that the past has in SelectScript.
_PAST = re.compile(r"\bFROM\s+[\w.\"]+\s*\{", re.IGNORECASE)
_PAST_TABLES = (
    "The past has tables of its own in SQL: SELECT name, z FROM entities_history WHERE time = 0.5"
)
_IS_SELECTSCRIPT = (
    "This is SelectScript: ss.eval runs it, and ssduck query without --sql. In SQL, entities are "
    "rows: SELECT b.name FROM entities a, entities b WHERE above(a, b) AND a.name = 'table'"
)
# The columns of what SelectScript has as a list.
_LISTS = {
    "position": "the columns x, y and z; positionOf(e) is a list of them",
    "orientation": "the columns qw, qx, qy and qz; orientation(e) is a list of them",
    "velocity": "the columns vx, vy and vz",
}
_YAW = "atan2(2 * (qw * qz + qx * qy), 1 - 2 * (qy * qy + qz * qz))"
_ANGLES = {
    "roll": "atan2(2 * (qw * qx + qy * qz), 1 - 2 * (qx * qx + qy * qy))",
    "pitch": "asin(greatest(-1, least(1, 2 * (qw * qy - qz * qx))))",
    "yaw": _YAW,
}
_OF_BODIES = (
    "A body is a row of entities, with the columns id and name; the other tables have its id, in "
    "the column entity, of contacts in a and b"
)
# What to write for columns that there are not.
_COLUMNS = {name: f"The {name} of an entity is in {where}" for name, where in _LISTS.items()} | {
    **{
        name: f"The orientation is in the columns qw, qx, qy and qz: the {name} is {angle}"
        for name, angle in _ANGLES.items()
    },
    **dict.fromkeys(("body", "object", "obj"), _OF_BODIES),
    "link": "Links are rows of the table of links, with the columns entity, link and name: "
    "FROM links l JOIN entities e ON e.id = l.entity; contacts have link_a and link_b",
}
# What to write for functions that there are not: tables, and those of other libraries.
_CALLS = {
    "clip": "write least(greatest(x, low), high)",
    "clamp": "write least(greatest(x, low), high)",
    "dot": "write list_dot_product(a, b)",
    "norm": "write sqrt(list_dot_product(a, a))",
    **{name: f"write {angle}" for name, angle in _ANGLES.items()},
    "gettime": "the simulated time is the column time",
    "under": "write below(a, b)",
    "=>": "write >=",
    "=<": "write <=",
    "joints": "joints is a table: FROM joints j JOIN entities e ON e.id = j.entity; the position "
    "of one joint is joint(e, 'its name')",
    "links": "links is a table: FROM links l JOIN entities e ON e.id = l.entity",
}
# What to write for tables that there are not.
_TABLES = {
    **dict.fromkeys(("bodies", "objects", "things"), "entities"),
    "robots": "entities, WHERE kind = 'robot'",
    "sensors": "entities, WHERE kind = 'sensor'",
    "geoms": "shapes",
    **dict.fromkeys(
        ("history", "past", "trajectory", "states"),
        "entities_history, links_history and so on, which have the rows of all recorded ticks",
    ),
}
# What to do about words of SelectScript.
_WORDS = {
    "IMPLIES": "IMPLIES is a word of SelectScript, which ss.eval runs: in SQL write NOT (a) OR (b)",
    "WHY": 'WHY is a word of SelectScript, which ss.eval runs: ss.eval("WHY on(table, cup);")',
}
# The functions of SelectScript that SQL has not.
_ONLY_PROGRAMS = frozenset(name.lower() for name in (*TEMPORAL_FUNCTIONS, *EXPANSIONS))


def add_hint(
    error: SqlError, sql: str, worlds: Mapping[str, World], functions: Collection[str]
) -> None:
    """Adds a hint to the error of a user's statement, if there is one."""
    message = error.message
    if (match := _TABLE.match(message)) and (world := _same(match.group(1), worlds)):
        error.message = (
            f"there is no table {match.group(1)!r}; of the world, there are {world}.entities, "
            f"{world}.links, {world}.contacts and so on"
        )
        if _is_selectscript(sql):
            error.message += f"\n{_IS_SELECTSCRIPT}"
    elif match := _SCHEMA.match(message):
        error.message = f"there is no world or schema {match.group(1)!r}"
        error.suggestions = tuple(nearest(match.group(1), worlds))
    elif (match := _FUNCTION.search(message)) and (name := _same(match.group(1), functions)):
        error.message = (
            f"{name} is a function of yours, and raw SQL calls those whose parameters and result "
            "all have type hints (bool, int, float, str or lists of these): "
            f"def {name}(x: float) -> float, say; programs of ss.eval call any, also of entities"
        )
    elif hint := _hint(message, sql, worlds):
        error.message = f"{message.partition(_GUESS)[0]}\n{hint}"


def _hint(message: str, sql: str, worlds: Mapping[str, World]) -> str:
    """Returns the hint for a message of DuckDB's; empty if there is none."""
    if message.startswith("Parser Error"):
        at = _SYNTAX.match(message)
        word = _WORDS.get(at.group(1).upper(), "") if at else ""
        hint = word or _hint_of_world(message, sql, worlds) or _hint_of_quotes(message, sql)
        return hint or _hint_of_syntax(sql)
    if match := _TABLE.match(message):
        return _hint_of_table(match.group(1), message, worlds)
    if match := _COLUMN.search(message):
        column = match.group(1) or match.group(2)
        if any(column in world for world in worlds.values()):
            return f"A text is in single quotes: {column!r}"
        return _hint_of_column(column.lower())
    if _CHANGE.search(message) and _OWN_TABLES.search(sql):
        return _READ_ONLY
    if (match := _AMBIGUOUS.search(message)) and f"'{match.group(1)}.{match.group(1)}'" in message:
        return _hint_of_alias(match.group(1))
    if _POINT.search(message):
        return "A point is {x: 1, y: 2, z: 3} in SQL"
    if match := _FIELD.search(message):
        return _hint_of_row(match.group(1), sql)
    if match := _FUNCTION.search(message):
        name = match.group(1).lower()
        return _CALLS.get(name, _IS_SELECTSCRIPT if name in _ONLY_PROGRAMS else "")
    if match := _NUMBER.search(message):
        return (
            "The ids of entities are numbers in SQL; their names are in the column name: "
            f"WHERE name = {match.group(1)!r}"
        )
    if (match := _NO_SOURCE.search(message)) and _same(match.group(1), worlds):
        return _IS_SELECTSCRIPT
    return ""


def _hint_of_table(name: str, message: str, worlds: Collection[str]) -> str:
    if name in _TABLES:
        return f"write {_TABLES[name]}"
    if nearest(name, re.findall(r"\w+", message.partition(_GUESS)[2])):  # DuckDB's guess is good
        return ""
    tables = "A"
    if worlds:
        tables = (
            f"The tables of a world are {', '.join(TABLES)}, and those of all recorded ticks "
            "entities_history and so on; a"
        )
    return f"{tables} frame of yours is a table after ss.register({name!r}, {name})"


def _hint_of_world(message: str, sql: str, worlds: Collection[str]) -> str:
    """Returns the hint for a world whose name is a word of SQL, where its tables are named."""
    match = _SYNTAX.match(message)
    for world in worlds if match else ():
        named = re.search(rf"\b({world})\s*\.\s*(\w+)", sql, re.IGNORECASE)
        if named and match and match.group(1) in (named.group(1), "."):
            (token,) = sqlglot.tokenize(world, read="duckdb")
            if match.group(1) != "." or token.token_type != sqlglot.TokenType.VAR:
                return f'{world} is a word of SQL: write "{world}".{named.group(2)}'
    return ""


def _hint_of_quotes(message: str, sql: str) -> str:
    """Returns the hint for a column whose name is a word of SQL, at the error or before it."""
    tables = [TABLES[name.lower()] for name in _OWN_TABLES.findall(sql)]
    quoted = _QUOTED.intersection(name for table in tables for name in table.names)
    if match := _SYNTAX.match(message):
        with suppress(sqlglot.TokenError):
            tokens = sqlglot.tokenize(sql, read="duckdb")
            for token, after in zip(tokens, [*tokens[1:], tokens[-1]], strict=True):
                is_at = token.text == match[1] or after.text.startswith(match[1])
                is_bare = token.token_type == sqlglot.TokenType.VAR
                if is_at and is_bare and token.text.lower() in quoted:
                    return f'{token.text} is a word of SQL: write "{token.text}"'
    return ""


def _hint_of_syntax(sql: str) -> str:
    if _PAST.search(sql):
        return f"{_PAST_TABLES}\n{_IS_SELECTSCRIPT}" if _is_selectscript(sql) else _PAST_TABLES
    called = _CALLED.search(sql)
    if called is not None and (_OWN_TABLES.search(sql) or not _is_selectscript(sql)):
        name = called.group(1)
        return f"{name} is a word of SQL: write {_RESERVED[name.lower()]}(…)"
    return _IS_SELECTSCRIPT if _is_selectscript(sql) else ""


def _hint_of_column(name: str) -> str:
    if name == "this":
        return _IS_SELECTSCRIPT
    if name in _COLUMNS:
        return _COLUMNS[name]
    relation = RELATIONS.get(_NAMES.get(name, ""))
    if relation is None or relation.parameters[0].type != "entity":
        return ""
    rest = "" if relation.required_count == 1 else ", …"
    alias = relation.aliases[0] if relation.aliases else relation.name
    return f"{alias} is a function of a row: write {alias}(e{rest}), with FROM entities e"


def _hint_of_alias(name: str) -> str:
    return (
        f"{name} is an alias of a table here, and the name of a column, which DuckDB reads first: "
        "take an alias that is no column's name, as in FROM entities p"
    )


def _hint_of_row(expression: str, sql: str) -> str:
    name = expression.lower()
    if re.search(rf"\b\w+\s+(AS\s+)?{name}\s*(,|;|JOIN\b|WHERE\b|$)", sql, re.IGNORECASE):
        return _hint_of_alias(expression)
    if name in ("entity", "sensor", "a", "b"):
        join = f"JOIN entities e ON e.id = {name}"
        return f"{name} is the id of an entity; a join has its columns: {join}"
    if expression.startswith("'") or name in ("name", "id"):
        which = expression if expression.startswith("'") else "'table'"
        return (
            f"Relations take rows, not {'names' if name != 'id' else 'ids'}: "
            f"FROM entities a, entities b WHERE near(a, b, 0.1) AND b.name = {which}"
        )
    return ""


def _is_selectscript(sql: str) -> bool:
    """Checks whether a text that is no SQL is a program of SelectScript."""
    try:
        parse(sql)
    except SelectScriptError:
        return False
    return True


def _same(name: str, names: Collection[str]) -> str | None:
    """Returns the name among others that differs in case only, which does not matter in SQL."""
    return next((known for known in names if known.lower() == name.lower()), None)
