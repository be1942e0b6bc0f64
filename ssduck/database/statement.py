"""Prepared statements, and which of them are valid yet."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from collections.abc import Set as AbstractSet
from contextlib import suppress
from itertools import count
from typing import Any, Literal

from sqlglot import exp

from ssduck.database.connection import Connection
from ssduck.errors import SelectScriptError
from ssduck.schema import RECORDED, TABLES, Column
from ssduck.world.live_tables import LiveTable

# What our prepared statements are called, in front of a number and of the tables that they read.
_OURS = "ssduck statement "
# The tables of a world whose buffers may be made anew.
_KNOWN = frozenset((*TABLES, *(table.history_view for table in RECORDED.values())))
# No source can be called so, for it is no name.
_PARAMETERS = "the parameters"


class PreparedPlans:
    """The plans that DuckDB keeps for prepared statements.

    Args:
        connection: where they are prepared.
        theirs: the tables that users' statements read of which DuckDB keeps plans.
    """

    def __init__(self, connection: Connection, theirs: AbstractSet[str]) -> None:
        self.connection = connection
        self._theirs = theirs
        # Counts up, by table, when prepared statements that read it lose their validity.
        self._generations = dict.fromkeys(_KNOWN, 0)

    def generation(self, tables: Iterable[str]) -> int:
        """Counts up when prepared statements that read one of these tables lose their validity."""
        return sum(self._generations.get(table, 0) for table in tables)

    def forget(self, *tables: str) -> None:
        """Drop prepared statements that would go on reading old buffers of one of these tables.

        Our own say by their names what they read. Of a user's it is not known, so that all are
        dropped if any statement that DuckDB keeps names such a table.
        """
        stale = set(tables)
        theirs = bool(stale & self._theirs)
        for table in tables:
            self._generations[table] += 1
        for (name,) in self.connection.own_rows("SELECT name FROM duckdb_prepared_statements()"):
            if stale & set(name.split()) if name.startswith(_OURS) else theirs:
                self.connection.run(
                    f"DEALLOCATE {exp.to_identifier(name, quoted=True).sql('duckdb')}"
                )


class Statement:
    """A SELECT that DuckDB plans once and runs many times.

    Planning is most of what a small query costs. DuckDB keeps the plan of a prepared statement
    only if it has no parameters; so these become the columns of a table of one row, which is
    written in place. Such a plan goes on reading the buffers that it was made for; when
    buffers are made anew, it is made anew.

    Args:
        plans: those of the database where it runs.
        select: the SELECT, its parameters as `exp.Parameter`.
        types: of the parameters, by name; all of them numbers.
    """

    _numbers = count(1)

    def __init__(
        self,
        plans: PreparedPlans,
        select: exp.Select,
        types: Mapping[str, Literal["real", "integer"]],
    ) -> None:
        self._plans = plans
        self._connection = plans.connection
        # The entities' buffers are made anew, too, when nothing else of the worlds is as it was.
        self._reads = frozenset(("entities", *(t.name for t in select.find_all(exp.Table))))
        self._name = _statement_name(next(self._numbers), self._reads)
        self._row = LiveTable(tuple(Column(name, type, "") for name, type in types.items()))
        self._row.fill(1, {})
        self._prepared_for: int | None = None
        tree = select.copy()
        self._has_parameters = bool(types)
        if types:
            _read_parameters(tree, exp.table_(self._name, quoted=True, alias=_PARAMETERS))
        name = exp.to_identifier(self._name, quoted=True).sql("duckdb")
        self._prepare = f"PREPARE {name} AS {tree.sql('duckdb')}"
        self._execute = f"EXECUTE {name}"
        self._deallocate = f"DEALLOCATE {name}"

    def rows(self, values: Mapping[str, float]) -> list[tuple[Any, ...]]:
        """All rows for these values of the parameters; the caller holds the worlds."""
        for name, value in values.items():
            self._row[name][0] = value
        generation = self._plans.generation(self._reads)
        if self._prepared_for != generation:
            if self._has_parameters:
                self._connection.show(self._name, self._row.arrow)
            self._connection.run(self._prepare, timed=True)
            self._prepared_for = generation
        try:
            return self._connection.rows(self._execute)
        except SelectScriptError:
            self._release()
            raise

    def _release(self) -> None:
        """Let go of the memory that DuckDB keeps for a statement that failed."""
        self._prepared_for = None
        with suppress(SelectScriptError):
            self._connection.run(self._deallocate)

    def forget(self) -> None:
        """Let DuckDB forget it."""
        if self._prepared_for == self._plans.generation(self._reads):
            self._connection.run(self._deallocate)
            self._prepared_for = None
        if self._has_parameters:
            self._connection.unshow(self._name)


def _statement_name(number: int, reads: Iterable[str]) -> str:
    """What a prepared statement of ours is called."""
    return f"{_OURS}{number} {' '.join(sorted(_KNOWN & set(reads)))}"


def _read_parameters(tree: exp.Select, row: exp.Expr) -> None:
    """Make parameters columns of a table of one row, in each SELECT that has some."""
    reading: list[exp.Select] = []
    for parameter in list(tree.find_all(exp.Parameter)):
        select = parameter.find_ancestor(exp.Select)
        assert isinstance(select, exp.Select)
        if not any(select is other for other in reading):
            reading.append(select)
        parameter.replace(exp.column(parameter.name, table=_PARAMETERS, quoted=True))
    for select in reading:
        if select.args.get("from_"):
            # In front of joins whose conditions have some in them.
            joins = select.args.get("joins") or []
            select.set("joins", [exp.Join(this=row.copy(), kind="CROSS"), *joins])
        else:
            select.from_(row.copy(), copy=False)
