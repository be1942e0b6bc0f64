"""Shows values as tables in a terminal or a notebook."""

from __future__ import annotations

import html
from dataclasses import replace
from typing import Any

from ssduck import validation
from ssduck.adapters.display import (
    DisplayTable,
    display_table,
    fitted_table,
    readable,
    terminal_width,
    text_lines,
)
from ssduck.adapters.text_table import FittedTable

# The number of rows shown by default.
MAX_ROWS = 20


class TableView:
    """A view of a value as a table: its first rows, numbers rounded to six digits.

    A terminal shows text that fits its width, a notebook shows HTML, and rich a table of its own.
    Other output is text at full width.

    Args:
        value: the rows, a list of dicts for example.
        rows: the maximal number of rows shown.

    Raises:
        NumberError: `rows` is not a whole number of at least 0.

    >>> TableView([{"id": "sink", "volume": 0.03}, {"id": "cup", "volume": 4e-4}], rows=1)
    id    volume
    ----  ------
    sink    0.03
    first 1 of 2 rows
    """

    def __init__(self, value: Any, rows: int = MAX_ROWS) -> None:
        rows = validation.integer(rows, "show: rows", minimum=0)
        table = display_table(value)
        self._count = len(table.rows)
        self._table: DisplayTable = replace(table, rows=list(table.rows)[:rows])

    @property
    def _note(self) -> str:
        """The note on rows that are not shown; empty if all are."""
        shown = len(self._table.rows)
        if not self._count:
            return "(no rows)"
        return f"first {shown} of {self._count} rows" if shown < self._count else ""

    def __repr__(self) -> str:
        table = self._table
        if table.columns and not table.named:
            lines = [readable(row[0]) for row in table.rows]
        elif (width := terminal_width()) is not None:
            return "\n".join(self.__rich__().lines(width))
        else:
            lines = list(text_lines(table)) if table.columns or table.rows else []
        return "\n".join([*lines, self._note] if self._note else lines)

    def _repr_html_(self) -> str:
        view = self._table
        head = "".join(f"<th>{_cell(name)}</th>" for name in view.columns if view.named)
        body = "".join(
            "<tr>" + "".join(f"<td>{_cell(value)}</td>" for value in row) + "</tr>"
            for row in view.rows
        )
        note = f"<p>{self._note}</p>" if self._note else ""
        html_table = f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"
        # A wide table scrolls instead of widening the notebook.
        return f'<div style="overflow-x: auto">{html_table}</div>{note}'

    def __rich__(self) -> FittedTable:
        return fitted_table(self._table, self._note)


def _cell(value: Any) -> str:
    return html.escape(readable(value))
