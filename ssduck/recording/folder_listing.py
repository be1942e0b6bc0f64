"""Lists the episodes of a record in a folder (see `ssduck.recording.stores.parquet_layout`)."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

from ssduck.errors import RecordError
from ssduck.recording.stores.descriptions import read_description
from ssduck.recording.stores.links import check_inside
from ssduck.recording.stores.parquet_layout import LOG, FolderRun
from ssduck.recording.stores.part_names import FORMAT, episode_numbers, names_in

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
_EPISODE = re.compile(r"(.+)-(0|[1-9][0-9]{0,8})\.json")


def runs_in(path: Path) -> list[FolderRun]:
    """Returns the runs in a folder, sorted by world and number; looks at none of their files.

    Of a record with any number of episodes, those without rows are found by two listings a world.

    Raises:
        RecordError: the folder is no record, a damaged one, or one of a newer version; or it has
            ticks of an episode, and not the file that describes it.
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
    place = path / "episodes"
    check_inside(path, place)
    matches = map(_EPISODE.fullmatch, names_in(place))
    keys = sorted((match.group(1), int(match.group(2))) for match in matches if match)
    return [FolderRun(path, world, number) for world, number in keys]


def lost_runs(path: Path, keys: Iterable[tuple[str, int]]) -> Iterator[FolderRun]:
    """Yields episodes that have ticks, and no file that describes them.

    Args:
        path: the folder.
        keys: the worlds and numbers of the files that are there.
    """
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
    """Checks that a folder is a record of a known version.

    Raises:
        RecordError: it is not.
    """
    about_file = folder / ABOUT
    if not about_file.is_file():
        raise RecordError(f"{folder} is no record of ssduck: it has no {ABOUT}")
    check_inside(folder, about_file)
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
