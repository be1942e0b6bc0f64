"""Defines the graphs of `AS graph`: networkx graphs that can be drawn where their entities are."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import networkx as nx
import numpy as np
from PIL import Image, ImageDraw

from ssduck.adapters.charts import COLOURS, INK, WHITE, chart, font, png
from ssduck.errors import ArgumentError
from ssduck.geometry.arrays import Array

# The planes of pictures: the axes to the right and upwards.
_PLANES = {"XY": (0, 1), "XZ": (0, 2), "YZ": (1, 2)}
_KINDS = {"robot": COLOURS[1], "kinbody": COLOURS[0], "sensor": COLOURS[2], "link": COLOURS[4]}
_SIZE, _RADIUS, _ARROW, _NAME_HEIGHT = 480, 6, 9, 14
_LEADER = (170, 175, 185)
# The share of the picture's size around the nodes.
_BORDER = 0.12
_SMALLEST = 1e-3


class _Drawn:
    """Draws a graph whose nodes have positions, m, and kinds."""

    def image(self, plane: str | None = None) -> Image.Image:
        """Returns a picture with the nodes at their positions, with axes in metres and a legend."""
        places, axes = _places(self, plane)
        points = np.array(list(places.values())).reshape(-1, 2)
        low, high = _bounds(points)
        scale = _SIZE / float((high - low).max())
        width, height = (np.maximum((high - low) * scale, 1)).astype(int).tolist()
        area = Image.new("RGB", (width, height), WHITE)
        draw = ImageDraw.Draw(area)
        pixels = {
            name: ((x - low[0]) * scale, height - (y - low[1]) * scale)
            for name, (x, y) in places.items()
        }
        for start, end in {edge[:2] for edge in self.edges()}:  # type: ignore[attr-defined]
            _draw_arrow(draw, pixels[start], pixels[end])
        kinds = nx.get_node_attributes(self, "kind")
        for name, (x, y) in pixels.items():
            box = (x - _RADIUS, y - _RADIUS, x + _RADIUS, y + _RADIUS)
            draw.ellipse(box, fill=_KINDS.get(kinds.get(name, ""), WHITE), outline=INK)
        _draw_names(draw, {str(name): place for name, place in pixels.items()}, area.size)
        entries = [(colour, kind) for kind, colour in _KINDS.items() if kind in kinds.values()]
        return chart(area, (low.tolist(), high.tolist()), _labels(axes), entries=entries)

    def _repr_png_(self) -> bytes:
        """Returns `image()` as a PNG picture for notebooks."""
        return png(self.image())


class EntityGraph(_Drawn, nx.DiGraph):  # type: ignore[misc]
    """A directed graph of entities."""


class EntityMultiGraph(_Drawn, nx.MultiDiGraph):  # type: ignore[misc]
    """A directed graph of entities with any number of edges between two of them."""


def _places(graph: Any, plane: str | None) -> tuple[dict[Any, tuple[float, float]], str]:
    """Returns the places of the nodes in a plane, m, and the plane."""
    if plane is not None and plane not in _PLANES:
        raise ArgumentError(f"plane: {plane!r} is not one of {', '.join(_PLANES)}")
    found = nx.get_node_attributes(graph, "position")
    positions = {name: _position(found.get(name)) for name in graph.nodes}
    if plane is None:
        extents = np.ptp([*positions.values()] or [[0.0] * 3], axis=0)
        # Of equal extents, x and y come first.
        plane = max(_PLANES, key=lambda name: round(sum(extents[list(_PLANES[name])]), 6))
    first, second = _PLANES[plane]
    return {name: (p[first], p[second]) for name, p in positions.items()}, plane


def _position(value: Any) -> list[float]:
    is_position = isinstance(value, list | tuple) and len(value) == 3
    numbers = [part if isinstance(part, int | float) else math.nan for part in value or ()]
    return [*map(float, numbers)] if is_position and np.isfinite(numbers).all() else [0.0] * 3


def _bounds(points: Array) -> tuple[Array, Array]:
    """Returns the corners of the area of a picture of points."""
    if not len(points):
        return np.zeros(2), np.ones(2)
    low, high = points.min(axis=0), points.max(axis=0)
    border = max(float((high - low).max()) * _BORDER, _SMALLEST)
    # A row of nodes has room for its names.
    least = np.maximum((high - low).max() * 0.4 - (high - low), 0.0) / 2
    return low - border - least, high + border + least


def _labels(plane: str) -> tuple[str, str]:
    return f"{plane[0].lower()} [m]", f"{plane[1].lower()} [m]"


def _draw_arrow(
    draw: ImageDraw.ImageDraw, start: tuple[float, float], end: tuple[float, float]
) -> None:
    """Draws an arrow from the rim of a node to that of another one."""
    dx, dy = end[0] - start[0], end[1] - start[1]
    length = math.hypot(dx, dy)
    if length <= 2 * _RADIUS:
        return
    ux, uy = dx / length, dy / length
    tip = (end[0] - _RADIUS * ux, end[1] - _RADIUS * uy)
    back = (tip[0] - _ARROW * ux, tip[1] - _ARROW * uy)
    side = _ARROW * 0.4
    draw.line((start[0] + _RADIUS * ux, start[1] + _RADIUS * uy, *back), fill=INK)
    wings = [(back[0] - side * uy, back[1] + side * ux), (back[0] + side * uy, back[1] - side * ux)]
    draw.polygon([tip, *wings], fill=INK)


def _draw_names(
    draw: ImageDraw.ImageDraw, pixels: dict[str, tuple[float, float]], size: tuple[int, int]
) -> None:
    """Writes the names of nodes beside them, where there is room; a line leads to a distant one."""
    taken = [(x - _RADIUS, y - _RADIUS, x + _RADIUS, y + _RADIUS) for x, y in pixels.values()]
    for name, (x, y) in pixels.items():
        length = font().getlength(name) + 2
        boxes = [
            (left, top, left + length, top + _NAME_HEIGHT)
            for left, top in _places_of_name(x, y, length)
            if 0 <= left <= size[0] - length and 0 <= top <= size[1] - _NAME_HEIGHT
        ] or [(x, y, x + length, y + _NAME_HEIGHT)]
        free = (box for box in boxes if not any(_overlap(box, other) for other in taken))
        box = next(free, boxes[0])
        taken.append(box)
        near = min(max(x, box[0]), box[2]), min(max(y, box[1]), box[3])
        if math.dist(near, (x, y)) > 2 * _RADIUS:
            draw.line((x, y, *near), fill=_LEADER)
        middle = (box[0] + 1, (box[1] + box[3]) / 2)
        draw.text(
            middle, name, fill=INK, font=font(), anchor="lm", stroke_width=1, stroke_fill=WHITE
        )


def _places_of_name(x: float, y: float, length: float) -> Iterator[tuple[float, float]]:
    """Yields upper left corners for the name of a node, the nearest ones first."""
    for distance in range(_RADIUS + 2, 8 * _NAME_HEIGHT, _NAME_HEIGHT // 2):
        middle = y - _NAME_HEIGHT / 2
        for shift in (0, -distance, distance):
            yield x + distance, middle + shift
            yield x - distance - length, middle + shift
        yield x - length / 2, y - distance - _NAME_HEIGHT
        yield x - length / 2, y + distance


def _overlap(a: tuple[float, ...], b: tuple[float, ...]) -> bool:
    """Checks whether two boxes (left, top, right, bottom) overlap."""
    return a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]
