"""Lists the episodes of folders of Parquet files, begins them, all or none, and removes them."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import Any

from ssduck.errors import RecordError
from ssduck.formatting import short_repr
from ssduck.recording.episode_steps import FOLDER as STEPS
from ssduck.recording.paths import FORMAT, episode_numbers, episodes_named, names_in
from ssduck.recording.stores.descriptions import read_description
from ssduck.recording.stores.files import create_file, is_temporary, json_text
from ssduck.recording.stores.object_store import ObjectPath, remove_tree
from ssduck.recording.stores.parquet_layout import INDEX, LOG, PAIRS, FolderRun
from ssduck.schema import MODELS


def folders_of(tables: Sequence[str]) -> tuple[str, ...]:
    """Returns the names of the folders of an episode with some tables."""
    return (*tables, LOG, INDEX, *(f"models/{table}" for table in MODELS))


def remove_episode(run: FolderRun) -> None:
    """Removes the files of an episode that is not wanted."""
    for name in (*folders_of(run.tables), PAIRS):
        remove_tree(run.place(name))
    (run.path / STEPS / f"{run.world}-{run.number}.json").unlink(missing_ok=True)
    run.about_file.unlink(missing_ok=True)


def missing_folders(path: Path) -> list[Path] | None:
    """Returns the folders that are made for a new record; None if there is one already."""
    if isinstance(path, ObjectPath) or (path / ABOUT).exists():
        return None
    return [folder for folder in (path, *path.parents) if not folder.exists()]


def remove_empty(path: Path, made: Sequence[Path]) -> None:
    """Removes a new record without episodes, and the folders that were made for it.

    Another recorder may have begun an episode in it; then it stays.
    """
    with suppress(OSError, ValueError):
        with suppress(FileNotFoundError):  # the disk was full before
            (path / "episodes").rmdir()
        (path / ABOUT).unlink(missing_ok=True)
        for name, _, _ in os.walk(path, topdown=False):
            if Path(name) != path:
                Path(name).rmdir()
    for folder in made:
        with suppress(OSError, ValueError):  # it has files, or was not made
            folder.rmdir()
    with suppress(OSError, ValueError):
        if (path / "episodes").exists() and not (path / ABOUT).exists():
            create_file(path / ABOUT, json_text(DESCRIPTION))


def begin_episode(path: Path, world: str, about: Mapping[str, Any]) -> FolderRun:
    """Begins a new episode in a folder; creates the folder if necessary."""
    if not world.isidentifier():
        raise RecordError(
            f"a world called {short_repr(world)} cannot be recorded: bind it to a name"
        )
    try:
        str(path.absolute()).encode()  # the Parquet library takes UTF-8 names only
        if path.exists() and not path.is_dir():
            raise RecordError(
                f"{path} is a file, and a record of Parquet files is a folder: give the path of a "
                "new folder, or of a record"
            )
        path.mkdir(parents=True, exist_ok=True)
        about_file = path / ABOUT
        if not about_file.exists():
            others = [file for file in path.iterdir() if not is_temporary(file)]
            # Another recorder may have begun in the meantime.
            if others and not about_file.exists():
                raise RecordError(
                    f"{path} has something else in it, and is no record of ssduck: give a new "
                    "folder, or an empty one"
                )
            create_file(about_file, json_text(DESCRIPTION))
        check_about(path)
        (path / "episodes").mkdir(exist_ok=True)
        return _claim_episode(path, world, about)
    except RecordError:
        raise
    except (OSError, ValueError) as error:  # a null character is a ValueError
        reason = error.strerror if isinstance(error, OSError) else error
        if isinstance(error, OSError) and error.errno == errno.ENAMETOOLONG:
            reason = f"{reason}: files are named after the world; bind it to a shorter name"
        raise RecordError(f"{path} cannot be written: {reason}") from error


def _claim_episode(path: Path, world: str, about: Mapping[str, Any]) -> FolderRun:
    """Creates the file of an episode under a number that is free, after those that are not."""
    numbers = count(_free_number(path, world))
    while True:
        run = FolderRun(path, world, next(numbers))
        if create_file(run.about_file, json_text({**about, "episode": run.number})):
            return run


def _free_number(path: Path, world: str) -> int:
    """Returns the number of an episode that is not there, after one that is."""
    step = 1
    while FolderRun(path, world, step - 1).about_file.exists():
        step *= 2
    # The number step // 2 - 1 is taken, if it is no less than 0, and step - 1 is free.
    taken, free = step // 2 - 1, step - 1
    while free - taken > 1:
        middle = (taken + free) // 2
        if FolderRun(path, world, middle).about_file.exists():
            taken = middle
        else:
            free = middle
    return free


# -- listing them -----------------------------------------------------------------------------

VERSION = 1
UNITS = {
    "position": "m",
    "angle": "rad",
    "time": "s",
    "mass": "kg",
    "force": "N",
    "frame": "world, z up as the scene has it",
    "quaternion": "w, x, y, z",
}
ABOUT = "ssduck.json"
# The contents of that file.
DESCRIPTION = {"format": FORMAT, "version": VERSION, "units": UNITS}


def runs_in(path: Path) -> list[FolderRun]:
    """Returns the runs in a folder, sorted by world and number; looks at none of their files.

    Of a record with any number of episodes, those without rows are found by two listings a world.
    """
    check_about(path)
    runs = runs_named(path)
    for lost in lost_runs(path, [(run.world, run.number) for run in runs]):
        raise RecordError(
            f"{lost.about_file} is missing, and ticks of its episode are there: put it back, or "
            f"move {lost.place('ticks')} elsewhere"
        )
    with_rows = {world: _numbers_with_rows(path, world) for world in {run.world for run in runs}}
    return [replace(run, is_empty=run.number not in with_rows[run.world]) for run in runs]


def runs_named(path: Path) -> list[FolderRun]:
    """Returns the episodes of a folder that have a file, sorted by world and number."""
    return [FolderRun(path, world, number) for world, number in episodes_named(path / "episodes")]


def lost_runs(path: Path, keys: Iterable[tuple[str, int]]) -> Iterator[FolderRun]:
    """Yields episodes that have ticks, and no file that describes them."""
    numbers: dict[str, set[int]] = {}
    for world, number in keys:
        numbers.setdefault(world, set()).add(number)
    folders = {folder for table in ("ticks", LOG) for folder in names_in(path / table)}
    for folder in sorted(folders):
        world = folder.removeprefix("world=")
        for number in sorted(_numbers_with_rows(path, world) - numbers.get(world, set())):
            yield FolderRun(path, world, number)


def _numbers_with_rows(path: Path, world: str) -> set[int]:
    """Returns the numbers of the episodes of a world that have folders of ticks or of a log."""
    places = (path / table / f"world={world}" for table in ("ticks", LOG))
    return set().union(*map(episode_numbers, places))


def check_about(folder: Path) -> None:
    """Checks that a folder is a record of a known version."""
    about_file = folder / ABOUT
    if not about_file.is_file():
        raise RecordError(f"{folder} is no record of ssduck: it has no {ABOUT}")
    about = read_description(about_file)
    if about.get("format") != FORMAT:
        raise RecordError(f"{folder} is no record of ssduck: {about_file} is of another format")
    version = about.get("version")
    if type(version) is not int or version < 1:
        raise RecordError(f"{about_file} is damaged: it has no version")
    if version > VERSION:
        raise RecordError(
            f"{folder} is a record of version {version}; this ssduck reads those up to {VERSION}: "
            "install a newer one"
        )
