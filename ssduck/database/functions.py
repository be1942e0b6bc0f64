"""The Python functions that SQL calls: users', and those of shapes and of recorded ticks.

They know worlds by the names of their schemas, and not the database, which they would keep alive.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from itertools import accumulate, product
from typing import Any, TypeVar

import pyarrow as pa
from duckdb.func import FunctionNullHandling, PythonUDFType

from ssduck.database.binding import BoundWorld
from ssduck.database.connection import Connection
from ssduck.database.values import Converter, converter, is_exactly
from ssduck.errors import EvaluationError, UnknownNameError, UnsupportedError, nearest
from ssduck.geometry.batch import PairPredicate, PredicateKind
from ssduck.geometry.queries import depth
from ssduck.language.builtins import Function
from ssduck.language.memo import Memo
from ssduck.recording.replay.record import PREDICATE_COLUMNS, Record
from ssduck.recording.stores.base import PairRequest
from ssduck.simulators.joints import JointError
from ssduck.sql.relations.common import RECORDED_NUMBERS_UDF
from ssduck.sql.relations.geometry_query import MARGINS_UDF, PAIR_SEARCHES, GeometryUdf
from ssduck.sql.relations.joints import JOINT_UDFS
from ssduck.sql.relations.registry import GEOMETRY_UDFS
from ssduck.sql.relations.relation import CHECKED_TICK_UDF, LENIENT_PREFIX
from ssduck.sql.types import Signature, SqlType


def add_users(
    connection: Connection,
    signature: Signature,
    function: Function,
    worlds: Mapping[str, BoundWorld],
) -> None:
    """Registers a user's function with SQL; replaces one of that signature."""
    converters = [converter_of(sql_type, worlds) for sql_type in signature.parameters]

    def given(arguments: list[Any]) -> Any:
        values = [
            value if convert is None else convert(value)
            for convert, value in zip(converters, arguments, strict=True)
        ]
        return _usable(function(values), signature.result)

    memo = Memo(given, keeps_same=False)

    def call(*arguments: Any) -> Any:
        return memo(list(arguments))

    types = [sql_type.duckdb_type for sql_type in signature.parameters]
    connection.add_function(
        signature.name, call, types, signature.result.duckdb_type, at_start=memo.forget
    )


def converter_of(sql_type: SqlType, worlds: Mapping[str, BoundWorld]) -> Converter | None:
    """Returns the function from SQL's values to Python's; it keeps no world alive.

    Args:
        sql_type: the type of the values.
        worlds: the worlds of the database by name, up to date.
    """
    return converter(
        sql_type, _Parts(worlds, lambda bound: bound.world), _Parts(worlds, _record_of)
    )


T = TypeVar("T")


class _Parts(Mapping[str, T]):
    """A mapping to a part of each world in a database, up to date.

    Args:
        worlds: the worlds by name.
        part: a function that returns the part.
    """

    def __init__(self, worlds: Mapping[str, BoundWorld], part: Callable[[BoundWorld], T]) -> None:
        self._worlds = worlds
        self._part = part

    def __getitem__(self, name: str) -> T:
        return self._part(self._worlds[name])

    def __iter__(self) -> Iterator[str]:
        return iter(self._worlds)

    def __len__(self) -> int:
        return len(self._worlds)


def _record_of(bound: BoundWorld) -> Record:
    assert bound.history is not None
    return bound.history.record


def _usable(value: Any, sql_type: SqlType) -> Any:
    """Returns a value if SQL keeps it as it is: it would turn 3 into 3.0, and NaN into NULL."""
    if not is_exactly(value, sql_type):
        raise ValueError("no value for SQL")
    return value


def add_own(connection: Connection, worlds: Mapping[str, BoundWorld]) -> None:
    """Make the functions of shapes and of recorded ticks some of SQL.

    Args:
        connection: where.
        worlds: by their names, as they come and go.
    """
    for udf in GEOMETRY_UDFS.values():
        connection.add_function(
            udf.name,
            _geometry(udf, worlds),
            udf.parameters,
            udf.result,
            null_handling=FunctionNullHandling.SPECIAL,  # it may yield none
            side_effects=udf.entities == 0,  # all pairs of a tick: not to be found for good
        )
    connection.add_function(MARGINS_UDF, partial(_margins, worlds), ("VARCHAR",), "DOUBLE")
    connection.add_function(
        CHECKED_TICK_UDF,
        partial(_checked_tick, worlds),
        ("VARCHAR", *["BIGINT"] * 3, *["DOUBLE"] * 7),
        "BIGINT",
        null_handling=FunctionNullHandling.SPECIAL,  # a pose may be unknown
    )
    for (name, (function, more)), prefix in product(JOINT_UDFS.items(), ("", LENIENT_PREFIX)):
        call = partial(_of_joints, worlds, function)
        connection.add_function(
            prefix + name,
            partial(_if_any, worlds, call) if prefix else call,
            ("VARCHAR", "BIGINT", "BIGINT", *more),
            "DOUBLE",
            null_handling=FunctionNullHandling.SPECIAL,
        )
    pairs = f"STRUCT({', '.join(f'{column} BIGINT' for column in PREDICATE_COLUMNS)})[]"
    for search in PAIR_SEARCHES:
        if search.predicate is None:
            continue
        # In columns: as lists, some thousand pairs took as long as comparing them.
        connection.add_function(
            search.name_over_ticks,
            partial(_then, worlds, search.predicate),
            ("VARCHAR", *["BIGINT"] * 4, "DOUBLE"),
            pairs,
            type=PythonUDFType.ARROW,
            side_effects=True,
        )
    connection.add_function(
        RECORDED_NUMBERS_UDF,
        partial(_told, worlds),
        ("VARCHAR", "VARCHAR", "BIGINT", "BIGINT", "BIGINT"),
        "DOUBLE[]",
        side_effects=True,
    )


def _geometry(udf: GeometryUdf, worlds: Mapping[str, BoundWorld]) -> Callable[..., Any]:
    """A function of shapes, of a world's name and of entities: of each its tick and its id."""
    after = 2 * udf.entities

    def call(world: str, *arguments: Any) -> Any:
        if None in arguments:
            return None
        if world not in worlds:
            raise UnknownNameError(f"there is no world {world!r} here any more")
        ticks = set(arguments[:after:2])
        if len(ticks) > 1:
            raise UnsupportedError(
                "shapes are compared at one tick: these rows are of the ticks "
                f"{' and '.join(map(str, sorted(ticks)))} of {world!r}"
            )
        ids = arguments[1:after:2]
        tick = ticks.pop() if ticks else None
        shapes = worlds[world].shapes(tick, None if udf.needs_whole_tick else ids)
        if udf.uses_margins:
            worlds[world].note_margins(tick)
        return udf.function(shapes, *ids, *arguments[after:])

    return call


def _margins(worlds: Mapping[str, BoundWorld], world: str) -> float:
    """How far apart shapes may be that touch by their margins, metres."""
    return worlds[world].margins if world in worlds else 0.0


def _checked_tick(
    worlds: Mapping[str, BoundWorld],
    world: str,
    run: int | None,
    tick: int | None,
    id: int | None,
    *pose: float | None,
) -> int | None:
    """The tick of a row of entities, if it is one of that world, and as it was."""
    if tick is None or id is None:
        return None
    if world not in worlds:
        raise UnknownNameError(f"there is no world {world!r} here any more")
    worlds[world].check_row(run, tick, id, pose)
    return tick


def _of_joints(
    worlds: Mapping[str, BoundWorld],
    answer: Callable[..., float | None],
    world: str,
    *arguments: Any,
) -> float | None:
    """What the joints of an entity tell, of its tick, its id and a name."""
    if None in arguments:
        return None
    if world not in worlds:
        raise UnknownNameError(f"there is no world {world!r} here any more")
    tick, id, *more = arguments
    return answer(worlds[world].joints(tick, id), *more)


def _if_any(
    worlds: Mapping[str, BoundWorld],
    call: Callable[..., float | None],
    world: str,
    tick: int,
    id: int,
    *name: str,
) -> float | None:
    """The same of raw SQL: None of an entity without a joint that another one has."""
    try:
        return call(world, tick, id, *name)
    except JointError:
        owners = worlds[world].joint_owners()
        if name[0] not in owners:
            raise JointError(
                f"no entity of {world!r} has a joint {name[0]!r}",
                suggestions=nearest(name[0], list(owners)),
            ) from None
        if owners[name[0]] == {id}:
            raise
        return None


def _then(
    worlds: Mapping[str, BoundWorld], of: PredicateKind, *arguments: pa.ChunkedArray
) -> pa.ListArray:
    """The narrow phase over many ticks, of columns of what is asked for."""

    def found(world: str, first: int, last: int, a: int, b: int, distance: float) -> pa.StructArray:
        history = worlds[world].history
        if history is None:
            raise EvaluationError(f"the ticks of {world!r} are not recorded")
        question = PairPredicate(of, depth(distance) if of == "colliding" else distance)
        apart = 0.0 if of == "colliding" else distance
        if of == "touching":
            worlds[world].note_margins(first)
        pairs = history.record.matching_pairs(PairRequest(first, last, a, b, apart), question)
        return pa.StructArray.from_arrays(list(map(pa.array, pairs)), names=PREDICATE_COLUMNS)

    rows = zip(*(values.to_pylist() for values in arguments), strict=True)
    answers = [found(*row) for row in rows]
    ends = accumulate(map(len, answers), initial=0)
    offsets = pa.array(ends, pa.int32())
    return pa.ListArray.from_arrays(offsets, pa.concat_arrays(answers))


def _told(
    worlds: Mapping[str, BoundWorld], world: str, what: str, tick: int, a: int, b: int
) -> list[float]:
    """What contacts and sensors told at a recorded tick."""
    return worlds[world].told(what, tick, a, b)
