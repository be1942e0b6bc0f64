"""Converts records to the formats of other tools, and poses of those formats to records."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, TypeAlias, get_args

from ssduck import validation
from ssduck.errors import ArgumentError, RecordError, check_known, record_errors, warn
from ssduck.formatting import short_repr
from ssduck.interchange import lerobot, lerobot_reader, mcap, mcap_reader, rerun
from ssduck.interchange.motion import motion_of
from ssduck.interchange.pose_batches import Frames, ImportedPoses, PoseBatch, batch_of
from ssduck.interchange.record_writer import KINDS, Entities, RecordWriter, entities_of
from ssduck.recording.episode import Episode
from ssduck.recording.stores.parquet_layout import FolderRun

ForeignFormat: TypeAlias = Literal["lerobot", "mcap", "rrd"]
FORMATS: tuple[str, ...] = get_args(ForeignFormat)
_SUFFIXES = {".mcap": "mcap", ".rrd": "rrd"}


def write_runs(
    runs: Sequence[FolderRun], output: Path, format: str, fps: int | None = None
) -> list[Path]:
    """Writes recorded episodes in a format of other tools, and returns what was written.

    The output is a new folder for LeRobot; for the other formats the file of the only episode, or a
    folder with a file for each. See `ssduck.interchange.lerobot.write_dataset` for `fps`.
    """
    message = f"there is no format {short_repr(format)}: choose one of {', '.join(FORMATS)}"
    check_known(format, FORMATS, message, ArgumentError)
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
    rate: float | None = None,
) -> list[Episode]:
    """Writes the poses of an MCAP file or of a dataset of LeRobot as a record.

    Such files tell of the poses of named frames at most. A warning says what they do not tell of,
    and what is not read.

    In an MCAP file, each frame is where it was told of last, until a message says that it is gone,
    and frames in frames are placed in the world. A tick is at the time of a message; messages of
    several frames that come within a period of the most frequent one are one tick, at the last of
    their times, so that no value is lost.

    Args:
        source: an MCAP file, or the folder of a dataset of LeRobot 3.0.
        folder: the folder of the record; see `ssduck.write_record`.
        entities: descriptions of entities by name, to add their kinds and shapes; others that the
            source tells of have none. See `ssduck.write_record`.
        world: the name of the world; None for that of the source, or `world`.
        rate: ticks per second of an MCAP file, from its first message on; None for the ticks of
            its messages.

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
        if rate is not None:
            raise ArgumentError("rate: a dataset of LeRobot has frames per second of its own")
        episodes = list(lerobot_reader.read_poses(place))
    elif place.is_file():
        if rate is not None:
            most = mcap_reader.MAX_RATE
            rate = validation.positive_number(rate, "rate", "number of ticks per second")
            if rate > most:
                raise ArgumentError(f"rate: at most {most:g} ticks per second, not {rate:g}")
        episodes = [mcap_reader.read_poses(place, rate)]
    else:
        raise RecordError(f"there is no file or folder {place}")
    if not episodes:
        raise RecordError(f"{place} has no episode")
    written = []
    for poses in episodes:
        about = poses.about
        described = _entities(poses.names, about.get("kinds", {}), entities)
        tags = about.get("tags") or {}
        if not isinstance(tags, Mapping):
            raise RecordError(f"{place}: its tags are no object of texts and numbers by name")
        tags = dict(tags)
        if about.get("task") is not None:
            tags.setdefault("task", about["task"])
        name = world or about.get("world") or "world"
        try:
            writer = RecordWriter(folder, described, world=name, tags=tags)
            written.append(writer.write_whole(_batches(writer, poses)))
        except ArgumentError as error:
            is_of_caller = entities is not None or world is not None
            kind = ArgumentError if is_of_caller else RecordError
            message = f"{place}: {error.message}"
            raise kind(message, suggestions=error.suggestions) from error
    unread = list(dict.fromkeys(each for poses in episodes for each in poses.unread))
    warn(_missing(place, unread, has_entities=entities is not None))
    return written


def _batches(writer: RecordWriter, poses: ImportedPoses) -> Iterator[PoseBatch]:
    """Yields the poses of tables; an entity is there when all of its links are."""
    for table in poses.tables:
        yield batch_of(writer.frames, table, None, None, writer.last, are_whole=False)


def _entities(names: Sequence[str], kinds: Any, given: Entities | None) -> Entities:
    """Returns the entities of frames: those given, and one for each frame that is no known link."""
    described: dict[str, dict[str, Any]] = {}
    frames: Sequence[str] = ()
    if given is not None:
        frames = Frames.of(entities_of(given)).names
        own = given if isinstance(given, Mapping) else {name: {} for name in given}
        described = {name: dict(about) for name, about in own.items()}
    for frame in frames:
        message = f"entities: the source does not tell of {short_repr(frame)}"
        check_known(frame, names, message, ArgumentError)
    known = kinds if isinstance(kinds, Mapping) else {}
    for name in names:
        if name in frames:
            continue
        owner = _owner(name, known)
        entity = described.setdefault(owner, {})
        if owner == name:
            kind = known.get(name)
            entity["kind"] = kind if kind in KINDS else "kinbody"
        else:
            entity["links"] = {**entity.get("links", {}), name.removeprefix(f"{owner}."): {}}
    return described


def _owner(name: str, kinds: Mapping[str, Any]) -> str:
    """Returns the entity of a frame: the frame itself unless it is a link of a known one."""
    if name in kinds:
        return name
    owners = [other for other in kinds if name.startswith(f"{other}.")]
    return max(owners, key=len, default=name)


def _missing(place: Path, unread: Sequence[str], *, has_entities: bool) -> str:
    """Returns what the record of a source does not have."""
    lacking = ["contacts, sensors and velocities"]
    if not has_entities:
        lacking.insert(0, "shapes (give them: entities={name: {…}})")
    message = f"{place} tells of poses; its record has no {', no '.join(lacking)}"
    return f"{message}; not read: {', '.join(unread)}" if unread else message
