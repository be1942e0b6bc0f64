"""The limits of a program: time, rows, memory, depth, files, statements, `eval` and progress.

What a process that ssduck starts begins with is here, too.
"""

from __future__ import annotations

import json
import math
import sys
import time
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ssduck import validation
from ssduck.errors import ArgumentError, LimitError, nearest
from ssduck.formatting import joined_names, short_repr

# The time after which a program that does not end by itself is ended with its process, s.
GRACE = 2.0
# A record may take so long to be opened, however short the time of programs is, s.
LEAST_OPENING = 10.0
# The effects of a sandbox: what its process cannot do, by whatever mechanism the system gives.
EFFECTS = {
    "files": "read other files than the scene or record and the libraries, or write outside its "
    "scratch folder",
    "network": "open a socket",
    "processes": "start, read or change another process",
    "signals": "send a signal to another process",
    "memory": "take more memory than it may",
    "time": "outlive its host, or run on without end",
}
# The largest answer of a sandbox by default, bytes.
ANSWER_BYTES = 32 * 2**20
_now = time.monotonic


@dataclass(frozen=True)
class Limits:
    """The limits of each program, and of each call of `sql`.

    Attributes:
        seconds: the longest running time, s; None for no limit.
        rows: the largest number of rows of a query, and of combinations that Python evaluates.
        memory: the memory of DuckDB, and the size of the values that a program makes in Python,
            bytes.
        depth: the largest number of rows in a path of a hierarchical query.
        eval: whether programs may call `eval('text')`.
        files: whether SQL may read and write files, load extensions and change settings, and
            result forms may write files.
        select_only: whether SQL is one SELECT of tables and functions that compute values, ssduck's
            own or the user's, and of nothing that ssduck keeps for itself.
        progress: whether programs that take longer than a second show their progress on a terminal
            (on standard error) or in a notebook.
        require: what a sandbox must keep programs from, of `"files"`, `"network"`, `"processes"`,
            `"signals"`, `"memory"` and `"time"`; empty for programs that run in this process.
        answer_bytes: the largest size of an answer of a sandbox, bytes.
        readable: files and folders that a sandbox may read beside the scene's folder or the record,
            as those of meshes elsewhere.

    Raises:
        ArgumentError: a limit has an invalid value.

    >>> Limits(seconds=2).seconds
    2.0
    """

    seconds: float | None = None
    rows: int | None = None
    memory: int | None = None
    depth: int = 1000
    eval: bool = True
    files: bool = True
    select_only: bool = False
    progress: bool = True
    require: Collection[str] = ()
    answer_bytes: int = ANSWER_BYTES
    readable: Collection[str | Path] = ()

    def __post_init__(self) -> None:
        for name in ("seconds", "rows", "memory", "depth", "answer_bytes"):
            value = getattr(self, name)
            if value is None and name not in ("depth", "answer_bytes"):
                continue
            rule = f"limits: {name} must be more than 0"
            if name == "seconds":
                value = validation.number_above_0(value, rule, may_be_infinite=True)
            else:
                value = validation.integer_above_0(value, f"{rule}, and a whole number")
            object.__setattr__(self, name, value)
        for name in ("eval", "files", "select_only", "progress"):
            object.__setattr__(
                self, name, validation.boolean(getattr(self, name), f"limits: {name}")
            )
        object.__setattr__(self, "require", _checked_effects(self.require))
        if isinstance(self.readable, str):
            raise ArgumentError("limits: readable: give a list of paths")
        paths = (validation.path(one, "limits: readable") for one in self.readable)
        object.__setattr__(self, "readable", tuple(map(str, paths)))

    @property
    def is_sandboxed(self) -> bool:
        """Whether programs run in a sandbox."""
        return bool(self.require)

    @classmethod
    def strict(cls, **changes: Any) -> Limits:
        """Returns limits for untrusted programs, scenes and records.

        They are in a sandbox, a process that reads nothing else, writes nothing that stays, and
        has no network. 10 s, a million rows, 1 GB, no `eval`, no files. SQL may create what it
        likes in the process; without a sandbox (`require=()`), it is one SELECT.

        Args:
            changes: limits that differ from these. Where the system cannot keep a program from all
                that `require` names, opening the sandbox is an error, which says what is missing.
        """
        return cls(
            **{
                "seconds": 10.0,
                "rows": 1_000_000,
                "memory": 10**9,
                "eval": False,
                "files": False,
                "select_only": True,
                "require": tuple(EFFECTS),
                **changes,
            }
        )


def _checked_effects(names: Collection[str]) -> tuple[str, ...]:
    """Returns the names of effects in order."""
    if isinstance(names, str) or not isinstance(names, Collection):
        raise ArgumentError(f"limits: require: give a list of names, not {short_repr(names)}")
    for name in names:
        if name not in EFFECTS:
            raise ArgumentError(
                f"limits: require: there is no {short_repr(name)}; there are "
                f"{joined_names(list(EFFECTS))}",
                suggestions=nearest(name, EFFECTS),
            )
    return tuple(name for name in EFFECTS if name in names)


# -- processes --------------------------------------------------------------------------------

# Gives a process the path of its parent before it imports more than the standard library. The
# current folder, which may be a stranger's, is on it only if it is on the parent's.
_START = (
    "import json, sys; sys.path[:] = json.loads(sys.argv.pop(1)); from {module} import main; main()"
)


def python_command(module: str, *arguments: str, path: Sequence[str] | None = None) -> list[str]:
    """Returns the command of a new process of Python that runs the `main` of a module of ssduck.

    Args:
        module: the full name of the module.
        arguments: what `sys.argv` holds after its first element.
        path: where it looks for modules; by default where this process does.
    """
    listed = json.dumps(list(map(str, sys.path)) if path is None else list(path))
    return [sys.executable, "-P", "-c", _START.format(module=module), listed, *arguments]


class UsageMeter:
    """Measures how much of its limits a running program has used.

    Args:
        limits: the limits of the program.
        is_stopped: tells whether another thread has stopped the program; None if none can.

    Attributes:
        start: when the program started, by the monotonic clock, s.
        step: counts a step in Python: a row, a call, a part of a path. It raises a LimitError if
            the time is up, or the program was stopped.
    """

    def __init__(self, limits: Limits, is_stopped: Callable[[], bool] | None = None) -> None:
        self.limits = limits
        self.start = time.monotonic()
        self._is_stopped = is_stopped
        seconds = math.inf if limits.seconds is None and is_stopped is not None else limits.seconds
        self._deadline = None if seconds is None else self.start + seconds
        self._size = 0
        # From when on `check_time` is to be called: always if the program can be stopped.
        self._first_look = math.inf if self._deadline is None else self._deadline
        if is_stopped is not None:
            self._first_look = -math.inf
        self.step = _clock(self._deadline, limits.seconds, is_stopped)

    def charge(self, size: int) -> None:
        """Counts the size of a large value that the program has made in Python.

        Args:
            size: bytes, roughly.

        Raises:
            LimitError: all values that it has made take too much memory, or the time is up.
        """
        self._size += size
        maximum = self.limits.memory
        if maximum is not None and self._size > maximum:
            raise LimitError(f"the program makes values of more than {maximum:,} bytes")
        if _now() > self._first_look:
            self.step()

    def combination_counter(self) -> Callable[[], None]:
        """Returns a function to call for each combination of rows that Python evaluates.

        The function raises a LimitError if there are too many, or the time is up.
        """
        maximum, step = self.limits.rows, self.step
        if maximum is None:
            return step
        count, now, first_look = 0, _now, self._first_look

        def count_combination() -> None:
            nonlocal count
            count += 1
            if count > maximum:
                raise LimitError(f"a query looks at more than {maximum} rows")
            if now() > first_look:
                step()

        return count_combination

    def check_time(self) -> None:
        """Checks that there is time left.

        Raises:
            LimitError: the time is up, or the program was stopped.
        """
        self.step()

    @property
    def deadline(self) -> float | None:
        """When the time is up, by the monotonic clock, s; long ago if the program was stopped.

        None if neither is possible.
        """
        if self._is_stopped is not None and self._is_stopped():
            return -math.inf
        return self._deadline

    def check_rows(self, count: int) -> None:
        """Checks the number of rows of a query against the limit.

        Raises:
            LimitError: the query has more rows than the limit.
        """
        if self.limits.rows is not None and count > self.limits.rows:
            raise LimitError(f"a query has more than {self.limits.rows} rows")


def _clock(
    deadline: float | None, seconds: float | None, is_stopped: Callable[[], bool] | None
) -> Callable[[], None]:
    """Returns a function that raises a LimitError if there is no time left.

    It is called for each row: a method, with what it looks up, would take twice as long.

    Args:
        deadline: when the time is up, by the monotonic clock, s; None for never.
        seconds: how long the time is, s.
        is_stopped: tells whether another thread has stopped the program; None if none can.
    """
    if deadline is None:
        return _do_nothing
    now = _now

    def check() -> None:
        if now() > deadline:
            raise LimitError(f"the program took more than {seconds:g} s")

    def check_both() -> None:
        if is_stopped is not None and is_stopped():
            raise LimitError("the program was stopped")
        check()

    return check if is_stopped is None else check_both


def _do_nothing() -> None:
    return
