"""Serves a scene or a record to agents: its schema, help, queries, episodes and pictures.

The server speaks the Model Context Protocol with the official SDK. `ssduck mcp` runs the programs
of agents under `Limits.strict()`, in a process of their own. Results have a largest size.
"""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, TypeVar

from mcp.server import MCPServer
from mcp.server.mcpserver import Image
from mcp.server.mcpserver.exceptions import ToolError

from ssduck.errors import SelectScriptError, printable
from ssduck.interpreter.archives import episodes
from ssduck.interpreter.interpreter import Interpreter
from ssduck.mcp.answers import Answers, InterpreterAnswers, Language, WorkerError
from ssduck.mcp.standard_streams import StandardStreamsServer
from ssduck.mcp.texts import as_text
from ssduck.mcp.turns import Turns

T = TypeVar("T")


def create_server(ss: Interpreter | Answers, record: Path | None = None) -> MCPServer[Any]:
    """Returns the server of an interpreter.

    Args:
        ss: the interpreter, with its limits, or the answers of a worker (`ssduck.cli.worker`).
        record: the path of the record that it reads; None for a scene.
    """
    server = StandardStreamsServer(
        "ssduck",
        instructions="Ask about a robot simulation. Read `schema` first; an error says what to "
        "write instead.",
        log_level="WARNING",
    )
    asking = _Asking(InterpreterAnswers(ss) if isinstance(ss, Interpreter) else ss)
    tools: list[Callable[..., Any]] = [asking.schema, asking.help, asking.query, asking.picture]
    if record is not None:
        tools.append(_episodes_of(record))
    for tool in tools:
        server.tool(structured_output=False)(tool)
    return server


class _Asking:
    """The questions that agents ask: the docstrings are written for them.

    Args:
        answers: answers the questions.
    """

    def __init__(self, answers: Answers) -> None:
        self._answers = answers
        self._turns = Turns(answers)

    async def _answer(self, method: Callable[..., T], *arguments: Any) -> T:
        """Returns the answer to a question, unless the agent cancels it."""

        def answer() -> T:
            with _errors_as_texts():
                return method(*arguments)

        return await self._turns.answer(answer)

    async def schema(self) -> str:
        """Explains how to write queries, and lists worlds, entities, tables and functions."""
        return await self._answer(self._answers.schema)

    async def help(self, name: str) -> str:
        """Describes a function, a relation or a result form: its arguments, units and result."""
        return await self._answer(self._answers.help, name)

    async def query(
        self, program: str, language: Language = "selectscript", max_rows: int = 100
    ) -> str:
        """Runs a program, and returns its result as JSON; infinities and NaN are texts.

        A large result is an object with the first rows, `rows`, their whole `count` and a `note`.

        Args:
            program: the program.
            language: SelectScript, or SQL: one SELECT.
            max_rows: the largest number of rows to return.
        """
        return await self._answer(self._answers.query, program, language, max_rows)

    async def picture(
        self,
        program: str,
        language: Language = "selectscript",
        width: int = 960,
        height: int = 720,
    ) -> Image:
        """Renders the world as PNG; the entities and links that a program selects stand out.

        A result that is a picture, such as that of `AS occupancygrid`, is returned as it is.

        Args:
            program: as of `query`, such as `SELECT obj FROM kitchen WHERE isRobot(this);`: its
                result has entities, links or their names.
            language: SelectScript, or SQL: one SELECT.
            width: pixels; more than 2,000 are 2,000.
            height: likewise.
        """
        data = await self._answer(self._answers.picture, program, language, width, height)
        return Image(data=data, format="png")


def _episodes_of(record: Path) -> Callable[[], str]:
    def list_episodes() -> str:
        """Lists the episodes of the record as JSON: world, number, ticks, times (s), tables."""
        with _errors_as_texts():
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
            return as_text(rows)

    list_episodes.__name__ = "episodes"
    return list_episodes


@contextlib.contextmanager
def _errors_as_texts() -> Iterator[None]:
    """Sends what programs print to standard error, and makes errors texts for the agent."""
    try:
        with contextlib.redirect_stdout(sys.stderr):
            yield
    except WorkerError as error:
        raise ToolError(printable(error.message, kept="\n")) from error
    except SelectScriptError as error:
        raise ToolError(printable(f"{type(error).__name__}: {error}", kept="\n")) from error
