"""Answers the questions of agents: texts and pictures of an interpreter."""

from __future__ import annotations

import io
from typing import Any, Literal, Protocol

from ssduck.adapters.display import RowsOfColumns, numbered_duplicates
from ssduck.errors import SelectScriptError
from ssduck.interpreter.interpreter import Interpreter
from ssduck.interpreter.shown_rows import rows_to_show
from ssduck.interpreter.stopping import StopRequest
from ssduck.mcp.guide import description
from ssduck.mcp.texts import as_text

# The largest size of a result, letters, and of a picture, pixels along a side.
MAX_LETTERS, MAX_PIXELS = 50_000, 2_000

Language = Literal["selectscript", "sql"]


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

    def picture(self, query: str, width: int, height: int) -> bytes:
        """Returns a PNG picture with the entities that a query selects highlighted."""


class InterpreterAnswers:
    """The answers of an interpreter in this process.

    Args:
        ss: the interpreter.
    """

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
        """Returns the description of a function, a relation or a result form.

        Raises:
            UnknownNameError: there is none of that name.
        """
        return str(self._ss.help(name))

    def query(self, program: str, language: Language, max_rows: int) -> str:
        """Returns the result of a program as JSON, cut to a number of rows and a largest size.

        Raises:
            SelectScriptError: the program failed.
        """
        with self._stop_request.applies_to(self._ss):
            if language == "sql":
                value: Any = self._ss.sql(program)
            else:
                value = rows_to_show(self._ss.compile(program), self._ss.eval)
            return _text(value, max_rows)

    def picture(self, query: str, width: int, height: int) -> bytes:
        """Returns a PNG picture with the entities that a query selects highlighted.

        Raises:
            SelectScriptError: the query failed.
        """
        size = min(width, MAX_PIXELS), min(height, MAX_PIXELS)
        # In a line of its own: a comment that ends the query would hide it.
        text = f"{query.strip().removesuffix(';')}\nAS image({size[0]:d}, {size[1]:d});"
        stream = io.BytesIO()
        with self._stop_request.applies_to(self._ss):
            self._ss.eval(text).save(stream, "PNG")
        return stream.getvalue()


def _text(value: Any, max_rows: int) -> str:
    """Returns a result as JSON, cut to a number of rows and a largest size."""
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
    text = "[" + ",\n".join(lines) + "]"
    if len(lines) < len(value):
        text += f"\n{len(lines)} of {len(value)} rows; LIMIT and OFFSET give others"
    return text


def _sized(text: str) -> str:
    if len(text) <= MAX_LETTERS:
        return text
    return f"{text[:MAX_LETTERS]}\n{MAX_LETTERS} of {len(text)} letters; select a part"
