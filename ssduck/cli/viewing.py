"""Defines the commands that show something: `view`, `render`, `scenes` and `functions`."""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ssduck.adapters.display import DisplayTable, print_line, print_table
from ssduck.cli.options import EpisodeNumber, Location, option
from ssduck.recording.paths import is_record

if TYPE_CHECKING:
    from ssduck.simulators.scenes import Camera
    from ssduck.view.view import View


def view(
    location: Location = "kitchen",
    episode: EpisodeNumber = None,
    host: Annotated[
        str,
        option(
            "The address to listen at. Another one than 127.0.0.1 lets other computers ask.",
            "ADDRESS",
        ),
    ] = "127.0.0.1",
    port: Annotated[
        int,
        typer.Option(
            min=0, max=65535, metavar="N", help="The port to listen at.", show_default="a free one"
        ),
    ] = 0,
    browser: Annotated[
        bool, typer.Option("--browser/--no-browser", help="Whether to open a browser.")
    ] = True,
) -> None:
    r"""Show a scene or a record in the browser, in 3-D and with a box for queries.

    The address, with the token that it needs, is the first line. Ctrl-C ends it. The page needs an
    extra: pip install 'ssduck\[view]'
    """
    from ssduck.adapters.optional import library

    library("websockets", "view")

    with _opened_view(location, episode, host, port) as page:
        typer.echo(page.url)
        sys.stdout.flush()
        if browser:
            typer.launch(page.url)
        threading.Event().wait()


@contextmanager
def _opened_view(location: str, episode: int | None, host: str, port: int) -> Iterator[View]:
    """Yields the page of a scene, which it runs, or of a record."""
    from ssduck.interpreter.opening import with_usable_name
    from ssduck.simulators.scenes import find_scene
    from ssduck.view.view import view_record, view_scene
    from ssduck.world.world import World

    if is_record(location):
        with view_record(location, episode, host=host, port=port) as page:
            yield page
        return
    if episode is not None:
        raise typer.BadParameter(f"--episode: {location} is no record")
    scene = with_usable_name(find_scene(location))

    def load() -> World:
        world = World.load(scene)
        world.name = scene.name
        return world

    with view_scene(load, host=host, port=port) as page:
        yield page


def render(
    location: Location,
    output: Annotated[Path, option("A file .png, .gif or .mp4.", "FILE", flags="-o --output")],
    start: Annotated[
        float | None, option("The simulated time of the first picture, s.", "T", flags="--from")
    ] = None,
    end: Annotated[
        float | None,
        option("The simulated time of the last picture, or of a PNG, s.", "T", flags="--to"),
    ] = None,
    speed: Annotated[float, option("Simulated seconds a second of the film.", "X")] = 1.0,
    fps: Annotated[float, option("Pictures a second.", "N")] = 30.0,
    size: Annotated[str, option("Width and height, pixels.", "WxH")] = "1280x720",
    eye: Annotated[
        str | None, option("The place of the camera, m.", "X,Y,Z", default="the scene's camera")
    ] = None,
    target: Annotated[str | None, option("Where the camera looks, m.", "X,Y,Z")] = None,
    fov: Annotated[float, option("The vertical field of view, with --eye.", "DEGREES")] = 50.0,
    highlight: Annotated[
        str | None,
        option("A query, asked at each picture: what it finds stands out, or why.", "QUERY"),
    ] = None,
    sql: Annotated[bool, option("The query is SQL, not SelectScript.", flags="--sql")] = False,
    episode: EpisodeNumber = None,
) -> None:
    r"""Draw a picture or a film of a scene or a record, without a screen.

    It needs an extra: pip install 'ssduck\[render]'
    """
    from ssduck.render.rendering import SECONDS, Film
    from ssduck.render.rendering import render as draw

    span = None
    if start is not None or end is not None:
        first = 0.0 if start is None else start
        span = first, (first + SECONDS if end is None else end)
    film = Film(
        span=span,
        speed=speed,
        fps=fps,
        size=_size(size),
        camera=_camera(eye, target, fov),
        highlight=highlight,
        language="sql" if sql else "selectscript",
    )
    with _progress() as on_picture:
        path = draw(location, output, film, episode=episode, on_picture=on_picture)
    typer.echo(path)


def _size(text: str) -> tuple[int, int]:
    width, _, height = text.lower().partition("x")
    try:
        return int(width), int(height)
    except ValueError:
        raise typer.BadParameter(f"--size: {text!r} is no size such as 1280x720") from None


def _camera(eye: str | None, target: str | None, fov: float) -> Camera | None:
    from ssduck.simulators.scenes import Camera

    if eye is None:
        if target is not None:
            raise typer.BadParameter("--target needs --eye")
        return None
    if not 0 < fov < 180:
        raise typer.BadParameter(f"--fov: {fov:g} is not between 0 and 180 degrees")
    at = Camera().target if target is None else _point(target, "--target")
    place = _point(eye, "--eye")
    if place == at:
        raise typer.BadParameter("--eye and --target are the same point")
    return Camera(place, at, fov)


def _point(text: str, option: str) -> tuple[float, float, float]:
    try:
        x, y, z = map(float, text.split(","))
    except ValueError:
        raise typer.BadParameter(f"{option}: {text!r} is no point such as 1,-2,1.5") from None
    return x, y, z


@contextmanager
def _progress() -> Iterator[Callable[[int, int], Any]]:
    from rich.console import Console
    from rich.progress import Progress

    console = Console(stderr=True)
    with Progress(console=console, disable=not console.is_terminal, transient=True) as progress:
        task = progress.add_task("pictures", total=None)
        yield lambda number, count: progress.update(task, completed=number, total=count)


def scenes() -> None:
    """List the scenes that come with ssduck."""
    from ssduck.simulators.scenes import read_scene, shipped_scenes

    shipped = [(name, read_scene(path).description) for name, path in shipped_scenes().items()]
    print_table(DisplayTable(["scene", "description"], shipped))


def functions(
    name: Annotated[
        str | None,
        typer.Argument(metavar="NAME", help="The function to describe; all are listed by default."),
    ] = None,
) -> None:
    """List the functions of the language with their usage, or describe one."""
    from ssduck.interpreter.completion import usage_and_summary
    from ssduck.interpreter.interpreter import Interpreter

    with Interpreter() as ss:
        if name is not None:
            print_line(ss.help(name))
            return
        listing = [usage_and_summary(ss.help(known)) for known in ss.help()]
    print_table(DisplayTable(["function", "what it does"], listing))
