"""Renders worlds that have no simulation of their own: past ticks and what-if worlds."""

from __future__ import annotations

import io
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ssduck.world.world import World

# The size of pictures in notebooks, pixels.
NOTEBOOK_SIZE = (640, 480)


@contextmanager
def renderable(world: World) -> Iterator[World]:
    """Yields a world that can be rendered: itself or, if it has no simulation, a copy.

    The entities of the copy have the names of the originals, but other ids.
    """
    if not world.is_final:
        yield world
        return
    with warnings.catch_warnings():
        # A picture does not show the velocities of joints.
        warnings.filterwarnings("ignore", message=".*velocities of joints are not recorded")
        copy = world.excerpt(list(world))
    try:
        yield copy
    finally:
        copy.close()


def png(world: World) -> bytes:
    """Returns a picture of a world by its camera as a PNG file."""
    from PIL import Image

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a notebook may draw a world at any time
        with renderable(world) as rendered:
            pixels = rendered.render(*NOTEBOOK_SIZE, world.camera)
    picture = Image.fromarray(pixels)
    buffer = io.BytesIO()
    picture.save(buffer, "PNG")
    return buffer.getvalue()
