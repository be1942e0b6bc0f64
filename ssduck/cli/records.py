"""Defines the commands about records: `ssduck record`, `export` and `episodes`."""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ssduck.adapters.display import DisplayTable, print_line, print_table

if TYPE_CHECKING:
    from ssduck.interpreter.interpreter import Interpreter
    from ssduck.recording.episode import Episode
    from ssduck.world.world import World

# The suffix of DuckDB files, and the position and value of the mark in them.
_DUCKDB_SUFFIX = ".duckdb"
_MAGIC = slice(8, 12), b"DUCK"


def is_record(location: str) -> bool:
    """Checks whether a path is the folder or file of a record; names of shipped scenes are not."""
    from ssduck.simulators.scenes import shipped_scenes

    path = Path(location)
    if location in shipped_scenes():
        return False
    if not path.is_file():
        return path.is_dir()
    position, magic = _MAGIC
    with path.open("rb") as file:
        return file.read(position.stop)[position] == magic


_Duration = Annotated[
    float,
    typer.Option(
        min=0.0, metavar="T", help="The simulated time, s, rounded to whole steps of the scene."
    ),
]
_RecordPath = Annotated[
    Path,
    typer.Option(
        "--output",
        "-o",
        metavar="PATH",
        help="A folder for Parquet files, or a DuckDB file if the name ends with .duckdb. "
        "An existing one gets a new episode.",
    ),
]
_Tables = Annotated[
    list[str] | None,
    typer.Option(
        metavar="NAME",
        help="A table to record: entities, links, joints, shapes, contacts or sensings; "
        "may be repeated.",
        show_default="all",
    ),
]
_Entities = Annotated[
    list[str] | None,
    typer.Option(
        metavar="NAME",
        help="The name of an entity to record; may be repeated.",
        show_default="all",
    ),
]


def record(
    scene: Annotated[str, typer.Argument(metavar="SCENE", help="The name or the path of a scene.")],
    seconds: _Duration,
    output: _RecordPath,
    tables: _Tables = None,
    entities: _Entities = None,
    every: Annotated[int, typer.Option(min=1, metavar="N", help="Record only each N-th step.")] = 1,
) -> None:
    """Simulate a scene and record it; each step of the simulator is a tick."""
    from ssduck.interpreter.opening import load
    from ssduck.recording.spec import Recording
    from ssduck.schema import RECORDABLE
    from ssduck.simulators.scenes import find_scene

    description = find_scene(scene)
    steps = whole_steps(seconds, description.timestep)
    recording = Recording(
        tables=tuple(tables or RECORDABLE),
        entities=None if entities is None else tuple(entities),
        every=every,
    )
    to_file = output.suffix == _DUCKDB_SUFFIX
    opened = load(scene, output, recording=recording) if to_file else load(scene, recording=None)
    with opened as ss, _deferred_ctrl_c() as pressed:
        writer = None if to_file else ss.record_to(output, recording=recording)
        with writer or nullcontext():
            _run(ss.call_variable(description.name), steps, pressed)
    (*_, episode) = (e for e in _episodes(output) if e.world == description.name)
    print_line(
        f"{episode.ticks} ticks of {episode.world!r}, from {episode.start:g} s to "
        f"{episode.end:g} s: episode {episode.number} in {output}"
    )
    if pressed.is_set():
        sys.stderr.write("interrupted: the record is complete up to then\n")
        raise typer.Exit(130)


def whole_steps(seconds: float, timestep: float) -> int:
    """Returns the number of simulation steps in a time.

    Raises:
        BadParameter: the time has too many steps.
    """
    from ssduck.validation import MAX_STEPS

    count = seconds / timestep
    if not count < MAX_STEPS:
        raise typer.BadParameter("--seconds: that is too long")
    return round(count)


def _run(world: World, steps: int, pressed: threading.Event) -> None:
    """Steps a world until Ctrl-C is pressed; terminals show a progress bar."""
    from rich.console import Console
    from rich.progress import Progress

    console = Console(stderr=True)
    with Progress(console=console, disable=not console.is_terminal, transient=True) as progress:
        for _ in progress.track(range(steps), description=f"Recording {world.name}"):
            if pressed.is_set():
                return
            world.step()


@contextmanager
def _deferred_ctrl_c() -> Iterator[threading.Event]:
    """Yields an event that the first Ctrl-C sets; the second one acts as usual."""
    pressed = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield pressed
        return
    handler = signal.getsignal(signal.SIGINT)

    def on_first_ctrl_c(*_: Any) -> None:
        pressed.set()
        signal.signal(signal.SIGINT, handler)

    signal.signal(signal.SIGINT, on_first_ctrl_c)
    try:
        yield pressed
    finally:
        signal.signal(signal.SIGINT, handler)


def export(
    path: Annotated[Path, typer.Argument(metavar="RECORD", help="The record.")],
    output: Annotated[
        Path,
        typer.Option("--output", "-o", metavar="PATH", help="The folder; it is made if necessary."),
    ],
    world: Annotated[
        str | None, typer.Option(metavar="NAME", help="The world to write.", show_default="all")
    ] = None,
    episode: Annotated[
        int | None,
        typer.Option(
            min=0,
            metavar="N",
            help="The number of the episode.",
            show_default="the last one of each world",
        ),
    ] = None,
    entities: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="The name of an entity to write; may be repeated.",
            show_default="all",
        ),
    ] = None,
    start: Annotated[
        float | None, typer.Option(metavar="T", help="The simulated time of the first tick, s.")
    ] = None,
    end: Annotated[
        float | None, typer.Option(metavar="T", help="The simulated time of the last tick, s.")
    ] = None,
) -> None:
    """Write an episode of a record, or a part of it, to a folder of Parquet files."""
    from ssduck.interpreter.opening import open_record

    with open_record(path, world, episode) as ss:
        for name, folder in ss.export(output, entities=entities, start=start, end=end).items():
            print_line(f"{name}: {folder}")


def episodes(
    path: Annotated[Path, typer.Argument(metavar="RECORD", help="The record.")],
) -> None:
    """List the episodes of a record: world, number, start, ticks, simulated times and tables."""
    columns = ["world", "episode", "started", "ticks", "from", "to", "tables"]
    rows = [
        (e.world, e.number, e.started, e.ticks, e.start, e.end, " ".join(e.tables))
        for e in _episodes(path)
    ]
    print_table(DisplayTable(columns, rows))


def _episodes(path: Path) -> list[Episode]:
    from ssduck.interpreter.archives import episodes as episodes_of

    return episodes_of(path)


def open_or_load(location: str, episode: int | None) -> Interpreter:
    """Returns an interpreter for a record or a scene.

    Raises:
        BadParameter: an episode of a scene is requested.
    """
    from ssduck.interpreter import opening

    if is_record(location):
        return opening.open_record(location, episode=episode)
    if episode is not None:
        raise typer.BadParameter(f"--episode: {location} is no record")
    return opening.load(location)
