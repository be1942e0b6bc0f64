"""Defines the command `ssduck view`."""

from __future__ import annotations

import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Annotated

import typer

from ssduck.recording.paths import is_record

if TYPE_CHECKING:
    from ssduck.view.view import View


def view(
    location: Annotated[
        str, typer.Argument(metavar="SCENE|RECORD", help="A scene, or the path of a record.")
    ] = "kitchen",
    episode: Annotated[
        int | None,
        typer.Option(
            min=0,
            metavar="N",
            help="The number of the episode of a record.",
            show_default="the last one",
        ),
    ] = None,
    host: Annotated[
        str,
        typer.Option(
            metavar="ADDRESS",
            help="The address to listen at. Another one than 127.0.0.1 lets other computers ask.",
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
    """Yields the page of a scene, which it runs, or of a record.

    Raises:
        BadParameter: an episode of a scene is requested.
    """
    from ssduck.interpreter.opening import load_tried, with_usable_name
    from ssduck.limits import Limits
    from ssduck.simulators.scenes import find_scene
    from ssduck.simulators.trial import Trial
    from ssduck.view.view import view_record, view_scene
    from ssduck.world.world import World

    if is_record(location):
        with view_record(location, episode, host=host, port=port) as page:
            yield page
        return
    if episode is not None:
        raise typer.BadParameter(f"--episode: {location} is no record")
    scene = with_usable_name(find_scene(location))
    trial = Trial(scene, Limits(trial=True))

    def load() -> World:
        world = load_tried(scene, trial)
        world.name = scene.name
        return world

    with view_scene(load, host=host, port=port) as page:
        yield page
