"""Draws charts with Pillow, in a plane or in space, with axes in metres and a legend."""

from __future__ import annotations

import io
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageDraw, ImageFont

from ssduck.geometry.arrays import Array, Indices

Colour: TypeAlias = tuple[int, int, int]

INK: Colour = (40, 44, 52)
WHITE: Colour = (255, 255, 255)
_DARK: tuple[Colour, ...] = (
    (31, 119, 180),
    (230, 120, 20),
    (44, 160, 44),
    (200, 40, 45),
    (148, 103, 189),
    (140, 86, 75),
    (227, 119, 194),
    (110, 110, 110),
    (170, 170, 30),
    (23, 170, 190),
)
# Ten colours, and the same in lighter shades.
COLOURS = (*_DARK, *(((r + 255) // 2, (g + 255) // 2, (b + 255) // 2) for r, g, b in _DARK))
# The largest number of entries of a legend.
MAX_ENTRIES = 20
_FONT_SIZE = 12
_MARGIN, _TICK, _LINE = 10, 5, 18
_SCALE_WIDTH = 14


@dataclass(frozen=True)
class ColourScale:
    """The colours of numbers.

    Attributes:
        label: what the numbers are, and their unit.
        largest: the number of the last colour; that of the first one is 0.
        colours: the colours, in equal steps.
        whole: whether the numbers are whole.
    """

    label: str
    largest: float
    colours: Sequence[Colour]
    whole: bool = False


def font() -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    """Returns the font of labels."""
    return ImageFont.load_default(_FONT_SIZE)


def ticks(low: float, high: float, count: int = 6, *, whole: bool = False) -> list[float]:
    """Returns at most about `count` round numbers between two numbers, which are finite.

    >>> ticks(-1.7, 2.45)
    [-1.0, 0.0, 1.0, 2.0]
    """
    if not low < high:
        return [low]
    rough = (high - low) / count
    power = 10.0 ** math.floor(math.log10(rough))
    step = next(power * factor for factor in (1, 2, 5, 10) if power * factor >= rough)
    step = max(step, 1.0) if whole else step
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    return [float(f"{number * step:.9g}") for number in range(first, last + 1)]


def legend(names: Sequence[str], colours: Sequence[Colour] = COLOURS) -> list[tuple[Colour, str]]:
    """Returns the entries of a legend; a last one counts the names left out."""
    entries = [(colours[n % len(colours)], name) for n, name in enumerate(names[:MAX_ENTRIES])]
    omitted = len(names) - len(entries)
    return [*entries, (WHITE, f"and {omitted} more")] if omitted > 0 else entries


def chart(
    area: Image.Image,
    bounds: tuple[Sequence[float], Sequence[float]],
    labels: tuple[str, str],
    *,
    entries: Sequence[tuple[Colour, str]] = (),
    scale: ColourScale | None = None,
) -> Image.Image:
    """Returns a picture with axes, and with a legend or a scale of colours at its right."""
    (left, low), (right, high) = bounds
    width, height = area.size
    x_ticks = ticks(left, right, max(2, width // 45))
    y_ticks = ticks(low, high, max(2, height // 40))
    start = _MARGIN + _LINE + _TICK + max(_text_width(f"{value:g}") for value in y_ticks) + 4
    side = beside(entries, scale, height)
    size = (start + width + _MARGIN + side.width, max(height + 3 * _LINE, side.height) + _MARGIN)
    picture = Image.new("RGB", size, WHITE)
    picture.paste(area.convert("RGB"), (start, _MARGIN))
    picture.paste(side, (start + width + _MARGIN, _MARGIN))
    draw, face, bottom = ImageDraw.Draw(picture), font(), _MARGIN + height
    draw.rectangle((start - 1, _MARGIN - 1, start + width, bottom), outline=INK)
    for value in x_ticks:
        x = start + (value - left) / (right - left) * width if right > left else start
        draw.line((x, bottom, x, bottom + _TICK), fill=INK)
        draw.text((x, bottom + _TICK + 2), f"{value:g}", fill=INK, font=face, anchor="mt")
    for value in y_ticks:
        y = bottom - (value - low) / (high - low) * height if high > low else bottom
        draw.line((start - _TICK, y, start - 1, y), fill=INK)
        draw.text((start - _TICK - 3, y), f"{value:g}", fill=INK, font=face, anchor="rm")
    centre = start + width / 2
    draw.text((centre, bottom + _TICK + _LINE), labels[0], fill=INK, font=face, anchor="mt")
    upright = _upright_text(labels[1])
    picture.paste(upright, (_MARGIN, _MARGIN + (height - upright.height) // 2))
    return picture


def beside(
    entries: Sequence[tuple[Colour, str]], scale: ColourScale | None, height: int
) -> Image.Image:
    """Returns the picture of a legend or of a scale of colours."""
    if scale is not None:
        return _scale_picture(scale, height)
    if not entries:
        return Image.new("RGB", (1, 1), WHITE)
    width = max(_text_width(text) for _, text in entries) + _LINE + _MARGIN
    picture = Image.new("RGB", (width, _LINE * len(entries) + 1), WHITE)
    draw, face = ImageDraw.Draw(picture), font()
    for row, (colour, text) in enumerate(entries):
        top = row * _LINE
        if not text.startswith("and ") or colour != WHITE:
            draw.rectangle((0, top + 3, 11, top + 14), fill=colour, outline=INK)
        draw.text((_LINE, top + _LINE / 2), text, fill=INK, font=face, anchor="lm")
    return picture


def _scale_picture(scale: ColourScale, height: int) -> Image.Image:
    values = ticks(0.0, scale.largest, max(2, height // 50), whole=scale.whole)
    texts = [f"{value:g}" for value in values]
    upright = _upright_text(scale.label)
    text_left = _SCALE_WIDTH + _TICK + 3
    width = text_left + max(map(_text_width, texts)) + upright.width + _MARGIN + 4
    picture = Image.new("RGB", (width, height + _MARGIN), WHITE)
    draw, face = ImageDraw.Draw(picture), font()
    for row in range(height):
        share = 1.0 - row / max(height - 1, 1)
        colour = scale.colours[round(share * (len(scale.colours) - 1))]
        draw.line((0, row, _SCALE_WIDTH, row), fill=colour)
    draw.rectangle((0, 0, _SCALE_WIDTH, height - 1), outline=INK)
    for value, text in zip(values, texts, strict=True):
        y = (height - 1) * (1.0 - (value / scale.largest if scale.largest > 0.0 else 0.0))
        draw.line((_SCALE_WIDTH, y, _SCALE_WIDTH + _TICK, y), fill=INK)
        draw.text((text_left, min(max(y, 6), height - 2)), text, fill=INK, font=face, anchor="lm")
    picture.paste(upright, (width - upright.width - 4, max((height - upright.height) // 2, 0)))
    return picture


def _upright_text(text: str) -> Image.Image:
    """Returns a text that runs upwards."""
    picture = Image.new("RGB", (_text_width(text) + 2, _FONT_SIZE + 4), WHITE)
    ImageDraw.Draw(picture).text((1, 1), text, fill=INK, font=font())
    return picture.transpose(Image.Transpose.ROTATE_90)


def _text_width(text: str) -> int:
    return math.ceil(font().getlength(text))


def png(picture: Image.Image) -> bytes:
    """Returns a picture as a PNG file."""
    buffer = io.BytesIO()
    picture.save(buffer, "PNG")
    return buffer.getvalue()


# -- points and triangles in space ------------------------------------------------------------


# The direction to the viewer: degrees about z from x, and above the horizontal.
_AZIMUTH, _ELEVATION = -60.0, 25.0
_SIZE, _EDGE, _GAP = 480, 46, 12
_FAINT = (205, 208, 214)
# A shape in the shade has this share of its colour.
_SHADE = 0.5
# The box around shapes is at least this long, m.
_SMALLEST = 1e-6


class _View:
    """A picture of the box of points in space, seen from the front, the right and slightly above.

    Args:
        points: (n, 3), m; without any, the picture is empty.
    """

    def __init__(self, points: Array) -> None:
        self._low = points.min(axis=0) if len(points) else np.zeros(3)
        high = points.max(axis=0) if len(points) else np.ones(3)
        self._high = np.maximum(high, self._low + _SMALLEST)
        a, e = math.radians(_AZIMUTH), math.radians(_ELEVATION)
        right = np.array([-math.sin(a), math.cos(a), 0.0])
        self.toward = np.array([math.cos(e) * math.cos(a), math.cos(e) * math.sin(a), math.sin(e)])
        self._plane = np.stack((right, np.cross(self.toward, right)), axis=1)
        bounds = zip(self._low, self._high, strict=True)
        corners = np.array(list(itertools.product(*bounds))) @ self._plane
        self._first = corners.min(axis=0)
        extent = np.ptp(corners, axis=0)
        self._scale = _SIZE / float(extent.max())
        self._height = float(extent[1]) * self._scale
        size = (extent * self._scale).astype(int) + 2 * _EDGE
        self._image = Image.new("RGB", (int(size[0]), int(size[1])), WHITE)
        self._draw = ImageDraw.Draw(self._image)
        if len(points):
            self._draw_axes()
        self.canvas = np.array(self._image)

    def pixels(self, points: Array) -> Array:
        """Returns the places of points (…, 3) in the picture, (…, 2)."""
        flat = (points @ self._plane - self._first) * self._scale
        flat[..., 1] = self._height - flat[..., 1]
        placed: Array = flat + _EDGE
        return placed

    def _draw_axes(self) -> None:
        """Draws the floor, the walls behind, and the axes with their ticks."""
        (x0, y0, z0), (x1, y1, z1) = self._low, self._high
        floor = [(x0, y0, z0), (x1, y0, z0), (x1, y1, z0), (x0, y1, z0), (x0, y0, z0)]
        walls = [(x0, y0, z0), (x0, y0, z1), (x0, y1, z1), (x1, y1, z1), (x1, y1, z0)]
        for line in (floor, walls, [(x0, y1, z0), (x0, y1, z1)]):
            self._line(line, _FAINT)
        self._axis("x [m]", 0, (x0, y0, z0), (-4, 8), "rt")
        self._axis("y [m]", 1, (x1, y0, z0), (7, 5), "lt")
        self._axis("z [m]", 2, (x0, y0, z0), (-7, 0), "rm")

    def _axis(
        self, label: str, axis: int, start: Sequence[float], offset: tuple[int, int], anchor: str
    ) -> None:
        """Draws an axis from a corner of the box; its texts lie at an offset from it, pixels."""
        first = np.array(start)
        last = first.copy()
        last[axis] = self._high[axis]
        self._line([first, last], INK)
        length = float(np.linalg.norm(np.diff(self.pixels(np.stack((first, last))), axis=0)))
        for value in ticks(first[axis], last[axis], max(1, int(length // 40))):
            point = first.copy()
            point[axis] = value
            x, y = self.pixels(point)
            self._draw.line((x, y, x + offset[0], y + offset[1]), fill=INK)
            text = (x + 1.4 * offset[0], y + 1.4 * offset[1])
            self._draw.text(text, f"{value:g}", fill=INK, font=font(), anchor=anchor)
        x, y = self.pixels(last if axis == 2 else (first + last) / 2)
        middle = {0: (x - 26, y + 24), 1: (x + 22, y + 20), 2: (x, y - 14)}[axis]
        centred = {0: "rt", 1: "lt", 2: "mm"}[axis]
        self._draw.text(middle, label, fill=INK, font=font(), anchor=centred)

    def _line(self, points: Any, colour: Colour) -> None:
        self._draw.line([(x, y) for x, y in self.pixels(np.array(points)).tolist()], fill=colour)

    def with_legend(self, names: Sequence[str]) -> Image.Image:
        """Returns the canvas with the names of the colours at its right."""
        height, width, _ = self.canvas.shape
        side = beside(legend(names), None, height)
        size = width + _GAP + side.width, max(height, side.height + 2 * _GAP)
        whole = Image.new("RGB", size, WHITE)
        whole.paste(Image.fromarray(self.canvas))
        whole.paste(side, (width, _GAP))
        return whole


def draw_points(points: Array, owners: Indices, names: Sequence[str]) -> Image.Image:
    """Returns a picture of points, with a colour for each owner."""
    view = _View(points)
    order = np.argsort(points @ view.toward)  # the nearest points are drawn last
    columns, rows = view.pixels(points[order]).astype(int).T
    colours = np.array(COLOURS, dtype=np.uint8)[owners[order] % len(COLOURS)]
    for right in (0, 1):
        view.canvas[rows, columns + right] = colours
    return view.with_legend(names)


def draw_triangles(triangles: Array, owners: Indices, names: Sequence[str]) -> Image.Image:
    """Returns a picture of triangles, (n, 3, 3), m; the rest is as for `draw_points`."""
    view = _View(triangles.reshape(-1, 3))
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    light = view.toward + np.array([0.2, 0.0, 0.5])
    shares = np.abs(normals @ (light / np.linalg.norm(light)))
    shares /= np.where(lengths > 0.0, lengths, 1.0)
    shades = (_SHADE + (1.0 - _SHADE) * shares)[:, None] * np.array(COLOURS)[owners % len(COLOURS)]
    depths = triangles @ view.toward
    _fill(view.canvas, view.pixels(triangles), depths, shades.astype(np.uint8))
    return view.with_legend(names)


def _fill(canvas: npt.NDArray[np.uint8], corners: Array, depths: Array, colours: Array) -> None:
    """Fills triangles by a depth buffer: a pixel shows the nearest triangle."""
    nearest = np.full(canvas.shape[:2], -np.inf)
    first = np.ceil(corners.min(axis=1)).astype(int)
    last = np.floor(corners.max(axis=1)).astype(int) + 1
    sides = corners[:, 1:] - corners[:, :1]
    areas = sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0]
    seen = (np.abs(areas) > 1e-9) & (last > first).all(axis=1)
    for n in np.nonzero(seen)[0].tolist():
        (left, top), (right, bottom) = first[n], last[n]
        x = np.arange(left, right) - corners[n, 0, 0]
        y = np.arange(top, bottom)[:, None] - corners[n, 0, 1]
        (ax, ay), (bx, by) = sides[n] / areas[n]
        second, third = x * by - y * bx, y * ax - x * ay
        a, b, c = depths[n]
        depth = a + second * (b - a) + third * (c - a)
        window = nearest[top:bottom, left:right]
        inside = (second >= 0) & (third >= 0) & (second + third <= 1) & (depth > window)
        window[inside] = depth[inside]
        canvas[top:bottom, left:right][inside] = colours[n]
