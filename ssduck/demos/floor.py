"""Grids on the floor: their free cells, shortest paths over them, and pictures from above."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise, product
from typing import TypeAlias

import numpy as np
from PIL import Image, ImageDraw, ImageFont
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from ssduck.adapters.charts import chart
from ssduck.interpreter.interpreter import Interpreter
from ssduck.simulators.scenes import Camera
from ssduck.world.entities import Entity
from ssduck.world.world import World

Cell: TypeAlias = tuple[int, int]
Place: TypeAlias = tuple[float, float]
Colour: TypeAlias = tuple[int, int, int]

# The height of the camera in widths of the picture: the higher, the less things lean outwards.
_HEIGHT = 4.0
_INK: Colour = (20, 22, 26)

_OCCUPIED = """\
SELECT tick(this) FROM world{}
WHERE near(tried, this, least) AND NOT id(this) IN ignored
AS list;"""


@dataclass(frozen=True)
class SearchGrid:
    """A grid of square cells on the floor.

    Attributes:
        first: the centre of cell (0, 0), metres.
        side: the distance of the centres of neighbours, metres.
        counts: the number of cells along x and y.

    >>> grid = SearchGrid(first=(0.5, 0.5), side=1.0, counts=(3, 2))
    >>> grid.place((2, 1)), grid.cell((1.4, 0.2)), (3, 0) in grid
    ((2.5, 1.5), (1, 0), False)
    """

    first: Place
    side: float
    counts: Cell

    def place(self, cell: Sequence[int]) -> Place:
        """Returns the centre of a cell, metres."""
        return self.first[0] + self.side * cell[0], self.first[1] + self.side * cell[1]

    def cell(self, place: Sequence[float]) -> Cell:
        """Returns the cell whose centre is nearest to a place, possibly outside the grid."""
        x, y = ((place[axis] - self.first[axis]) / self.side for axis in (0, 1))
        return round(x), round(y)

    def __contains__(self, cell: Sequence[int]) -> bool:
        return all(0 <= number < count for number, count in zip(cell, self.counts, strict=True))

    def cells(self) -> list[Cell]:
        """Returns all cells."""
        return list(product(range(self.counts[0]), range(self.counts[1])))


def free_cells(
    ss: Interpreter, robot: Entity, grid: SearchGrid, clearance: float, ignored: Collection[str]
) -> set[Cell]:
    """Returns the cells in which a robot keeps a distance, m, to all but some entities.

    The robot moves to one cell after the other, each at a tick of the history, and stays in the
    last one; a single query finds all ticks at which something was too near.
    """
    world = ss.add_variable("world", robot.world)
    variables = {"tried": robot, "least": clearance, "ignored": [robot.name, *ignored]}
    for name, value in variables.items():
        ss.add_variable(name, value)
    height = robot.position[2]
    cells_by_tick: dict[int, Cell] = {}
    for cell in grid.cells():
        robot.move([*grid.place(cell), height])
        cells_by_tick[world.snapshot.number] = cell
    occupied = {cells_by_tick[tick] for tick in ss.eval(_OCCUPIED) if tick in cells_by_tick}
    return set(cells_by_tick.values()) - occupied


def shortest_path(
    free: Collection[Cell], start: Cell, goal: Cell, *, diagonal: bool = False
) -> list[Cell]:
    """Returns the shortest path over free cells from a start to a goal; empty if there is none.

    Start and goal are part of it, free or not. Diagonal steps are to cells that share a corner.

    >>> shortest_path({(1, 0), (1, 1), (1, 2)}, (0, 0), (0, 2))
    [(0, 0), (1, 0), (1, 1), (1, 2), (0, 2)]
    """
    cells = sorted({*free, start, goal})
    numbers = {cell: number for number, cell in enumerate(cells)}
    moves = [(1, 0), (0, 1), *([(1, 1), (1, -1)] if diagonal else [])]
    steps = [
        (number, numbers[x + dx, y + dy], math.hypot(dx, dy))
        for (x, y), number in numbers.items()
        for dx, dy in moves
        if (x + dx, y + dy) in numbers
    ]
    first, second, lengths = np.array(steps).reshape(-1, 3).T
    graph = coo_array((lengths, (first.astype(int), second.astype(int))), shape=(len(cells),) * 2)
    distances, predecessors = dijkstra(
        graph, directed=False, indices=numbers[goal], return_predecessors=True
    )
    if not math.isfinite(distances[numbers[start]]):
        return []
    path = [numbers[start]]
    while path[-1] != numbers[goal]:
        path.append(int(predecessors[path[-1]]))
    return [cells[number] for number in path]


def strides(
    robot: Entity,
    path: Iterable[Place],
    length: float,
    rounded: Callable[[float], int],
    turns: bool,
) -> Iterator[None]:
    """Moves a robot along a path in strides of about a length, m, and yields after each."""
    height = robot.position[2]
    for before, after in pairwise(path):
        dx, dy = after[0] - before[0], after[1] - before[1]
        yaw = math.atan2(dy, dx) if turns else 0.0
        count = rounded(math.hypot(dx, dy) / length)
        for share in (number / count for number in range(1, count + 1)):
            place = [before[0] + share * dx, before[1] + share * dy, height]
            robot.move(place, wxyz=[math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)])
            yield


class TopView:
    """A picture of a world from above, for drawing in metres; x points right, y up.

    Args:
        world: the world.
        low: the visible corner of least x and y, metres.
        high: the opposite corner.
        floor: the height of the plane of drawings, metres.
        width: the width of the picture, pixels; its height follows.
    """

    def __init__(
        self, world: World, low: Place, high: Place, *, floor: float = 0.0, width: int = 800
    ) -> None:
        wide, deep = high[0] - low[0], high[1] - low[1]
        self._scale = width / wide
        self._corner = (low[0], high[1])
        height = round(width * deep / wide)
        far = _HEIGHT * max(wide, deep)
        centre = ((low[0] + high[0]) / 2, (low[1] + high[1]) / 2)
        # Straight down there is no up direction, so the camera stands south by less than a pixel.
        camera = Camera(
            eye=(centre[0], centre[1] - 1e-4 * far, floor + far),
            target=(*centre, floor),
            fov=2 * math.degrees(math.atan2(deep / 2, far)),
        )
        self.image = Image.fromarray(world.render(width, height, camera, shadow=False))
        self._draw = ImageDraw.Draw(self.image)
        self._font = ImageFont.load_default(13)

    def with_axes(self, legend: Sequence[tuple[Colour, str]]) -> Image.Image:
        """Returns the picture with axes in metres, and with a legend of colours at its right."""
        width, height = self.image.size
        left, high = self._corner
        bounds = (left, high - height / self._scale), (left + width / self._scale, high)
        return chart(self.image, bounds, ("x [m]", "y [m]"), entries=legend)

    def pixel(self, point: Sequence[float]) -> Place:
        """Returns the position of a point in the picture, x to the right and y down."""
        x, y = point[0] - self._corner[0], self._corner[1] - point[1]
        return x * self._scale, y * self._scale

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
