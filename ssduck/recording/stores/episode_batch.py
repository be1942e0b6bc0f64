"""Reads many episodes with the same entities as one: an archive of a batch of episodes.

The ticks of an episode are moved by an offset, so that those of no two episodes are equal. SQL
reads the files of all episodes at once, or those of one: the views name variables of DuckDB, which
`EpisodeBatch.show` sets. A file is read only if its bytes have the checksum that its episode has in
a manifest.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.parquet as pq
from sqlglot import exp

from ssduck.errors import RecordError
from ssduck.geometry.arrays import Array
from ssduck.recording.buffers import TickBuffer
from ssduck.recording.spec import Recording
from ssduck.recording.static_tables import members_of
from ssduck.recording.stores.base import (
    BufferViews,
    PairRequest,
    RowBlock,
    StoreConnection,
    TickArchive,
)
from ssduck.recording.stores.checksums import footer_in
from ssduck.recording.stores.history_sql import near_pair_rows, quoted
from ssduck.recording.stores.object_store import ObjectPath, is_address
from ssduck.recording.stores.parquet_archive import (
    arrow_types,
    multi_link_bodies,
    pattern_of,
)
from ssduck.recording.stores.parquet_layout import OTHER_PART
from ssduck.recording.stores.row_checks import TABLES_OF_BODIES, RowChecks, key_types
from ssduck.recording.stores.stored_columns import check_parquet
from ssduck.schema import MODELS, TABLES

_OLDER = "a part of an older record is read by itself"
# The column in which the parts have the number of the run.
_RUN = "run"
# The largest number of checked parts that are remembered.
MAX_CHECKED = 20_000


@dataclass(frozen=True)
class BatchedFile:
    """A file of a part.

    Attributes:
        path: where it is.
        checksum: the CRC-32 of its bytes.
        label: what its footer has to tell it from other parts.
        table: its table, or `models/<table>`.
    """

    path: str
    checksum: int
    label: bytes
    table: str

    def content(self) -> bytes:
        """Returns the bytes of the file.

        Raises:
            OSError: it cannot be read.
            RecordError: they are not those that the manifest knows, or those of another part.
        """
        if is_address(self.path):
            content = ObjectPath(self.path).read_bytes()
        else:
            with open(self.path, "rb", buffering=0) as file:  # noqa: PTH123  # faster than a Path
                content = file.readall()
        if zlib.crc32(content) != self.checksum:
            raise RecordError(f"{self.path} was changed or damaged since the manifest was made")
        if self.label not in footer_in(content):
            raise RecordError(f"{self.path} {OTHER_PART}")
        return content

    def rows(self, content: bytes, columns: list[str] | None = None) -> pa.Table:
        """Returns the rows of the file, of some columns or of all.

        Args:
            content: its bytes.
            columns: the names of the columns; None for all.

        Raises:
            RecordError: it lacks columns of the table, or claims more rows than a part has.
        """
        metadata = check_parquet(self.path, footer_in(content), self.table)
        part = pq.ParquetFile(pa.BufferReader(content), metadata=metadata)
        return part.read(columns, use_threads=False)

    def keys(self, content: bytes) -> pa.Table:
        """Returns the columns of the rows that are checked.

        Raises:
            RecordError: an older record lacks some of them.
        """
        names = key_types(self.table).names
        rows = self.rows(content, names)
        if not set(names) <= set(rows.column_names):
            raise RecordError(_OLDER)
        return rows.select(names)

    def check(
        self, content: bytes, checks: RowChecks, ticks: TickBuffer, between: tuple[int, int]
    ) -> None:
        """Checks the rows of the file, except that the bodies with parts are those that are there.

        Args:
            content: its bytes.
            checks: checks the rows.
            ticks: the ticks of the episode.
            between: the first and the last tick of the part.

        Raises:
            RecordError: they are of unknown ticks, entities or links, twice there, or incomplete.
        """
        block = RowBlock(*between, self.keys(content))
        self.require(checks.problem_of_block(self.table, block, ticks))

    def require(self, problem: str | None) -> None:
        """Raises a RecordError if there is a problem with the rows."""
        if problem is not None:
            raise RecordError(f"{self.path} is damaged: of the rows of {self.table}, {problem}")


@dataclass(frozen=True)
class BatchedEpisode:
    """An episode of a batch.

    Attributes:
        offset: is added to the numbers of its ticks.
        ticks: the rows of its ticks: `tick`, without the offset, `time` and `wall_time`.
        files: the files of its parts, by table.
        starts: the first tick of each part, without the offset.
        checked: the tables whose bytes and rows were checked a moment ago.
    """

    offset: int
    ticks: pa.Table
    files: Mapping[str, Sequence[BatchedFile]]
    starts: Sequence[int]
    checked: frozenset[str] = frozenset()

    @cached_property
    def numbers(self) -> npt.NDArray[np.int64]:
        """The numbers of its ticks in the batch, (n,)."""
        numbers: npt.NDArray[np.int64] = self.ticks["tick"].to_numpy() + self.offset
        return numbers

    def key_of(self, file: BatchedFile) -> tuple[BatchedFile, tuple[BatchedFile, ...]]:
        """Returns what decides whether the rows of a file are right in the episode."""
        return file, (*self.files["ticks"], *self.files["entities"])

    @cached_property
    def tick_buffer(self) -> TickBuffer:
        """Its ticks, without the offset."""
        return TickBuffer.from_arrays(self.ticks["tick"].to_numpy(), self.times)

    def ticks_of_part(self, number: int) -> tuple[int, int]:
        """Returns the first and the last tick of a part, without the offset."""
        ends = [*self.starts[1:], int(self.tick_buffer.numbers[-1]) + 1]
        return self.starts[number], ends[number] - 1

    @cached_property
    def times(self) -> Array:
        """Their simulated times, s, (n,)."""
        times: Array = self.ticks["time"].to_numpy()
        return times


class DamagedEpisodeError(RecordError):
    """A file of an episode of a batch is missing or damaged.

    Attributes:
        index: the index of the episode.
    """

    def __init__(self, message: str, index: int) -> None:
        super().__init__(message)
        self.index = index


class EpisodeBatch(TickArchive):
    """The ticks of episodes with the same entities and tables.

    Args:
        recording: what was recorded of each tick.
        tables: the tables, `ticks` among them.
        models: the rows of each model.
        run: the number of the run, which all rows get.
        connection: the archive's own connection, which reads the files.
        run_statement: runs a statement on the connection that has the views.

    Attributes:
        checks: checks rows against the models.
    """

    def __init__(
        self,
        recording: Recording,
        tables: Sequence[str],
        models: Mapping[str, pa.Table],
        run: int,
        connection: StoreConnection,
        run_statement: Callable[[str], None],
    ) -> None:
        self.recording = recording
        self.tables = tuple(tables)
        self._run = run
        self._models = models
        self._linked = multi_link_bodies(models["entities"])
        self.checks = RowChecks(members_of(models))
        self._connection, self._run_statement = connection, run_statement
        self._episodes: Sequence[BatchedEpisode] = ()
        self._starts = np.zeros(0, dtype=np.int64)
        # The tables that SQL or Python has read: their files are checked when a batch is loaded.
        self._read: set[str] = {"entities"}
        self._in_sql: set[str] = set()
        # The parts whose rows are right, with the files of the ticks and entities of the episode.
        self._checked: set[tuple[BatchedFile, tuple[BatchedFile, ...]]] = set()
        self._shown: tuple[int, int] | None = None

    def load(self, episodes: Sequence[BatchedEpisode]) -> None:
        """Replaces the episodes.

        Args:
            episodes: the episodes; their numbers of ticks ascend.

        Raises:
            DamagedEpisodeError: a file of an episode is damaged or missing.
        """
        self._episodes = episodes
        self._starts = np.array([episode.numbers[0] for episode in episodes], dtype=np.int64)
        if len(self._checked) > MAX_CHECKED:
            self._checked.clear()
        for table in sorted(self._read):
            self._check(table, is_loading=True)
        self._shown = None
        self.show(0, len(episodes))

    def show(self, first: int, end: int) -> None:
        """Lets SQL see the episodes from `first` to `end - 1` only."""
        if (first, end) != self._shown:
            self._shown = first, end
            for table in self._in_sql:
                self._set_variables(table)

    def _check(self, table: str, *, is_loading: bool = False) -> None:
        """Checks the files of a table; of episodes being loaded, those that were not yet."""
        for index, episode in enumerate(self._episodes):
            if is_loading and table in episode.checked:
                self._checked.update(map(episode.key_of, episode.files[table]))
                continue
            for number in range(len(episode.files[table])):
                self._content(table, number, index)

    def _content(self, table: str, number: int, index: int) -> bytes:
        """Returns the bytes of a file of an episode, whose rows are right.

        Moved by its offset, a row of another tick might be one of another episode.

        Args:
            table: the table.
            number: the number of the part.
            index: the index of the episode.

        Raises:
            DamagedEpisodeError: the file is missing or damaged, or a row is wrong.
        """
        episode = self._episodes[index]
        file = episode.files[table][number]
        try:
            content = file.content()
            key = episode.key_of(file)
            if table != "ticks" and key not in self._checked:
                file.check(content, self.checks, episode.tick_buffer, episode.ticks_of_part(number))
                if table in TABLES_OF_BODIES:
                    self._check_bodies(file, content, self._content("entities", number, index))
                self._checked.add(key)
        except DamagedEpisodeError:
            raise
        except RecordError as error:
            raise DamagedEpisodeError(error.message, index) from error
        except (OSError, pa.ArrowException) as error:
            raise DamagedEpisodeError(f"{file.path} cannot be read: {error}", index) from error
        return content

    def _check_bodies(self, file: BatchedFile, content: bytes, entities: bytes) -> None:
        """Checks that the bodies with parts in a file are those in the file of entities."""
        bodies = replace(file, table="entities").keys(entities)
        rows = file.keys(content)
        file.require(self.checks.problem_of_bodies(file.table, rows, bodies, single=True))

    # -- SQL --------------------------------------------------------------------------------

    def select(self, table: str, buffer_views: BufferViews | None) -> str | None:  # noqa: ARG002
        """Returns the SELECT of the view of a table's history; None if it is not recorded."""
        if table not in self.tables:
            return None
        if table not in self._read:
            self._read.add(table)
            self._check(table)
        self._in_sql.add(table)
        self._set_variables(table)
        files, offsets = (f"getvariable({_text(name)})" for name in _variables(table))
        moved = f"(tick + list_extract({offsets}, file_index::BIGINT + 1))::BIGINT"
        special = {"tick": f"{moved} AS tick", _RUN: f"{self._run:d}::BIGINT AS {_RUN}"}
        columns = ", ".join(
            special.get(column.name, quoted(column.name)) for column in TABLES[table].columns
        )
        return f"SELECT {columns} FROM read_parquet({files}, hive_partitioning = false)"  # noqa: S608

    def _set_variables(self, table: str) -> None:
        """Sets the files of a table that SQL reads, and the offsets of their ticks."""
        shown = self._episodes[slice(*(self._shown or (0, len(self._episodes))))]
        paths = [(pattern_of(f.path), e.offset) for e in shown for f in e.files[table]]
        files = exp.Array(expressions=[exp.Literal.string(path) for path, _ in paths]).sql("duckdb")
        offsets = ", ".join(str(int(offset)) for _, offset in paths)
        names = [quoted(name) for name in _variables(table)]
        self._run_statement(f"SET VARIABLE {names[0]} = {files}::VARCHAR[]")
        self._run_statement(f"SET VARIABLE {names[1]} = [{offsets}]::BIGINT[]")

    def models(self) -> dict[str, str]:
        """Returns the SELECT of the view of each model, by the name of the view."""
        # They are registered with the connection, as tables in memory.
        return {
            table.model_view: f"SELECT * FROM {quoted(model_table(table.name))}"  # noqa: S608
            for table in MODELS.values()
        }

    def model_rows(self) -> Mapping[str, pa.Table]:
        """Returns the rows of each model, by the name of its table."""
        return self._models

    # -- rows -------------------------------------------------------------------------------

    def fetch(self, table: str, first: int, last: int) -> pa.Table:
        """Returns the rows of a table at the ticks from first to last."""
        types = arrow_types(table)
        if table == "links" and not len(self._linked):
            return types.empty_table()
        begin = max(int(np.searchsorted(self._starts, first, side="right")) - 1, 0)
        end = int(np.searchsorted(self._starts, last, side="right"))
        parts = (
            [
                _moved(e.ticks.select(types.names), types, e.offset, first, last)
                for e in self._episodes[begin:end]
            ]
            if table == "ticks"
            else [
                _rows(
                    file,
                    self._content(table, number, index),
                    types,
                    self._episodes[index].offset,
                    first,
                    last,
                )
                for index in range(begin, end)
                for number, file in enumerate(self._episodes[index].files[table])
            ]
        )
        rows = parts[0] if len(parts) == 1 else pa.concat_tables([types.empty_table(), *parts])
        if table == "links":  # the rows of bodies with one link repeat the pose of the body
            rows = rows.filter(pa.array(np.isin(rows["entity"].to_numpy(), self._linked)))
        return rows

    def near_pairs(self, request: PairRequest, buffered: pa.Table | None) -> pa.Table:  # noqa: ARG002
        """Returns the pairs of entities whose boxes are near at a tick, or unknown."""
        begin = max(int(np.searchsorted(self._starts, request.first, side="right")) - 1, 0)
        end = int(np.searchsorted(self._starts, request.last, side="right"))
        paths = [
            (pattern_of(file.path), episode.offset)
            for episode in self._episodes[begin:end]
            for file in episode.files["entities"]
        ]
        files = ", ".join(_text(path) for path, _ in paths)
        offsets = ", ".join(str(int(offset)) for _, offset in paths)
        moved = f"(tick + list_extract([{offsets}]::BIGINT[], file_index::BIGINT + 1))::BIGINT"
        stored = (
            f"SELECT * REPLACE ({moved} AS tick) "  # noqa: S608
            f"FROM read_parquet([{files}], hive_partitioning = false)"
        )
        return near_pair_rows(self._connection, stored, request, None)

    def close(self, *, forget: bool) -> None:  # noqa: ARG002
        """Closes the connection; keeps the files."""
        self._connection.close()


def model_table(table: str) -> str:
    """Returns the name under which the rows of a model are registered with the connection."""
    return f"batch: {table} model"


def _variables(table: str) -> tuple[str, str]:
    """Returns the names of DuckDB's variables of the files and the offsets of a table."""
    return f"files of {table}", f"offsets of {table}"


def _text(text: str) -> str:
    return exp.Literal.string(text).sql("duckdb")


def _rows(
    file: BatchedFile, content: bytes, types: pa.Schema, offset: int, first: int, last: int
) -> pa.Table:
    """Returns the columns of a part that change with the tick, its ticks moved by an offset.

    Args:
        file: the file of the part.
        content: its bytes.
        types: the columns.
        offset: the offset.
        first: the first tick whose rows are returned, with the offset.
        last: the last of them.
    """
    rows = file.rows(content, types.names)
    if not set(types.names) <= set(rows.column_names):
        raise RecordError(_OLDER)
    return _moved(rows.select(types.names), types, offset, first, last)


def _moved(rows: pa.Table, types: pa.Schema, offset: int, first: int, last: int) -> pa.Table:
    """Returns the rows of some ticks, their numbers moved by an offset."""
    ticks = rows["tick"].to_numpy() + offset
    if (np.diff(ticks) < 0).any():
        chosen = (ticks >= first) & (ticks <= last)
        rows, ticks = rows.filter(pa.array(chosen)), ticks[chosen]
    else:
        start, end = np.searchsorted(ticks, [first, last + 1]).tolist()
        rows, ticks = rows.slice(start, end - start), ticks[start:end]
    place = rows.column_names.index("tick")
    rows = rows.set_column(place, types.field("tick"), pa.array(ticks))
    return rows if rows.schema.equals(types) else rows.cast(types)
