"""Answers messages on standard input that the SDK cannot read, and leaves without an answer."""

from __future__ import annotations

import json
from types import TracebackType
from typing import Any, Self

import anyio
from mcp.server import MCPServer
from mcp.server.stdio import stdio_server
from mcp.shared.message import SessionMessage
from mcp_types import PARSE_ERROR, ErrorData, JSONRPCError
from pydantic import ValidationError


class StandardStreamsServer(MCPServer[Any]):
    """A server that answers each request on standard input, unreadable ones with an error."""

    async def run_stdio_async(self) -> None:
        """Answers the messages on standard input until it ends."""
        server = self._lowlevel_server
        async with stdio_server() as (messages, answers):
            read = _ReadableMessages(messages, answers)
            await server.run(read, answers, server.create_initialization_options())


class _ReadableMessages:
    """The messages that can be read; it answers the others itself.

    Args:
        messages: all messages; an exception in the place of one that cannot be read.
        answers: takes answers.
    """

    def __init__(self, messages: Any, answers: Any) -> None:
        self._messages = messages
        self._answers = answers

    @property
    def last_context(self) -> Any:
        """The context of the sender, for the SDK."""
        return self._messages.last_context

    async def receive(self) -> SessionMessage | Exception:
        """Returns the next message."""
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
        """Ends the messages."""
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
