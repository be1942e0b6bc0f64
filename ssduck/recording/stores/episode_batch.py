"""Reads many episodes with the same entities as one: an archive of a batch of episodes.

The ticks of an episode are moved by an offset, so that those of no two episodes are equal. SQL
reads the files of all episodes at once, or those of one: the views name variables of DuckDB, which
`EpisodeBatch.show` sets. A file is read only if its bytes have the checksum that its episode has in
a manifest.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.parquet as pq
from sqlglot import exp

from ssduck.errors import RecordError
from ssduck.geometry.arrays import Array
from ssduck.recording.spec import Recording
from ssduck.recording.stores.base import BufferViews, PairRequest, StoreConnection, TickArchive
from ssduck.recording.stores.checksums import footer_in
from ssduck.recording.stores.history_sql import near_pair_rows, quoted
from ssduck.recording.stores.object_store import ObjectPath, is_address
from ssduck.recording.stores.parquet_archive import (
    arrow_types,
    multi_link_bodies,
    pattern_of,
)
from ssduck.recording.stores.parquet_layout import OTHER_PART
from ssduck.recording.stores.stored_columns import check_parquet
from ssduck.recording.stores.tick_checks import stray_row
from ssduck.schema import MODELS, TABLES

# The column in which the parts have the number of the run.
_RUN = "run"
# The largest number of checked parts that are remembered.
MAX_CHECKED = 20_000
# The columns of each part that tell of which tick a row is.
_TICK = pa.schema({"tick": pa.int64(), "time": pa.float64()})


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


@dataclass(frozen=True)
class BatchedEpisode:
    """An episode of a batch.

    Attributes:
        offset: is added to the numbers of its ticks.
        ticks: the rows of its ticks: `tick`, without the offset, `time` and `wall_time`.
        files: the files of its parts, by table.
        checked: the tables whose bytes and ticks were checked a moment ago.
    """

    offset: int
    ticks: pa.Table
    files: Mapping[str, Sequence[BatchedFile]]
    checked: frozenset[str] = frozenset()

    @cached_property
    def numbers(self) -> npt.NDArray[np.int64]:
        """The numbers of its ticks in the batch, (n,)."""
        numbers: npt.NDArray[np.int64] = self.ticks["tick"].to_numpy() + self.offset
        return numbers

    def key_of(self, file: BatchedFile) -> tuple[BatchedFile, tuple[BatchedFile, ...]]:
        """Returns what decides whether the rows of a file are of ticks of the episode."""
        return file, tuple(self.files["ticks"])

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
        self._connection, self._run_statement = connection, run_statement
        self._episodes: Sequence[BatchedEpisode] = ()
        self._starts = np.zeros(0, dtype=np.int64)
        # The tables that SQL or Python has read: their files are checked when a batch is loaded.
        self._read: set[str] = {"entities"}
        self._in_sql: set[str] = set()
        # The parts whose rows are of ticks of their own episode, with the checksums of the ticks.
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
            for file in episode.files[table]:
                self._content(table, file, index)

    def _content(self, table: str, file: BatchedFile, index: int) -> bytes:
        """Returns the bytes of a file of an episode, whose rows are of ticks of the episode.

        Moved by its offset, a row of another tick might be one of another episode.

        Raises:
            DamagedEpisodeError: the file is missing or damaged, or a row is of another tick.
        """
        try:
            content = file.content()
            episode = self._episodes[index]
            key = episode.key_of(file)
            if table != "ticks" and key not in self._checked:
                rows = file.rows(content, _TICK.names)
                check_ticks(rows, episode.ticks, table, file.path)
                self._checked.add(key)
        except RecordError as error:
            raise DamagedEpisodeError(error.message, index) from error
        except (OSError, pa.ArrowException) as error:
            raise DamagedEpisodeError(f"{file.path} cannot be read: {error}", index) from error
        return content

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
                    self._content(table, file, index),
                    types,
                    self._episodes[index].offset,
                    first,
                    last,
                )
                for index in range(begin, end)
                for file in self._episodes[index].files[table]
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


def check_ticks(rows: pa.Table, ticks: pa.Table, table: str, path: str) -> None:
    """Checks that all rows of a part have the number and the time of a tick of their episode.

    Args:
        rows: the rows, with `tick` and `time`.
        ticks: the rows of the ticks, with the same columns.
        table: the table of the rows, for the message.
        path: the part or the record, to begin the message.

    Raises:
        RecordError: a row has those of none, or the part has no such columns.
    """
    is_whole = set(_TICK.names) <= set(rows.column_names)
    if not is_whole or any(
        rows[field.name].type != field.type or rows[field.name].null_count for field in _TICK
    ):
        raise RecordError(f"{path} has no tick and time of each row of {table}")
    stray = stray_row(rows, ticks["tick"].to_numpy(), ticks["time"].to_numpy())
    if stray is not None:
        raise RecordError(f"{path} is damaged: of the rows of {table}, {stray}")


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
        raise RecordError("a part of an older record is read by itself")
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
