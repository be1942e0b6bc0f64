"""Checks all files of a record in a folder, and repairs it."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

from ssduck.errors import RecordError, RecordPermissionError, warn
from ssduck.recording.episode import new_id
from ssduck.recording.episode_steps import (
    EpisodeSteps,
    NewerStepsError,
    recorded_steps,
    steps_file,
)
from ssduck.recording.folder_episodes import ABOUT, DESCRIPTION, check_about, lost_runs, runs_named
from ssduck.recording.paths import part_name
from ssduck.recording.stores.descriptions import read_description
from ssduck.recording.stores.files import (
    create_file,
    footer_in,
    json_text,
    parquet_problem,
    verified_parquet,
    write_json,
)
from ssduck.recording.stores.parquet_layout import LOG, PAIRS, FolderRun
from ssduck.recording.stores.part_log import log_file_problem, log_files
from ssduck.recording.stores.stored_columns import MISSING
from ssduck.schema import MODELS, RECORDED

# What is added to the name of a damaged file.
DAMAGED = ".damaged"
_UNFINISHED = "is of an export that did not end"
_LABEL = re.compile(rb'\{"episode": "([0-9a-f]+)", "table": ')


@dataclass(frozen=True)
class Damage:
    """A file of a record that is damaged or missing.

    Attributes:
        file: the file.
        problem: what is wrong with it.
        loss: what cannot be read without it.
        is_repaired: whether it was repaired: what is left can be opened.
    """

    file: Path
    problem: str
    loss: str
    is_repaired: bool = False


@dataclass(frozen=True)
class _RunDamage(Damage):
    """A damaged file of an episode."""

    part: int | None = None  # the number of the part of its tables
    log: int | None = None  # the number of files of the log before it


def check_folder(path: Path, *, repair: bool = False) -> list[Damage]:
    """Returns the damaged and missing files of a folder; reads all bytes of all files."""
    try:
        return _checked_folder(path, repair=repair)
    except RecordError:
        raise
    except OSError as error:
        verb = "repaired" if repair else "read"
        raise RecordError(f"{path} cannot be {verb}: {error.strerror or error}") from error


def _checked_folder(path: Path, *, repair: bool) -> list[Damage]:
    damages: list[Damage] = []
    about = path / ABOUT
    try:
        check_about(path)
    except RecordError as error:
        if not (path / "episodes").is_dir() or (about.exists() and "damaged" not in error.message):
            raise
        problem = _problem_of(error, about) if about.exists() else MISSING
        damages.append(Damage(about, problem, "the whole record", is_repaired=repair))
        if repair:
            set_aside(about)
            create_file(about, json_text(DESCRIPTION))
    runs = runs_named(path)
    runs += lost_runs(path, [(run.world, run.number) for run in runs])
    for run in runs:
        found = list(damages_of(run))
        damages += _repair_run(run, found) if repair else found
    for damage, cause in _step_damages(path):
        is_repaired = repair and not isinstance(cause, NewerStepsError)
        if is_repaired:
            set_aside(damage.file)
        damages.append(replace(damage, is_repaired=is_repaired))
    return damages


def _step_damages(path: Path) -> Iterator[tuple[Damage, RecordError]]:
    """Yields the damaged files of the steps of environments, and their errors."""
    for world, number in recorded_steps(path):
        file = steps_file(path, world, number)
        try:
            EpisodeSteps.read(path, world, number)
        except RecordError as error:
            loss = f"the variables, actions and rewards of episode {number} of {world!r}"
            yield Damage(file, _problem_of(error, file), loss), error


def partial_run(run: FolderRun) -> FolderRun:
    """Returns an episode without its damaged parts; warns of each damaged file."""
    damages = list(damages_of(run))
    for damage in damages:
        if damage.part is None and damage.log is None:
            if damage.file == _pairs_file(run):
                continue
            raise RecordError(f"{damage.file} {damage.problem}: {damage.loss} cannot be read")
    for damage in damages:
        warn(f"{damage.file} {damage.problem}; left out: {damage.loss}")
    parts = frozenset(damage.part for damage in damages if damage.part is not None)
    ends = [damage.log for damage in damages if damage.log is not None]
    return replace(run, left_out=parts, log_end=min(ends, default=None))


def damages_of(run: FolderRun) -> Iterator[_RunDamage]:
    """Yields the damaged and missing files of an episode; reads all bytes of all files."""
    episode = f"episode {run.number} of {run.world!r}"
    try:
        tables = run.tables
    except RecordPermissionError:  # it may be intact
        raise
    except RecordError as error:
        yield _RunDamage(run.about_file, _problem_of(error, run.about_file), f"all of {episode}")
        return
    if run.is_unfinished_export:
        yield _RunDamage(run.about_file, _UNFINISHED, f"{episode}, which is not complete")
        return
    for number in run.numbers_to_check(is_model=False):
        for table in tables if number not in run.removed_parts else ():
            if (problem := run.problem(table, number)) is not None:
                file = run.place(table) / part_name(number)
                yield _RunDamage(file, problem, _loss(run, number), part=number)
    for number in run.numbers_to_check(is_model=True):
        for table in (f"models/{model}" for model in MODELS):
            if (problem := run.problem(table, number)) is not None:
                yield _RunDamage(run.place(table) / part_name(number), problem, f"all of {episode}")
    yield from _log_damages(run)
    pairs = _pairs_file(run)
    if pairs.is_file():
        problem = parquet_problem(pairs.read_bytes(), has_checksums=True)
        if problem is not None:
            yield _RunDamage(pairs, problem, "the table of pairs, for other tools")


def _pairs_file(run: FolderRun) -> Path:
    """Returns the file of the pairs of an episode, whether it is there or not."""
    return run.place(PAIRS) / part_name(0)


def _log_damages(run: FolderRun) -> Iterator[_RunDamage]:
    for number, file in enumerate(log_files(run.place(LOG))[: run.log_end]):
        problem = log_file_problem(file, run.key, has_checksums=run.has_checksums)
        if problem is not None:
            loss = "ticks from there to the end of the log"
            yield _RunDamage(file, problem, loss, log=number)
            return


def _loss(run: FolderRun, part: int) -> str:
    """Returns the ticks that are lost with a part."""
    if run.problem("ticks", part) is not None:
        return f"ticks of part {part}"
    file = run.place("ticks") / part_name(part)
    ticks = verified_parquet(file, has_checksums=run.has_checksums).read(["tick"])["tick"]
    first, last = ticks[0].as_py(), ticks[-1].as_py()
    return f"tick {first}" if first == last else f"ticks {first} to {last}"


def _problem_of(error: RecordError, file: Path) -> str:
    return error.message.removeprefix(f"{file} ")


# -- repairing --------------------------------------------------------------------------------


def _repair_run(run: FolderRun, damages: Sequence[_RunDamage]) -> list[Damage]:
    """Takes the damaged files of an episode out of the record; returns what was done."""
    parts = sorted({damage.part for damage in damages if damage.part is not None})
    if parts:  # the description comes first: an interrupted repair leaves no gap
        about = read_description(run.about_file)
        removed = sorted({*about.get("removed", ()), *parts})
        write_json(about | {"removed": removed}, run.about_file)
        for part in parts:
            for table in run.tables:
                set_aside(run.place(table) / part_name(part))
    return [replace(damage, is_repaired=_repair(run, damage)) for damage in damages]


def _repair(run: FolderRun, damage: _RunDamage) -> bool:
    """Repairs a damaged file unless it is of a part; returns whether it is repaired."""
    if damage.part is not None:
        return True
    if damage.log is not None:
        for file in log_files(run.place(LOG))[damage.log :]:
            set_aside(file)
        return True
    if damage.file == _pairs_file(run):
        set_aside(damage.file)
        return True
    is_export = damage.problem == _UNFINISHED
    about = _description_of(run) if damage.file == run.about_file and not is_export else None
    if about is None and not is_export:
        return False
    set_aside(damage.file)
    if about is not None:
        create_file(run.about_file, json_text(about))
    return True


def set_aside(file: Path) -> None:
    """Adds `.damaged` to the name of a file, if it is there; replaces none."""
    if not _is_there(file):
        return
    place, number = file.with_name(f"{file.name}{DAMAGED}"), 1
    while _is_there(place):
        number += 1
        place = file.with_name(f"{file.name}{DAMAGED}-{number}")
    file.rename(place)


def _is_there(file: Path) -> bool:
    """Checks whether there is a file, perhaps a link to nothing."""
    return file.exists() or file.is_symlink()


def _description_of(run: FolderRun) -> dict[str, object] | None:
    """Returns what the files of an episode say of it; None if they are too damaged."""
    tables = [table for table in RECORDED if run.place(table).is_dir()]
    files = sorted(run.place("ticks").glob("part-*.parquet"))
    for file in files:
        with suppress(OSError):
            content = file.read_bytes()
            match = _LABEL.search(footer_in(content))
            if match is None or parquet_problem(content, has_checksums=True) is not None:
                continue
            started = datetime.fromtimestamp(file.stat().st_mtime, UTC)
            return {
                "world": run.world,
                "episode": run.number,
                "id": new_id(),
                "key": json.loads(b'"%s"' % match.group(1)),
                "checksums": "crc32",
                "tables": tables,
                "started": started.isoformat(timespec="seconds"),
                "recording": {"every": 1, "entities": None},
            }
    return None
