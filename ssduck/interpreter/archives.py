"""Opens and checks records: folders of Parquet files, and DuckDB files."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import islice
from pathlib import Path
from typing import Any, TypeAlias

from ssduck import validation
from ssduck.database.database import Database
from ssduck.database.instances import CHECK_HINT, log_of
from ssduck.errors import RecordError, SqlError, nearest, record_errors
from ssduck.recording.episode import Episode, Tags, extent_of
from ssduck.recording.folder_check import DAMAGED, Damage, check_folder, set_aside
from ssduck.recording.folder_episodes import runs_in
from ssduck.recording.opened_record import OpenedRecord
from ssduck.recording.paths import expand_path
from ssduck.recording.replay.record import Record
from ssduck.recording.replay.replayed_world import ReplayedWorld, ReplayTicker
from ssduck.recording.spec import Recording
from ssduck.recording.static_tables import geometries_of, members_of, run_of
from ssduck.recording.stores.base import StoreConnection
from ssduck.recording.stores.descriptions import (
    DATABASE_EPISODE,
    camera_of,
    check_description,
    parse_description,
)
from ssduck.recording.stores.duckdb import DuckDBStore
from ssduck.recording.stores.model_tables import ABOUT, RUN_SCHEMA, VERSION, RecordFile
from ssduck.recording.stores.parquet_archive import ParquetArchive
from ssduck.recording.stores.parquet_layout import FolderRun
from ssduck.schema import MODELS, RECORDABLE
from ssduck.simulators.scene_bodies import MODEL_SUFFIXES
from ssduck.world.snapshot import new_run

# The number of an episode in the name of a schema.
_NUMBER = re.compile("0|[1-9][0-9]{0,8}")
# So many episodes an error names.
_MOST_NAMED = 20


@record_errors()
def episodes(path: str | Path) -> list[Episode]:
    """Returns the episodes in a folder or in a DuckDB file, by world and number.

    Args:
        path: the path of the folder or the file.

    Raises:
        RecordError: there is no such record, or it is damaged, of a newer version, or in use by
            another process.
    """
    with closing(Database(":memory:", None)) as database:
        runs = recorded_runs(expand_path(path), database)
        return [run.episode for run in runs if run.has_begun]


def recorded_runs(path: Path, database: Database) -> Sequence[RecordedRun]:
    """Returns the runs in a folder or in a DuckDB file, by world and number."""
    if path.is_dir():
        return runs_in(path)
    if not path.is_file():
        raise RecordError(f"there is no record {path}: neither a folder nor a DuckDB file")
    try:
        schema = database.connection.attach(path)
    except RecordError as error:
        if path.suffix.lower() in (".toml", *MODEL_SUFFIXES):
            error.message += "; scenes and models are opened by ssduck.load, not as records"
        raise
    return _runs_in_file(path, schema, database.connection.reader(OpenedRecord(path)))


def select_runs(
    runs: Sequence[RecordedRun], world: str | None, number: int | None
) -> list[RecordedRun]:
    """Returns one run of each world, or of one: the run of a number, or the last one with ticks.

    They are in the order in which the worlds were added, or that of their names where the record
    does not have it.
    """
    if not runs:
        raise RecordError("nothing is recorded there")
    names = sorted({run.world for run in runs})
    if world is not None and world not in names:
        raise RecordError(
            f"no world {world!r} is recorded; recorded worlds: {', '.join(names)}",
            suggestions=nearest(world, names),
        )
    candidates = [run for run in runs if world in (None, run.world)]
    selected: dict[str, RecordedRun] = {}
    for run in reversed(candidates):  # the others are not looked at
        is_wanted = number is None or run.number == number
        if is_wanted and run.world not in selected and run.has_ticks:
            selected[run.world] = run
    if not selected and number is None:
        raise RecordError(
            f"no tick of {candidates[-1].world!r} was stored before the recording ended"
        )
    if not selected:
        with_ticks = (run for run in reversed(candidates) if run.has_ticks)
        last = [f"{run.number} of {run.world!r}" for run in islice(with_ticks, _MOST_NAMED + 1)]
        named = [*(["…"] if len(last) > _MOST_NAMED else []), *reversed(last[:_MOST_NAMED])]
        raise RecordError(
            f"no episode {number} has ticks; episodes with ticks: {', '.join(named) or 'none'}"
        )
    found = list(reversed(selected.values()))
    if len(found) > 1:
        found.sort(key=lambda run: run.description.get("order", 0))
    return found


def folder_run(path: str | Path, world: str | None, number: int | None) -> FolderRun:
    """Returns one run of a folder: of a number, or the last one with ticks."""
    folder = expand_path(path).absolute()
    if not folder.is_dir():
        raise RecordError(f"there is no folder of Parquet files {folder}")
    runs = select_runs(runs_in(folder), world, number)
    if len(runs) > 1:
        names = ", ".join(run.world for run in runs)
        raise RecordError(f"{folder} has several worlds: {names}; name one")
    (run,) = runs
    assert isinstance(run, FolderRun)
    return run


def replayed_world(run: RecordedRun, database: Database) -> ReplayedWorld:
    """Returns the world of a recorded run."""
    archive: ParquetArchive | DuckDBStore
    if isinstance(run, FolderRun):
        tables = [table for table in run.tables if table in RECORDABLE]
        recording = _recording({**run.recording, "tables": tables}, run.about_file)
        opened = OpenedRecord(run.path, run.about_file, run.description, run.about_status)
        archive = ParquetArchive(run, recording, database.connection.reader(opened), opened)
        ticks, models = archive.ticks, archive.model_rows()
    else:
        archive = run.history(database.connection.reader(OpenedRecord(run.path)))
        ticks, models = archive.ticks(), archive.model_rows()
    try:
        run_number, members = run_of(models), members_of(models)
    except RecordError as error:
        raise RecordError(
            f"{run.path}: episode {run.number} of {run.world!r}: {error.message}"
        ) from error
    record = Record(
        None,
        ticks,
        members,
        archive.tables,
        archive.fetch,
        partial(archive.near_pairs, buffered=None),
        geometries_of(models),
        run_number or new_run(),
        source=str(run.path),
        tags=run.tags,
        order=run.description.get("order"),
        entities=archive.recording.entities,
    )
    ticker = ReplayTicker(run.world, record)
    return ReplayedWorld(ticker, (archive, record), camera_of(run.description))


# -- DuckDB files -----------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class StoredRun:
    """A recorded run in a DuckDB file."""

    file: RecordFile
    schema: str  # the schema of the run
    world: str  # the name of the world
    number: int  # the number of the episode, from 0
    reader: StoreConnection  # a connection that can read it

    @property
    def path(self) -> Path:
        """The file."""
        return self.file.path

    @cached_property
    def description(self) -> dict[str, Any]:
        """The description of the run in the file."""
        rows = self.file.read(self.reader, self.schema, ABOUT, {"about": "string"})
        return _description(self.path, self.schema, rows["about"].to_pylist())

    def history(self, reader: StoreConnection) -> DuckDBStore:
        """Returns the store of the run."""
        recording = _recording(self.description["recording"], self.path)
        return DuckDBStore(self.schema, reader, recording, file=self.file)

    @property
    def has_ticks(self) -> bool:
        """Whether ticks were stored."""
        return self.history(self.reader).has_ticks

    # It is said from the beginning what is recorded.
    has_begun = True

    @property
    def tags(self) -> Tags:
        """What the user says of the run, by name."""
        tags: Tags = self.description.get("tags", {})
        return tags

    @cached_property
    def episode(self) -> Episode:
        """The contents of the run."""
        history = self.history(self.reader)
        return Episode(
            self.path,
            self.world,
            self.number,
            started=self.description["started"],
            tables=tuple(sorted(history.recording.tables)),
            every=history.recording.every,
            entities=history.recording.entities,
            complete=self.description["complete"],
            id=self.description["id"],
            tags=dict(self.tags),
            **extent_of(history.ticks()),
        )


# A recorded run of a world.
RecordedRun: TypeAlias = FolderRun | StoredRun


def _runs_in_file(path: Path, catalog: str, reader: StoreConnection) -> list[StoredRun]:
    file = RecordFile.of(path, catalog, reader)
    runs = []
    for schema in file.schemas_with(ABOUT):
        world, _, number = schema.rpartition(RUN_SCHEMA)
        if not (_NUMBER.fullmatch(number) and world.isidentifier()):
            raise RecordError(f"{path} is damaged: the schema {schema!r} is of no episode")
        runs.append(StoredRun(file, schema, world, int(number), reader))
    if not runs:
        raise RecordError(f"nothing is recorded in the DuckDB file {path}")
    return sorted(runs, key=lambda run: (run.world, run.number))


def _description(path: Path, schema: str, texts: list[Any]) -> dict[str, Any]:
    """Returns the description of a run, checked."""
    if len(texts) != 1 or texts[0] is None:
        raise RecordError(f"{path} is damaged: {schema} lacks its description")
    source = f"{path}: the description of {schema}"
    description = parse_description(texts[0], source)
    version = description.get("version")
    if type(version) is int and version > VERSION:
        raise RecordError(
            f"{schema} in {path} is a record of version {version}; this ssduck reads those up to "
            f"{VERSION}: install a newer one"
        )
    check_description(description, DATABASE_EPISODE, source, "what is recorded")
    return description


def _recording(description: dict[str, Any], path: Path) -> Recording:
    try:
        return Recording(**description)
    except TypeError as error:  # ArgumentError is one
        raise RecordError(f"{path} is damaged: it has no valid recording settings") from error


@record_errors()
def check(path: str | Path, *, repair: bool = False) -> list[Damage]:
    """Returns the damaged and missing files of a record; reads all of it.

    A repair takes what is damaged out of the record and deletes nothing: the files stay, under
    names that end in `.damaged`. Of a folder, it takes out whole parts, with all rows of their
    ticks; of a DuckDB file, its log, with the ticks since the last checkpoint.

    Args:
        path: the path of the folder or the DuckDB file.
        repair: whether the record is repaired. No process may record into it.

    Returns:
        A list of damages: `file`, `problem`, `loss` (what cannot be read without the file) and
        `is_repaired`. It is empty if the record is intact.

    Raises:
        RecordError: there is no such record, or it is of a newer version or in use by another
            process.

    >>> import ssduck, tempfile
    >>> with ssduck.load("kitchen") as ss, tempfile.TemporaryDirectory() as folder:
    ...     _ = ss.export(folder)
    ...     ssduck.check(folder)
    []
    """
    validation.boolean(repair, "check: repair")
    place = expand_path(path).absolute()
    if place.is_dir():
        return check_folder(place, repair=repair) or list(_unreadable(place))
    try:
        return list(_damages_of_file(place)) or list(_unreadable(place))
    except RecordError as error:
        log = log_of(place)
        if CHECK_HINT in error.message:  # which is this check
            text = error.message.replace(CHECK_HINT, "nothing of it can be read: put a copy back")
            raise RecordError(text) from error
        # The path may have the word, and a log that is in use must stay where it is.
        if not log.exists() or "damaged" not in error.message.replace(str(place), ""):
            raise
        loss = "ticks since the last checkpoint"
        damage = Damage(log, f"does not fit the file, or is damaged: {error.message}", loss)
    return _without_log(place, damage) if repair else [damage]


def _unreadable(place: Path) -> Iterator[Damage]:
    """Yields the episodes that cannot be opened although their files are whole."""
    with closing(Database(":memory:", None)) as database:
        for run in recorded_runs(place, database):
            try:
                if run.has_begun and run.has_ticks:
                    replayed_world(run, database)
            except RecordError as error:
                loss = f"all of episode {run.number} of {run.world!r}"
                yield Damage(run.path, error.message.removeprefix(f"{run.path} "), loss)


def _without_log(file: Path, damage: Damage) -> list[Damage]:
    """Renames the log of a DuckDB file, so that the file opens without it."""
    set_aside(damage.file)
    try:
        damages = list(_damages_of_file(file))
    except RecordError as error:
        aside = damage.file.with_name(f"{damage.file.name}{DAMAGED}")
        aside.rename(damage.file)
        return [Damage(file, error.message.removeprefix(f"{file} "), "the whole record")]
    return [Damage(damage.file, damage.problem, damage.loss, is_repaired=True), *damages]


def _damages_of_file(file: Path) -> Iterator[Damage]:
    """Yields what of a DuckDB file cannot be read."""
    with closing(Database(":memory:", None)) as database:
        for run in recorded_runs(file, database):
            assert isinstance(run, StoredRun)
            episode = f"episode {run.number} of {run.world!r}"
            try:
                yield from _damages_of_run(run, episode)
            except (RecordError, SqlError) as error:
                yield Damage(file, error.message.removeprefix(f"{file} "), f"all of {episode}")


def _damages_of_run(run: StoredRun, episode: str) -> Iterator[Damage]:
    history = run.history(run.reader)
    ticks = history.ticks().numbers
    sources = {table: history.stored_rows(table) for table in history.tables}
    sources |= {f"models of {t}": f"SELECT * FROM {history.model_source(t)}" for t in MODELS}  # noqa: S608
    for name, rows in sources.items():
        try:
            run.reader.rows(f"SELECT count(hash(rows)) FROM ({rows}) AS rows")  # noqa: S608
        except (RecordError, SqlError) as error:
            problem = error.message.removeprefix(f"{run.path} ")
            yield Damage(run.path, problem, f"{name} of {episode}")
    if (ticks[1:] <= ticks[:-1]).any():
        yield Damage(run.path, "is damaged: its ticks do not ascend", f"all of {episode}")
