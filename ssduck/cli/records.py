"""Defines the commands about records, and those that bring them to other tools and back."""

from __future__ import annotations

import signal
import sys
import tempfile
from collections.abc import Collection
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ssduck.adapters.display import DisplayTable, print_line, print_table
from ssduck.cli import signals
from ssduck.cli.options import RecordPath, option, write_text
from ssduck.errors import RecordError, warn
from ssduck.formatting import count_of
from ssduck.recording.paths import expand_path, is_record

if TYPE_CHECKING:
    from ssduck.interpreter.interpreter import Interpreter
    from ssduck.limits import Limits
    from ssduck.world.world import World

_Duration = Annotated[
    float, option("The simulated time, s, rounded to whole steps of the scene.", "T", least=0.0)
]
_NewRecord = Annotated[
    Path,
    option(
        "A folder for Parquet files, or a DuckDB file if the name ends with .duckdb. "
        "An existing one gets a new episode.",
        "PATH",
        flags="--output -o",
    ),
]
_Tables = Annotated[
    list[str] | None,
    option(
        "A table to record: entities, links, joints, shapes, contacts or sensings; "
        "may be repeated.",
        "NAME",
        default="all",
    ),
]
_Entities = Annotated[
    list[str] | None,
    option("The name of an entity to record; may be repeated.", "NAME", default="all"),
]

_Tags = Annotated[
    list[str] | None,
    option(
        "What you say of the run, such as task=pick or success=true; may be repeated.",
        "NAME=VALUE",
        flags="--tag",
        default="none",
    ),
]


def record(
    scene: Annotated[str, typer.Argument(metavar="SCENE", help="The name or the path of a scene.")],
    seconds: _Duration,
    output: _NewRecord,
    tables: _Tables = None,
    entities: _Entities = None,
    every: Annotated[int, option("Record only each N-th step.", "N", least=1)] = 1,
    flush_every: Annotated[
        float, option("The real time, s, after which a step is on the disk.", "T", least=0.001)
    ] = 1.0,
    tag: _Tags = None,
) -> None:
    """Simulate a scene and record it; each step of the simulator is a tick."""
    from ssduck.interpreter.archives import episodes as episodes_of
    from ssduck.interpreter.opening import load
    from ssduck.recording.episode import parsed_tag
    from ssduck.recording.spec import Recording
    from ssduck.schema import RECORDABLE
    from ssduck.validation import steps_in

    output = expand_path(output)
    recording = Recording(
        tables=tuple(tables or RECORDABLE),
        entities=None if entities is None else tuple(entities),
        every=every,
        flush_every=flush_every,
    )
    tags = dict(map(parsed_tag, tag or ()))
    to_file = output.suffix == ".duckdb"
    with signals.deferred() as received:
        database = output if to_file else ":memory:"
        with load(scene, database, recording=None) as ss:
            (world,) = ss.worlds
            steps = steps_in(seconds, world.timestep, "--seconds")
            writer = None
            if to_file:
                ss.record(world.name, recording, tags=tags)
            else:
                writer = ss.record_to(output, recording=recording, tags=tags)
            with writer or nullcontext():
                _run(world, steps, received)
    (*_, episode) = (e for e in episodes_of(output) if e.world == world.name)
    times = f"from {episode.start:g} s to {episode.end:g} s"
    if episode.ticks == 1:
        times = f"at {episode.start:g} s"
    ticks = f"{count_of(episode.ticks, 'tick')} of {episode.world!r}, {times}"
    print_line(f"{ticks}: episode {episode.number} in {output}")
    if received:
        word = "interrupted" if received[0] == signal.SIGINT else "terminated"
        sys.stderr.write(f"{word}: the record is complete up to then\n")
        raise typer.Exit(128 + received[0])


def _run(world: World, steps: int, received: Collection[int]) -> None:
    """Steps a world until there is a signal; terminals show a progress bar."""
    from rich.console import Console
    from rich.progress import Progress

    console = Console(stderr=True)
    with Progress(console=console, disable=not console.is_terminal, transient=True) as progress:
        for _ in progress.track(range(steps), description=f"Recording {world.name}"):
            if received:
                return
            world.step()


@signals.raised()
def export(
    path: RecordPath,
    output: Annotated[
        Path, option("The folder; it is made if necessary.", "PATH", flags="--output -o")
    ],
    world: Annotated[str | None, option("The world to write.", "NAME", default="all")] = None,
    episode: Annotated[
        int | None,
        option("The number of the episode.", "N", default="the last one of each world", least=0),
    ] = None,
    entities: Annotated[
        list[str] | None,
        option("The name of an entity to write; may be repeated.", "NAME", default="all"),
    ] = None,
    start: Annotated[float | None, option("The simulated time of the first tick, s.", "T")] = None,
    end: Annotated[float | None, option("The simulated time of the last tick, s.", "T")] = None,
    tag: _Tags = None,
    pairs: Annotated[
        float | None,
        option(
            "Write also the table of the pairs of entities within D metres.", "D", default="none"
        ),
    ] = None,
    format: Annotated[
        str,
        option(
            "folder (of Parquet files), lerobot (a dataset), mcap or rrd (files).",
            "FORMAT",
            flags="--format",
        ),
    ] = "folder",
    fps: Annotated[
        int | None,
        option(
            "The frames per second of a dataset of LeRobot.",
            "N",
            default="that of the ticks",
            least=1,
        ),
    ] = None,
) -> None:
    """Write an episode of a record, or a part of it, to a folder or in a format of other tools."""
    from ssduck.interpreter.opening import open_record
    from ssduck.recording.episode import parsed_tag

    tags = dict(map(parsed_tag, tag or ()))
    if format != "folder":
        if pairs is not None:
            raise typer.BadParameter("--pairs: only records have a table of pairs")
        export_as(path, output, format, world, episode, fps, entities, (start, end))
        return
    if fps is not None:
        raise typer.BadParameter("--fps is for lerobot")
    with open_record(path, world, episode) as ss:
        folders = ss.export(output, entities=entities, start=start, end=end, tags=tags, pairs=pairs)
        for name, folder in folders.items():
            print_line(f"{name}: {folder}")


def episodes(path: RecordPath) -> None:
    """List the episodes of a record: number, start, ticks, simulated times, tables and tags."""
    from ssduck.interpreter.archives import episodes as episodes_of

    listed = episodes_of(path)
    columns = ["world", "episode", "started", "ticks", "from", "to", "tables"]
    rows = [
        [e.world, e.number, e.started, e.ticks, e.start, e.end, " ".join(e.tables)] for e in listed
    ]
    if any(e.tags for e in listed):
        columns.append("tags")
        for row, e in zip(rows, listed, strict=True):
            row.append(" ".join(f"{name}={tag}" for name, tag in sorted(e.tags.items())))
    print_table(DisplayTable(columns, rows))


def check(
    path: RecordPath,
    repair: Annotated[
        bool,
        option(
            "Take damaged files out of the record; their names then end in .damaged.",
            flags="--repair",
        ),
    ] = False,
) -> None:
    """List the damaged and missing files of a record, and what is lost with each."""
    from ssduck.interpreter.archives import check as damages_of

    path = expand_path(path)
    damages = damages_of(path, repair=repair)
    if not damages:
        print_line(f"{path} is intact")
        return
    rows = [(str(d.file), d.problem, d.loss, d.is_repaired) for d in damages]
    print_table(DisplayTable(["file", "problem", "lost", "repaired"], rows))
    if not all(damage.is_repaired for damage in damages):
        raise typer.Exit(1)


def open_or_load(location: str, episode: int | None, limits: Limits | None = None) -> Interpreter:
    """Returns an interpreter for a record or a scene."""
    from ssduck.interpreter import opening

    if is_record(location):
        return opening.open_record(location, episode=episode, limits=limits)
    if episode is not None:
        raise typer.BadParameter(f"--episode: {location} is no record")
    return opening.load(location, limits=limits)


# -- other tools ------------------------------------------------------------------------------


def macros(
    names: Annotated[
        list[str] | None,
        typer.Argument(metavar="NAME", help="A relation to write; all are by default."),
    ] = None,
    record: Annotated[
        Path | None,
        option(
            "A folder whose tables become views, with relations that look things up in them.",
            "RECORD",
            flags="--of",
        ),
    ] = None,
    world: Annotated[str | None, option("The world of the record.", "NAME")] = None,
    episode: Annotated[
        int | None, option("The number of the episode.", "N", default="the last one", least=0)
    ] = None,
    output: Annotated[
        Path | None, option("The file.", "FILE", flags="--output -o", default="standard output")
    ] = None,
) -> None:
    """Write relations as macros for plain DuckDB, which needs no ssduck then.

    The comments at the beginning name the relations that are not there, and why.
    """
    from ssduck.interchange.macros import macro_script
    from ssduck.interpreter.archives import folder_run

    if record is None and (world is not None or episode is not None):
        raise typer.BadParameter("--world, --episode: name the record by --of")
    run = None if record is None else folder_run(record, world, episode)
    script = macro_script(tuple(names or ()), run)
    if names:  # of all relations, some are never there
        for name, reason in script.missing.items():
            warn(f"{name} is not written: it is {reason}")
    write_text(script.text.rstrip("\n"), output)


def export_as(
    path: Path,
    output: Path,
    format: str,
    world: str | None,
    episode: int | None,
    fps: int | None,
    entities: list[str] | None,
    between: tuple[float | None, float | None],
) -> None:
    """Writes episodes of a record in a format of other tools: all of them, or one."""
    from ssduck.interchange.conversion import write_runs
    from ssduck.interpreter.archives import episodes
    from ssduck.interpreter.opening import open_record
    from ssduck.recording.folder_episodes import runs_in

    is_part = entities is not None or between != (None, None)
    with tempfile.TemporaryDirectory() as folder:
        place = expand_path(path)
        if place.is_dir() and not is_part:
            listed = runs_in(place.absolute())
        else:  # a DuckDB file, or a part of an episode: an export has it as a folder
            for one in episodes(path):
                if one.ticks and world in (None, one.world) and episode in (None, one.number):
                    with open_record(path, one.world, one.number) as ss:
                        ss.export(folder, entities=entities, start=between[0], end=between[1])
            listed, episode = runs_in(Path(folder)), None
        runs = [
            run
            for run in listed
            if world in (None, run.world) and episode in (None, run.number) and run.has_ticks
        ]
        if not runs:
            raise RecordError(f"{path} has no such episode with ticks")
        for written in write_runs(runs, output, format, fps):
            print_line(str(written))


@signals.raised()
def import_(
    source: Annotated[
        Path,
        typer.Argument(metavar="SOURCE", help="An MCAP file, or a folder with a LeRobot dataset."),
    ],
    output: Annotated[
        Path, option("The folder of the record; it may have others.", "PATH", flags="--output -o")
    ],
    world: Annotated[
        str | None, option("The name of the world.", "NAME", default="that of the source, or world")
    ] = None,
    rate: Annotated[
        float | None,
        option("Ticks per second of an MCAP file.", "N", default="those of its messages"),
    ] = None,
) -> None:
    """Write the poses of an MCAP file or of a LeRobot dataset as a record.

    A warning says what they do not tell of.
    """
    from ssduck.interchange.conversion import import_poses

    output = expand_path(output)
    for episode in import_poses(source, output, world=world, rate=rate):
        ticks = f"{count_of(episode.ticks, 'tick')} of {episode.world!r}"
        print_line(f"{ticks}: episode {episode.number} in {output}")
