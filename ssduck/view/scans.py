"""Finds the recorded ticks at which the answer of a query changes.

The ticks are sampled first; between two samples with different answers, bisection finds a tick at
which the answer changes. So an answer that changes and changes back between two samples is missed,
unless the record has no more ticks than samples.
"""

from __future__ import annotations

import heapq
import json
import time
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np

from ssduck.adapters.display import as_json, display_table
from ssduck.adapters.grid_values import Grid
from ssduck.adapters.point_cloud import PointCloud
from ssduck.errors import SelectScriptError
from ssduck.interpreter.completion import Language
from ssduck.interpreter.interpreter import Interpreter
from ssduck.interpreter.program import value_to_show
from ssduck.interpreter.stopping import StopRequest
from ssduck.logic.why import Why
from ssduck.recording.replay.replayed_world import ReplayedWorld

SAMPLES = 200
MAX_EVALUATIONS = 1200
# Numbers that are equal to so many decimals are the same answer: millimetres.
DECIMALS = 3
_MAX_ROWS = 1000
# The answer of a program that fails at a tick.
_FAILED = -1


@dataclass(frozen=True)
class _Answer:
    """An answer at a tick: what tells it from others, and the number of its rows."""

    key: str
    count: int


@dataclass
class Scan:
    """A search for the changes of an answer."""

    ss: Interpreter
    world: ReplayedWorld
    text: str
    language: Language
    stop: StopRequest = field(default_factory=StopRequest)
    _known: dict[int, _Answer] = field(default_factory=dict)
    _gaps: list[tuple[int, int, int]] = field(default_factory=list)
    _evaluations: int = 0

    def __post_init__(self) -> None:
        # The last of several ticks of one time: `seek` goes there.
        times = self.world.ticker.record.ticks.times
        self._times = np.unique(times)
        count = len(self._times)
        samples = np.linspace(0, count - 1, min(count, SAMPLES)).astype(int)
        # Coarse samples first, so that a page soon has something to show.
        order = sorted(range(len(samples)), key=lambda place: -(place & -place or SAMPLES))
        self._samples = [int(samples[place]) for place in order][::-1]
        self._total = len(self._samples)

    def advance(self, seconds: float) -> bool:
        """Asks at further ticks for some time; returns whether there are more."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            if self._samples:
                self._ask(self._samples.pop())
                if not self._samples:
                    known = sorted(self._known)
                    for low, high in pairwise(known):
                        self._add_gap(low, high)
            elif self._gaps and self._evaluations < MAX_EVALUATIONS:
                _, low, high = heapq.heappop(self._gaps)
                middle = (low + high) // 2
                self._ask(middle)
                self._add_gap(low, middle)
                self._add_gap(middle, high)
            else:
                return False
        return True

    def _add_gap(self, low: int, high: int) -> None:
        if high - low > 1 and self._known[low].key != self._known[high].key:
            heapq.heappush(self._gaps, (low - high, low, high))

    def _ask(self, place: int) -> None:
        self._evaluations += 1
        self.world.seek(float(self._times[place]))
        try:
            with self.stop.applies_to(self.ss):
                value = value_to_show(self.ss, self.text, self.language)
            self._known[place] = _answer(value)
        except SelectScriptError:
            if not any(answer.count != _FAILED for answer in self._known.values()):
                raise
            self._known[place] = _Answer("", _FAILED)

    @property
    def progress(self) -> dict[str, Any]:
        """What is known so far: runs of equal answers [start, end, rows], s, and how complete."""
        runs: list[list[float]] = []
        last: str | None = None
        for place in sorted(self._known):
            answer, when = self._known[place], float(self._times[place])
            if runs:
                runs[-1][1] = when
            if answer.key != last:
                runs.append([when, when, answer.count])
                last = answer.key
        is_done = not self._samples and (not self._gaps or self._evaluations >= MAX_EVALUATIONS)
        return {
            "runs": runs,
            "done": is_done,
            "share": 1.0
            if is_done
            else len(self._known) / (len(self._known) + len(self._samples) + len(self._gaps) + 1),
            "exact": is_done and not self._gaps and len(self._times) <= SAMPLES,
            "all": is_done and not self._gaps,
        }


def _answer(value: Any) -> _Answer:
    if isinstance(value, Grid):
        return _Answer(value.cells.tobytes().hex(), int(value.cells.any()))
    if isinstance(value, PointCloud):
        return _Answer(np.round(value.points, DECIMALS).tobytes().hex(), len(value))
    if isinstance(value, Why):
        return _Answer(str(value.value), int(value.value is True))
    table = display_table(value)
    rows = [[_rounded(as_json(cell, words=True)) for cell in row] for row in table.rows[:_MAX_ROWS]]
    if len(rows) == len(table.columns) == 1 and rows[0][0] in (False, None):
        return _Answer(json.dumps(rows), 0)
    return _Answer(json.dumps(rows), len(table.rows))


def _rounded(value: Any) -> Any:
    if isinstance(value, float):
        return round(value, DECIMALS) + 0.0  # -0.0 is 0.0
    if isinstance(value, list):
        return [_rounded(part) for part in value]
    if isinstance(value, dict):
        return {key: _rounded(part) for key, part in value.items()}
    return value
