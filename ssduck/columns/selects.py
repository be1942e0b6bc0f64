"""A SELECT of entities as functions of arrays: its conditions, its columns and its order."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np
from sqlglot import exp

from ssduck.columns.arrays import Array, ArrayOperations
from ssduck.columns.compiler import Compiler, Leaves, LeftToDuckDBError
from ssduck.sql.plan import Plan
from ssduck.sql.relation_calls import PAIR_CALL, PairCall

# The types of values that arrays have; entities are none.
PLAIN = frozenset(("double", "integer", "boolean", "string", "list"))
_CLAUSES = frozenset(("expressions", "from_", "joins", "where", "order", "limit", "offset"))


class ArraySelect:
    """A SELECT of entities of a world, or of combinations of them, as functions of arrays.

    Args:
        is_split: whether conditions that AND joins are several, to leave out rows between them;
            else there is one at most.
    """

    def __init__(
        self,
        plan: Plan,
        schema: str,
        operations: ArrayOperations,
        leaf: Leaves,
        renamed: Callable[[exp.Expr], exp.Expr],
        *,
        is_split: bool,
    ) -> None:
        select = plan.select
        if not _is_of_entities(plan, schema):
            raise LeftToDuckDBError
        is_ordered = plan.query.order and not plan.python_clauses.order
        keys: list[exp.Ordered] = select.args["order"].expressions if is_ordered else []
        self._descending = [bool(key.args.get("desc")) for key in keys]
        where = select.args.get("where")
        conditions = [] if where is None else [where.this]
        if is_split:
            conditions = [part for whole in conditions for part in _conjuncts(whole)]
        wanted = (*conditions, *select.expressions, *(key.this for key in keys))
        parts = [renamed(part) for part in wanted]
        compiler = Compiler(operations, leaf, parts)
        expressions = [compiler.expression(part) for part in parts]
        count, self.width = len(conditions), len(select.expressions)
        # What rows have to fulfil, each computed where those before it hold; the narrow phase has
        # the last word.
        self.conditions = [
            part.compute for part in sorted(expressions[:count], key=lambda part: part.has_calls)
        ]
        # The columns of the SELECT, and the keys of its order.
        self.columns = [part.compute for part in expressions[count:]]
        limit, offset = (_number(select.args.get(name)) for name in ("limit", "offset"))
        self._start = offset or 0
        self._end = np.inf if limit is None else self._start + limit
        texts = [part.sql("duckdb") for part in parts]
        # The SQL of all parts.
        self.text = f"{count} {self._descending} {self._start} {self._end} {texts}"

    def arranged(self, columns: Sequence[Array]) -> list[Array]:
        """Returns columns in the order of the query, as many rows as it limits to.

        Args:
            columns: (rows,) each: the instance of each row, ascending, then `columns`.

        Returns:
            The same without the keys of the order.
        """
        keys = columns[1 + self.width :]
        result = list(columns[: 1 + self.width])
        if keys:
            ranked = map(_ranks, keys, self._descending)
            order = np.lexsort([*reversed([columns[0], *ranked])])
            result = [column[order] for column in result]
        if self._start or self._end < np.inf:
            instances = result[0]
            places = np.arange(len(instances)) - np.searchsorted(instances, instances)
            chosen = (places >= self._start) & (places < self._end)
            result = [column[chosen] for column in result]
        return result


def _ranks(key: Array, descending: bool) -> Array:
    """Returns numbers that are in the order of a key."""
    if key.dtype.kind not in "fi":
        key = np.unique(key, return_inverse=True)[1]
    return -key if descending else key


def _number(clause: exp.Expr | None) -> int | None:
    """Returns the number of LIMIT or OFFSET."""
    return None if clause is None else int(clause.expression.name)


def _conjuncts(sql: exp.Expr) -> Iterator[exp.Expr]:
    """Yields the conditions that AND joins; each is computed where those before it hold."""
    pair = sql.meta.get(PAIR_CALL)
    is_call = isinstance(pair, PairCall) and pair.call is None
    match sql:
        case exp.Paren() if not is_call:
            yield from _conjuncts(sql.this)
        case exp.And() if not is_call:
            yield from _conjuncts(sql.this)
            yield from _conjuncts(sql.expression)
        case exp.Or(expression=exp.Boolean(this=False)):
            yield from _conjuncts(sql.this)
        case _:
            yield sql


def _is_of_entities(plan: Plan, schema: str) -> bool:
    """Checks whether the SQL of a plan is of entities of a world, and of nothing else."""
    outputs = (*plan.known.values(), *(plan.outputs or ()))
    select = plan.select
    joins: list[exp.Join] = select.args.get("joins") or []
    return (
        all(output.sql_type.type in (*PLAIN, "entity") for output in outputs)
        and not plan.paths
        and not any(value for name, value in select.args.items() if name not in _CLAUSES)
        and len(joins) == len(plan.source_types) - 1
        and all(
            isinstance(join.this, exp.Table) and join.args.get("kind") == "CROSS" for join in joins
        )
        and all(
            (source.schema, source.table, source.past_kind) == (schema, "entities", "")
            for source in plan.source_types
        )
    )
