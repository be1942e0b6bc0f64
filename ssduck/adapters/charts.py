"""Draws charts with Pillow: pictures with axes in metres, a scale of colours and a legend."""

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

from PIL import Image, ImageDraw, ImageFont

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

    Args:
        low: the first number.
        high: the last number.
        count: the number of ticks.
        whole: whether the ticks have to be whole numbers.

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
    """Returns a picture with axes, and with a legend or a scale of colours at its right.

    Args:
        area: the picture of the area of the axes.
        bounds: the coordinates of its lower left and its upper right corner.
        labels: the labels of the axis to the right and of the axis upwards.
        entries: the colours and texts of the legend.
        scale: the scale of colours.
    """
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
