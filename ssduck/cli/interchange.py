"""Defines the commands for other tools: `ssduck macros`, `import`, and exports to their formats."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Annotated

import typer

from ssduck.adapters.display import print_line
from ssduck.cli import signals
from ssduck.errors import RecordError, warn
from ssduck.formatting import count_of
from ssduck.recording.paths import expand_path


def macros(
    names: Annotated[
        list[str] | None,
        typer.Argument(metavar="NAME", help="A relation to write; all are by default."),
    ] = None,
    record: Annotated[
        Path | None,
        typer.Option(
            "--of",
            metavar="RECORD",
            help="A folder whose tables become views, with relations that look things up in them.",
        ),
    ] = None,
    world: Annotated[
        str | None, typer.Option(metavar="NAME", help="The world of the record.")
    ] = None,
    episode: Annotated[
        int | None,
        typer.Option(
            min=0, metavar="N", help="The number of the episode.", show_default="the last one"
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", "-o", metavar="FILE", help="The file.", show_default="standard output"
        ),
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
    if output is None:
        print_line(script.text.rstrip("\n"))
    else:
        output.write_text(script.text, encoding="utf-8")


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
        Path,
        typer.Option(
            "--output", "-o", metavar="PATH", help="The folder of the record; it may have others."
        ),
    ],
    world: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="The name of the world.",
            show_default="that of the source, or world",
        ),
    ] = None,
    rate: Annotated[
        float | None,
        typer.Option(
            metavar="N",
            help="Ticks per second of an MCAP file.",
            show_default="those of its messages",
        ),
    ] = None,
) -> None:
    """Write the poses of an MCAP file or of a LeRobot dataset as a record.

    A warning says what they do not tell of.
    """
    from ssduck.interchange.conversion import import_poses

    for episode in import_poses(source, output, world=world, rate=rate):
        ticks = f"{count_of(episode.ticks, 'tick')} of {episode.world!r}"
        print_line(f"{ticks}: episode {episode.number} in {output}")
