"""Runs what is typed at a page, in either language."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, Literal, TypeAlias

from ssduck.interpreter.interpreter import Interpreter
from ssduck.interpreter.program import rows_to_show
from ssduck.language.analysis import calls_of
from ssduck.language.tree import Assignment, Call

Language: TypeAlias = Literal["selectscript", "sql"]
# A start and an end, s.
Span: TypeAlias = list[float]
# The functions whose values are intervals of simulated time.
_INTERVALS = "holds"
MAX_LANES = 12


def value_of(ss: Interpreter, text: str, language: Language) -> Any:
    """Returns the value of a program; of a query, its rows.

    Raises:
        SelectScriptError: the program is wrong, or reaches a limit.
    """
    return ss.sql(text) if language == "sql" else rows_to_show(ss.compile(text), ss.eval)


def not_shown(ss: Interpreter, text: str, language: Language) -> Iterator[str]:
    """Yields a note if a program that was run has statements whose results are not shown."""
    if language == "sql":
        return
    *before, _ = ss.compile(text).tree.statements
    if any(not isinstance(statement, Assignment) for statement in before):
        yield (
            f"this is the result of the last of {len(before) + 1} statements; run the others by "
            "themselves to see theirs"
        )


def has_intervals(ss: Interpreter, text: str, language: Language) -> bool:
    """Checks whether a program that was run asks when something held."""
    if language == "sql":
        return False
    calls = (name for part in ss.compile(text).tree.statements for name in calls_of(part))
    return _INTERVALS in calls


def heads_of(
    ss: Interpreter, text: str, language: Language, value: Any, columns: Sequence[str]
) -> list[str]:
    """Returns the heads of a value's table: those of its columns, or what intervals consist of.

    Args:
        ss: the interpreter that ran the program.
        text: the program.
        language: its language.
        value: its value.
        columns: the names of the columns of the value's table.
    """
    if language == "selectscript" and _are_spans(value):
        last = ss.compile(text).tree.statements[-1]
        if isinstance(last, Call) and last.name == _INTERVALS:
            return ["begin", "end"]
    return list(columns)


def lanes_of(
    value: Any, columns: Sequence[str], rows: Sequence[Sequence[Any]]
) -> Iterator[tuple[str, Any]]:
    """Yields the intervals of a value for the time line: a label, and spans [start, end] in s.

    Args:
        value: the value.
        columns: the names of the columns of its table.
        rows: the rows of its table.
    """
    if _are_spans(value):
        yield "holds", value
        return
    for row in rows[:MAX_LANES]:
        names = [str(cell) for cell in row if isinstance(cell, str)]
        for column, cell in zip(columns, row, strict=True):
            if _are_spans(cell):
                yield " ".join(names) or column, cell


def _are_spans(value: Any) -> bool:
    return (
        isinstance(value, list)
        and all(isinstance(part, list) and len(part) == 2 for part in value)
        and all(isinstance(number, int | float) for part in value for number in part)
    )
