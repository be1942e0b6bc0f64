"""Plans a program as one statement over the recorded ticks, which SQL alone can answer.

Such a program is a query of a world, or an expression of its entities, perhaps in a function over
time. Its statement has ids of entities and texts, and no other value of the episode at hand, so
that it is right for each episode with the same entities.
"""

from __future__ import annotations

from dataclasses import dataclass

from sqlglot import exp

from ssduck.errors import SourceSpan, UnsupportedError
from ssduck.interpreter.execution import Execution
from ssduck.interpreter.interpreter import Interpreter
from ssduck.interpreter.over_time.functions import TEMPORAL_FUNCTIONS
from ssduck.language import ast
from ssduck.language.aggregates import is_grouped
from ssduck.language.analysis import OVER_TIME
from ssduck.language.evaluator import Frame
from ssduck.schema import TABLES
from ssduck.sql.explain import select_for
from ssduck.sql.from_clause import past_value
from ssduck.sql.plan import ParameterBinding, Plan
from ssduck.sql.relations.registry import RELATIONS
from ssduck.sql.types import SqlType

# Parts of a program whose value is the same in each episode, if their own parts are such.
_OF_VALUES = (ast.Literal, ast.ListLiteral, ast.Unary, ast.Binary, ast.OperatorChain)
# Their rows are not those of entities.
_OTHER_TABLES = frozenset(TABLES) - {"entities", "ticks"}
# The engine that has the fewest functions of those that read the files of records.
_LEAST = "spark"
_ADVICE = "ask the episodes instead (Lake.ask)"


@dataclass(frozen=True)
class SelectedSql:
    """A column of a statement: its name, its value and the type of that."""

    name: str
    value: exp.Expr
    sql_type: SqlType


@dataclass(frozen=True)
class TickPlan:
    """A statement over the recorded ticks."""

    select: exp.Select  # the statement; its tables are those of the past of one world
    # Its columns; without `is_query` the tick, the time and the value of an expression.
    columns: tuple[SelectedSql, ...]
    is_query: bool  # whether the rows are the answer
    # The function over time that makes the answer from the values; None for the value at the last
    # tick.
    function: str | None
    # How many seconds before the last tick the first one is, less than 0; 0 for the last tick only;
    # None for all ticks.
    age: float | None


def plan_over_ticks(interpreter: Interpreter, text: str) -> TickPlan:
    """Plans a program for the recorded ticks."""
    execution = interpreter._execution  # noqa: SLF001  # a part of this package
    program = interpreter.compile(text).tree
    if len(program.statements) != 1 or program.explain:
        raise UnsupportedError(
            f"SQL takes a program of one statement, a query or an expression: {_ADVICE}"
        )
    with execution.transaction(program), execution.rehearsal(program) as frame:
        (statement,) = execution.read(program).statements
        if isinstance(statement, ast.Query):
            return _of_query(execution, statement, frame)
        return _of_expression(execution, statement, frame)


def _check_parts(query: ast.Query) -> None:
    """Checks that a query has formulas only, and no part that is evaluated before it."""
    for node in query.walk():
        if isinstance(node, ast.Query) and node is not query:
            raise _unsupported("a query inside of another expression", node)
        if not isinstance(node, ast.Call):
            continue
        if node.name in OVER_TIME:
            raise _unsupported(f"{node.name} inside of another expression", node)
        relation = RELATIONS.get(node.name)
        if relation is not None and relation.geometry is not None:
            raise _unsupported(f"{node.name}, which compares shapes,", node)
        for table in sorted((relation.inputs if relation else frozenset()) & _OTHER_TABLES):
            raise _unsupported(f"{node.name}, which reads {table},", node)


def _unsupported(what: str, node: ast.Node) -> UnsupportedError:
    return UnsupportedError(f"{what} is not written as SQL: {_ADVICE}", span=node.span)


# -- queries ----------------------------------------------------------------------------------


def _of_query(execution: Execution, query: ast.Query, frame: Frame) -> TickPlan:
    for part, words in ((query.recursion, "START WITH"), (query.adapter, "AS")):
        if part is not None:
            raise _unsupported(words, part)
    ages = {_age_of(source, frame) for source in query.sources}
    if len(ages) != 1:
        raise _unsupported("a query of several ranges of ticks, or of none,", query)
    sources = {source: _over_all_ticks(source) for source in query.sources}
    whole = query.replaced(lambda node: sources.get(node) if isinstance(node, ast.Source) else None)
    assert isinstance(whole, ast.Query)
    plan, select = _planned(execution, whole, frame)
    return TickPlan(select, _columns(plan, select, query.span), True, None, ages.pop())


def _age_of(source: ast.Source, frame: Frame) -> float | None:
    """Returns which ticks a source has, as `TickPlan.age`."""
    match source.value:
        case ast.Name():
            return 0.0
        case ast.TimeIndex(age=None):
            return None
        case ast.TimeIndex(age=ast.Node() as age) if _is_value(age) and frame.value(age) < 0:
            return float(frame.value(age))
    raise _unsupported("a source other than a world, as in sim, sim{} and sim{-2.0},", source.value)


def _over_all_ticks(source: ast.Source) -> ast.Source:
    name = source.value.name  # type: ignore[attr-defined]  # of a name, or of its past
    return ast.Source(source.span, source.alias, ast.TimeIndex(source.value.span, name, None))


# -- expressions ------------------------------------------------------------------------------


def _of_expression(execution: Execution, node: ast.Node, frame: Frame) -> TickPlan:
    function: str | None = None
    age: float | None = 0.0
    for part in node.walk():
        if isinstance(part, ast.Query):
            raise _unsupported("a query inside of another expression", part)
    call = ast.Call(node.span, "the last value", (node,), node.span)
    if isinstance(node, ast.Call) and node.name in TEMPORAL_FUNCTIONS:
        form = TEMPORAL_FUNCTIONS[node.name]
        if not form.is_in_lakes:
            raise _unsupported(node.name, node)
        function, call, age = node.name, node, None
        if len(node.arguments) > 1:
            age = _window_of(node, frame)
    query, placeholders = execution.temporal.query_over_ticks(call, frame)
    plan, select = _planned(execution, query, Frame(execution, placeholders=placeholders))
    return TickPlan(select, _columns(plan, select, node.span), False, function, age)


def _window_of(call: ast.Call, frame: Frame) -> float:
    age = call.arguments[1]
    value = frame.value(age) if _is_value(age) else None
    if not isinstance(value, int | float) or not value < 0:
        raise _unsupported("an age other than a negative number", age)
    return float(value)


# -- plans ------------------------------------------------------------------------------------


def _planned(execution: Execution, query: ast.Query, frame: Frame) -> tuple[Plan, exp.Select]:
    plan, values = execution.planner.sql_plan(query, frame)
    if plan is not None:
        _check_parts(plan.query)
        if is_grouped(plan.query) or plan.query.distinct:
            raise _unsupported("GROUP BY, DISTINCT or an aggregate", query)
        for node in plan.python_parts:
            what = node.name if isinstance(node, ast.Call) else "a part"
            raise _unsupported(f"{what}, which Python computes,", node)
    try:
        select = select_for(query, plan, values, _LEAST)
    except UnsupportedError as error:
        reason = f"this is not written as SQL, since {error.message}: {_ADVICE}"
        raise UnsupportedError(reason, span=error.span) from error
    assert plan is not None  # or else `select_for` fails
    if any(source.past_kind != "window" for source in plan.source_types):
        raise _unsupported("a source other than a world, as in sim, sim{} and sim{-2.0},", query)
    for binding in plan.bindings:
        if not _is_of_any_episode(binding):
            raise _unsupported("a value that depends on the episode", binding.node or query)
    for node in plan.python_constants:
        raise _unsupported("a value that is left to Python", node)
    if not isinstance(select, exp.Select) or plan.outputs is None or plan.paths:
        raise _unsupported("what is left to Python", query)
    return plan, select


def _is_of_any_episode(binding: ParameterBinding) -> bool:
    """Checks whether the value of a parameter is the same in each episode with such entities."""
    if binding.end or binding.column == "id":
        return True
    return binding.column is None and binding.node is not None and _is_value(binding.node)


def _is_value(node: ast.Node | None) -> bool:
    """Checks whether a part has the same value in each episode."""
    return isinstance(node, _OF_VALUES) and all(map(_is_value, node.children()))


def _columns(plan: Plan, select: exp.Select, span: SourceSpan) -> tuple[SelectedSql, ...]:
    assert plan.outputs is not None
    if len(plan.names) != len(plan.outputs):
        raise UnsupportedError("columns need names: write AS and a name", span=span)
    result = []
    for name, output in zip(plan.names, plan.outputs, strict=True):
        value = select.expressions[output.index]
        value = value.this if isinstance(value, exp.Alias) else value
        if output.sql_type.type == "entity":
            value = _full_name(value, span)
        result.append(SelectedSql(name, value, output.sql_type))
    return tuple(result)


def _full_name(key: exp.Expr, span: SourceSpan) -> exp.Expr:
    """Returns the name of the entity of a row, in place of its key."""
    column = key.find(exp.Column)
    if column is None or key != past_value("", column.table).sql:
        raise UnsupportedError(
            f"an entity that is not the row's own is not written as SQL: {_ADVICE}", span=span
        )
    return exp.column("name", table=column.args["table"].copy())
