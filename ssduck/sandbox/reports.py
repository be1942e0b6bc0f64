"""Carries errors, warnings and what programs print from a worker to the host, as data."""

from __future__ import annotations

import io
import sys
import warnings
from collections.abc import Sequence
from typing import Any

from ssduck import errors
from ssduck.errors import (
    MAX_MESSAGE_LENGTH,
    LimitError,
    ProgramWarning,
    SandboxError,
    SelectScriptError,
    SourceSpan,
    SqlError,
    printable,
    warn,
)
from ssduck.formatting import error_text
from ssduck.sandbox.budget import InvalidAnswerError

_ERRORS = {
    name: kind
    for name, kind in vars(errors).items()
    if isinstance(kind, type) and issubclass(kind, SelectScriptError)
}
_WARNINGS = {kind.__name__: kind for kind in (ProgramWarning, UserWarning, RuntimeWarning)}
# Of each answer, so many warnings and suggestions cross.
_MOST = 20
# What stands for a kind of warning with what a program prints, and how much of that crosses.
_PRINTED, _MAX_PRINTED = "print", 100_000


def told_error(error: BaseException) -> dict[str, Any]:
    """Returns what the host is told of an error."""
    if isinstance(error, MemoryError) or isinstance(error.__cause__, MemoryError):
        error = LimitError("the program needs more memory than it may take")
    elif isinstance(error, KeyboardInterrupt):
        error = LimitError("the program was stopped")
    elif isinstance(error, RecursionError):
        error = LimitError("the program is nested too deeply")
    if not isinstance(error, SelectScriptError):
        return {"class": "", "kind": type(error).__name__, "message": error_text(error)}
    kinds = (kind.__name__ for kind in type(error).__mro__ if kind.__name__ in _ERRORS)
    told: dict[str, Any] = {"class": next(kinds), "message": error.message}
    if error.text is not None and error.span is not None:
        told |= {"text": error.text, "span": [error.span.start, error.span.end]}
    if error.suggestions:
        told["suggestions"] = list(error.suggestions[:_MOST])
    if isinstance(error, SqlError):
        told |= {"final": error.is_final, "refused": error.is_refused}
    return told


def error_of(told: dict[str, Any]) -> SelectScriptError:
    """Returns the error that a worker tells of; of ssduck's own classes, or a SandboxError."""
    message, suggestions = told.get("message"), told.get("suggestions", [])
    text, span = told.get("text"), told.get("span", [0, 0])
    are_texts = all(isinstance(part, str) for part in (message, text or "", *suggestions))
    if not (are_texts and all(type(end) is int and end >= 0 for end in span)):
        raise InvalidAnswerError("this is no error")
    kind = _ERRORS.get(str(told.get("class")))
    if kind is None:
        name = str(told.get("kind"))[:MAX_MESSAGE_LENGTH]
        return SandboxError(f"the program failed in its sandbox: {name}: {message}")
    error = kind(str(message))
    error.text, error.span = text, None if text is None else SourceSpan(*span)
    error.suggestions = tuple(suggestions[:_MOST])
    if isinstance(error, SqlError):
        error.is_final, error.is_refused = bool(told.get("final")), bool(told.get("refused"))
    return error


def called_error(told: dict[str, Any]) -> Exception:
    """Returns the error that the host tells of, of a function of the user's."""
    if "kind" not in told:
        return error_of(told)
    kind: type[Exception] = type(told["kind"], (Exception,), {})
    return kind(told["message"])


class Log:
    """Keeps the warnings of a worker, and what its programs print, for the next answer."""

    def __init__(self) -> None:
        self._told: list[list[str]] = []
        sys.stdout = self._printed = io.StringIO()
        warnings.simplefilter("always")
        for kind in (DeprecationWarning, ImportWarning, ResourceWarning, PendingDeprecationWarning):
            warnings.simplefilter("ignore", kind)
        warnings.showwarning = self._keep  # type: ignore[assignment]  # it takes less

    def _keep(self, message: Warning | str, category: type[Warning], *_: Any) -> None:
        kinds = (kind.__name__ for kind in category.__mro__ if kind.__name__ in _WARNINGS)
        if len(self._told) < _MOST:
            self._told.append([next(kinds, "UserWarning"), str(message)[:MAX_MESSAGE_LENGTH]])

    def taken(self) -> list[list[str]]:
        """Returns the kinds and texts of all, and forgets them."""
        told, self._told = self._told, []
        if text := self._printed.getvalue():
            self._printed.seek(0)
            self._printed.truncate()
            more = "…\n" if len(text) > _MAX_PRINTED else ""
            told.append([_PRINTED, f"{text[:_MAX_PRINTED]}{more}"])
        return told


def tell(told: Sequence[Sequence[str]]) -> None:
    """Warns in the host of what a worker has warned of, and prints what it has printed."""
    for name, message in told[: _MOST + 1]:
        if name == _PRINTED:
            print(printable(message[: _MAX_PRINTED + 2], kept="\n\t"), end="")  # noqa: T201
            continue
        warn(str(message)[:MAX_MESSAGE_LENGTH], _WARNINGS.get(name, UserWarning))
