"""Opening what was recorded: a folder of Parquet files, or a DuckDB file."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from sqlglot import exp

from ssduck.errors import RecordError, nearest
from ssduck.folder import Episode
from ssduck.history import (
    History,
    Near,
    Waiting,
    Writer,
    abouts,
    columns_of,
    model_name,
    near_rows,
)
from ssduck.models import MODELS, members_of
from ssduck.past import Record, RecordedWorld
from ssduck.recording import Ticks
from ssduck.tables import TABLES


class OpenedFolder:
    """An episode in a folder, to be read (`ssduck.history.Archive`).

    Args:
        episode: which.
        writer: a connection of its own, that reads the files.
    """

    def __init__(self, episode: Episode, writer: Writer) -> None:
        self.episode = episode
        self._writer = writer
        self._starts: list[int] = []
        self.ticks = Ticks()
        for file in episode.files("ticks"):
            rows = _read_ticks(file)
            self._starts.append(int(rows["tick"][0].as_py()))
            self.ticks.extend(rows["tick"].to_numpy(), rows["time"].to_numpy())
        if not self._starts:
            raise RecordError(f"{episode.path} holds no whole part of {episode.world!r}")
        # All of them have to be there, so that no query fails later.
        self._files = {table: episode.files(table) for table in episode.tables}

    def select(self, table: str, rings: Waiting | None) -> str | None:  # noqa: ARG002
        """What the view of a table's history selects; None for what is not recorded."""
        if table not in self._files:
            return None
        columns = ", ".join(_quoted(column.name) for column in TABLES[table])
        return f"SELECT {columns} FROM {_scan(self._files[table])}"  # noqa: S608

    def models(self) -> dict[str, str]:
        """What the views select that tell what entities are, by their names."""
        return {
            model_name(table): f"SELECT * FROM {_scan(self.episode.files(f'models/{table}'))}"  # noqa: S608
            for table in MODELS
        }

    def record(self) -> Record:
        """What is kept of the world."""
        models = {table: self.episode.read(f"models/{table}") for table in MODELS}
        return Record(
            None,
            self.ticks,
            members_of(models),
            self.episode.tables,
            self.fetch,
            lambda asked: self.near(asked, None),
        )

    def fetch(self, table: str, first: int, last: int) -> pa.Table:
        """The rows of a table at ticks from first to last."""
        begin = max(int(np.searchsorted(self._starts, first, side="right")) - 1, 0)
        end = int(np.searchsorted(self._starts, last, side="right"))
        files = self._files[table][begin:end]
        columns = ", ".join(map(_quoted, columns_of(table)))
        if not files:
            files, first, last = self._files[table][:1], 0, -1
        chosen = "tick BETWEEN ? AND ?"
        if table == "links":  # those of bodies of one link are as the body
            entities = _scan(self.episode.files("models/entities"))
            chosen += f" AND entity IN (SELECT id FROM {entities} WHERE links > 1)"  # noqa: S608
        return self._writer.rows(
            f"SELECT {columns} FROM {_scan(files)} WHERE {chosen}",  # noqa: S608
            (first, last),
        )

    def near(self, asked: Near, waiting: pa.Table | None) -> pa.Table:
        """The pairs of entities whose boxes are near at some ticks."""
        rows = self.select("entities", None)
        assert rows is not None
        return near_rows(self._writer, rows, asked, waiting)

    def close(self, *, forget: bool) -> None:  # noqa: ARG002
        """Read no more."""
        self._writer.close()


def _read_ticks(file: Path) -> pa.Table:
    try:
        return pq.ParquetFile(file).read(["tick", "time"])
    except (pa.ArrowException, OSError, KeyError) as error:
        raise RecordError(f"{file} cannot be read: it is damaged: {error}") from error


def _scan(files: Sequence[Path]) -> str:
    names = ", ".join(exp.Literal.string(str(file.resolve())).sql("duckdb") for file in files)
    return f"read_parquet([{names}], hive_partitioning = false)"


def _quoted(name: str) -> str:
    return exp.to_identifier(name, quoted=True).sql("duckdb")


def world_of(episode: Episode, writer: Writer) -> RecordedWorld:
    """The world of an episode, as far as it was recorded.

    Raises:
        RecordError: a file is missing or damaged.
    """
    archive = OpenedFolder(episode, writer)
    return RecordedWorld(episode.world, archive.record(), archive)


@dataclass(frozen=True)
class StoredRun:
    """A run that is recorded in a DuckDB file.

    Attributes:
        schema: what holds it.
        world: the name of the world.
        number: of the episode, from 1.
    """

    schema: str
    world: str
    number: int


def stored_runs(writer: Writer) -> list[StoredRun]:
    """The runs that are recorded in a DuckDB file, by world and number."""
    found = []
    for schema, text in abouts(writer):
        number = schema.rpartition("_")[2]
        found.append(StoredRun(schema, json.loads(text)["world"], int(number)))
    return sorted(found, key=lambda run: (run.world, run.number))


def chosen_runs(
    found: Sequence[StoredRun], world: str | None, episode: int | None
) -> list[StoredRun]:
    """One run of each world, or of one: the last, or that of a number.

    Raises:
        RecordError: there is none such.
    """
    if not found:
        raise RecordError("nothing is recorded in this DuckDB file")
    names = sorted({run.world for run in found})
    if world is not None and world not in names:
        told = f"nothing of a world {world!r} is recorded"
        raise RecordError(told, suggestions=nearest(world, names))
    chosen = []
    for name in names if world is None else [world]:
        own = [run for run in found if run.world == name]
        picked = own if episode is None else [run for run in own if run.number == episode]
        if not picked:
            known = ", ".join(str(run.number) for run in own)
            raise RecordError(f"there is no episode {episode} of {name!r}; there are {known}")
        chosen.append(picked[-1])
    return chosen


def world_of_run(run: StoredRun, writer: Writer) -> RecordedWorld:
    """The world of a run in a DuckDB file, as far as it was stored.

    Raises:
        RecordError: nothing was stored, or it is of a newer version.
    """
    history = History.stored(run.schema, writer)
    ticks = history.ticks()
    if not len(ticks):
        raise RecordError(f"of {run.world!r} nothing was stored before the file was left")
    record = Record(
        None,
        ticks,
        history.members(),
        history.tables,
        history.fetch,
        lambda asked: history.near(asked, None),
    )
    return RecordedWorld(run.world, record, history)
