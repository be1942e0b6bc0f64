"""Renders worlds that have no simulation of their own: past ticks and what-if worlds."""

from __future__ import annotations

import io
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Protocol, TypeVar

import numpy as np
import numpy.typing as npt

from ssduck.simulators.scenes import Camera

# The size of pictures in notebooks, pixels.
NOTEBOOK_SIZE = (640, 480)


class Renderable(Protocol):
    """What this module needs of a world."""

    camera: Camera

    @property
    def is_final(self) -> bool:
        """Whether it has no simulation of its own."""

    def excerpt(self, entities: list[Any]) -> Any:
        """Returns a world with a simulation, of entities of this one."""

    def render(self, width: int, height: int, camera: Camera) -> npt.NDArray[np.uint8]:
        """Returns a picture."""

    def close(self) -> None:
        """Ends the simulation."""

    def __iter__(self) -> Iterator[Any]:
        """Iterates over the entities."""


AnyWorld = TypeVar("AnyWorld", bound=Renderable)


@contextmanager
def renderable(world: AnyWorld) -> Iterator[AnyWorld]:
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


def png(world: Renderable) -> bytes:
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
