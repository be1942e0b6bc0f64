"""Runs inputs and reports outcomes that should not happen."""

from __future__ import annotations

import contextlib
import time
import traceback
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tools.fuzzing.environment import (
    CORRECT,
    functions_of_inputs,
    variables_of_inputs,
    world_of_inputs,
)
from tools.fuzzing.mutation import Input

# The seconds after which an input is slow; an interpreter limits its queries to 2 s.
SLOW = 6.0
# The number of inputs of an interpreter, which caches their plans.
LIFETIME = 4000


@dataclass(frozen=True)
class Finding:
    """An outcome that should not happen.

    Attributes:
        number: the number of the input.
        input: the input.
        kind: a line that describes the outcome.
        cause: the place in the code; findings of one kind and cause count as one.
        trace: details.
    """

    number: int
    input: Input
    kind: str
    cause: str = ""
    trace: str = ""

    def __str__(self) -> str:
        kind = "sql" if self.input.is_sql else "program"
        text = shortened(ascii(self.input.text), 1500)
        return f"#{self.number} {self.kind} [{self.cause}]\n  {kind}: {text}"


def shortened(text: str, limit: int) -> str:
    return text if len(text) <= limit else f"{text[: limit // 2]} ... {text[-limit // 2 :]}"


class Bench:
    """Runs inputs one after another in interpreters on one world."""

    def __init__(self) -> None:
        self._world = world_of_inputs()
        self._run_count = 0
        self._error_count = 0
        self._ss: Any = None

    def check(self, tested: Input) -> tuple[str, str, str] | None:
        """Runs an input; returns the kind, cause and trace of an error in its outcome."""
        if self._ss is None or self._run_count >= LIFETIME:
            self._begin()
        self._run_count += 1
        started = time.monotonic()
        fault = self._fault_of(tested)
        seconds = time.monotonic() - started
        if fault is None and seconds > SLOW:
            fault = ("slow", "", f"{seconds:.1f} s")
        if fault is not None:
            self._begin()
        return fault

    def error_of(self, tested: Input) -> Exception | None:
        """Returns the `SelectScriptError` of an input; None if it has a value."""
        if self._ss is None:
            self._begin()
        try:
            return self._error_of(tested)
        finally:
            self._ss._execution.variables = dict(self._before)  # noqa: SLF001  # each input anew

    def _error_of(self, tested: Input) -> Exception | None:
        from ssduck import SelectScriptError

        try:
            _ = self._ss.sql(tested.text) if tested.is_sql else self._ss.eval(tested.text)
        except SelectScriptError as error:
            return error
        return None

    def _begin(self) -> None:
        from ssduck import Interpreter, Limits

        if self._ss is not None:
            self._ss.close()
        limits = Limits(seconds=2, rows=100_000, memory=2 * 10**8, files=False)
        self._ss = ss = Interpreter(limits=limits)
        ss.add_variable("room", self._world)
        ss.add_variable("cup", self._world["cup"])
        ss.add_variable("shelf", self._world["shelf"])
        for name, value in variables_of_inputs().items():
            ss.add_variable(name, value)
        for name, function in functions_of_inputs().items():
            ss.add_function(name, function)
        self._before: Mapping[str, Any] = dict(ss._execution.variables)  # noqa: SLF001  # to compare with
        self._values = self._mutable_values()
        self._run_count = 0

    def _mutable_values(self) -> str:
        return repr([v for v in self._before.values() if isinstance(v, list | dict)])

    def _fault_of(self, tested: Input) -> tuple[str, str, str] | None:
        try:
            error = self._error_of(tested)
            return (self._check_error(error) if error else None) or self._check_values()
        except BaseException as caught:  # noqa: BLE001  # every exception is a finding
            return _fault_from("raises", caught)
        finally:
            self._ss._execution.variables = dict(self._before)  # noqa: SLF001  # each input anew

    def _check_error(self, error: Any) -> tuple[str, str, str] | None:
        try:
            message = str(error)
        except Exception as caught:  # noqa: BLE001  # every exception is a finding
            return _fault_from("str(error) raises", caught)
        text, span = error.text, error.span
        # An error at the end of the text underlines one letter behind it.
        if text is not None and span is not None:
            end = len(text) + 1
            if not 0 <= span.start <= span.end <= end:
                return (
                    "span outside the text",
                    type(error).__name__,
                    f"{span} of {len(text)}: {message}",
                )
        variables = self._ss._execution.variables  # noqa: SLF001  # to compare with
        if variables.keys() != self._before.keys():
            return ("names changed", "", str(variables.keys() ^ self._before.keys()))
        for name, value in variables.items():
            if value is not self._before[name]:
                return ("value replaced", name, repr(value))
        return self._check_next(error)

    def _check_next(self, error: Any) -> tuple[str, str, str] | None:
        """Checks a correct query, but seldom after errors of the parser, which are frequent."""
        from ssduck.errors import ParseError

        self._error_count += 1
        if isinstance(error, ParseError) and self._error_count % 50:
            return None
        program, expected = CORRECT[self._error_count % len(CORRECT)]
        try:
            value = self._ss.eval(program)
        except BaseException as caught:  # noqa: BLE001  # every exception is a finding
            kind, cause, trace = _fault_from("the next query raises", caught)
            return (kind, cause, f"{program}\n{trace}")
        return None if value == expected else ("the next query is wrong", program, repr(value))

    def _check_values(self) -> tuple[str, str, str] | None:
        values = self._mutable_values()
        return None if values == self._values else ("values changed", "", values)


def _fault_from(event: str, error: BaseException) -> tuple[str, str, str]:
    frames = traceback.extract_tb(error.__traceback__)
    ours = [frame for frame in frames if "/ssduck/" in frame.filename] or list(frames)
    places = [f"{Path(f.filename).name}:{f.lineno} {f.name}" for f in ours[-2:]]
    with contextlib.suppress(Exception):
        kind = f"{event} {type(error).__name__}"
        return (kind, " < ".join(reversed(places)), shortened(f"{error}", 400))
    return (f"{event} {type(error).__name__}", " < ".join(reversed(places)), "")
