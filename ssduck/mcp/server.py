"""Serves a scene or a record to agents: its schema, help, queries, episodes and pictures.

The server speaks the Model Context Protocol with the official SDK. `ssduck mcp` runs the programs
of agents under `Limits.strict()`, in a sandbox. Results have a largest size.
"""

from __future__ import annotations

import contextlib
import json
import sys
import threading
from collections.abc import Callable, Iterator
from functools import partial
from importlib.metadata import version
from pathlib import Path
from types import TracebackType
from typing import Any, Self, TypeVar

import anyio
from mcp.server import MCPServer
from mcp.server.mcpserver import Image
from mcp.server.mcpserver.exceptions import ToolError
from mcp.server.stdio import stdio_server
from mcp.shared.message import SessionMessage
from mcp_types import PARSE_ERROR, ErrorData, JSONRPCError
from pydantic import ValidationError

from ssduck.errors import LimitError, SelectScriptError, heard_warnings, printable
from ssduck.interpreter.completion import Language
from ssduck.interpreter.interpreter import Interpreter
from ssduck.interpreter.stopping import StopRequest
from ssduck.mcp.answers import InterpreterAnswers
from ssduck.sandbox.interpreter import SandboxedInterpreter


class _Turns:
    """The turns of questions to an interpreter, each in a thread of its own."""

    def __init__(self, ss: Interpreter | SandboxedInterpreter) -> None:
        self._ss = ss
        self._one_at_a_time = threading.Lock()

    async def answer(self, question: Callable[[], T]) -> T:
        """Returns the answer to a question, which ends early if the request is cancelled."""
        stop = StopRequest()
        try:
            return await anyio.to_thread.run_sync(
                self._answered, stop, question, abandon_on_cancel=True
            )
        except anyio.get_cancelled_exc_class():
            stop.make()
            raise

    def _answered(self, stop: StopRequest, question: Callable[[], T]) -> T:
        with self._one_at_a_time:
            if stop.is_made:
                raise LimitError("the request was cancelled")
            with stop.applies_to(self._ss):
                return question()


class StandardStreamsServer(MCPServer[Any]):
    """A server that answers each request on standard input, unreadable ones with an error."""

    async def run_stdio_async(self) -> None:
        """Answers the messages on standard input until it ends."""
        server = self._lowlevel_server
        async with stdio_server() as (messages, answers):
            read = _ReadableMessages(messages, answers)
            await server.run(read, answers, server.create_initialization_options())


class _ReadableMessages:
    """The messages that can be read; it answers the others itself."""

    def __init__(self, messages: Any, answers: Any) -> None:
        self._messages = messages
        self._answers = answers

    @property
    def last_context(self) -> Any:
        """The context of the sender, for the SDK."""
        return self._messages.last_context

    async def receive(self) -> SessionMessage | Exception:
        while True:
            message: SessionMessage | Exception = await self._messages.receive()
            answer = _answer_to(message) if isinstance(message, ValidationError) else None
            if answer is None:
                return message
            await self._answers.send(SessionMessage(answer))

    def __aiter__(self) -> Self:
        return self

    async def __anext__(self) -> SessionMessage | Exception:
        try:
            return await self.receive()
        except anyio.EndOfStream:
            raise StopAsyncIteration from None

    async def aclose(self) -> None:
        await self._messages.aclose()

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        await self.aclose()


def _answer_to(error: ValidationError) -> JSONRPCError | None:
    r"""Returns the answer to a line that is no JSON to the SDK; None if it is no request.

    Python reads half of a surrogate pair, such as `\ud800`, which the SDK does not.
    """
    problem = error.errors(include_url=False)[0]
    if problem["type"] != "json_invalid":
        return None
    hint = ""
    if "hex escape" in problem["msg"]:
        hint = ": half of a surrogate pair is no character; write both halves, or the character"
    try:
        id = json.loads(problem["input"])["id"]
        if id is None:  # a notification
            return None
        if isinstance(id, str):
            id.encode()
        data = ErrorData(code=PARSE_ERROR, message=f"{problem['msg']}{hint}")
        return JSONRPCError(jsonrpc="2.0", id=id, error=data)
    except (ValueError, TypeError, KeyError, RecursionError):  # a ValidationError is a ValueError
        return None


T = TypeVar("T")


def create_server(
    ss: Interpreter | SandboxedInterpreter, record: Path | None = None
) -> MCPServer[Any]:
    """Returns the server of an interpreter.

    Args:
        ss: the interpreter, with its limits.
        record: the path of the record that it reads; None for a scene.
    """
    server = StandardStreamsServer(
        "ssduck",
        instructions="Ask about a robot simulation. Read `schema` first; an error says what to "
        "write instead.",
        version=version("ssduck"),
        log_level="WARNING",
    )
    if isinstance(ss, SandboxedInterpreter):
        ask = partial(_ask_sandbox, ss)
    else:
        ask = partial(_ask_here, InterpreterAnswers(ss, record))
    asking = _Asking(ask, _Turns(ss))
    tools: list[Callable[..., Any]] = [asking.schema, asking.help, asking.query, asking.picture]
    if record is not None:
        tools.append(asking.episodes)
    for tool in tools:
        server.tool(structured_output=False)(tool)
    return server


def _ask_sandbox(ss: SandboxedInterpreter, method: str, *arguments: Any) -> Any:
    return ss.ask(f"agent answers.{method}", *arguments)


def _ask_here(answers: InterpreterAnswers, method: str, *arguments: Any) -> Any:
    return getattr(answers, method)(*arguments)


class _Asking:
    """The questions that agents ask: the docstrings are written for them."""

    def __init__(self, ask: Callable[..., Any], turns: _Turns) -> None:
        self._ask, self._turns = ask, turns

    async def _answer(self, method: str, *arguments: Any) -> list[Any]:
        """Returns the answer to a question and its warnings, unless the agent cancels it."""

        def answer() -> list[Any]:
            with _told_to_agent() as told:
                result = self._ask(method, *arguments)
            return [result, *_marked(told)]

        return await self._turns.answer(answer)

    async def schema(self) -> list[str]:
        """Explains how to write queries, and lists worlds, entities, tables and functions."""
        return await self._answer("schema")

    async def help(self, name: str) -> list[str]:
        """Describes a function, a relation or a result form: its arguments, units and result."""
        return await self._answer("help", name)

    async def query(
        self, program: str, language: Language = "selectscript", max_rows: int = 100
    ) -> list[str]:
        """Runs a program, and returns its result as JSON; infinities and NaN are texts.

        A large result is an object with the first rows, `rows`, their whole `count` and a `note`.
        `WHY` in front of a condition, or of a SELECT without rows, returns what fails, and by how
        much.

        Args:
            program: the program.
            language: SelectScript, or SQL: one SELECT.
            max_rows: the largest number of rows to return.
        """
        return await self._answer("query", program, language, max_rows)

    async def picture(
        self,
        program: str,
        language: Language = "selectscript",
        width: int = 960,
        height: int = 720,
    ) -> list[Image | str]:
        """Renders the world as PNG; the entities and links that a program selects stand out.

        A result that is a picture, such as that of `AS occupancygrid`, is returned as it is.

        Args:
            program: as of `query`, such as `SELECT obj FROM kitchen WHERE isRobot(this);`: its
                result has entities, links or their names.
            language: SelectScript, or SQL: one SELECT.
            width: pixels; more than 2,000 are 2,000.
            height: likewise.
        """
        png, *told = await self._answer("picture", program, language, width, height)
        return [Image(data=png, format="png"), *told]

    async def episodes(self) -> list[str]:
        """Lists the episodes of the record as JSON: world, number, ticks, times (s), tables."""
        return await self._answer("episodes")


@contextlib.contextmanager
def _told_to_agent() -> Iterator[list[str]]:
    """Lists warnings, makes errors texts, and sends what programs print to standard error."""
    with heard_warnings() as told, contextlib.redirect_stdout(sys.stderr):
        try:
            yield told
        except SelectScriptError as error:
            text = printable(f"{type(error).__name__}: {error}", kept="\n")
            raise ToolError("\n".join([text, *_marked(told)])) from error


def _marked(warnings: list[str]) -> list[str]:
    return [f"warning: {text}" for text in dict.fromkeys(warnings)]
