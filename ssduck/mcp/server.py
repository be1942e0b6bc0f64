"""Serves a scene or a record to agents: its schema, help, queries, episodes and pictures.

The server speaks the Model Context Protocol with the official SDK. Its programs run under
`Limits.strict()`, and results have a largest size.
"""

from __future__ import annotations

import contextlib
import io
import json
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Literal

from mcp.server import MCPServer
from mcp.server.mcpserver import Image
from mcp.server.mcpserver.exceptions import ToolError

from ssduck.adapters.display import RowsOfColumns, as_json, numbered_duplicates
from ssduck.errors import SelectScriptError
from ssduck.interpreter.archives import episodes
from ssduck.interpreter.interpreter import Interpreter
from ssduck.interpreter.shown_rows import rows_to_show
from ssduck.mcp.guide import description

# The largest size of a result, letters, and of a picture, pixels along a side.
MAX_LETTERS, MAX_PIXELS = 50_000, 2_000

Language = Literal["selectscript", "sql"]


def create_server(ss: Interpreter, record: Path | None = None) -> MCPServer[Any]:
    """Returns the server of an interpreter.

    Args:
        ss: the interpreter, with its limits.
        record: the path of the record that it reads; None for a scene.
    """
    server: MCPServer[Any] = MCPServer(
        "ssduck",
        instructions="Ask about a robot simulation. Read `schema` first; an error says what to "
        "write instead.",
        log_level="WARNING",
    )
    asking = _Asking(ss)
    tools: list[Callable[..., Any]] = [asking.schema, asking.help, asking.query, asking.picture]
    if record is not None:
        tools.append(_episodes_of(record))
    for tool in tools:
        server.tool(structured_output=False)(tool)
    return server


class _Asking:
    """The questions that agents ask an interpreter: the docstrings are written for them.

    Args:
        ss: the interpreter.
    """

    def __init__(self, ss: Interpreter) -> None:
        self._ss = ss

    def schema(self) -> str:
        """Explains how to write queries, and lists worlds, entities, tables and functions."""
        return description(self._ss)

    def help(self, name: str) -> str:
        """Describes a function, a relation or a result form: its arguments, units and result."""
        with _answers():
            return str(self._ss.help(name))

    def query(self, program: str, language: Language = "selectscript", max_rows: int = 100) -> str:
        """Runs a program, and returns its result as JSON.

        Args:
            program: the program.
            language: SelectScript, or SQL: one SELECT.
            max_rows: the largest number of rows to return; the result says how many there are.
        """
        with _answers():
            if language == "sql":
                value: Any = self._ss.sql(program)
            else:
                value = rows_to_show(self._ss.compile(program), self._ss.eval)
            return _text(value, max_rows)

    def picture(self, query: str, width: int = 960, height: int = 720) -> Image:
        """Renders the world with the entities that a query selects highlighted, as PNG.

        Args:
            query: a SelectScript query that selects entities and has no AS, such as
                `SELECT obj FROM kitchen WHERE isRobot(this)`.
            width: pixels, at most 2,000.
            height: pixels, at most 2,000.
        """
        size = min(width, MAX_PIXELS), min(height, MAX_PIXELS)
        with _answers():
            text = f"{query.strip().removesuffix(';')} AS image({size[0]:d}, {size[1]:d});"
            stream = io.BytesIO()
            self._ss.eval(text).save(stream, "PNG")
        return Image(data=stream.getvalue(), format="png")


def _episodes_of(record: Path) -> Callable[[], str]:
    def list_episodes() -> str:
        """Lists the episodes of the record as JSON: world, number, ticks, times (s), tables."""
        with _answers():
            rows = [
                {
                    "world": episode.world,
                    "number": episode.number,
                    "started": episode.started,
                    "ticks": episode.ticks,
                    "start": episode.start,
                    "end": episode.end,
                    "tables": list(episode.tables),
                }
                for episode in episodes(record)
            ]
            return json.dumps(rows)

    list_episodes.__name__ = "episodes"
    return list_episodes


@contextlib.contextmanager
def _answers() -> Iterator[None]:
    """Sends what programs print to standard error, and makes errors texts for the agent."""
    try:
        with contextlib.redirect_stdout(sys.stderr):
            yield
    except SelectScriptError as error:
        raise ToolError(f"{type(error).__name__}: {error}") from error


def _text(value: Any, max_rows: int) -> str:
    """Returns a result as JSON, cut to a number of rows and a largest size."""
    if isinstance(value, RowsOfColumns):
        names = numbered_duplicates(value.columns)
        value = [dict(zip(names, row, strict=True)) for row in value]
    if not isinstance(value, list):
        return _sized(json.dumps(as_json(value), ensure_ascii=False))
    lines: list[str] = []
    size = 0
    for row in value[: max(0, max_rows)]:
        line = json.dumps(as_json(row), ensure_ascii=False)
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
