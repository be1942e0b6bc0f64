"""Pictures of worlds: the camera of those without one, past and what-if worlds, drawn bodies."""

from __future__ import annotations

import io
import math
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from ssduck.errors import SimulatorError, warn
from ssduck.geometry.shapes import PlacedGeometry
from ssduck.simulators.backends import drawn_shapes, stored_visuals
from ssduck.simulators.interface import Body, Simulator
from ssduck.simulators.scenes import Camera

if TYPE_CHECKING:
    from ssduck.geometry.arrays import Array
    from ssduck.world.snapshot import Snapshot

# The size of pictures in notebooks, pixels.
NOTEBOOK_SIZE = (640, 480)


@contextmanager
def renderable(world: Any) -> Iterator[Any]:
    """Yields a `World` that can be rendered: itself or, if it has no simulation, a copy.

    The entities of the copy have the names of the originals, but other ids.
    """
    if not world.is_final:
        yield world
        return
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of what a picture does not show: friction, velocities
        copy = world.posed()
    try:
        yield copy
    finally:
        copy.close()


def png(world: Any) -> bytes:
    """Returns a picture of a `World` by its camera as a PNG file."""
    from PIL import Image

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a notebook may draw a world at any time
        with renderable(world) as rendered:
            pixels = rendered.render(*NOTEBOOK_SIZE, world.camera)
    picture = Image.fromarray(pixels)
    buffer = io.BytesIO()
    picture.save(buffer, "PNG")
    return buffer.getvalue()


# The direction along which it looks, and its angle of view, degrees.
_DIRECTION = np.array([-0.62, 0.62, -0.48]) / np.linalg.norm([-0.62, 0.62, -0.48])
_FOV = 40.0
# What is larger than so many times the middle one of the things that move is left out.
_LARGE = 30.0
# So is what does not move and is larger than so many times all of them, and than furniture, m.
_SURROUNDINGS, _FURNITURE = 2.0, 3.0
# The least radius that is framed, m.
_LEAST = 0.05


def framing_camera(snapshot: Snapshot) -> Camera:
    """Returns a camera that frames the bodies of a tick.

    A ground, walls and terrain around what moves are not framed. Where nothing moves, all is taken
    for what does.
    """
    boxes, movable = _boxes(snapshot)
    if not len(boxes):
        return Camera()
    if not movable.any():
        movable[:] = True
    sizes = np.linalg.norm(boxes[:, 1] - boxes[:, 0], axis=1)
    is_framed = movable & (sizes <= _LARGE * max(float(np.median(sizes[movable])), _LEAST))
    low, high = _union(boxes[is_framed])
    limit = max(_SURROUNDINGS * float(np.linalg.norm(high - low)), _FURNITURE)
    low, high = _union(boxes[is_framed | (~movable & (sizes <= limit))])
    centre, radius = (low + high) / 2, max(float(np.linalg.norm(high - low)) / 2, _LEAST)
    eye = centre - _DIRECTION * radius / math.sin(math.radians(_FOV) / 2)
    x, y, z = eye.tolist()
    return Camera((x, y, z), tuple(centre.tolist()), _FOV)


def _boxes(snapshot: Snapshot) -> tuple[Array, npt.NDArray[np.bool_]]:
    """Returns the boxes of the bodies that have shapes and an end, (n, 2, 3); which can move."""
    corners = ("xmin", "ymin", "zmin", "xmax", "ymax", "zmax")
    boxes, movable = [], []
    for info in snapshot.entities:
        if info.body is None:
            continue
        box = snapshot.doubles_in(snapshot.rows[info.id], corners)
        if all(number is not None and abs(number) < 1e9 for number in box):
            boxes.append(box)
            movable.append(info.body.movable)
    return np.array(boxes, float).reshape(-1, 2, 3), np.array(movable, bool)


def _union(boxes: Array) -> tuple[Array, Array]:
    return boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)


# -- what is drawn ----------------------------------------------------------------------------


class DrawnBodies:
    """Asks a simulator what it draws of a body, while it has the body.

    A simulator may give the number of a removed body to a new one. So a body that is gone has what
    was read last, or its collision shapes if nothing was. If the simulator is gone, all bodies are,
    and a warning says so.
    """

    def __init__(self, simulator: Simulator, is_there: Callable[[Body], bool]) -> None:
        self._simulator, self._is_there = simulator, is_there
        self._read: dict[int, tuple[Body, Sequence[PlacedGeometry]]] = {}
        self._has_told = False

    def __call__(self, body: Body) -> Sequence[PlacedGeometry]:
        """Returns what is drawn of a body."""
        if self._is_there(body):
            try:
                self._read[id(body)] = body, drawn_shapes(self._simulator, body)
            except SimulatorError as error:
                if not self._has_told:
                    self._has_told = True
                    reason = error.message.partition(";")[0]
                    warn(f"{reason}: collision shapes stand in for what it draws")
        known = self._read.get(id(body))
        if known is not None and known[0] is body:
            return known[1]
        return stored_visuals(body)
