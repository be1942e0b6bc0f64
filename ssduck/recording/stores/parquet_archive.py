"""Reads an episode that was recorded in a folder of Parquet files, through DuckDB."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.parquet as pq

from ssduck.errors import RecordError
from ssduck.recording.opened_record import OpenedRecord
from ssduck.recording.paths import part_number
from ssduck.recording.spec import Recording
from ssduck.recording.static_tables import complete_rows
from ssduck.recording.stores.base import (
    BufferViews,
    PairRequest,
    StoreConnection,
    TickArchive,
)
from ssduck.recording.stores.history_sql import (
    column_list,
    exact_path,
    near_pair_rows,
    quoted,
    rows_of_files,
)
from ssduck.recording.stores.object_store import parquet_source
from ssduck.recording.stores.parquet_layout import LOG, FolderRun
from ssduck.recording.stores.stored_columns import arrow_types, unreadable
from ssduck.schema import FRAMES, MODELS, TABLES

# From so many parts on, a record has groups of them, and a part is checked when it is read.
MANY_PARTS = 16


class ParquetArchive(TickArchive):
    """The ticks of an episode in a folder.

    Attributes:
        ticks: the numbers and times of the stored ticks.
        visible_rows: the rows of the log, which DuckDB reads from memory, by table.
    """

    def __init__(
        self,
        run: FolderRun,
        recording: Recording,
        connection: StoreConnection,
        opened: OpenedRecord,
    ) -> None:
        self.recording = recording
        self.tables = run.tables
        self._run = run
        self._opened = opened
        self._connection = connection
        self._starts, self.ticks = run.ticks()
        # Fails now if files are missing, or DuckDB cannot read them, rather than in a later query.
        exact_path(run.path)
        # The working directory may change.
        self._files = {t: [file.absolute() for file in run.listed_files(t)] for t in run.tables}
        # The files whose bytes were checked. The footers of all files are checked here, unless they
        # are many.
        self._checked: set[Path] = set()
        for table, files in self._files.items() if len(self._starts) < MANY_PARTS else ():
            self._run.check_footers(table, map(part_number, files))
        self._models = {table: run.read(f"models/{table}") for table in MODELS}
        self._linked = multi_link_bodies(self._models["entities"])
        if len(self._linked) and not {"links", FRAMES} & set(run.tables):
            raise RecordError(
                f"{run.about_file} is damaged: bodies have several links, and their poses are in "
                "neither links nor frames"
            )
        self._log = _logged_rows(run, self._models)
        self.visible_rows = (self._log,) if self._log else ()

    def model_rows(self) -> dict[str, pa.Table]:
        """Returns the stored rows of each model, by the name of its table."""
        return self._models

    def select(self, table: str, buffer_views: BufferViews | None) -> str | None:
        """Returns the SELECT of the view of a table's history; None if it is not recorded.

        DuckDB reads the footer of each part to find some ticks. It reads none of a group of parts
        whose ticks are others. The files must have been checked.

        Few parts are read together: then a sum is the same to the last bit, whatever their number.
        """
        if table not in self._files:
            return None
        count = len(self._files[table])
        groups = self._groups(table) if self.has_groups(table) else [range(count)]
        parts = [self._select_parts(table, group) for group in groups if group]
        names = column_list(column.name for column in TABLES[table].columns)
        views = () if buffer_views is None else buffer_views(table)
        parts += [f"SELECT {names} FROM {quoted(view)}" for view in views]  # noqa: S608
        return " UNION ALL ".join(parts)

    def has_groups(self, table: str) -> bool:
        """Checks whether a statement about some ticks reads some files of a table only."""
        return len(self._files.get(table, ())) >= MANY_PARTS

    def check(self, table: str, ticks: tuple[int, int] | None = None) -> None:
        """Checks the bytes of the files that SQL reads of a table, each once."""
        if table not in self._files:
            return
        if ticks is None or not self.has_groups(table):
            self._check(table, range(len(self._files[table])))
            return
        for group in self._groups(table):
            first, last = self._ticks_of(group)
            if first <= ticks[1] and ticks[0] <= last:
                self._check(table, group)

    def _groups(self, table: str) -> list[range]:
        """Returns the parts of a table in groups: √n of n parts."""
        count = len(self._files[table])
        size = math.isqrt(count)
        return [range(begin, min(begin + size, count)) for begin in range(0, count, size)]

    def _ticks_of(self, parts: range) -> tuple[int, int]:
        """Returns the first and the last tick of some parts."""
        starts, last = self._starts, int(self.ticks.numbers[-1])
        if parts.stop < len(starts):
            last = starts[parts.stop] - 1
        return starts[parts.start], last

    def models(self) -> dict[str, str]:
        """Returns the SELECT of the view of each model, by the name of the view."""
        return {
            table.model_view: rows_of_files(files, table.model)
            for table in MODELS.values()
            if (files := self._run.listed_files(f"models/{table.name}"))
        }

    def _select_parts(self, table: str, parts: range) -> str:
        """Returns a SELECT of all columns of some parts of a table."""
        files = self._files[table]
        rows = rows_of_files(files[parts.start : parts.stop], TABLES[table].columns)
        if len(parts) == len(files):
            return rows
        first, last = self._ticks_of(parts)
        return f"{rows} WHERE tick BETWEEN {first} AND {last}"

    def _check(self, table: str, parts: range) -> None:
        """Checks the files of parts that were not checked yet."""
        files = self._files[table][parts.start : parts.stop]
        unchecked = [file for file in files if file not in self._checked]
        self._run.check_data(table, map(part_number, unchecked))
        self._checked.update(unchecked)

    def fetch(self, table: str, first: int, last: int) -> pa.Table:
        """Returns the rows of a table at the ticks from first to last."""
        self._opened.check()
        if table == FRAMES and table not in self._files:  # no body has several links
            return arrow_types(table).empty_table()
        found = self._parts_with(table, first, last)
        self._check(table, found)
        types, files = arrow_types(table), self._files[table][found.start : found.stop]
        parts = [_rows_of_ticks(file, types, first, last) for file in files]
        if self._log:
            logged = self._log[table].arrow.select(types.names).cast(types)
            parts.append(_between(logged, first, last))
        rows = pa.concat_tables([types.empty_table(), *parts])
        if table == "links":  # the rows of bodies with one link repeat the pose of the body
            rows = rows.filter(pa.array(np.isin(rows["entity"].to_numpy(), self._linked)))
        return rows

    def _parts_with(self, table: str, first: int, last: int) -> range:
        """Returns the numbers of the parts with the ticks from first to last."""
        begin = max(int(np.searchsorted(self._starts, first, side="right")) - 1, 0)
        end = int(np.searchsorted(self._starts, last, side="right"))
        return range(begin, min(end, len(self._files[table])))

    def near_pairs(self, request: PairRequest, buffered: pa.Table | None) -> pa.Table:
        """Returns the pairs of entities whose boxes are near at a tick, or unknown."""
        logged = self._log["entities"].arrow if self._log else buffered
        parts = self._parts_with("entities", request.first, request.last)
        self._check("entities", parts)
        stored = self._select_parts("entities", parts) if parts else None
        return near_pair_rows(self._connection, stored, request, logged)


def multi_link_bodies(entities: pa.Table) -> npt.NDArray[np.int64]:
    """Returns the ids of the bodies with several links, from the rows of the model of entities."""
    ids: npt.NDArray[np.int64] = entities["id"].to_numpy()[entities["links"].to_numpy() > 1]
    return ids


@dataclass(frozen=True)
class _LoggedRows:
    """The rows of the log of a table, which remain as they are."""

    arrow: pa.Table
    version: int = 1


def _logged_rows(run: FolderRun, models: Mapping[str, pa.Table]) -> dict[str, _LoggedRows]:
    """Returns the rows of the log of an episode with all columns, by table."""
    try:
        return {
            table: _LoggedRows(complete_rows(table, rows, run.log["entities"], models))
            for table, rows in run.log.items()
        }
    except RecordError as error:
        raise RecordError(f"{run.place(LOG)} is damaged: {error.message}") from error


def _rows_of_ticks(file: Path, types: pa.Schema, first: int, last: int) -> pa.Table:
    try:
        part = pq.ParquetFile(parquet_source(file))
        groups = _groups_with(part, first, last)
        # To wake threads up takes longer.
        rows = part.read_row_groups(groups, columns=types.names, use_threads=False)
    except (pa.ArrowException, OSError) as error:
        raise unreadable(file, error) from error
    return _between(rows.select(types.names).cast(types), first, last)


def _groups_with(part: pq.ParquetFile, first: int, last: int) -> list[int]:
    """Returns the numbers of the groups of rows that may have ticks from first to last."""
    place = part.schema_arrow.get_field_index("tick")
    ranges = (
        part.metadata.row_group(number).column(place).statistics
        for number in range(part.num_row_groups)
    )
    return [
        number
        for number, ticks in enumerate(ranges)
        if ticks is None or not ticks.has_min_max or (ticks.min <= last and ticks.max >= first)
    ]


def _between(rows: pa.Table, first: int, last: int) -> pa.Table:
    """Returns the rows at the ticks from first to last."""
    ticks = rows["tick"].to_numpy()
    return rows.filter(pa.array((ticks >= first) & (ticks <= last)))
