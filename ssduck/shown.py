"""Values as tables for people: in a terminal, in a notebook."""

from __future__ import annotations

import html
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from ssduck.answers import Answer, answer_of, lines_of, readable, table_of

if TYPE_CHECKING:
    from rich.console import RenderableType

# So many rows are shown.
MOST_ROWS = 20


class Shown:
    """What shows as a table: its first rows, numbers rounded to six digits.

    A terminal shows it as text, a notebook as HTML, rich as a table of its own.

    Args:
        value: the rows: a list of dicts, say.
        rows: how many are shown at most.
    """

    def __init__(self, value: Any, rows: int = MOST_ROWS) -> None:
        answer = answer_of(value)
        self._count = len(answer.rows)
        self._answer: Answer = replace(answer, rows=list(answer.rows)[:rows])

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
        return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>{more}"

    def __rich__(self) -> RenderableType:
        from rich.console import Group
        from rich.text import Text

        table = table_of(self._answer)
        return Group(table, Text(self._more)) if self._more else table


def _cell(value: Any) -> str:
    return html.escape(readable(value))
