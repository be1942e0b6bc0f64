"""Opens the page of a scene or a record for `ssduck view`."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import typer

from ssduck.recording.paths import is_record
from ssduck.simulators.scenes import find_scene
from ssduck.view.view import View, view_record, view_scene
from ssduck.world.world import World


@contextmanager
def opened_view(location: str, episode: int | None, host: str, port: int) -> Iterator[View]:
    """Yields the page of a scene, which it runs, or of a record.

    Raises:
        BadParameter: an episode of a scene is requested.
    """
    if is_record(location):
        with view_record(location, episode, host=host, port=port) as page:
            yield page
        return
    if episode is not None:
        raise typer.BadParameter(f"--episode: {location} is no record")
    scene = find_scene(location)

    def load() -> World:
        world = World.load(scene)
        world.name = scene.name
        return world

    with view_scene(load(), load, host=host, port=port) as page:
        yield page
