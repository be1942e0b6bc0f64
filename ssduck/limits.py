"""What a program may use: time, rows, memory, depth, files and `eval`."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from ssduck import validation
from ssduck.errors import LimitError

# So many rows, calls or paths are counted before the clock is looked at.
_STRIDE = 8


@dataclass(frozen=True)
class Limits:
    """What a program may use; each program, each `sql` anew.

    Attributes:
        seconds: how long it may run; None for no end.
        rows: how many rows a query may yield, and how many combinations Python may look at.
        memory: what DuckDB may use, in bytes.
        depth: how many rows a path of a hierarchical query may have.
        eval: whether `eval('text')` may be called.
        files: whether SQL may read and write files, load extensions and change settings, and
            result forms may write files.
    """

    seconds: float | None = None
    rows: int | None = None
    memory: int | None = None
    depth: int = 1000
    eval: bool = True
    files: bool = True

    def __post_init__(self) -> None:
        for name in ("seconds", "rows", "memory", "depth"):
            value = getattr(self, name)
            if value is None and name != "depth":
                continue
            rule = f"limits: {name} is to be more than 0"
            if name == "seconds":
                value = validation.number_above_0(value, rule, may_be_infinite=True)
            else:
                value = validation.integer_above_0(value, f"{rule}, and a whole number")
            object.__setattr__(self, name, value)
        for name in ("eval", "files"):
            object.__setattr__(
                self, name, validation.boolean(getattr(self, name), f"limits: {name}")
            )

    @classmethod
    def strict(cls, **changes: Any) -> Limits:
        """For programs from elsewhere: 10 s, a million rows, 1 GB, no `eval`, no files."""
        return cls(
            **{
                "seconds": 10.0,
                "rows": 1_000_000,
                "memory": 10**9,
                "eval": False,
                "files": False,
                **changes,
            }
        )


class UsageMeter:
    """How much of its limits a running program has used.

    Args:
        limits: what it may use.
    """

    def __init__(self, limits: Limits) -> None:
        self.limits = limits
        self._ends = None if limits.seconds is None else time.monotonic() + limits.seconds
        self._steps = 0

    def step(self) -> None:
        """Count a step of Python's: a row, a call, a part of a path.

        Raises:
            LimitError: the time is up.
        """
        self._steps += 1
        if self._ends is not None and self._steps % _STRIDE == 0:
            self.check_time()

    def looks(self) -> Callable[[], None]:
        """What one query calls at each combination of its sources that Python looks at.

        It raises a LimitError if there are too many, or the time is up.
        """
        most = self.limits.rows
        if most is None:
            return self.step
        looked = 0

        def look() -> None:
            nonlocal looked
            looked += 1
            if looked > most:
                raise LimitError(f"a query looks at more than {most} rows")
            self.step()

        return look

    def check_time(self) -> None:
        """Look at the clock.

        Raises:
            LimitError: the time is up.
        """
        if self._ends is not None and time.monotonic() > self._ends:
            raise LimitError(f"the program took more than {self.limits.seconds:g} s")

    @property
    def remaining(self) -> float | None:
        """Seconds that are left, not less than 0; None for no end."""
        return None if self._ends is None else max(0.0, self._ends - time.monotonic())

    def check_rows(self, count: int) -> None:
        """Complain of too many rows.

        Raises:
            LimitError: there are more than the limits allow.
        """
        if self.limits.rows is not None and count > self.limits.rows:
            raise LimitError(f"a query has more than {self.limits.rows} rows")
