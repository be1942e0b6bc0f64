"""Finds the free cells of a grid on the floor, and shortest paths over them."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

if TYPE_CHECKING:
    from ssduck.interpreter.interpreter import Interpreter
    from ssduck.world.entities import Entity

Cell: TypeAlias = tuple[int, int]
Place: TypeAlias = tuple[float, float]

_STRAIGHT = ((1, 0), (0, 1))
_DIAGONAL = ((1, 1), (1, -1))

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
    """Returns the cells in which a robot, at its orientation, keeps clear of everything.

    The robot moves to one cell after the other, each at a tick of the history, and stays in the
    last one; a single query finds all ticks at which something was too near.

    Args:
        ss: an interpreter with the world of the robot; variables are set in it.
        robot: the robot.
        grid: the cells.
        clearance: the required distance to everything, metres.
        ignored: names of entities that may be near.
    """
    world = ss.add_variable("world", robot.world)
    ss.add_variable("tried", robot)
    ss.add_variable("least", clearance)
    ss.add_variable("ignored", [robot.name, *ignored])
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
    """Returns the shortest path over free cells from the start to the goal, both included.

    Args:
        free: the free cells; the start and the goal count as free.
        start: the first cell.
        goal: the last cell.
        diagonal: whether steps to cells that only share a corner are allowed.

    Returns:
        The cells of the path; empty if there is none.

    >>> shortest_path({(1, 0), (1, 1), (1, 2)}, (0, 0), (0, 2))
    [(0, 0), (1, 0), (1, 1), (1, 2), (0, 2)]
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import dijkstra

    cells = sorted({*free, start, goal})
    numbers = {cell: number for number, cell in enumerate(cells)}
    steps = [
        (number, numbers[x + dx, y + dy], math.hypot(dx, dy))
        for (x, y), number in numbers.items()
        for dx, dy in (*_STRAIGHT, *(_DIAGONAL if diagonal else ()))
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
