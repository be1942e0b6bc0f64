"""Values as tables for people: in a terminal, in a notebook."""

from __future__ import annotations

import html
from dataclasses import replace
from typing import Any

from ssduck import validation
from ssduck.adapters.display import (
    DisplayTable,
    answer_of,
    fitted,
    lines_of,
    readable,
    terminal_width,
)
from ssduck.adapters.text_table import FittedTable

# So many rows are shown.
MOST_ROWS = 20


class TableView:
    """What shows as a table: its first rows, numbers rounded to six digits.

    A terminal shows it as text that fits, a notebook as HTML, rich as a table of its own.
    Text that goes elsewhere is as wide as it is.

    Args:
        value: the rows: a list of dicts, say.
        rows: how many are shown at most.

    Raises:
        NumberError: that is no whole number, 0 or more.
    """

    def __init__(self, value: Any, rows: int = MOST_ROWS) -> None:
        rows = validation.integer(rows, "show: rows", minimum=0)
        answer = answer_of(value)
        self._count = len(answer.rows)
        self._answer: DisplayTable = replace(answer, rows=list(answer.rows)[:rows])

    @property
    def _more(self) -> str:
        """How many rows there are, if not all are shown, or none."""
        shown = len(self._answer.rows)
        if not self._count:
            return "(no rows)"
        return f"first {shown} of {self._count} rows" if shown < self._count else ""

    def __repr__(self) -> str:
        answer = self._answer
        if answer.columns and not answer.named:
            lines = [readable(row[0]) for row in answer.rows]
        elif (width := terminal_width()) is not None:
            return "\n".join(self.__rich__().lines(width))
        else:
            lines = list(lines_of(answer)) if answer.columns or answer.rows else []
        return "\n".join([*lines, self._more] if self._more else lines)

    def _repr_html_(self) -> str:
        answer = self._answer
        head = "".join(f"<th>{_cell(name)}</th>" for name in answer.columns if answer.named)
        body = "".join(
            "<tr>" + "".join(f"<td>{_cell(value)}</td>" for value in row) + "</tr>"
            for row in answer.rows
        )
        more = f"<p>{self._more}</p>" if self._more else ""
        table = f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"
        # A wide table is scrolled; the notebook is not made wider by it.
        return f'<div style="overflow-x: auto">{table}</div>{more}'

    def __rich__(self) -> FittedTable:
        return fitted(self._answer, self._more)


def _cell(value: Any) -> str:
    return html.escape(readable(value))
