"""Places on a floor: cells of a grid, which of them a robot may be in, and ways over these."""

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

_TRIED = """\
SELECT tick(this) FROM world{}
WHERE near(tried, this, apart) AND NOT id(this) IN leftOut
AS list;"""


@dataclass(frozen=True)
class SearchGrid:
    """Square cells on the floor.

    Attributes:
        first: the middle of cell (0, 0), metres.
        side: how far the middles of neighbours are apart, metres.
        counts: how many cells there are along x and y.
    """

    first: Place
    side: float
    counts: Cell

    def place(self, cell: Sequence[int]) -> Place:
        """The middle of a cell, metres."""
        return self.first[0] + self.side * cell[0], self.first[1] + self.side * cell[1]

    def cell(self, place: Sequence[float]) -> Cell:
        """The cell whose middle is nearest to a place, which may be beyond the grid."""
        x, y = ((place[axis] - self.first[axis]) / self.side for axis in (0, 1))
        return round(x), round(y)

    def __contains__(self, cell: Sequence[int]) -> bool:
        return all(0 <= number < count for number, count in zip(cell, self.counts, strict=True))

    def cells(self) -> list[Cell]:
        """All of them."""
        return list(product(range(self.counts[0]), range(self.counts[1])))


def free_cells(
    ss: Interpreter, robot: Entity, grid: SearchGrid, apart: float, ignored: Collection[str]
) -> set[Cell]:
    """The cells in which a robot, as it is turned, is nowhere too near to anything.

    The robot is put into one after the other, each a tick of the record, and left in the last
    one; one query asks for all ticks at which something was too near.

    Args:
        ss: an interpreter with the robot's world alone; its variables are used.
        robot: who is put into cells.
        grid: the cells.
        apart: how far everything is to be away, metres.
        ignored: names of what may be near.
    """
    world = ss.add_variable("world", robot.world)
    ss.add_variable("tried", robot)
    ss.add_variable("apart", apart)
    ss.add_variable("leftOut", [robot.name, *ignored])
    height = robot.position[2]
    at: dict[int, Cell] = {}
    for cell in grid.cells():
        robot.move([*grid.place(cell), height])
        at[world.snapshot.number] = cell
    taken = {at[tick] for tick in ss.eval(_TRIED) if tick in at}
    return set(at.values()) - taken


def shortest_way(
    free: Collection[Cell], start: Cell, goal: Cell, *, diagonal: bool = False
) -> list[Cell]:
    """The shortest way over free cells from the start to the goal, both included.

    Args:
        free: the cells; the start and the goal are taken to be free.
        start: where it begins.
        goal: where it ends.
        diagonal: whether there are steps to cells that share a corner only.

    Returns:
        The cells on the way; none if there is no way.
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
    far, before = dijkstra(graph, directed=False, indices=numbers[goal], return_predecessors=True)
    if not math.isfinite(far[numbers[start]]):
        return []
    way = [numbers[start]]
    while way[-1] != numbers[goal]:
        way.append(int(before[way[-1]]))
    return [cells[number] for number in way]
