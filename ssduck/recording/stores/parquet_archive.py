"""Reads an episode that was recorded in a folder of Parquet files, through DuckDB."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from sqlglot import exp

from ssduck.errors import RecordError
from ssduck.recording.spec import Recording
from ssduck.recording.static_tables import default_values
from ssduck.recording.stores.base import PairRequest, StoreConnection, TickArchive, Waiting
from ssduck.recording.stores.history_sql import all_columns, near_rows
from ssduck.recording.stores.parquet_layout import FolderRun
from ssduck.schema import MODELS, RECORDED, TABLES, Column

_PATTERN = re.compile(r"[*?[]")


class ParquetArchive(TickArchive):
    """The ticks of an episode in a folder.

    Args:
        run: the episode.
        recording: what was recorded of each tick.
        connection: a connection of its own, that reads the files.

    Attributes:
        ticks: the numbers and times of the stored ticks.

    Raises:
        RecordError: a file is missing or damaged, or nothing was stored.
    """

    def __init__(self, run: FolderRun, recording: Recording, connection: StoreConnection) -> None:
        self.recording = recording
        self.tables = run.tables
        self._run = run
        self._connection = connection
        self._starts, self.ticks = run.ticks()
        # All of them have to be there, so that no query fails later.
        self._files = {table: run.files(table) for table in run.tables}

    def model_rows(self) -> dict[str, pa.Table]:
        """The stored rows of each model, by the table that it is of."""
        return {table: self._run.read(f"models/{table}") for table in MODELS}

    def select(self, table: str, waiting: Waiting | None) -> str | None:  # noqa: ARG002
        """The SELECT of the view of a table's history; None for a table that is not recorded."""
        if table not in self._files:
            return None
        return self._complete(self._files[table], TABLES[table].columns)

    def models(self) -> dict[str, str]:
        """The SELECT of the view of each model, by the name of the view."""
        return {
            table.model_view: self._complete(self._run.files(f"models/{table.name}"), table.model)
            for table in MODELS.values()
        }

    def _complete(self, files: Sequence[Path], columns: Sequence[Column]) -> str:
        """A SELECT of all columns of a table from its files."""
        return self._with(files, {column.name: column.sql for column in columns})

    def _with(self, files: Sequence[Path], columns: Mapping[str, str]) -> str:
        geometries = _scan(self._run.files("models/geometries"))
        missing = default_values(self.unrecorded_run, geometries)
        return all_columns(_scan(files), columns, _columns_in(files), missing)

    def fetch(self, table: str, first: int, last: int) -> pa.Table:
        """The rows of a table at the ticks from first to last."""
        begin = max(int(np.searchsorted(self._starts, first, side="right")) - 1, 0)
        end = int(np.searchsorted(self._starts, last, side="right"))
        files = self._files[table][begin:end]
        if not files:
            files, first, last = self._files[table][:1], 0, -1
        chosen = "tick BETWEEN ? AND ?"
        if table == "links":  # those of bodies of one link are as the body
            entities = _scan(self._run.files("models/entities"))
            chosen += f" AND entity IN (SELECT id FROM {entities} WHERE links > 1)"  # noqa: S608
        rows = self._with(files, RECORDED[table].tick_columns.sql)
        return self._connection.rows(f"{rows} WHERE {chosen}", (first, last))

    def near(self, request: PairRequest, waiting: pa.Table | None) -> pa.Table:
        """The pairs of entities whose boxes are near at a tick, or unknown."""
        return near_rows(self._connection, self.select("entities", None), request, waiting)

    def close(self, *, forget: bool) -> None:  # noqa: ARG002
        """Closes the connection; the folder stays."""
        self._connection.close()


def _columns_in(files: Sequence[Path]) -> list[str]:
    """The columns of a table's parts: one ssduck wrote all of them."""
    names: list[str] = pq.read_schema(files[0].absolute()).names
    return names


def _scan(files: Sequence[Path]) -> str:
    """The rows of files, in SQL."""
    names = ", ".join(exp.Literal.string(_exact_path(file)).sql("duckdb") for file in files)
    return f"read_parquet([{names}], hive_partitioning = false)"


def _exact_path(file: Path) -> str:
    """The path of one file as DuckDB takes it, which reads `*`, `?` and `[` as patterns.

    Raises:
        RecordError: the path has a backslash beside one of them: DuckDB takes it for a slash.
    """
    path = str(file.resolve())
    if not _PATTERN.search(path):
        return path
    if "\\" in path and os.sep != "\\":
        raise RecordError(
            f"{path} cannot be read: DuckDB takes a backslash in such a name for a slash; rename "
            "the folder"
        )
    return _PATTERN.sub(r"[\g<0>]", path)
