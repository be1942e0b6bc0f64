"""Defines the command `ssduck render`."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from ssduck.simulators.scenes import Camera


def render(
    location: Annotated[
        str, typer.Argument(metavar="SCENE|RECORD", help="A scene, or the path of a record.")
    ],
    output: Annotated[
        Path,
        typer.Option("-o", "--output", metavar="FILE", help="A file .png, .gif or .mp4."),
    ],
    start: Annotated[
        float | None,
        typer.Option("--from", metavar="T", help="The simulated time of the first picture, s."),
    ] = None,
    end: Annotated[
        float | None,
        typer.Option(
            "--to", metavar="T", help="The simulated time of the last picture, or of a PNG, s."
        ),
    ] = None,
    speed: Annotated[
        float, typer.Option(metavar="X", help="Simulated seconds a second of the film.")
    ] = 1.0,
    fps: Annotated[float, typer.Option(metavar="N", help="Pictures a second.")] = 30.0,
    size: Annotated[
        str, typer.Option(metavar="WxH", help="Width and height, pixels.")
    ] = "1280x720",
    eye: Annotated[
        str | None,
        typer.Option(
            metavar="X,Y,Z", help="The place of the camera, m.", show_default="the scene's camera"
        ),
    ] = None,
    target: Annotated[
        str | None, typer.Option(metavar="X,Y,Z", help="Where the camera looks, m.")
    ] = None,
    fov: Annotated[
        float, typer.Option(metavar="DEGREES", help="The vertical field of view, with --eye.")
    ] = 50.0,
    highlight: Annotated[
        str | None,
        typer.Option(
            metavar="QUERY",
            help="A query, asked at each picture: the entities of its result stand out.",
        ),
    ] = None,
    sql: Annotated[bool, typer.Option("--sql", help="The query is SQL, not SelectScript.")] = False,
    episode: Annotated[
        int | None,
        typer.Option(
            min=0,
            metavar="N",
            help="The number of the episode of a record.",
            show_default="the last one",
        ),
    ] = None,
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
