"""A relation's formula with its arguments put in."""

from __future__ import annotations

from collections.abc import Mapping

from sqlglot import exp

from ssduck.relations import Relation, in_schema
from ssduck.sqlvalues import NotSqlError, SqlValue, wrapped


def expanded(
    formula: exp.Expr, values: Mapping[str, SqlValue], name: str | None = None
) -> exp.Expr:
    """A relation's formula with its parameters put in.

    Args:
        formula: over columns of the parameters.
        values: what the parameters stand for.
        name: the column to be taken instead of `name`, for a relation that yields an entity.
    """

    def put_in(part: exp.Expr) -> exp.Expr:
        if not isinstance(part, exp.Column):
            return part
        if (part.table or part.name) not in values:
            return part  # of a table that the formula looks things up in
        if not part.table:
            return wrapped(values[part.name].sql.copy())
        column = values[part.table].column
        assert column is not None, f"{part.table} has no columns"
        return column(name if name is not None and part.name == "name" else part.name)

    found: exp.Expr = formula.copy().transform(put_in)
    return exp.paren(found) if isinstance(found, exp.Connector | exp.In) else found


def looked_up(relation: Relation, formula: exp.Expr, values: Mapping[str, SqlValue]) -> exp.Expr:
    """A relation's formula with the tables of its entities' world.

    Raises:
        NotSqlError: which world that is is not known yet.
    """
    schemas = {value.tag.schema for value in values.values() if value.tag.type == "entity"}
    if None in schemas:
        raise NotSqlError
    if len(schemas) > 1:
        return relation.when_apart
    return in_schema(formula, str(schemas.pop()))
