"""Sends and receives messages over a socket: a head, JSON, and a body of bytes.

The head says which question it belongs to, and how long both are, so that a receiver can refuse a
message before it takes memory. A message is a question of the host, its answer, or, before the
answer, a call: the worker asks the host for something that the answer needs.
"""

from __future__ import annotations

import os
import select
import struct
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import inf

from ssduck.limits import GRACE
from ssduck.sandbox.budget import InvalidAnswerError
from ssduck.world.ctrl_c import allowed

# The mark, the number of the question, the sizes of the JSON and of the body, bytes.
_HEAD = struct.Struct("<4sIQQ")
_MARK, _CALL = b"duck", b"call"
# So much is read at first, bytes; the body begins at a multiple of `_ALIGNMENT`.
_FIRST, _ALIGNMENT = 4096, 64
# Whoever waits looks at what else is to be looked at so often, s.
LOOK_EVERY = 0.1


@dataclass(frozen=True)
class Message:
    """A message.

    Attributes:
        number: the number of the question.
        document: the JSON, not parsed.
        body: the bytes to which the JSON refers.
        is_call: whether it is a call.
    """

    number: int
    document: bytes
    body: memoryview
    is_call: bool = False


def send(
    descriptor: int,
    number: int,
    document: bytes,
    parts: Sequence[bytes | memoryview] = (),
    wait: Callable[[int], None] | None = None,
    *,
    is_call: bool = False,
) -> None:
    """Sends a message."""
    document += b" " * (-(len(document) + _HEAD.size) % _ALIGNMENT)
    size = sum(len(part) for part in parts)
    head = _HEAD.pack(_CALL if is_call else _MARK, number, len(document), size) + document
    for part in (head, *parts):
        data = memoryview(part)
        while data:
            try:
                data = data[os.write(descriptor, data) :]
            except BlockingIOError:
                assert wait is not None
                wait(select.POLLOUT)


def receive(
    descriptor: int,
    check: Callable[[int, int], None] | None = None,
    wait: Callable[[int], None] | None = None,
) -> Message:
    """Receives a message."""
    first = bytearray(_FIRST)
    done = 0
    while done < _HEAD.size:
        done += _read(descriptor, memoryview(first)[done:], wait)
    mark, number, length, size = _HEAD.unpack_from(first)
    if mark not in (_MARK, _CALL):
        raise InvalidAnswerError("it does not begin as a message does")
    if check is not None:
        check(length, size)
    total = _HEAD.size + length + size
    if done > total:
        raise InvalidAnswerError("it is longer than it says")
    data = first
    if total > _FIRST:
        data = bytearray(total)
        data[:done] = first[:done]
    view = memoryview(data)[:total]
    while done < total:
        done += _read(descriptor, view[done:], wait)
    body = _HEAD.size + length
    return Message(number, bytes(view[_HEAD.size : body]), view[body:], mark == _CALL)


def _read(descriptor: int, space: memoryview, wait: Callable[[int], None] | None) -> int:
    """Reads what there is, at least a byte, and returns how much."""
    while True:
        try:
            read = os.readv(descriptor, [space])
        except BlockingIOError:
            assert wait is not None
            wait(select.POLLIN)
            continue
        if not read:
            raise EOFError
        return read


class Waiting:
    """Waits for a socket until a time, and looks at something else now and then.

    Ctrl-C, which is deferred elsewhere, breaks no message off: it stops the other side.

    Args:
        descriptor: the socket.
        seconds: how long it may take in all, s; None for ever.
        look: is called about ten times a second; it raises an error if the wait is to end.
        stop: tells the other side of Ctrl-C, after which it has `GRACE`.

    Attributes:
        is_pressed: whether Ctrl-C was pressed.
    """

    def __init__(
        self,
        descriptor: int,
        seconds: float | None,
        look: Callable[[], None],
        stop: Callable[[], None],
    ) -> None:
        self._descriptor = descriptor
        now = time.monotonic()
        self._deadline = inf if seconds is None else now + seconds
        self._look, self._next_look = look, now + LOOK_EVERY
        self._stop, self.is_pressed = stop, False
        self._poll = select.poll()

    def check(self) -> None:
        """Checks the time, and looks if it is time to: also if there is never need to wait."""
        now = time.monotonic()
        if now >= self._deadline:
            raise TimeoutError
        if now >= self._next_look:
            self._next_look = now + LOOK_EVERY
            self._look()

    def __call__(self, events: int) -> None:
        """Waits for an event of `select.poll`."""
        self._poll.register(self._descriptor, events)
        while True:
            self.check()
            until = min(self._next_look, self._deadline)
            try:
                with allowed():
                    if self._poll.poll(max(0.0, 1000 * (until - time.monotonic()))):
                        return
            except KeyboardInterrupt:
                self.press()

    def press(self) -> None:
        """Tells the other side of Ctrl-C."""
        self._deadline = min(self._deadline, time.monotonic() + GRACE)
        self.is_pressed = True
        self._stop()
