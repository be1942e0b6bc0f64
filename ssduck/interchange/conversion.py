"""Converts records to the formats of other tools, and poses of those formats to records."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, TypeAlias, get_args

from ssduck.errors import ArgumentError, RecordError, nearest, record_errors, warn
from ssduck.formatting import short_repr
from ssduck.interchange import lerobot, lerobot_reader, mcap, rerun
from ssduck.interchange.entities import KINDS, Entities
from ssduck.interchange.motion import motion_of
from ssduck.interchange.record_writer import write_record
from ssduck.recording.episode import Episode
from ssduck.recording.stores.parquet_layout import FolderRun

ForeignFormat: TypeAlias = Literal["lerobot", "mcap", "rrd"]
FORMATS: tuple[str, ...] = get_args(ForeignFormat)
_SUFFIXES = {".mcap": "mcap", ".rrd": "rrd"}


def write_runs(
    runs: Sequence[FolderRun], output: Path, format: str, fps: int | None = None
) -> list[Path]:
    """Writes recorded episodes in a format of other tools.

    Args:
        runs: the episodes.
        output: a new folder for LeRobot; for the other formats the file of the only episode, or a
            folder with a file for each.
        format: lerobot, mcap or rrd.
        fps: the frames per second of LeRobot; see `ssduck.interchange.lerobot.write_dataset`.

    Returns:
        What was written: the folder of the dataset, or the files.

    Raises:
        ArgumentError: there is no such format, or `fps` is not for it, or not above 0.
        RecordError: the record is damaged, or the output cannot be written.
        UnsupportedError: an extra is not installed.
    """
    if format not in FORMATS:
        raise ArgumentError(
            f"there is no format {short_repr(format)}: choose one of {', '.join(FORMATS)}",
            suggestions=nearest(format, FORMATS),
        )
    if format == "lerobot":
        return [lerobot.write_dataset(output, map(motion_of, runs), fps)]
    if fps is not None:
        raise ArgumentError(f"fps: {format} has all ticks; frames per second are for lerobot")
    write = {"mcap": mcap.write_mcap, "rrd": rerun.write_rrd}[format]
    if output.suffix in _SUFFIXES:
        if len(runs) != 1:
            raise ArgumentError(
                f"{output} would be the file of one episode, and there are {len(runs)}: choose "
                "one (--world, --episode), or name a folder"
            )
        return [write(output, motion_of(runs[0]))]
    files = [(output / f"{run.world}-{run.number}.{format}", run) for run in runs]
    return [write(file, motion_of(run)) for file, run in files]


@record_errors()
def import_poses(
    source: str | Path,
    folder: str | Path,
    *,
    entities: Entities | None = None,
    world: str | None = None,
) -> list[Episode]:
    """Writes the poses of an MCAP file or of a dataset of LeRobot as a record.

    Such files tell of the poses of named frames at most. A warning says what they do not tell of.

    Args:
        source: an MCAP file, or the folder of a dataset of LeRobot 3.0.
        folder: the folder of the record; see `ssduck.write_record`.
        entities: descriptions of the entities by name, to add their kinds and shapes; None for
            those that the source tells of, without shapes. See `ssduck.write_record`.
        world: the name of the world; None for that of the source, or `world`.

    Returns:
        The episodes.

    Raises:
        RecordError: the source cannot be read, or has no poses of named frames; or the folder holds
            other files, or cannot be written.
        ArgumentError: an entity is unknown, or its description is wrong.
        UnsupportedError: an extra is not installed.
    """
    place = Path(source).expanduser()
    if place.is_dir():
        episodes = list(lerobot_reader.read_poses(place))
    elif place.is_file():
        episodes = [mcap.read_poses(place)]
    else:
        raise RecordError(f"there is no file or folder {place}")
    if not episodes:
        raise RecordError(f"{place} has no episode")
    written = []
    for rows, told in episodes:
        names = list(dict.fromkeys(rows["name"].to_pylist()))
        described = _entities(names, told.get("kinds", {}), entities)
        tags = told.get("tags") or {}
        if not isinstance(tags, Mapping):
            raise RecordError(f"{place}: its tags are no object of texts and numbers by name")
        tags = dict(tags)
        if told.get("task") is not None:
            tags.setdefault("task", told["task"])
        name = world or told.get("world") or "world"
        try:
            written.append(write_record(folder, described, rows, world=name, tags=tags))
        except ArgumentError as error:
            is_of_caller = entities is not None or world is not None
            kind = ArgumentError if is_of_caller else RecordError
            message = f"{place}: {error.message}"
            raise kind(message, suggestions=error.suggestions) from error
    warn(_missing(place, episodes[0][1], has_entities=entities is not None))
    return written


def _entities(names: Sequence[str], kinds: Any, given: Entities | None) -> Entities:
    """Returns the entities of frames: those given, or one for each frame that is no known link."""
    if given is not None:
        return given
    known = kinds if isinstance(kinds, Mapping) else {}
    described: dict[str, dict[str, Any]] = {}
    for name in names:
        owner = _owner(name, known)
        if owner == name:
            kind = known.get(name)
            described.setdefault(name, {})["kind"] = kind if kind in KINDS else "kinbody"
        else:
            entity = described.setdefault(owner, {})
            entity.setdefault("links", {})[name.removeprefix(f"{owner}.")] = {}
    return described


def _owner(name: str, kinds: Mapping[str, Any]) -> str:
    """Returns the entity of a frame: the frame itself unless it is a link of a known one."""
    if name in kinds:
        return name
    owners = [other for other in kinds if name.startswith(f"{other}.")]
    return max(owners, key=len, default=name)


def _missing(place: Path, told: Mapping[str, Any], *, has_entities: bool) -> str:
    """Returns what a source does not tell of."""
    lacking = ["contacts, sensors and velocities"]
    if not has_entities:
        lacking.insert(0, "shapes (give them: entities={name: {…}})")
    message = f"{place} tells of poses; its record has no {', no '.join(lacking)}"
    ignored = told.get("ignored")
    return f"{message}; not read: {', '.join(ignored)}" if ignored else message
