"""The lake of a process that is sealed already."""

from __future__ import annotations

from functools import partial
from typing import Any

import pyarrow as pa

from ssduck.lakes.lake import open_lake
from ssduck.limits import Limits


class SealedLake:
    """What the process of a sandbox asks: a lake, with the limits of what it is asked."""

    def __init__(self, path: str, limits: Limits) -> None:
        self._lake = lake = open_lake(path)
        options: dict[str, Any] = {"limits": limits, "processes": 1, "progress": False}
        self.ask = partial(lake.ask, **options)
        self.lint = partial(lake.lint, **options)
        self.score = partial(lake.score, **options)
        self.sql = lake.sql

    @property
    def episodes(self) -> pa.Table:
        """The episodes, as those of `Lake`."""
        return self._lake.episodes
