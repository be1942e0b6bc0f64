"""The Python functions that SQL calls: users', and those of shapes and of recorded ticks.

They refer to worlds by the names of their schemas: a reference to the database would keep it alive.
"""

from __future__ import annotations

import weakref
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from itertools import accumulate
from typing import Any, get_args

import numpy as np
import pyarrow as pa
from duckdb.func import FunctionNullHandling, PythonUDFType

from ssduck.database.binding import BoundWorld
from ssduck.database.connection import Connection
from ssduck.database.values import Converter, converter, is_exactly
from ssduck.errors import (
    ArgumentError,
    EvaluationError,
    UnknownNameError,
    UnsupportedError,
    nearest,
)
from ssduck.geometry.arrays import Indices
from ssduck.geometry.broad_phase import IdPairs
from ssduck.geometry.pair_batch import PairQuestion, QuestionKind
from ssduck.geometry.queries import ShapeQueries
from ssduck.geometry.tick_shapes import depth
from ssduck.language.builtins import Function
from ssduck.language.value_keys import Memo
from ssduck.limits import UsageMeter
from ssduck.recording.replay.pair_answers import PairQueries
from ssduck.recording.replay.record import Record
from ssduck.recording.spec import no_ticks_message
from ssduck.recording.stores.base import PairRequest
from ssduck.schema import LINK_FACTOR
from ssduck.simulators.kinematics import JointError
from ssduck.sql.pair_lookup import PairLookup
from ssduck.sql.relations.common import RECORDED_NUMBERS_UDF
from ssduck.sql.relations.geometry_query import (
    MARGINS_UDF,
    GeometryUdf,
    PairKind,
    PairSearch,
    name_over_ticks,
)
from ssduck.sql.relations.motion import JOINT_UDFS, LINK_SPEED_UDFS
from ssduck.sql.relations.registry import GEOMETRY_UDFS, RELATIONS
from ssduck.sql.relations.relation import CHECKED_TICK_UDF, LENIENT_PREFIX
from ssduck.sql.types import Signature, SqlType
from ssduck.world.live_tables import LiveTable


def add_user_function(
    connection: Connection,
    signature: Signature,
    function: Function,
    worlds: Mapping[str, BoundWorld],
) -> None:
    """Registers a user's function with SQL; replaces one of that signature."""
    converters = [converter_of(sql_type, worlds) for sql_type in signature.parameters]

    def call_with_list(arguments: list[Any]) -> Any:
        values = [
            value if convert is None else convert(value)
            for convert, value in zip(converters, arguments, strict=True)
        ]
        result = function(values)
        if not is_exactly(result, signature.result):  # as 3 would be 3.0, and NaN NULL
            raise ValueError("SQL does not preserve the value")
        return result

    memo = Memo(call_with_list, by_identity=False)

    def call(*arguments: Any) -> Any:
        return memo(list(arguments))

    types = [sql_type.duckdb_type for sql_type in signature.parameters]
    connection.register_function(
        signature.name, call, types, signature.result.duckdb_type, at_start=memo.forget
    )


def offer_user_function(
    connection: Connection, function: Function, parameters: Sequence[SqlType], result: SqlType
) -> None:
    """Has a user's function registered under its own name when a statement names it.

    A function of SQL's own of that name stays.
    """

    def call(*arguments: Any) -> Any:
        return function(arguments)

    def make(own: Connection) -> None:
        ((count,),) = own.internal_rows(
            "SELECT count(*) FROM duckdb_functions() WHERE lower(function_name) = lower(?)",
            [function.name],
        )
        if not count:
            types = [sql_type.duckdb_type for sql_type in parameters]
            own.register_function(function.name, call, types, result.duckdb_type)

    connection.on_demand.offer((None, function.name), make)


def converter_of(sql_type: SqlType, worlds: Mapping[str, BoundWorld]) -> Converter | None:
    """Returns the function from SQL's values to Python's; it keeps no world alive."""
    return converter(
        sql_type, lambda name: worlds[name].world, lambda name: _record_of(worlds[name])
    )


def _bound(worlds: Mapping[str, BoundWorld], world: str) -> BoundWorld:
    if world not in worlds:
        raise UnknownNameError(f"there is no world {world!r} here any more")
    return worlds[world]


def _record_of(bound: BoundWorld) -> Record:
    assert bound.history is not None
    return bound.history.record


def offer_geometry_functions(connection: Connection, worlds: Mapping[str, BoundWorld]) -> None:
    """Has the functions of shapes, joints and recorded ticks registered when SQL names them."""
    key = ("VARCHAR", "BIGINT", "BIGINT")  # a world, a tick and an entity

    def offer(
        name: str,
        function: Callable[..., Any],
        parameters: Sequence[str],
        result: str = "DOUBLE",
        *,
        may_be_null: bool = True,
        **options: Any,
    ) -> None:
        if may_be_null:  # an argument or the result
            options["null_handling"] = FunctionNullHandling.SPECIAL
        connection.offer_function(name, function, parameters, result, **options)

    for udf in GEOMETRY_UDFS.values():
        if isinstance(udf, PairSearch):  # all pairs of a tick change with the tick
            function, changes = _pair_search(udf, worlds), True
        else:
            function, changes = _geometry_function(udf, worlds), False
        offer(udf.name, function, udf.parameters, udf.result, side_effects=changes)
    offer(MARGINS_UDF, partial(_margins, worlds), ("VARCHAR",), may_be_null=False)
    row = ("VARCHAR", *["BIGINT"] * 3, *["DOUBLE"] * 7)
    offer(CHECKED_TICK_UDF, partial(_checked_tick, worlds), row, "BIGINT")
    for name, (of_joints, parameters) in JOINT_UDFS.items():
        call = partial(_joint_value, worlds, of_joints)
        offer(name, call, (*key, *parameters))
        lenient = partial(_lenient_joint_value, worlds, call)
        offer(LENIENT_PREFIX + name, lenient, (*key, *parameters))
    for name, columns in LINK_SPEED_UDFS.items():
        offer(name, partial(_link_speed, worlds, columns), key)
    for kind in get_args(QuestionKind):
        # As Arrow columns: converting lists would take as long as comparing the pairs.
        offer(
            name_over_ticks(kind),
            partial(_pairs_over_ticks, worlds, weakref.ref(connection), kind),
            ("VARCHAR", *["BIGINT"] * 4, "DOUBLE"),
            "STRUCT(tick BIGINT, a BIGINT, b BIGINT, value DOUBLE)[]",
            may_be_null=False,
            type=PythonUDFType.ARROW,
            side_effects=True,
        )
    offer(
        RECORDED_NUMBERS_UDF,
        lambda world, *question: worlds[world].recorded_numbers(*question),
        ("VARCHAR", "VARCHAR", *["BIGINT"] * 3),
        "DOUBLE[]",
        may_be_null=False,
        side_effects=True,
    )


def shape_functions(worlds: Mapping[str, BoundWorld]) -> dict[str, Callable[..., Any]]:
    """Returns the functions of shapes, joints and contacts of single entities, by their names.

    The arguments of those of shapes and joints are those of SQL: a world's name, the tick and the
    id of each entity, and further values. The functions of contacts have the names of relations,
    and a world's name and two ids as arguments.
    """
    functions: dict[str, Callable[..., Any]] = {
        udf.name: _geometry_function(udf, worlds) for udf in GEOMETRY_UDFS.values() if udf.entities
    }
    functions[MARGINS_UDF] = partial(_margins, worlds)
    for name, (function, _) in JOINT_UDFS.items():
        functions[name] = partial(_joint_value, worlds, function)
    for name, columns in LINK_SPEED_UDFS.items():
        functions[name] = partial(_link_speed, worlds, columns)
    for relation in RELATIONS.values():
        if relation.of_contacts is not None:
            functions[relation.name] = partial(_of_contacts, worlds, relation.of_contacts)
    return functions


def _geometry_function(udf: GeometryUdf, worlds: Mapping[str, BoundWorld]) -> Callable[..., Any]:
    """Returns a function of a world's name, the tick and the id of each entity, and more values."""
    id_count = 2 * udf.entities

    def call(world: str, *arguments: Any) -> Any:
        if None in arguments:
            return None
        bound = _bound(worlds, world)
        ticks = set(arguments[:id_count:2])
        if len(ticks) > 1:
            raise UnsupportedError(
                "shapes are compared at one tick: these rows are of the ticks "
                f"{' and '.join(map(str, sorted(ticks)))} of {world!r}"
            )
        ids = arguments[1:id_count:2]
        tick = ticks.pop()
        has_links = max(ids) >= LINK_FACTOR
        shapes = bound.shapes(tick, with_sites=has_links)
        if has_links:
            shapes = shapes.of(ids)
        if udf.uses_margins:
            bound.warn_of_changed_margins(tick)
        bound.warn_of_filled_meshes(udf.function, shapes, ids)
        if udf.needs_whole_tick:
            bound.warn_of_missing_entities(tick)
        answer = udf.function(shapes, *ids, *arguments[id_count:])
        if udf.function is ShapeQueries.inside and answer is not None and 0.0 < answer < 1.0:
            bound.warn_of_overlaps(shapes, ids[1])
        return answer

    return call


def _pair_search(search: PairSearch, worlds: Mapping[str, BoundWorld]) -> Callable[..., Any]:
    """Returns a function of a world's name, the kind of pairs, and more values: all such pairs."""

    def call(world: str, kind: PairKind, *values: Any) -> list[int] | None:
        if None in values:
            return None
        found: IdPairs | list[int] = _found(_bound(worlds, world), search, kind, values)
        return found.numbers if isinstance(found, IdPairs) else found

    return call


def _found(bound: BoundWorld, search: PairSearch, kind: PairKind, values: Sequence[Any]) -> Any:
    """Returns what a search finds at a world's current tick."""
    if search.of_boxes:
        return search.function(bound.world.snapshot.boxes())
    shapes = bound.world.snapshot.shapes()
    if kind == "links":
        shapes = shapes.links
    elif kind == "links and entities":
        shapes = shapes.links_and_entities
    bound.warn_of_filled_meshes(search.function, shapes)
    return search.function(shapes, *values)


def pair_rows(
    lookup: PairLookup, bound: BoundWorld, parameters: Mapping[str, Any], meter: UsageMeter
) -> list[tuple[Any, ...]] | None:
    """Returns the rows that the SQL of a look-up's query has; None if a statement has to run."""
    if not set(map(type, parameters.values())) <= {int, float}:
        return None
    entities = bound.world.snapshot.tables["entities"]
    distance, distances = lookup.distance, []
    if lookup.search.numbers:
        distances = [float(parameters[distance] if isinstance(distance, str) else distance)]
    try:
        found: IdPairs = _found(bound, lookup.search, "entities", distances)
    except ArgumentError:  # the SQL raises it, with its place
        return None
    meter.check_time()
    rows = found.first, found.second
    for comparison in lookup.comparisons:
        ranks = entities["id"] if comparison.column == "id" else _ranks(entities)
        left, right = (ranks[rows[side]] for side in comparison.sides)
        holds = comparison.compare(left, right)
        rows = rows[0][holds], rows[1][holds]
    meter.check_rows(len(rows[0]))
    if not lookup.columns:  # the SQL selects a constant
        return [(1,)] * len(rows[0])
    columns = (entities.values(column.name, rows[column.side]) for column in lookup.columns)
    return list(zip(*columns, strict=True))


def _ranks(entities: LiveTable) -> Indices:
    """Returns the place of each entity's name in their order; equal names have equal places."""
    names = entities.values("name")
    places = {name: place for place, name in enumerate(sorted(set(names)))}
    return np.array([places[name] for name in names], np.intp)


def _margins(worlds: Mapping[str, BoundWorld], world: str) -> float:
    """Returns the largest distance, m, of shapes that touch by their margins."""
    return worlds[world].margins if world in worlds else 0.0


def _checked_tick(
    worlds: Mapping[str, BoundWorld],
    world: str,
    run: int | None,
    tick: int | None,
    id: int | None,
    *pose: float | None,
) -> int | None:
    """Returns the tick of a row of entities, checked against the record of the world."""
    if tick is None or id is None:
        return None
    _bound(worlds, world).check_row(run, tick, id, pose)
    return tick


def _joint_value(
    worlds: Mapping[str, BoundWorld],
    function: Callable[..., float | None],
    world: str,
    *arguments: Any,
) -> float | None:
    """Returns the value of a function of joints, of a tick, an entity's id and more values."""
    if None in arguments:
        return None
    tick, id, *more = arguments
    return function(_bound(worlds, world).joints(tick, id), *more)


def _link_speed(
    worlds: Mapping[str, BoundWorld], columns: Sequence[str], world: str, tick: int, id: int
) -> float | None:
    """Returns the greatest magnitude of a velocity of an entity's links but its base."""
    if None in (tick, id):
        return None
    return _bound(worlds, world).fastest_link(tick, id, columns)


def _of_contacts(
    worlds: Mapping[str, BoundWorld], function: Callable[..., bool | float], world: str, *ids: int
) -> bool | float:
    """Returns the value of a function of the contacts of two entities at a world's present tick."""
    return function(worlds[world].contacts(), *ids)


def _lenient_joint_value(
    worlds: Mapping[str, BoundWorld],
    call: Callable[..., float | None],
    world: str,
    tick: int,
    id: int,
    *name: str,
) -> float | None:
    """Returns the value for raw SQL: None for an entity without a joint that another one has."""
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


def _pairs_over_ticks(
    worlds: Mapping[str, BoundWorld],
    connection: weakref.ref[Connection],
    kind: QuestionKind,
    *arguments: pa.ChunkedArray,
) -> pa.ListArray:
    """Returns the answers over ranges of ticks, given as columns, but those that are False."""

    def pairs_of(
        world: str, first: int, last: int, a: int, b: int, distance: float
    ) -> pa.StructArray:
        history = worlds[world].history
        if history is None:
            raise EvaluationError(no_ticks_message(world))
        question = PairQuestion(kind, depth(distance) if kind == "colliding" else distance)
        if question.uses_margins:
            worlds[world].warn_of_changed_margins(first)
        if question.needs_whole_tick:
            history.record.warn_of_missing_entities()
        own = connection()
        assert own is not None, "a statement of the connection is running"
        queries = PairQueries(history.record, own.meter)
        answers = queries.answers(PairRequest(first, last, a, b, 0.0), question)
        rows = slice(None) if question.is_number else np.flatnonzero(answers.values != 0.0)
        columns = answers.ticks[rows], answers.first[rows], answers.second[rows]
        values = pa.array(answers.values[rows], mask=np.isnan(answers.values[rows]))
        names = ("tick", "a", "b", "value")
        return pa.StructArray.from_arrays([*map(pa.array, columns), values], names=names)

    rows = zip(*(values.to_pylist() for values in arguments), strict=True)
    results = [pairs_of(*row) for row in rows]
    ends = accumulate(map(len, results), initial=0)
    offsets = pa.array(ends, pa.int32())
    return pa.ListArray.from_arrays(offsets, pa.concat_arrays(results))
