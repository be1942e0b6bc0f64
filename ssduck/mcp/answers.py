"""Answers the questions of agents: texts and pictures of an interpreter."""

from __future__ import annotations

from typing import Any, Protocol

from ssduck.adapters.charts import png
from ssduck.adapters.display import RowsOfColumns, display_table, numbered_duplicates
from ssduck.adapters.formats import png_of
from ssduck.adapters.marks import highlighted, marks_of
from ssduck.errors import ArgumentError, SelectScriptError
from ssduck.formatting import short_repr
from ssduck.interpreter.completion import Language
from ssduck.interpreter.interpreter import Interpreter
from ssduck.interpreter.program import last_query, value_to_show, with_last
from ssduck.interpreter.stopping import StopRequest
from ssduck.language.tree import AdapterClause, Literal
from ssduck.mcp.guide import as_text, description

# The largest size of a result, letters, and of a picture, pixels along a side.
MAX_LETTERS, MAX_PIXELS = 50_000, 2_000


class WorkerError(SelectScriptError):
    """An error of another process: the message begins with its type there."""


class Answers(Protocol):
    """The answers to the questions that the server's tools ask, one at a time."""

    def begin(self) -> None:
        """Is called before each question."""

    def stop(self) -> None:
        """Ends the question that was begun last, soon; any thread may call it."""

    def schema(self) -> str:
        """Returns the guide, the worlds, tables and functions."""

    def help(self, name: str) -> str:
        """Returns the description of a function, a relation or a result form."""

    def query(self, program: str, language: Language, max_rows: int) -> str:
        """Returns the result of a program as JSON."""

    def picture(self, program: str, language: Language, width: int, height: int) -> bytes:
        """Returns the PNG picture of a result, or one where what a program selects stands out."""


class InterpreterAnswers:
    """The answers of an interpreter in this process."""

    def __init__(self, ss: Interpreter) -> None:
        self._ss = ss
        self._stop_request = StopRequest()

    def begin(self) -> None:
        """Forgets what was stopped before."""
        self._stop_request = StopRequest()

    def stop(self) -> None:
        """Ends the question that was begun last: its program raises a LimitError."""
        self._stop_request.make()

    def schema(self) -> str:
        """Returns the guide, the worlds, tables and functions."""
        return description(self._ss)

    def help(self, name: str) -> str:
        """Returns the description of a function, a relation or a result form."""
        return str(self._ss.help(name))

    def query(self, program: str, language: Language, max_rows: int) -> str:
        """Returns the result of a program as JSON, cut to a number of rows and a largest size."""
        with self._stop_request.applies_to(self._ss):
            return _text(value_to_show(self._ss, program, language), max_rows)

    def picture(self, program: str, language: Language, width: int, height: int) -> bytes:
        """Returns the PNG picture of a result, or one where what a program selects stands out."""
        size = min(width, MAX_PIXELS), min(height, MAX_PIXELS)
        with self._stop_request.applies_to(self._ss):
            if language == "sql":
                return self._with_marks(self._ss.sql(program), size)
            compiled = self._ss.compile(program)
            value, query = self._ss.eval(compiled), last_query(compiled)
            if picture := png_of(value):
                return picture
            if query is None:
                return self._with_marks(value, size)
            arguments = tuple(Literal(query.span, number) for number in size)
            form = AdapterClause(query.span, "image", arguments)
            return png(self._ss.eval(with_last(compiled, query, form)))

    def _with_marks(self, value: Any, size: tuple[int, int]) -> bytes:
        """Returns a picture of the first world where what a value has stands out."""
        world, rows = self._ss.worlds[0], display_table(value).rows
        found = marks_of(world, rows)
        if not found:
            raise ArgumentError(
                "the program selects no entity and no link of the world "
                f"{short_repr(world.name)}, by itself or by name: let it end with a query for obj"
            )
        return png(highlighted(world, found, *size))


def _text(value: Any, max_rows: int) -> str:
    """Returns a result as JSON; a large one as an object with a part of it, and what is left out.

    Such an object has `rows`, their `count` and a `note`; or the `beginning` of the value's JSON,
    the number of its `letters` and a `note`.
    """
    if isinstance(value, RowsOfColumns):
        names = numbered_duplicates(value.columns)
        value = [dict(zip(names, row, strict=True)) for row in value]
    if not isinstance(value, list):
        return _sized(as_text(value))
    lines: list[str] = []
    size = 0
    for row in value[: max(0, max_rows)]:
        line = as_text(row)
        size += len(line) + 2
        if size > MAX_LETTERS:
            break
        lines.append(line)
    rows = "[" + ",\n".join(lines) + "]"
    if len(lines) == len(value):
        return rows
    note = f"{len(lines)} of {len(value)} rows; LIMIT and OFFSET give others"
    return f'{{"rows": {rows},\n"count": {len(value)}, "note": {as_text(note)}}}'


def _sized(text: str) -> str:
    if len(text) <= MAX_LETTERS:
        return text
    note = f"{MAX_LETTERS} of {len(text)} letters; select a part"
    return as_text({"beginning": text[:MAX_LETTERS], "letters": len(text), "note": note})
