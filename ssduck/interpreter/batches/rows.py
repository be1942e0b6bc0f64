"""The rows of a query in all environments: its sources are combined within each of them alone."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from sqlglot import exp

from ssduck.columns.arrays import Array, ArrayValues
from ssduck.columns.expressions import Compute, LeftToDuckDBError
from ssduck.columns.selects import ArraySelect
from ssduck.geometry.arrays import Flags, Indices
from ssduck.interpreter.batches.expressions import (
    CHANGING,
    CompiledExpressions,
    Engine,
    Leaves,
    value_of,
)
from ssduck.interpreter.batches.selection import Selection
from ssduck.interpreter.execution import Execution
from ssduck.language.clauses import Groups, Rows
from ssduck.language.evaluator import Frame
from ssduck.language.tree import Binary, Call, Literal, Node, Query
from ssduck.schema import STORED_TABLES
from ssduck.sql.pair_joins import sides_of
from ssduck.sql.plan import Plan

# So many rows are computed at a time.
MAX_ROWS = 1 << 19
_KINDS = {column.name: column.type for column in STORED_TABLES["entities"].columns}


@dataclass(frozen=True, eq=False)
class FoundRows:
    """The rows that SQL would give in each environment.

    Attributes:
        environments: (rows,), the environment of each, ascending.
        columns: the columns of the SELECT, (rows,) or (rows, length) each.
        left: (n,), the environments that have to be evaluated by themselves; they have no rows.
    """

    environments: Indices
    columns: list[Array]
    left: Flags


class BatchRows:
    """The rows of a query of a batch's entities, or of combinations of them, as arrays.

    Attributes:
        planned: the query with its plan, whose clauses Python applies to the rows.
        leaves: what the expressions read.
    """

    def __init__(self, execution: Execution, engine: Engine, query: Query, frame: Frame) -> None:
        planned = execution.planner.planned(_without_searches(query), frame, "rows")
        if planned is None:
            raise LeftToDuckDBError
        self.planned, plan = planned, planned.plan
        self._engine, self.leaves = engine, Leaves(engine)
        joins = plan.select.args.get("joins") or ()
        tables = [plan.select.args["from_"].this, *(join.this for join in joins)]
        self._size, self._sources = len(engine.world.snapshot.entities), len(tables)
        # The environments and the entities of the rows that are computed, (1 + sources, rows).
        self._rows: npt.NDArray[np.intp] = np.zeros((1 + len(tables), 0), np.intp)
        for place, table in enumerate(tables, 1):
            self._note_columns(table.alias_or_name, place)
        self.leaves.note_given(query, frame)

        def renamed(part: exp.Expr) -> exp.Expr:
            return self.leaves.renamed(part, plan.bindings, frame)

        operations, leaf = engine.operations, self.leaves.expression
        self._select = ArraySelect(plan, engine.schema, operations, leaf, renamed, is_split=True)
        self._selection = _selection(plan)
        self._constants = [] if self._selection is None else self._selection.constants
        self._constant_values = CompiledExpressions(
            engine, execution, self._constants, frame.placeholders
        )

    def _note_columns(self, table: str, place: int) -> None:
        """Notes the columns of a table in SQL, whose entities have a place in the rows."""
        entities = self._engine.world.snapshot.tables["entities"]
        for name, kind in _KINDS.items():
            key = f"column {table}.{name}"
            if name in CHANGING:
                self.leaves.note(key, "double", self._changing(name, place))
            elif kind in ("double", "integer", "string", "boolean") and name != "run":
                listed = entities.values(name)
                own = np.array(listed, object if kind == "string" else None)
                if not any(value is None for value in listed):
                    self.leaves.note(key, kind, self._constant(own, place))

    def _changing(self, name: str, place: int) -> Callable[[Mapping[str, Array]], Array]:
        columns, entities = self._engine.columns, self._engine.world.snapshot.entities

        def read(_: Mapping[str, Array]) -> Array:
            table: Array = np.stack([columns.column(one.id, name) for one in entities], axis=1)
            values: Array = table.ravel()[self._rows[0] * self._size + self._rows[place]]
            return values

        return read

    def _constant(self, own: Array, place: int) -> Callable[[Mapping[str, Array]], Array]:
        return lambda _: own[self._rows[place]]

    def is_current(self, frame: Frame) -> bool:
        """Takes the present values of variables; returns whether they have the same types."""
        return self.leaves.is_current(frame) and self._constant_values.is_current(frame)

    # -- evaluation -------------------------------------------------------------------------

    def found(
        self,
        given: Mapping[str, Array],
        unknown: Mapping[str, Flags],
        step: Callable[[], object],
    ) -> FoundRows:
        """Returns the rows of all environments.

        Args:
            given: the values of placeholders, (n,) or (n, length).
            unknown: where they are unknown.
            step: is called before each part of the environments.
        """
        nowhere = np.zeros(self._engine.world.count, np.bool_)
        left = np.any([nowhere, *unknown.values()], axis=0)
        asked, parts = np.flatnonzero(~left), []
        at_once = max(1, MAX_ROWS // self._size**self._sources)
        for start in range(0, len(asked), at_once):
            step()
            numbers = asked[start : start + at_once]
            part = self._part(numbers, given, left)
            if part is None:
                left[numbers] = True
            elif len(part[0]):
                parts.append(part)
        columns = [np.concatenate(column) for column in zip(*parts, strict=True)]
        environments, *others = columns or [np.zeros(0, np.intp)] * (1 + self._select.width)
        known = ~left[environments]
        return FoundRows(environments[known], [column[known] for column in others], left)

    def selected(
        self, found: FoundRows, given: Mapping[str, Array], unknown: Mapping[str, Flags]
    ) -> list[Rows | Groups] | None:
        """Returns the selected rows, or their groups, of each environment.

        None if the clauses of the query are applied environment by environment.
        """
        count = self._engine.world.count
        values, unknowns = self._constant_values.values(given, unknown, count)
        constants = {
            node: own.tolist()
            for node, own in zip(self._constants, values, strict=True)
            if own is not None
        }
        if self._selection is None or len(constants) < len({*self._constants}):
            return None
        np.any([found.left, *unknowns], axis=0, out=found.left)
        return self._selection.selected(found.environments, found.columns, constants, count)

    def _part(
        self, numbers: Indices, given: Mapping[str, Array], left: Flags
    ) -> list[Array] | None:
        """Returns the environments and the columns of the rows in some; None if arrays cannot."""
        shape = (len(numbers), *[self._size] * self._sources)
        rows = np.array(np.unravel_index(np.arange(np.prod(shape)), shape))
        rows[0] = numbers[rows[0]]
        for condition in self._select.conditions:
            found = self._evaluated(rows, [condition], given, left)
            if found is None:
                return None
            rows = rows[:, found[0] & ~left[rows[0]]]
        values = self._evaluated(rows, self._select.columns, given, left)
        return None if values is None else self._select.arranged([rows[0], *values])

    def _evaluated(
        self,
        rows: npt.NDArray[np.intp],
        computes: Sequence[Compute],
        given: Mapping[str, Array],
        left: Flags,
    ) -> list[Array] | None:
        """Returns the values of expressions in some rows; None if arrays cannot have them."""
        self._rows, (environments, *_) = rows, rows
        if not len(environments):
            return [np.zeros(0, np.bool_) for _ in computes]
        of_rows = {name: values[environments] for name, values in given.items()}

        def evaluate(values: ArrayValues) -> list[Array | None]:
            return [value_of(compute, values) for compute in computes]

        with self._engine.shapes.with_rows(environments):
            found, unknown = self.leaves.evaluated(evaluate, of_rows, {}, len(environments))
        left[environments[unknown]] = True
        known = [values for values in found if values is not None]
        return known if len(known) == len(found) else None


def _selection(plan: Plan) -> Selection | None:
    try:
        return Selection(plan)
    except LeftToDuckDBError:
        return None


def _without_searches(query: Query) -> Query:
    """Returns a query with conditions on pairs in place of searches, which are of one tick."""

    def asked(node: Node) -> Node | None:
        if not isinstance(node, Call) or sides_of(node) is None:
            return None
        return Binary(node.span, "OR", node, Literal(node.span, value=False))

    return query if query.where is None else replace(query, where=query.where.replaced(asked))
