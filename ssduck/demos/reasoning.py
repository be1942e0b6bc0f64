"""A robot's way through a cluttered hall, found by one hierarchical query.

The places are the cells of a grid. A query moves from cell to cell, and stops where the robot would
be too near to something. A function finds such obstacles by the exact shapes, in a what-if world
with the robot in the cell. `MEMORIZE` makes a graph of the reached cells and returns the shortest
path.

Two checks do not use that query. The robot tries the same cells in a recording, one query selects
the free ones, and scipy finds the shortest path over them. And the robot drives along the path, and
may not collide at any tick.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

from ssduck.demos.drawing import Colour, TopView
from ssduck.demos.grid import Cell, SearchGrid, free_cells, shortest_path
from ssduck.demos.placing import Placing
from ssduck.demos.results import keep_picture

if TYPE_CHECKING:
    from ssduck.interpreter.interpreter import Interpreter
    from ssduck.world.entities import Entity

GRID = SearchGrid(first=(0.6, 0.6), side=0.4, counts=(28, 18))
# The robot lies within RADIUS of its axis. Between two cells a disc that moves straight comes
# nearer to things than at the cells by at most sqrt(r² + (side / 2)²) - r.
RADIUS = 0.2
CLEARANCE = math.hypot(RADIUS, GRID.side / 2) - RADIUS
GROUND = ("floor", "goal")
# The distance that the robot drives from tick to tick, m.
STRIDE = 0.05
# The colours of the picture.
FREE: Colour = (70, 150, 90)
WAY: Colour = (200, 30, 30)

PROGRAM = """\
moves = [[1, 0], [0, 1], [-1, 0], [0, -1]];
SELECT to(after(at, m.this), 'cell') FROM m=moves
WHERE after(at, m.this) == goal
START WITH at = start
CONNECT BY MEMORIZE 500 MAXIMUM 1 at = after(at, m.this)
STOP WITH [] != inTheWay(after(at, m.this))
AS list;"""

COLLISIONS = """\
SELECT time(this), id FROM hall{}
WHERE collides(rover, this) AND id(this) != 'floor' AND id(this) != 'goal';"""


def run(folder: Path, say: Callable[[str], None], *, seed: int) -> bool:  # noqa: ARG001
    """Finds, checks and draws the path; uses no random numbers."""
    from ssduck.interpreter.opening import load

    with load("hall") as ss:
        hall = ss.call_variable("hall")
        start, goal = (GRID.cell(hall[name].position) for name in ("rover", "goal"))
        say(PROGRAM)
        path = query_path(ss, start, goal, say)
        view = TopView(hall, (-0.2, -0.2), (12.2, 8.2), width=900)
    with load("hall") as ss:
        free = free_cells(ss, ss.call_variable("hall")["rover"], GRID, CLEARANCE, GROUND)
        least = len(shortest_path(free, start, goal)) - 1
        say(
            f"{len(free)} of {len(GRID.cells())} cells are free; the shortest way by scipy's "
            f"Dijkstra: {'none' if least < 0 else f'{least} steps, {least * GRID.side:g} m'}"
        )
    hits = None
    if path:
        with load("hall") as ss:
            ticks, hits = drive(ss, [start, *path])
        rover_hits = "no collision" if not hits else f"collisions: {hits[:5]}"
        say(f"Driven in {ticks} recorded ticks: {rover_hits}")
    draw(view, free, [start, *path])
    legend = [(FREE, "a free cell"), (WAY, "the shortest way")]
    target = keep_picture(view.with_axes(legend), folder / "reasoning.png")
    say(f"Cells that are free, and the way: {target}")
    return bool(path) and len(path) == least and set(path) <= free and hits == []


def query_path(ss: Interpreter, start: Cell, goal: Cell, say: Callable[[str], None]) -> list[Cell]:
    """Returns the cells of the path that the query finds, without the first one."""
    hall = ss.call_variable("hall")
    placing = Placing(hall, hall["rover"], CLEARANCE, ignored=GROUND)

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
    start_time = time.perf_counter()
    paths = ss.eval(PROGRAM)
    seconds = time.perf_counter() - start_time
    path: list[Cell] = [(row[0][0], row[0][1]) for row in paths[0]] if paths else []
    outcome = f"a way of {len(path)} steps, {len(path) * GRID.side:g} m" if path else "no way"
    say(f"The query found {outcome}, in {seconds:.1f} s; it looked at {placing.count} places")
    return path


def drive(ss: Interpreter, path: Sequence[Cell]) -> tuple[int, list[dict[str, object]]]:
    """Drives along cells; returns the number of ticks, and the collisions at them."""
    hall = ss.call_variable("hall")
    rover: Entity = ss.add_variable("rover", hall["rover"])
    height, first = rover.position[2], hall.snapshot.number
    strides = round(GRID.side / STRIDE)
    for before, after in pairwise(map(GRID.place, path)):
        yaw = math.atan2(after[1] - before[1], after[0] - before[0])
        for stride in range(1, strides + 1):
            share = stride / strides
            x, y = (b + share * (a - b) for b, a in zip(before, after, strict=True))
            rover.move([x, y, height], wxyz=[math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)])
            hall.step(12, every=12)
    return hall.snapshot.number - first, ss.eval(COLLISIONS)


def draw(view: TopView, free: set[Cell], path: Sequence[Cell]) -> None:
    """Draws the free cells and the path."""
    for cell in free:
        view.square(GRID.place(cell), 0.1, FREE)
    points = list(map(GRID.place, path))
    view.path(points, WAY, 4)
    for point, name in ((points[0], "start"), (points[-1], "goal")):
        view.dot(point, WAY)
        view.text(point, name)
    words = f"{len(path) - 1} steps, {(len(path) - 1) * GRID.side:g} m"
    view.text(points[len(points) // 2], words)
