"""The functions of Python that SQL calls: users', and those of shapes and of recorded ticks.

They know the worlds by the names of their schemas, and not the database, which they would keep
alive.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from itertools import accumulate
from typing import Any

import pyarrow as pa
from duckdb.func import FunctionNullHandling, PythonUDFType

from ssduck.database.bound import Bound
from ssduck.database.connection import Connection
from ssduck.errors import EvaluationError, UnknownNameError, UnsupportedError
from ssduck.functions import Function
from ssduck.history import Near
from ssduck.memo import Memo
from ssduck.record import PAIR, Record
from ssduck.shapes import ANSWERS
from ssduck.types import Signature, Tag, converter, is_exactly
from ssduck.udfs import NARROW, THEN, THEN_COLLIDING, THEN_TOLD
from ssduck.world import World


def add_users(
    connection: Connection,
    signature: Signature,
    function: Function,
    worlds: Mapping[str, World],
    records: Mapping[str, Record],
) -> None:
    """Make a user's function one of SQL; replaces one of that signature."""
    converters = [converter(tag, worlds, records) for tag in signature.parameters]

    def given(arguments: list[Any]) -> Any:
        values = [
            value if convert is None else convert(value)
            for convert, value in zip(converters, arguments, strict=True)
        ]
        return _usable(function(values), signature.result)

    memo = Memo(given, keeps_same=False)

    def call(*arguments: Any) -> Any:
        return memo(list(arguments))

    types = [tag.sql_type for tag in signature.parameters]
    connection.add_function(
        signature.name, call, types, signature.result.sql_type, at_start=memo.forget
    )


def _usable(value: Any, tag: Tag) -> Any:
    """A value that SQL gives back as it is: it would make 3.0 of 3, and nothing of a NaN."""
    if not is_exactly(value, tag):
        raise ValueError("no value for SQL")
    return value


def add_own(connection: Connection, worlds: Mapping[str, Bound]) -> None:
    """Make the functions of shapes and of recorded ticks some of SQL.

    Args:
        connection: where.
        worlds: by their names, as they come and go.
    """
    for name, (taken, result) in NARROW.items():
        connection.add_function(
            name,
            _narrow(name, worlds),
            ("VARCHAR", *taken),
            result,
            null_handling=FunctionNullHandling.SPECIAL,  # it may yield none
            side_effects=result == "BIGINT[]",  # all pairs of a tick: not to be found for good
        )
    pairs = f"STRUCT({', '.join(f'{column} BIGINT' for column in PAIR)})[]"
    for name in THEN:
        collide = name == THEN_COLLIDING
        # In columns: as lists, some thousand pairs took as long as comparing them.
        connection.add_function(
            name,
            partial(_then, worlds, collide),
            ("VARCHAR", *["BIGINT"] * 4, *([] if collide else ["DOUBLE"])),
            pairs,
            type=PythonUDFType.ARROW,
            side_effects=True,
        )
    connection.add_function(
        THEN_TOLD,
        partial(_told, worlds),
        ("VARCHAR", "VARCHAR", "BIGINT", "BIGINT", "BIGINT"),
        "DOUBLE[]",
        side_effects=True,
    )


def _narrow(name: str, worlds: Mapping[str, Bound]) -> Callable[..., Any]:
    """A function of the narrow phase, of a world's name and of entities."""
    entities = NARROW[name][0].count("BIGINT")  # twice as many: of each its tick and its id
    answer = ANSWERS[name]

    def call(world: str, *arguments: Any) -> Any:
        if None in arguments:
            return None
        if world not in worlds:
            raise UnknownNameError(f"there is no world {world!r} here any more")
        ticks = set(arguments[:entities:2])
        if len(ticks) > 1:
            raise UnsupportedError(
                "shapes are compared at one tick: these rows are of the ticks "
                f"{' and '.join(map(str, sorted(ticks)))} of {world!r}"
            )
        ids = arguments[1:entities:2]
        shapes = worlds[world].shapes(ticks.pop() if ticks else None, ids)
        return answer(shapes, *ids, *arguments[entities:])

    return call


def _then(worlds: Mapping[str, Bound], collide: bool, *arguments: pa.ChunkedArray) -> pa.ListArray:
    """The narrow phase over many ticks, of columns of what is asked for."""

    def found(
        world: str, first: int, last: int, a: int, b: int, apart: float = 0.0
    ) -> pa.StructArray:
        kept = worlds[world].kept
        if kept is None:
            raise EvaluationError(f"the ticks of {world!r} are not recorded")
        pairs = kept.record.pairs(Near(first, last, a, b, apart), collide=collide)
        return pa.StructArray.from_arrays(list(map(pa.array, pairs)), names=PAIR)

    rows = zip(*(values.to_pylist() for values in arguments), strict=True)
    answers = [found(*row) for row in rows]
    ends = accumulate(map(len, answers), initial=0)
    offsets = pa.array(ends, pa.int32())
    return pa.ListArray.from_arrays(offsets, pa.concat_arrays(answers))


def _told(
    worlds: Mapping[str, Bound], world: str, what: str, tick: int, a: int, b: int
) -> list[float]:
    """What contacts and sensors told at a recorded tick."""
    return worlds[world].told(what, tick, a, b)
