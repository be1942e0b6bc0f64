"""A robot's way through a cluttered hall, found by one hierarchical query.

The places are the cells of a grid. A query moves from cell to cell, and stops where the robot
would be too near to something: a function tells what, by the exact shapes, from a what-if world
with the robot there. `MEMORIZE` makes a graph of the cells that are reached, and gives the
shortest way through it.

Two checks do not use that query: the same cells are tried out in a record, about which one
query asks, and scipy looks for the shortest way over those that are free; and the robot drives
the way that was found, in which no tick may find it colliding.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

from ssduck.demos.drawing import TopView
from ssduck.demos.grid import Cell, SearchGrid, free_cells, shortest_way
from ssduck.demos.placing import Placing
from ssduck.demos.results import keep_picture

if TYPE_CHECKING:
    from ssduck.interpreter.interpreter import Interpreter
    from ssduck.world.entities import Entity

GRID = SearchGrid(first=(0.6, 0.6), side=0.4, counts=(28, 18))
# The robot is within this distance of its axis. Between two cells it is nowhere nearer to
# anything than at one of them, less this: sqrt(r² + (side / 2)²) - r, of a disc that moves
# straight by a side.
RADIUS = 0.2
APART = math.hypot(RADIUS, GRID.side / 2) - RADIUS
GROUND = ("floor", "goal")
# Metres a tick, when it drives.
STRIDE = 0.05

PROGRAM = """\
moves = [[1, 0], [0, 1], [-1, 0], [0, -1]];
SELECT to(after(at, m.this), 'cell') FROM m=moves
WHERE after(at, m.this) == goal
START WITH at = start
CONNECT BY MEMORIZE 500 MAXIMUM 1 at = after(at, m.this)
STOP WITH [] != inTheWay(after(at, m.this))
AS list;"""

DRIVEN = """\
SELECT time(this), id FROM hall{}
WHERE collides(rover, this) AND id(this) != 'floor' AND id(this) != 'goal';"""


def run(folder: Path, say: Callable[[str], None], *, seed: int) -> bool:  # noqa: ARG001
    """Find the way, check and draw it; nothing of it is by chance."""
    from ssduck.interpreter.opening import load

    with load("hall") as ss:
        hall = ss.call_variable("hall")
        start, goal = (GRID.cell(hall[name].position) for name in ("rover", "goal"))
        say(PROGRAM)
        way = found_way(ss, start, goal, say)
        view = TopView(hall, (-0.2, -0.2), (12.2, 8.2), width=900)
    with load("hall") as ss:
        free = free_cells(ss, ss.call_variable("hall")["rover"], GRID, APART, GROUND)
        least = len(shortest_way(free, start, goal)) - 1
        say(
            f"{len(free)} of {len(GRID.cells())} cells are free; the shortest way by scipy's "
            f"Dijkstra: {'none' if least < 0 else f'{least} steps, {least * GRID.side:g} m'}"
        )
    hits = None
    if way:
        with load("hall") as ss:
            ticks, hits = driven(ss, [start, *way])
        rover_hits = "no collision" if not hits else f"collisions: {hits[:5]}"
        say(f"Driven in {ticks} recorded ticks: {rover_hits}")
    draw(view, free, [start, *way])
    target = keep_picture(view.image, folder / "reasoning.png")
    say(f"Cells that are free, and the way: {target}")
    return bool(way) and len(way) == least and set(way) <= free and hits == []


def found_way(ss: Interpreter, start: Cell, goal: Cell, say: Callable[[str], None]) -> list[Cell]:
    """The cells that the query goes through, without the first; none if there is no way."""
    hall = ss.call_variable("hall")
    placing = Placing(hall, hall["rover"], APART, ignored=GROUND)

    def after(at: list[int], move: list[int]) -> list[int]:
        return [at[0] + move[0], at[1] + move[1]]

    @cache
    def near(x: int, y: int) -> list[str]:
        return placing.near(*GRID.place((x, y)))

    def in_the_way(cell: list[int]) -> list[str]:
        if cell not in GRID:
            return ["the edge of the grid"]
        return near(*cell)

    ss.add_function("after", after, "Returns the cell after a move.\nUsage: after(at, move)")
    ss.add_function(
        "inTheWay",
        in_the_way,
        "Returns what the robot would be too near to in a cell.\nUsage: inTheWay(cell)",
    )
    ss.add_variable("start", list(start))
    ss.add_variable("goal", list(goal))
    began = time.perf_counter()
    paths = ss.eval(PROGRAM)
    taken = time.perf_counter() - began
    way: list[Cell] = [(row[0][0], row[0][1]) for row in paths[0]] if paths else []
    told = f"a way of {len(way)} steps, {len(way) * GRID.side:g} m" if way else "no way"
    say(f"The query found {told}, in {taken:.1f} s; it looked at {placing.asked} places")
    return way


def driven(ss: Interpreter, way: Sequence[Cell]) -> tuple[int, list[dict[str, object]]]:
    """Drive along cells: how many ticks were taken, and what collided with the robot at them."""
    hall = ss.call_variable("hall")
    rover: Entity = ss.add_variable("rover", hall["rover"])
    height, first = rover.position[2], hall.snapshot.number
    strides = round(GRID.side / STRIDE)
    for before, after in pairwise(map(GRID.place, way)):
        yaw = math.atan2(after[1] - before[1], after[0] - before[0])
        for stride in range(1, strides + 1):
            part = stride / strides
            x, y = (b + part * (a - b) for b, a in zip(before, after, strict=True))
            rover.move([x, y, height], [math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)])
            hall.step(12)
    return hall.snapshot.number - first, ss.eval(DRIVEN)


def draw(view: TopView, free: set[Cell], way: Sequence[Cell]) -> None:
    """Draw where the robot may be, and its way."""
    for cell in free:
        view.square(GRID.place(cell), 0.1, (70, 150, 90))
    points = list(map(GRID.place, way))
    view.path(points, (200, 30, 30), 4)
    for point, name in ((points[0], "start"), (points[-1], "goal")):
        view.dot(point, (200, 30, 30))
        view.text(point, name)
    words = f"{len(way) - 1} steps, {(len(way) - 1) * GRID.side:g} m"
    view.text(points[len(points) // 2], words)
