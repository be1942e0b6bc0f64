"""Runs a program on many recorded episodes with the same entities, one after the other.

The episodes of a batch are one record (`ssduck.recording.stores.episode_batch`), of which the world
sees those ticks that belong to the present episode. So shapes and plans are made once, and an
expression over time, as in `holds(near(gripper, cup, 0.02))`, is evaluated at the ticks of all
episodes by one statement.
"""

from __future__ import annotations

from collections.abc import Collection, Hashable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial

import numpy as np
import pyarrow as pa

from ssduck.errors import SelectScriptError
from ssduck.interpreter.interpreter import Interpreter
from ssduck.interpreter.over_time.functions import OF_VALUES, TEMPORAL_FUNCTIONS, parts_of
from ssduck.interpreter.over_time.series import ColumnsOf, TickColumns
from ssduck.language import ast
from ssduck.language.builtins import BUILTINS
from ssduck.language.intervals import RELATIONS_OF_INTERVALS
from ssduck.limits import Limits
from ssduck.recording.buffers import TickBuffer
from ssduck.recording.opened_record import OpenedRecord
from ssduck.recording.paths import expand_path
from ssduck.recording.replay.pair_answers import PairQueries
from ssduck.recording.replay.past import Past
from ssduck.recording.replay.record import Record
from ssduck.recording.replay.replayed_world import ReplayedWorld, ReplayTicker
from ssduck.recording.spec import Recording
from ssduck.recording.static_tables import geometries_of, members_of
from ssduck.recording.stores.base import PairRequest
from ssduck.recording.stores.episode_batch import (
    BatchedEpisode,
    DamagedEpisodeError,
    EpisodeBatch,
    model_table,
)
from ssduck.simulators.scenes import Camera


def reads_present(program: ast.Program) -> bool:
    """Checks whether a program may read more of the current tick than its number and its time.

    One that consists of functions of expressions over time, such as `holds(above(table, cup))`,
    reads the past only, where the current tick is one of the recorded ones.
    """
    return any(map(_reads_present, program.statements))


def _reads_present(node: ast.Node) -> bool:
    if isinstance(node, ast.Call):
        form = TEMPORAL_FUNCTIONS.get(node.name)
        if form is not None:
            _, other = parts_of(node)
            return other is not None and _reads_present(other)
        is_of_values = node.name in BUILTINS or node.name in RELATIONS_OF_INTERVALS
        if not is_of_values:
            return True
    elif not isinstance(node, OF_VALUES):
        return True
    return any(map(_reads_present, node.children()))


@contextmanager
def collected_doubts(interpreter: Interpreter) -> Iterator[Collection[str]]:
    """Yields what gets the probable mistakes of the programs inside, in place of warnings.

    It has each once, also if an earlier program had it, and at most so many as are shown.
    """
    execution = interpreter._execution  # noqa: SLF001  # one package
    doubts: dict[str, None] = {}
    execution.doubts = doubts
    try:
        yield doubts
    finally:
        execution.doubts = None


class BatchInterpreter:
    """An interpreter with the world of recorded episodes that have the same entities."""

    world: ReplayedWorld

    def __init__(
        self,
        world: str,
        recording: Recording,
        tables: Sequence[str],
        models: Mapping[str, pa.Table],
        run: int,
        limits: Limits | None,
        source: str,
        camera: Camera,
    ) -> None:
        self.interpreter = Interpreter(recording=None, limits=limits)
        self._execution = self.interpreter._execution  # noqa: SLF001  # a part of this package
        database = self.interpreter._database  # noqa: SLF001
        connection = database.connection
        for table, rows in models.items():
            connection.register(model_table(table), rows)
        self._archive = EpisodeBatch(
            recording,
            tables,
            models,
            run,
            connection.reader(OpenedRecord(expand_path(source))),
            connection.register,
        )
        self.parts = self._archive.parts  # the parts of the episodes that are asked now
        self._record = Record(
            None,
            TickBuffer(),
            members_of(models),
            self._archive.tables,
            self._archive.fetch,
            partial(self._archive.near_pairs, buffered=None),
            geometries_of(models),
            run,
            source=source,
            entities=self._archive.recording.entities,
        )
        self._name, self._camera = world, camera
        self._episodes: Sequence[BatchedEpisode] = ()
        self._present = 0
        self._offset = 0
        self._series: dict[Hashable, TickColumns | None] = {}
        self._least: dict[tuple[int, int], list[tuple[int, float] | None]] = {}
        self._execution.temporal.reader = self

    def load(self, episodes: Sequence[BatchedEpisode]) -> None:
        """Replaces the episodes.

        Their numbers of ticks are all larger than those of any episode before.
        """
        self._series.clear()
        self._least.clear()
        self._archive.load(episodes)
        self._episodes = episodes
        self._numbers = np.concatenate([episode.numbers for episode in episodes])
        self._times = np.concatenate([episode.times for episode in episodes])
        if not hasattr(self, "world"):
            self._record.ticks.replace(episodes[0].numbers, episodes[0].times)
            ticker = ReplayTicker(self._name, self._record)
            self.world = ReplayedWorld(ticker, (self._archive, self._record), self._camera)
            self.interpreter.add_variable(self._name, self.world)

    @contextmanager
    def episode(self, index: int, *, is_present_read: bool = True) -> Iterator[Interpreter]:
        """Yields the interpreter, with the world at the last tick of an episode.

        Variables that are set in the context are gone after it.
        """
        self._present = index
        episode = self._episodes[index]
        self.world.ticker.replace_ticks(episode.numbers, episode.times, is_read=is_present_read)
        before = dict(self._execution.variables)
        try:
            yield self.interpreter
        finally:
            self._execution.variables = before

    def columns(self, key: Hashable | None, past: Past, columns_of: ColumnsOf) -> TickColumns:
        """Returns the values of an expression over time, evaluated for all episodes at once."""
        if key is not None and key not in self._series:
            self._series[key] = self._columns_of_all(past, columns_of)
        of_all = None if key is None else self._series[key]
        if of_all is None:
            self._archive.show(self._present, self._present + 1)
            return columns_of(past)
        return of_all.between(past.first, past.last)

    def _columns_of_all(self, past: Past, columns_of: ColumnsOf) -> TickColumns | None:
        """Returns the values in all episodes; None if an episode has an error."""
        episode = self._episodes[self._present]
        ticks = self._record.ticks
        self._archive.show(0, len(self._episodes))
        ticks.replace(self._numbers, self._times)
        try:
            whole = Past(past.record, int(self._numbers[0]), int(self._numbers[-1]), is_window=True)
            return columns_of(whole)
        except DamagedEpisodeError:
            raise
        except SelectScriptError:
            return None
        finally:
            ticks.replace(episode.numbers, episode.times)

    def least_clearance(self, past: Past, a: int, b: int) -> tuple[int, float] | None:
        """Returns the least clearance of two entities, found for all episodes at once."""
        episode = self._episodes[self._present]
        queries = PairQueries(self._record, self._execution.meter)
        if past.first != episode.numbers[0] or past.last != episode.numbers[-1]:
            request = PairRequest(past.first, past.last, a, b, 0.0)
            return queries.least_clearances(request, np.array([past.first]))[0]
        key = min(a, b), max(a, b)
        if key not in self._least:
            first, last = int(self._numbers[0]), int(self._numbers[-1])
            starts = np.array([one.numbers[0] for one in self._episodes])
            request = PairRequest(first, last, a, b, 0.0)
            self._least[key] = queries.least_clearances(request, starts)
        return self._least[key][self._present]

    def forget(self) -> None:
        """Forgets the rows of the episodes, which are not asked any more."""
        self._archive.forget()

    def close(self) -> None:
        """Closes the interpreter."""
        self.interpreter.close()
