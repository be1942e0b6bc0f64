"""The lake of a process that is sealed already."""

from __future__ import annotations

from typing import Any

import pyarrow as pa

from ssduck.lakes.lake import open_lake
from ssduck.limits import Limits


class SealedLake:
    """What the process of a sandbox asks: a lake, with the limits of what it is asked."""

    def __init__(self, path: str, limits: Limits) -> None:
        self._lake = open_lake(path)
        self._options: dict[str, Any] = {"limits": limits, "processes": 1, "progress": False}
        self.sql = self._lake.sql

    @property
    def episodes(self) -> pa.Table:
        """The episodes, as those of `Lake`."""
        return self._lake.episodes

    def ask(self, *arguments: Any, **options: Any) -> pa.Table:
        """Returns the answer of each episode to a program, as `Lake.ask` does."""
        return self._lake.ask(*arguments, **{**options, **self._options})

    def lint(self, *arguments: Any, **options: Any) -> list[str]:
        """Tells of a condition, as `Lake.lint` does."""
        return self._lake.lint(*arguments, **{**options, **self._options})

    def score(self, *terms: Any, **options: Any) -> pa.Table:
        """Returns the score of each episode, as `Lake.score` does."""
        return self._lake.score(*terms, **{**options, **self._options})
