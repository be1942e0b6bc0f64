"""Shows values as tables in a terminal or a notebook."""

from __future__ import annotations

import html
from typing import Any

from ssduck import validation
from ssduck.adapters.display import (
    ROW_MARK,
    fitted_table,
    on_lines,
    readable_table,
    table_lines,
    terminal_width,
)
from ssduck.adapters.text_table import FittedTable

# The number of rows shown by default.
MAX_ROWS = 20


class TableView:
    """A view of a value as a table: its first and last rows, numbers rounded to six digits.

    A row of · stands for the rows in the middle that are left out, and a line below has the
    counts. A terminal shows text that fits its width, a notebook shows HTML, and rich a table of
    its own. Other output is text at full width.

    Args:
        value: the rows, a list of dicts for example.
        rows: the maximal number of rows shown.

    Raises:
        NumberError: `rows` is not a whole number of at least 0.

    >>> heights = [{"id": "sink", "z": 0.9}, {"id": "cup", "z": 1.0}, {"id": "lamp", "z": 2.1}]
    >>> TableView(heights, rows=2)
    id      z
    ----  ---
    sink  0.9
    ·       ·
    lamp  2.1
    3 rows (2 shown)
    """

    def __init__(self, value: Any, rows: int = MAX_ROWS) -> None:
        rows = validation.integer(rows, "show: rows", minimum=0)
        self._table = readable_table(value, rows)

    def text(self, width: int | None = None) -> str:
        """Returns the table as a text.

        Args:
            width: the maximal width, characters; by default that of the terminal, if there is one.

        Raises:
            NumberError: `width` is not a whole number of at least 1.
        """
        if width is None:
            width = terminal_width()
        else:
            width = validation.integer(width, "show: width", minimum=1)
        return "\n".join(table_lines(self._table, width))

    def __repr__(self) -> str:
        return self.text()

    def _repr_html_(self) -> str:
        table = self._table
        names = [*map(_escaped, table.columns)] if table.named else []
        types = [f"<br><small>{_escaped(type)}</small>" for type in table.types]
        head = _html_row("th", [*map("".join, zip(names, types, strict=True))] if types else names)
        rows = [_html_row("td", map(_escaped, row)) for row in table.rows]
        if table.omitted:
            count = max([len(table.columns), *map(len, table.rows)])
            rows.insert((len(rows) + 1) // 2, _html_row("td", [ROW_MARK] * count))
        note = f"<p>{self._note}</p>" if self._note else ""
        html_table = f"<table><thead>{head}</thead><tbody>{''.join(rows)}</tbody></table>"
        # A wide table scrolls instead of widening the notebook.
        return f'<div style="overflow-x: auto">{html_table}</div>{note}'

    @property
    def _note(self) -> str:
        """The numbers of rows and of columns, if rows are left out."""
        table = self._table
        if not (table.omitted and table.named):
            return table.row_note
        count = len(table.columns)
        return f"{table.row_note}, {count} column{'' if count == 1 else 's'}"

    def __rich__(self) -> FittedTable:
        return fitted_table(self._table)


def _html_row(tag: str, cells: Any) -> str:
    return f"<tr>{''.join(f'<{tag}>{cell}</{tag}>' for cell in cells)}</tr>"


def _escaped(value: Any) -> str:
    text = html.escape(on_lines(value))
    return f"<pre>{text}</pre>" if "\n" in text else text
