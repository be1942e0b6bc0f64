"""Finds the ticks at which a query reads the tables of the past, if it says so itself."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass

from sqlglot import exp

from ssduck.schema import HISTORIES
from ssduck.sql.plan import ParameterBinding

_VIEWS = frozenset(table.history_view for table in HISTORIES.values())


@dataclass(frozen=True)
class HistoryWindow:
    """A table of the past that a query reads at some ticks only.

    Attributes:
        schema: the schema of its world.
        view: the name of its view.
        first: the parameter of the first tick.
        last: the parameter of the last tick.
    """

    schema: str
    view: str
    first: str
    last: str


def history_windows(
    select: exp.Query, bindings: Collection[ParameterBinding]
) -> list[HistoryWindow]:
    """Returns the tables of the past that a query reads, each with its ticks.

    Returns:
        Nothing if the query may read one of them at other ticks, as joins do.
    """
    ends = {binding.name: binding.end for binding in bindings}
    if not {"first", "last"} <= set(ends.values()):
        return []
    tables = [table for table in select.find_all(exp.Table) if table.name in _VIEWS]
    windows = [_window_of(table, ends) for table in tables]
    return [] if None in windows else [window for window in windows if window is not None]


def _window_of(table: exp.Table, ends: Mapping[str, str]) -> HistoryWindow | None:
    """Returns the ticks of a table that is read as `SELECT … WHERE tick BETWEEN $a AND $b`."""
    clause = table.parent
    select = None if clause is None else clause.parent
    if not (isinstance(clause, exp.From) and isinstance(select, exp.Select)):
        return None
    where = select.args.get("where")
    if where is None or select.args.get("joins"):
        return None
    for condition in where.this.flatten() if isinstance(where.this, exp.And) else [where.this]:
        if isinstance(condition, exp.Between) and condition.this == exp.column("tick"):
            first, last = condition.args["low"], condition.args["high"]
            if (ends.get(first.name), ends.get(last.name)) == ("first", "last"):
                return HistoryWindow(table.db, table.name, first.name, last.name)
    return None
