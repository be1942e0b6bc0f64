"""Errors and warnings: what is wrong, where, the nearest right name, and what to do about it.

Every error that ssduck raises on purpose is a `SelectScriptError`; each kind is also the
builtin exception that a Python user expects (`LookupError` for an unknown name, and so on).
"""

from __future__ import annotations

import difflib
import sys
import warnings
from collections.abc import Callable, Iterable
from dataclasses import dataclass

# Longer messages and lines of a program are cut: whoever sees one is to read it.
MOST_OF_MESSAGE = 4000
MOST_OF_LINE = 160
_BEFORE = 60
# A longer name is compared with others by its beginning.
_MOST_OF_NAME = 200
_PACKAGE = __name__.partition(".")[0]
# Frames of decorators, context managers and cached properties stand between those of the package.
_BETWEEN = frozenset((_PACKAGE, "contextlib", "functools", "numpy"))


@dataclass(frozen=True)
class SourceSpan:
    """A part of a program's text: `text[start:end]`, in characters."""

    start: int
    end: int


def nearest(name: object, known: Iterable[str], limit: int = 3) -> tuple[str, ...]:
    """The known names that are most alike to `name`, best first, case aside; to a text only."""
    if not isinstance(name, str):
        return ()
    by_folded = {candidate.casefold(): candidate for candidate in sorted(known)}
    wanted = name[:_MOST_OF_NAME].casefold()
    found = difflib.get_close_matches(wanted, list(by_folded), n=limit, cutoff=0.6)
    return tuple(by_folded[match] for match in found)


class SelectScriptError(Exception):
    """The root of ssduck's errors.

    Attributes:
        message: what is wrong, in one line.
        text: the program's text, where there is one.
        span: the offending part of it: `text[span.start:span.end]`.
        suggestions: the nearest right names, best first.

    Args:
        instead: what to write instead, given the program's text.
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
        if len(message) > MOST_OF_MESSAGE:
            message = f"{message[:MOST_OF_MESSAGE]}…"
        super().__init__(message)
        self.message = message
        self.text = text
        self.span = span
        self.suggestions = tuple(suggestions)
        self._instead = instead

    def locate(self, text: str) -> None:
        """Tell it the program in which it arose, unless it knows one already."""
        if self.text is None:
            self.text = text
            if self._instead is not None:
                self.message += f"; write {self._instead(text)}"

    @property
    def line(self) -> int | None:
        """The line of the offending text, from 1."""
        if self.text is None or self.span is None:
            return None
        return self.text.count("\n", 0, self.span.start) + 1

    @property
    def column(self) -> int | None:
        """The column of the offending text's first character, from 1."""
        if self.text is None or self.span is None:
            return None
        return self.span.start - (self.text.rfind("\n", 0, self.span.start) + 1) + 1

    def __str__(self) -> str:
        told = self.message
        if self.suggestions:
            told += f"; did you mean {' or '.join(repr(name) for name in self.suggestions)}?"
        if self.text is None or self.span is None:
            return told
        return f"{told}\n  line {self.line}, column {self.column}\n{self._underlined()}"

    def _underlined(self) -> str:
        """The offending line, or its part around the offending text, which is underlined."""
        assert self.text is not None
        assert self.span is not None
        first = self.text.rfind("\n", 0, self.span.start) + 1
        last = self.text.find("\n", self.span.start)
        last = len(self.text) if last < 0 else last
        cut = ""
        if last - first > MOST_OF_LINE:
            cut = "…" if self.span.start - first > _BEFORE else ""
            first = max(first, self.span.start - _BEFORE)
            last = min(last, first + MOST_OF_LINE)
        line = cut + self.text[first:last]
        before = line[: len(cut) + self.span.start - first]
        width = max(1, min(self.span.end, last) - self.span.start)
        # A tab keeps its place, so that the mark stands under what it marks.
        indent = "".join("\t" if letter == "\t" else " " for letter in before)
        return f"    {line}\n    {indent}{'^' * width}"


class ProgramWarning(UserWarning):
    """What in a program has a meaning, and is probably a mistake: what, where, what was meant."""


class ParseError(SelectScriptError, ValueError):
    """The text is no SelectScript program."""


class UnknownNameError(SelectScriptError, LookupError):
    """A name that no variable, function, adapter, entity, table or scene has."""


class ArgumentError(SelectScriptError, TypeError):
    """The wrong number of arguments, or one of the wrong type."""


class NumberError(ArgumentError, ValueError):
    """A number of the wrong kind, or out of the range that a function takes."""


class StateError(SelectScriptError, ValueError):
    """A pose, or the value of a joint, that a body cannot be given."""


class EvaluationError(SelectScriptError, ArithmeticError):
    """A value that cannot be computed: a division by zero, an index out of range."""


class FunctionError(SelectScriptError, RuntimeError):
    """A user's function raised; the original is the cause."""


class UnsupportedError(SelectScriptError, NotImplementedError):
    """What this version, or another engine whose SQL is wanted, does not run."""


class LimitError(SelectScriptError, RuntimeError):
    """A program would use more than the interpreter's limits allow, or search without end."""


class SceneError(SelectScriptError, ValueError):
    """A scene description that cannot be loaded: file, key and reason."""


class RemovedEntityError(SelectScriptError, LookupError):
    """An entity that is no longer in its world."""


class SimulatorError(SelectScriptError, RuntimeError):
    """The simulator does not answer: its client was disconnected, say."""


class RecordError(SelectScriptError, OSError):
    """What was recorded cannot be opened, read or written."""


class SqlError(SelectScriptError, RuntimeError):
    """DuckDB refused a statement; its own error is the cause.

    Attributes:
        is_final: whether no other statement could do better.
        is_refused: whether it did not even begin to run.
    """

    def __init__(self, message: str, *, is_final: bool = False, is_refused: bool = False) -> None:
        super().__init__(message)
        self.is_final = is_final
        self.is_refused = is_refused


def warn(message: str, category: type[Warning] = UserWarning) -> None:
    """Warn of the innermost line that is not ssduck's own.

    Args:
        message: the text of the warning.
        category: the class of the warning.
    """
    frame, level = sys._getframe(), 1  # noqa: SLF001  # warnings counts frames, too
    while frame.f_back is not None and _package(frame.f_globals) in _BETWEEN:
        frame, level = frame.f_back, level + 1
    warnings.warn(message, category, stacklevel=level)


def _package(names: dict[str, object]) -> str:
    return str(names.get("__name__", "")).partition(".")[0]
