"""Draws pictures of scenes from above, with paths and names on them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageDraw, ImageFont

from ssduck.adapters.charts import chart
from ssduck.errors import SelectScriptError
from ssduck.simulators.scenes import Camera

if TYPE_CHECKING:
    from ssduck.world.world import World

Point: TypeAlias = tuple[float, float]
Colour: TypeAlias = tuple[int, int, int]

# The height of the camera in widths of the picture: from higher up, high things lean outwards
# less.
_HEIGHT = 4.0
_INK: Colour = (20, 22, 26)


def save(picture: npt.NDArray[np.uint8] | Image.Image, target: Path) -> None:
    """Writes a picture in the format of the suffix.

    Raises:
        SelectScriptError: the file cannot be written.
    """
    image = picture if isinstance(picture, Image.Image) else Image.fromarray(picture)
    try:
        image.save(target, optimize=True)
    except (OSError, ValueError) as error:  # ValueError: unknown suffix
        reason = error.strerror if isinstance(error, OSError) else error
        raise SelectScriptError(f"{target} cannot be written: {reason}") from error


class TopView:
    """A picture of a world from above, for drawing in metres.

    x points right, y up. The picture is a rendering from far above: drawings lie on a plane at
    the height of the floor, and higher things lean outwards a little.

    Args:
        world: the world.
        low: the visible corner of least x and y, metres.
        high: the opposite corner.
        floor: the height of the plane of drawings, metres.
        width: the width of the picture, pixels; its height follows.
    """

    def __init__(
        self, world: World, low: Point, high: Point, *, floor: float = 0.0, width: int = 800
    ) -> None:
        wide, deep = high[0] - low[0], high[1] - low[1]
        self._scale = width / wide
        self._corner = (low[0], high[1])
        height = round(width * deep / wide)
        far = _HEIGHT * max(wide, deep)
        centre = ((low[0] + high[0]) / 2, (low[1] + high[1]) / 2)
        # A camera that looks straight down has no up direction, so it stands south by less
        # than a pixel.
        camera = Camera(
            eye=(centre[0], centre[1] - 1e-4 * far, floor + far),
            target=(*centre, floor),
            fov=2 * math.degrees(math.atan2(deep / 2, far)),
        )
        self.image = Image.fromarray(world.render(width, height, camera, shadow=False))
        self._draw = ImageDraw.Draw(self.image)
        self._font = ImageFont.load_default(13)

    def with_axes(self, legend: Sequence[tuple[Colour, str]]) -> Image.Image:
        """Returns the picture with axes in metres, and with a legend at its right.

        Args:
            legend: the colours and what they mean.
        """
        width, height = self.image.size
        left, high = self._corner
        bounds = (left, high - height / self._scale), (left + width / self._scale, high)
        return chart(self.image, bounds, ("x [m]", "y [m]"), entries=legend)

    def pixel(self, point: Sequence[float]) -> Point:
        """Returns the position of a point in the picture, x to the right and y down."""
        return (
            (point[0] - self._corner[0]) * self._scale,
            (self._corner[1] - point[1]) * self._scale,
        )

    def path(self, points: Iterable[Sequence[float]], colour: Colour, width: int = 3) -> None:
        """Draws a line through points."""
        pixels = [self.pixel(point) for point in points]
        if len(pixels) > 1:
            self._draw.line(pixels, fill=colour, width=width, joint="curve")

    def dot(self, point: Sequence[float], colour: Colour, radius: float = 6.0) -> None:
        """Draws a disc with a rim; the radius is in pixels."""
        x, y = self.pixel(point)
        box = (x - radius, y - radius, x + radius, y + radius)
        self._draw.ellipse(box, fill=colour, outline=_INK)

    def square(self, point: Sequence[float], side: float, colour: Colour) -> None:
        """Draws the outline of an axis-aligned square around a point; the side is in metres."""
        x, y = self.pixel(point)
        half = side * self._scale / 2
        self._draw.rectangle((x - half, y - half, x + half, y + half), outline=colour)

    def text(self, point: Sequence[float], text: str, colour: Colour = _INK) -> None:
        """Writes text beside a point on a light background, within the picture."""
        x, y = self.pixel(point)
        left, top, right, bottom = self._draw.textbbox((0, 0), text, font=self._font)
        wide, high = right - left + 6, bottom - top + 4
        x = min(max(x + 8, 0), self.image.width - wide)
        y = min(max(y - high - 4, 0), self.image.height - high)
        self._draw.rectangle((x, y, x + wide, y + high), fill=(255, 255, 255))
        self._draw.text((x + 3 - left, y + 2 - top), text, fill=colour, font=self._font)
