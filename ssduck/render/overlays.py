"""Draws the parts of a condition over a picture: two points each, a line, and the margin."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from ssduck.geometry.arrays import Array
from ssduck.logic.why import COLOURS, Why
from ssduck.render.canvas import NEAR, Picture, look_at, projection
from ssduck.simulators.scenes import Camera

# Lines are drawn so many times as large, and made smaller, so that they are smooth.
_SCALE = 3
# The width of a line, the radius of a point and the height of letters, parts of the height; lines
# and letters are large enough in small pictures, too.
_LINE, _POINT, _LETTER = 1 / 260, 1 / 110, 1 / 26


def with_parts(picture: Picture, parts: Sequence[Why], camera: Camera) -> Picture:
    """Returns a picture (height, width, 3) by a camera with parts of a condition drawn over it."""
    height, width = picture.shape[:2]
    overlay = Image.new("RGBA", (_SCALE * width, _SCALE * height))
    draw = ImageDraw.Draw(overlay)
    size = _SCALE * height
    line = max(2 * _SCALE, round(size * _LINE))
    letter = max(12 * _SCALE, size * _LETTER)
    font = ImageFont.load_default(letter)
    labels: list[tuple[float, ...]] = []
    for part in parts:
        ends = _pixels(np.array(part.points), camera, overlay.width, overlay.height)
        if ends is None:
            continue
        colour, radius = COLOURS[part.value], size * _POINT
        draw.line([tuple(end) for end in ends.tolist()], colour, line)
        for x, y in ends.tolist():
            draw.ellipse((x - radius, y - radius, x + radius, y + radius), colour)
        if part.margin is None:
            continue
        text, (x, y) = f"{part.margin:.3g} m", ends.mean(axis=0).tolist()
        style = {"font": font, "anchor": "lm", "stroke_width": round(letter / 10)}
        box = draw.textbbox((x + 2 * radius, y), text, **style)
        while any(_overlap(box, other) for other in labels):
            y += box[3] - box[1]
            box = draw.textbbox((x + 2 * radius, y), text, **style)
        labels.append(box)
        draw.text((x + 2 * radius, y), text, colour, **style, stroke_fill="white")
    smooth = overlay.resize((width, height), Image.Resampling.LANCZOS)
    drawn = Image.alpha_composite(Image.fromarray(picture).convert("RGBA"), smooth)
    return np.asarray(drawn.convert("RGB"))


def _pixels(points: Array, camera: Camera, width: int, height: int) -> Array | None:
    """Returns where two points are seen, (2, 2), x y; None if both are behind the camera.

    One that is behind it is replaced by the point of the line that is just in front.
    """
    eye, target = np.array(camera.eye, float), np.array(camera.target, float)
    matrix = projection(camera.fov, width / height, 1.0) @ look_at(eye, target)
    seen = np.hstack((points, np.ones((2, 1)))) @ matrix.T
    depths = seen[:, 3]
    if (depths < NEAR).all():
        return None
    for behind, front in ((0, 1), (1, 0)):
        if depths[behind] < NEAR:
            share = (depths[front] - NEAR) / (depths[front] - depths[behind])
            seen[behind] = seen[front] + share * (seen[behind] - seen[front])
    x, y = (seen[:, :2] / seen[:, 3:]).T
    return np.stack(((1 + x) / 2 * width, (1 - y) / 2 * height), axis=1)


def _overlap(a: Sequence[float], b: Sequence[float]) -> bool:
    return a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]
