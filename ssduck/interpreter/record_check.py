"""Checks records, and repairs them: folders of Parquet files, and DuckDB files."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from ssduck import validation
from ssduck.database.database import Database
from ssduck.database.file_paths import CHECK_HINT, log_of
from ssduck.errors import RecordError, SqlError, record_errors
from ssduck.interpreter.archives import StoredRun, recorded_runs, replayed_world
from ssduck.recording.folder_check import DAMAGED, Damage, check_folder, set_aside
from ssduck.recording.paths import expand_path
from ssduck.schema import MODELS


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
    database = Database(":memory:", None)
    try:
        for run in recorded_runs(place, database):
            try:
                if run.has_begun and run.has_ticks:
                    replayed_world(run, database)
            except RecordError as error:
                loss = f"all of episode {run.number} of {run.world!r}"
                yield Damage(run.path, error.message.removeprefix(f"{run.path} "), loss)
    finally:
        database.close()


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
    database = Database(":memory:", None)
    try:
        for run in recorded_runs(file, database):
            assert isinstance(run, StoredRun)
            episode = f"episode {run.number} of {run.world!r}"
            try:
                yield from _damages_of_run(run, episode)
            except (RecordError, SqlError) as error:
                yield Damage(file, error.message.removeprefix(f"{file} "), f"all of {episode}")
    finally:
        database.close()


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
