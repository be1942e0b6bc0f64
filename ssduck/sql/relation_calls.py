"""Replaces the parameters of a relation's formula; finds the tables that relations read."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from sqlglot import exp

from ssduck.language import ast
from ssduck.language.analysis import cached_by_node, sees_outside
from ssduck.schema import ALL_ENTITIES, TABLES
from ssduck.sql.relations.registry import RELATIONS
from ssduck.sql.relations.relation import Relation, in_schema
from ssduck.sql.sql_values import NotSqlError, SqlValue, wrapped


def expanded(
    formula: exp.Expr, values: Mapping[str, SqlValue], name: str | None = None
) -> exp.Expr:
    """Returns a relation's formula with its parameters replaced.

    >>> from ssduck.sql.from_clause import entity_value
    >>> from ssduck.sql.relations.registry import RELATIONS
    >>> formula = RELATIONS["aabbVolume"].expressions[1]
    >>> expanded(formula, {"object": entity_value("kitchen", "cup")}).sql("duckdb")
    '(cup.xmax - cup.xmin) * (cup.ymax - cup.ymin) * (cup.zmax - cup.zmin)'
    """

    def substitute(part: exp.Expr) -> exp.Expr:
        if not isinstance(part, exp.Column):
            return part
        if (part.table or part.name) not in values:
            return part  # a column of a table in the formula
        if not part.table:
            return wrapped(values[part.name].sql.copy())
        column = values[part.table].column
        assert column is not None, f"{part.table} has no columns"
        return column(name if name is not None and part.name == "name" else part.name)

    result: exp.Expr = formula.copy().transform(substitute)
    return exp.paren(result) if isinstance(result, exp.Connector | exp.In) else result


def in_world(
    relation: Relation,
    formula: exp.Expr,
    values: Mapping[str, SqlValue],
    ticks: Sequence[exp.Expr],
) -> exp.Expr:
    """Returns a relation's formula with the tables of its entities' world.

    Raises:
        NotSqlError: the world is not known yet.
    """
    schemas = {
        value.sql_type.schema for value in values.values() if value.sql_type.type == "entity"
    }
    if None in schemas:
        raise NotSqlError
    if len(schemas) > 1:
        return relation.across_worlds_expression
    schema = str(schemas.pop())
    if not ticks:
        return in_schema(formula, schema)
    return relation.at_one_tick(_at_tick(formula, schema, ticks[0]), ticks)


@dataclass(frozen=True)
class PairCall:
    """A relation of two entities or links of a world's present tick, which a formula stands for."""

    relation: str  # the name of the relation
    schema: str  # the schema of the world
    ids: tuple[exp.Expr, ...]  # the ids of both, as SQL
    # The call of a function of shapes that decides alone; None for one of contacts.
    call: exp.Anonymous | None = None


# The key of a formula's metadata that has its call.
PAIR_CALL = "pair call"


def note_pair(result: exp.Expr, relation: Relation, values: Mapping[str, SqlValue]) -> None:
    """Notes in a formula which relation of two entities of the present tick it stands for."""
    is_geometric = relation.geometry is not None
    entities = [v for v in values.values() if not is_geometric or v.sql_type.type == "entity"]
    schemas = {value.sql_type.schema for value in entities}
    columns = [value.column for value in entities if value.column is not None]
    is_past = any(value.sql_type.past for value in entities)
    if len(schemas) == 1 and len(columns) == len(entities) and not is_past:
        call = None
        if relation.geometry is not None:
            name = relation.geometry.udf_name
            call = next(part for part in result.find_all(exp.Anonymous) if part.name == name)
        ids = tuple(column("id") for column in columns)
        result.meta[PAIR_CALL] = PairCall(relation.name, str(schemas.pop()), ids, call)


def _as_exists(part: exp.Expr) -> exp.Expr:
    """Rewrites `(x, y) IN (SELECT …)` as EXISTS: DuckDB has no such IN for correlated queries."""
    query = part.args.get("query") if isinstance(part, exp.In) else None
    if query is None or not isinstance(part.this, exp.Tuple):
        return part
    columns = [f"c{place}" for place in range(len(part.this.expressions))]
    alias = exp.TableAlias(
        this=exp.to_identifier("found then", quoted=True),
        columns=[exp.to_identifier(column) for column in columns],
    )
    inner = query.this if isinstance(query, exp.Subquery) else query
    rows = exp.select("1").from_(exp.Subquery(this=inner.copy(), alias=alias))
    equal = [
        exp.EQ(this=exp.column(column, table="found then", quoted=True), expression=value.copy())
        for column, value in zip(columns, part.this.expressions, strict=True)
    ]
    return exp.Exists(this=rows.where(*equal))


# The tables whose values are the same at all ticks.
_MODEL_TABLES = {name: TABLES[name].model_view for name in ("shapes", "geometries")}


def _at_tick(formula: exp.Expr, schema: str, tick: exp.Expr) -> exp.Expr:
    """Returns a formula with the tables of a world at the tick of its entities."""
    result = in_schema(formula, schema)
    for table in list(result.find_all(exp.Table)):
        alias = exp.to_identifier(table.alias_or_name)
        if table.name in _MODEL_TABLES:
            table.set("this", exp.to_identifier(_MODEL_TABLES[table.name]))
            table.set("alias", exp.TableAlias(this=alias))
            continue
        history = exp.table_(
            TABLES[table.name].history_view, db=schema, alias="ticks then", quoted=True
        )
        tick_column = exp.column("tick", table="ticks then", quoted=True)
        rows = (
            exp.select("*").from_(history).where(exp.EQ(this=tick_column, expression=tick.copy()))
        )
        table.replace(rows.subquery(alias))
    return result.transform(_as_exists)


@cached_by_node
def tables_of(node: ast.Node) -> frozenset[str]:
    """Returns the tables that relations in a part read, and masses if they read these.

    A nested query about rows of the queries around it depends on all entities of the tick.
    """
    is_nested = isinstance(node, ast.Query) and sees_outside(node)
    tables = frozenset((ALL_ENTITIES,)) if is_nested else frozenset()
    # A bare name may be a relation of the only source, a key a relation of its source.
    name = node.key if isinstance(node, ast.QualifiedName) else getattr(node, "name", None)
    if (
        isinstance(node, ast.Call | ast.UnresolvedName | ast.Name | ast.QualifiedName)
        and name in RELATIONS
    ):
        tables = RELATIONS[name].inputs
    return tables.union(*map(tables_of, node.children()))
