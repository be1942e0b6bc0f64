"""Errors and warnings: what is wrong, where, the nearest right name, and what to do.

Every error that ssduck raises on purpose is a `SelectScriptError`. Each kind is also the builtin
exception that a Python user expects (`LookupError` for an unknown name, and so on).
"""

from __future__ import annotations

import difflib
import sys
import traceback
import warnings
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from types import CodeType, FrameType
from typing import Any

# Longer messages and lines of a program are cut, to stay readable.
MAX_MESSAGE_LENGTH = 4000
MAX_LINE_LENGTH = 160
_MAX_CONTEXT = 60
# Of a longer name, only the beginning is compared with others.
_MAX_NAME_LENGTH = 200
_PACKAGE = __name__.partition(".")[0]
# Frames of decorators, context managers and cached properties lie between those of the package.
_NOTEBOOK_PACKAGES = frozenset(("IPython", "ipykernel"))
_SKIPPED_PACKAGES = frozenset((_PACKAGE, "contextlib", "functools", "numpy"))


@dataclass(frozen=True)
class SourceSpan:
    """A part of a program's text: `text[start:end]`, in characters.

    Attributes:
        start: the index of its first character.
        end: the index after its last character.
    """

    start: int
    end: int


def printable(text: str, kept: str = "") -> str:
    """Escapes control characters, and those that turn the direction of what follows.

    Args:
        text: the text.
        kept: characters that stay as they are.
    """
    if text.isprintable():
        return text
    return "".join(one if one.isprintable() or one in kept else _escaped(one) for one in text)


def _escaped(character: str) -> str:
    """Returns a character as JSON writes it: one beyond 16 bits as two."""
    units = character.encode("utf-16-be", errors="surrogatepass")
    return "".join(f"\\u{units[i]:02x}{units[i + 1]:02x}" for i in range(0, len(units), 2))


def nearest(
    name: object, known: Iterable[str], limit: int = 3, *, least: float = 0.6
) -> tuple[str, ...]:
    """Returns the known names most similar to a name, best first; case does not matter.

    Args:
        name: the name.
        known: the known names.
        limit: the maximal number of names.
        least: the smallest similarity, from 0 to 1.

    >>> nearest("fridg", ["Fridge", "table"])
    ('Fridge',)
    """
    if not isinstance(name, str):
        return ()
    by_folded = {candidate.casefold(): candidate for candidate in sorted(known)}
    folded = name[:_MAX_NAME_LENGTH].casefold()
    matches = difflib.get_close_matches(folded, list(by_folded), n=limit, cutoff=least)
    return tuple(by_folded[match] for match in matches)


class SelectScriptError(Exception):
    """The base class of ssduck's errors.

    Attributes:
        message: the message, in one line.
        text: the text of the program; None if there is none.
        span: the place of the error in it; None if it is not known.
        suggestions: the nearest right names, best first.

    Args:
        instead: a function that returns the right code, from the text of the program.
    """

    def __init__(
        self,
        message: str,
        *,
        text: str | None = None,
        span: SourceSpan | None = None,
        suggestions: Iterable[str] = (),
        instead: Callable[[str], str] | None = None,
    ) -> None:
        if len(message) > MAX_MESSAGE_LENGTH:
            message = f"{message[:MAX_MESSAGE_LENGTH]}…"
        super().__init__(message)
        self.message = message
        self.text = text
        self.span = span
        self.suggestions = tuple(suggestions)
        self._instead = instead

    def locate(self, text: str) -> None:
        """Sets the program in which the error arose, unless it is set."""
        if self.text is None:
            self.text = text
            if self._instead is not None:
                self.message += f"; write {self._instead(text)}"

    @property
    def line(self) -> int | None:
        """The line of the error, from 1."""
        if self.text is None or self.span is None:
            return None
        return self.text.count("\n", 0, self.span.start) + 1

    @property
    def column(self) -> int | None:
        """The column of the error's first character, from 1."""
        if self.text is None or self.span is None:
            return None
        return self.span.start - (self.text.rfind("\n", 0, self.span.start) + 1) + 1

    def __str__(self) -> str:
        return printable(self._whole_text(), kept="\n\t")  # names may come from strangers

    def _whole_text(self) -> str:
        text = self.message
        if self.suggestions:
            text += f"; did you mean {' or '.join(repr(name) for name in self.suggestions)}?"
        if self.text is None or self.span is None:
            return text
        return f"{text}\n  line {self.line}, column {self.column}\n{self._underlined()}"

    def _render_traceback_(self) -> list[str]:
        """Returns the lines that notebooks show: the user's own lines, and the error."""
        return [*_outside_lines(self), f"{type(self).__name__}: {self}"]

    def _underlined(self) -> str:
        """Returns the line of the error, or a part of a long one, with the place underlined."""
        assert self.text is not None
        assert self.span is not None
        first = self.text.rfind("\n", 0, self.span.start) + 1
        last = self.text.find("\n", self.span.start)
        last = len(self.text) if last < 0 else last
        cut = ""
        if last - first > MAX_LINE_LENGTH:
            cut = "…" if self.span.start - first > _MAX_CONTEXT else ""
            first = max(first, self.span.start - _MAX_CONTEXT)
            last = min(last, first + MAX_LINE_LENGTH)
        line = cut + self.text[first:last]
        before = line[: len(cut) + self.span.start - first]
        width = max(1, min(self.span.end, last) - self.span.start)
        # Tabs are kept, so that the mark is below the marked text.
        indent = "".join("\t" if letter == "\t" else " " for letter in before)
        return f"    {line}\n    {indent}{'^' * width}"


def _outside_lines(error: BaseException) -> list[str]:
    """Returns the lines of code outside ssduck that led to an error, in the order of the calls."""
    frames = list(traceback.walk_tb(error.__traceback__))
    inner = [n for n, (frame, _) in enumerate(frames) if _package(frame.f_globals) == _PACKAGE]
    frames = frames[: inner[0]] if inner else frames
    frames = [pair for pair in frames if _package(pair[0].f_globals) not in _NOTEBOOK_PACKAGES]
    lines = traceback.StackSummary.extract(iter(frames)).format()
    cause = error.__cause__
    if isinstance(error, FunctionError) and cause is not None:
        frames = list(traceback.walk_tb(cause.__traceback__))
        while frames and _package(frames[0][0].f_globals) in _SKIPPED_PACKAGES:
            del frames[0]
        lines += traceback.StackSummary.extract(iter(frames)).format()
    return [line.rstrip("\n") for line in lines]


class ProgramWarning(UserWarning):
    """A part of a program is valid, but probably a mistake."""


class ParseError(SelectScriptError, ValueError):
    """The text is not a valid SelectScript program."""


class UnknownNameError(SelectScriptError, LookupError):
    """No variable, function, adapter, entity, table or scene has that name."""


class ArgumentError(SelectScriptError, TypeError):
    """The number of arguments or the type of an argument is wrong."""


class NumberError(ArgumentError, ValueError):
    """A number has the wrong kind, or is out of range."""


class StateError(SelectScriptError, ValueError):
    """A body cannot have such a pose or joint position."""


class EvaluationError(SelectScriptError, ArithmeticError):
    """A value cannot be computed: a division by zero, an index out of range."""


class FunctionError(SelectScriptError, RuntimeError):
    """A user's function raised; the original error is the cause."""


class UnsupportedError(SelectScriptError, NotImplementedError):
    """A feature that this version, or the requested SQL dialect, does not support."""


class LimitError(SelectScriptError, RuntimeError):
    """A program exceeded the limits of the interpreter, or its search would not end."""


class SandboxError(SelectScriptError, RuntimeError):
    """A sandbox cannot be had on this system, or its process does not answer as it should."""


class SceneError(SelectScriptError, ValueError):
    """A scene cannot be loaded; the message has file, key and reason."""


class RemovedEntityError(SelectScriptError, LookupError):
    """An entity is no longer in its world."""


class SimulatorError(SelectScriptError, RuntimeError):
    """The simulator does not answer, for example because its client was disconnected."""


class RecordError(SelectScriptError, OSError):
    """A record cannot be opened, read or written."""


class RecordPermissionError(RecordError, PermissionError):
    """A file of a record may not be read or written, which is no damage."""


def record_error(message: str, error: OSError) -> RecordError:
    """Returns the error of a record for one of the operating system."""
    kind = RecordPermissionError if isinstance(error, PermissionError) else RecordError
    return kind(message)


@contextmanager
def record_errors() -> Iterator[None]:
    """Turns errors of the operating system about files into RecordErrors that name them.

    A folder without permission, say, is met wherever it is listed or looked at first.
    """
    try:
        yield
    except SelectScriptError:
        raise
    except OSError as error:
        if error.filename is None:
            raise
        raise record_error(f"{error.filename}: {error.strerror}", error) from error


class SqlError(SelectScriptError, RuntimeError):
    """DuckDB refused a statement; its own error is the cause.

    Attributes:
        is_final: whether no other statement could succeed.
        is_refused: whether the statement did not even begin to run.
    """

    def __init__(self, message: str, *, is_final: bool = False, is_refused: bool = False) -> None:
        super().__init__(message)
        self.is_final = is_final
        self.is_refused = is_refused


def check_known(
    name: Any,
    known: Collection[str],
    message: str,
    error: type[SelectScriptError] = UnknownNameError,
) -> None:
    """Raises an error with the nearest names, unless a name is known."""
    if name not in known:
        raise error(message, suggestions=nearest(name, known))


# Where the texts of warnings go instead.
_heard: ContextVar[list[str] | None] = ContextVar("_heard", default=None)


def warn(message: str, category: type[Warning] = UserWarning) -> None:
    """Warns, with the innermost line outside ssduck as the location.

    Args:
        message: the text of the warning.
        category: the class of the warning.
    """
    text, heard = printable(message, kept="\n\t"), _heard.get()
    if heard is not None:
        heard.append(text)
        return
    _, level = _outer_frame()
    warnings.warn(text, category, stacklevel=level)


@contextmanager
def heard_warnings() -> Iterator[list[str]]:
    """Lists the texts of ssduck's warnings in this thread or task, which then warn of nothing."""
    heard: list[str] = []
    token = _heard.set(heard)
    try:
        yield heard
    finally:
        _heard.reset(token)


def calling_place() -> tuple[CodeType, int]:
    """Returns the place in the user's program that called ssduck: its code, and the line."""
    frame, _ = _outer_frame()
    return frame.f_code, frame.f_lineno


def _outer_frame() -> tuple[FrameType, int]:
    """Returns the innermost frame outside ssduck, and how many frames it is from the caller."""
    frame: FrameType | None = sys._getframe(1)  # noqa: SLF001  # warnings counts frames, too
    assert frame is not None
    level = 1
    while frame.f_back is not None and _package(frame.f_globals) in _SKIPPED_PACKAGES:
        frame, level = frame.f_back, level + 1
    return frame, level


def _package(names: dict[str, object]) -> str:
    return str(names.get("__name__", "")).partition(".")[0]
