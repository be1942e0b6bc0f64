"""Answers questions about pairs of entities at many recorded ticks, each answer computed once."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import numpy as np
import pyarrow as pa

from ssduck.geometry.arrays import Array, Flags, Indices
from ssduck.geometry.pair_batch import PairQuestion
from ssduck.limits import UsageMeter
from ssduck.recording.replay.batch_queries import Ids, PairSide
from ssduck.recording.replay.progress import task
from ssduck.recording.replay.record import Record, Ticks
from ssduck.recording.stores.base import PairRequest
from ssduck.schema import POSE


@dataclass(frozen=True, eq=False)
class PairAnswers:
    """Answers about n pairs of entities."""

    ticks: Ticks  # (n,), the tick of each pair
    first: Ids  # (n,), the ids of the first entities
    second: Ids  # (n,), the ids of the second entities
    values: Array  # (n,), the answers: numbers; 1 for True, 0 for False, NaN for unknown


class PairQueries:
    """The questions about pairs of entities of a record."""

    def __init__(self, record: Record, meter: UsageMeter) -> None:
        self._record = record
        self._meter = meter
        self._cache = record.answer_cache

    def answers(
        self, request: PairRequest, question: PairQuestion, among: Ticks | None = None
    ) -> PairAnswers:
        """Returns the answers about the pairs of entities whose boxes are near."""
        margins = self._record.margins if question.uses_margins else 0.0
        gap = request.max_gap + question.max_gap + margins
        rows = self._record.near_pairs(replace(request, max_gap=gap))
        if among is not None:
            rows = rows.filter(pa.array(np.isin(rows["tick"].to_numpy(), among)))
        ticks, first, second = (rows[name].to_numpy() for name in ("tick", "a", "b"))
        values = np.zeros(len(ticks))
        is_cached = np.zeros(len(ticks), dtype=bool)
        pairs = list(_rows_of_pairs(first, second, is_symmetric=question.is_symmetric))
        for a, b, members in pairs:
            values[members], is_cached[members] = self._cache.look_up(
                (question, a, b), ticks[members]
            )
        missing = ~is_cached
        if question.is_symmetric and not (request.a or request.b):  # both orders are there
            missing &= first < second
        if missing.any():
            values[missing] = self._computed(rows, np.flatnonzero(missing), question)
            first_kept = int(self._record.ticks.numbers[0])
            for a, b, members in pairs:
                new = members[missing[members]]
                if not len(new):
                    continue
                self._cache.add((question, a, b), ticks[new], values[new], first_kept)
                others = members[~missing[members] & ~is_cached[members]]
                values[others] = values[new][np.searchsorted(ticks[new], ticks[others])]
        return PairAnswers(ticks, first, second, values)

    def least_clearances(
        self, request: PairRequest, starts: Ticks
    ) -> list[tuple[int, float] | None]:
        """Returns the least clearance of two entities in each of some ranges of ticks."""
        question = PairQuestion("clearance")
        rows = self._record.near_pairs(replace(request, max_gap=question.max_gap))
        ticks = rows["tick"].to_numpy()
        if not len(ticks):
            return [None] * len(starts)
        groups = np.searchsorted(starts, ticks, side="right") - 1
        first, second = self._sides(rows, question)
        with task(self._meter, "comparing shapes at recorded ticks", len(ticks)) as advance:
            values = self._record.entity_shapes.answers(
                first, second, question, self._record.calls, advance, groups
            ).values
        values = np.where(np.isnan(values), np.inf, values)
        ends = np.searchsorted(groups, np.arange(len(starts) + 1))
        found: list[tuple[int, float] | None] = []
        for start, end in pairwise(ends.tolist()):
            place = start + int(np.argmin(values[start:end])) if end > start else -1
            is_known = place >= 0 and values[place] < np.inf
            found.append((int(ticks[place]), float(values[place])) if is_known else None)
        return found

    def _sides(self, rows: pa.Table, question: PairQuestion) -> tuple[PairSide, PairSide]:
        """Returns the two entities of each of some rows of near pairs."""
        ticks, ids = rows["tick"].to_numpy(), [rows[side].to_numpy() for side in "ab"]
        poses = [_columns(rows, side, POSE) for side in "ab"]
        if question.is_symmetric:  # as at the current tick: rounding errors depend on the order
            is_turned = ids[0] > ids[1]
            ids = [np.where(is_turned, *order) for order in (ids[::-1], ids)]
            turned = is_turned[:, np.newaxis]
            poses = [np.where(turned, *order) for order in (poses[::-1], poses)]
        link_poses = partial(self._record.link_poses, ticks)
        return PairSide(ids[0], poses[0], link_poses), PairSide(ids[1], poses[1], link_poses)

    def _computed(self, rows: pa.Table, selected: Indices, question: PairQuestion) -> Array:
        """Returns the answers for some rows of near pairs."""
        if len(selected) < rows.num_rows:
            rows = rows.take(pa.array(selected))
        ticks = rows["tick"].to_numpy()
        first, second = self._sides(rows, question)
        with task(self._meter, "comparing shapes at recorded ticks", len(ticks)) as advance:
            answers = self._record.entity_shapes.answers(
                first, second, question, self._record.calls, advance
            )
        values, is_open = answers.values, answers.is_open
        if question.kind == "resting":
            for a, b, members in _rows_of_pairs(first.ids, second.ids, is_symmetric=False):
                known = members[is_open[members]]
                values[known] = self._are_resting(ticks[known], a, b)
            return values
        for row in np.flatnonzero(is_open).tolist():
            place = int(ticks[row]), int(first.ids[row]), int(second.ids[row])
            values[row] = self._single(question, *place)
            self._meter.check_time()
        return values

    def _single(self, question: PairQuestion, tick: int, a: int, b: int) -> float:
        """Returns the answer about one pair, by the queries of its tick."""
        shapes = self._record.shapes(tick)
        answer = shapes.supports(a, b) if question.kind == "supports" else shapes.on(a, b)
        return float("nan") if answer is None else float(answer)

    def _are_resting(self, ticks: Ticks, a: int, b: int) -> Flags:
        """Returns whether b rests on a, at some ticks, by a search down from b."""
        resting: set[int] = set()
        pending = {b: set(ticks.tolist())}
        seen = {(tick, b) for tick in pending[b]}
        while pending:
            upper, remaining = pending.popitem()
            resting.update(tick for tick, _ in self._below(upper, remaining - resting, a))
            for tick, lower in self._below(upper, remaining - resting):
                if (tick, lower) not in seen:
                    seen.add((tick, lower))
                    pending.setdefault(lower, set()).add(tick)
        are_resting: Flags = np.isin(ticks, list(resting))
        return are_resting

    def _below(self, upper: int, ticks: set[int], lower: int = 0) -> list[tuple[int, int]]:
        """Returns the ticks at which an entity is on another one or any, each with the other."""
        if not ticks:
            return []
        request = PairRequest(min(ticks), max(ticks), lower, upper, 0.0)
        among = np.array(sorted(ticks), dtype=np.int64)
        found = self.answers(request, PairQuestion("on"), among)
        is_on = found.values == 1.0
        return list(zip(found.ticks[is_on].tolist(), found.first[is_on].tolist(), strict=True))


def _rows_of_pairs(
    first: Ids, second: Ids, *, is_symmetric: bool
) -> Iterator[tuple[int, int, Indices]]:
    """Yields the distinct pairs with their rows; of a symmetric question in either order."""
    if is_symmetric:
        first, second = np.minimum(first, second), np.maximum(first, second)
    if len(first) and (first == first[0]).all() and (second == second[0]).all():
        yield int(first[0]), int(second[0]), np.arange(len(first))
        return
    order = np.lexsort((second, first))
    first, second = first[order], second[order]
    is_start = (np.diff(first, prepend=-1) != 0) | (np.diff(second, prepend=-1) != 0)
    for start, end in pairwise([*np.flatnonzero(is_start).tolist(), len(order)]):
        yield int(first[start]), int(second[start]), order[start:end]


def _columns(rows: pa.Table, side: str, names: tuple[str, ...]) -> Array:
    """Returns columns of one of two entities, (rows, names)."""
    columns = [_numbers(rows[f"{side}_{name}"]) for name in names]
    return np.array(columns).reshape(len(names), rows.num_rows).T


def _numbers(column: pa.ChunkedArray) -> Array:
    """Returns a column of numbers; NaN for unknown ones."""
    return np.asarray(column.to_numpy(), dtype=np.float64)
