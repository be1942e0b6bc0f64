"""A compiled query on the kitchen, against the same SQL sent to DuckDB by hand.

By hand means what a user of DuckDB would write: `connection.execute(sql, parameters).fetchall()`
on the same tables. A Python loop over the entities' columns, already fetched, is shown as well.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial

import ssduck
from benchmarks.timing import medians, shown
from ssduck.language.tree import Query

QUESTIONS = {
    "robots": "SELECT id, position, type FROM kitchen WHERE isRobot(this);",
    "small things above the table": (
        "SELECT volume FROM kitchen WHERE above(table, this) AND volume(this) < 0.001 AS list;"
    ),
    "all pairs above each other": (
        "SELECT to(id(a.this), 'a'), to(id(b.this), 'b') FROM a=kitchen, b=kitchen "
        "WHERE above(a.this, b.this) AND NOT (isSensor(a.this) OR isSensor(b.this));"
    ),
}


def by_hand(ss: ssduck.Interpreter, program: str) -> Callable[[], object]:
    """The SQL that a program becomes, sent to the same connection by hand."""
    database = ss._database
    (query,) = ss.compile(program).tree.statements
    assert isinstance(query, Query)
    ss.eval(program)
    (planned,) = ss._planner._plans[query]
    plan = planned.plan
    table = ss.call_variable("table")
    parameters = {binding.name: table.column(binding.column or "id") for binding in plan.bindings}
    return lambda: database.connection.rows(plan.sql, parameters or None)


def rows() -> Iterator[tuple[str, str, str, str]]:
    """One row a question: compiled, by hand, ratio."""
    with ssduck.load("kitchen") as ss:
        ss.eval("table = SELECT obj FROM kitchen WHERE id(this) == 'table' AS value;")
        for name, program in QUESTIONS.items():
            compiled = ss.compile(program)
            hand = by_hand(ss, program)
            times = medians({"ssduck": partial(ss.eval, compiled), "hand": hand})
            ratio = f"{times['ssduck'] / times['hand']:.2f}"
            yield (name, shown(times["ssduck"]), shown(times["hand"]), ratio)


HEADER = ("a compiled query", "ssduck", "SQL by hand", "ratio")
