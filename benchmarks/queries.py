"""Measures compiled queries on the kitchen against the same SQL sent to DuckDB by hand.

`python -m benchmarks queries` takes some seconds. SQL by hand is the call of a user of DuckDB,
`connection.execute(sql, parameters).fetchall()`, on the same tables.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial

import ssduck
from benchmarks.timing import medians, text_of
from ssduck.language.ast import Query

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
    """Returns a call that sends the SQL of a program to the same connection."""
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
    """Yields a row for each question: the compiled query, SQL by hand, the ratio."""
    with ssduck.load("kitchen") as ss:
        ss.eval("table = SELECT obj FROM kitchen WHERE id(this) == 'table' AS value;")
        for name, program in QUESTIONS.items():
            compiled = ss.compile(program)
            hand = by_hand(ss, program)
            times = medians({"ssduck": partial(ss.eval, compiled), "hand": hand})
            ratio = f"{times['ssduck'] / times['hand']:.2f}"
            yield (name, text_of(times["ssduck"]), text_of(times["hand"]), ratio)


HEADER = ("a compiled query", "ssduck", "SQL by hand", "ratio")
