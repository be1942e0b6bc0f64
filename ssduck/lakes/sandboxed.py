"""A lake in a sandbox: strangers' records are listed and asked in a process that can do no harm."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path
from typing import Any, Self

import pyarrow as pa

from ssduck import validation
from ssduck.errors import UnsupportedError
from ssduck.limits import Limits
from ssduck.recording.paths import expand_path
from ssduck.sandbox.interpreter import SandboxedInterpreter
from ssduck.sandbox.sources import Source

# What the process of a question takes care of itself.
_ITS_OWN = ("engine", "processes", "batch", "resume", "options", "session", "limits", "progress")


class SandboxedLake:
    """The records below a folder, asked by a process that reads this folder and writes nothing.

    It has `episodes`, `ask`, `score`, `lint` and `sql` of `Lake`; one process answers, and no
    manifest is written.

    Args:
        path: a folder with records in it, or a record.
        limits: the limits of the question; `seconds` are those of each episode.

    Raises:
        UnsupportedError: the path is a pattern, or in an object store.
        RecordError: there is no such path.
    """

    def __init__(self, path: str | Path, limits: Limits) -> None:
        place = expand_path(validation.path(path, "lake: path"))
        if not isinstance(place, Path) or not place.exists():
            raise UnsupportedError(f"{path} is no folder or file, which a sandbox could read")
        self.path = str(place.absolute())
        self._limits, readable = limits, (self.path, str(place.resolve()))
        self._ss = SandboxedInterpreter(Source("lake", self.path, {}, readable), limits=limits)

    def close(self) -> None:
        """Ends the process."""
        self._ss.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @cached_property
    def episodes(self) -> pa.Table:
        """The episodes, as those of `Lake`."""
        return self._ask("episodes")

    def ask(self, program: str, where: str | None = None, **options: Any) -> pa.Table:
        """Returns the answer of each episode to a program, as `Lake.ask` does."""
        return self._ask("ask", program, where, **options)

    def score(self, *terms: Any, **options: Any) -> pa.Table:
        """Returns the score of each episode, as `Lake.score` does."""
        return self._ask("score", *terms, **options)

    def lint(self, condition: str, where: str | None = None, **options: Any) -> list[str]:
        """Tells of a condition that holds never, always, or at first, as `Lake.lint` does."""
        told: list[str] = self._ask("lint", condition, where, **options)
        return told

    def sql(self, program: str, where: str | None = None, dialect: str = "duckdb") -> str:
        """Returns one statement that answers a program of formulas, as `Lake.sql` does."""
        return str(self._ask("sql", program, where, dialect))

    def _ask(self, method: str, *arguments: Any, **options: Any) -> Any:
        for name in _ITS_OWN:
            if options.pop(name, None) not in (None, "local", True, 1):
                raise UnsupportedError(f"{method}: {name}: one process of a sandbox answers")
        seconds = 0.0
        if method in ("ask", "lint", "score"):
            seconds = len(self.episodes) * (self._limits.seconds or 0.0)
        return self._ss.ask(f"lake.{method}", *arguments, seconds=seconds, **options)


def check_in_process(limits: Limits | None, method: str) -> None:
    """Checks that no sandbox is asked for."""
    if limits is not None and limits.is_sandboxed:
        raise UnsupportedError(
            f"{method}: limits: not in a sandbox; ssduck.lake(path, limits=…).ask(…) is"
        )
