"""A robot's way through a cluttered hall, found by one hierarchical query.

The query moves from cell to cell of a grid, and stops where the robot would be too near to
something in a what-if world. The path is checked against the shortest one over the cells that are
free in a recording, and by driving along it.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Collection, Sequence
from functools import cache
from pathlib import Path

from ssduck.demos.floor import Cell, Colour, SearchGrid, TopView, free_cells, shortest_path, strides
from ssduck.demos.results import Say, keep_picture
from ssduck.interpreter.interpreter import Interpreter
from ssduck.interpreter.opening import load
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


def run(folder: Path, say: Say, *, seed: int) -> bool:  # noqa: ARG001
    """Finds, checks and draws the path; uses no random numbers."""
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
    hits: list[dict[str, object]] = []
    if path:
        with load("hall") as ss:
            ticks, hits = drive(ss, [start, *path])
        outcome = f"collisions: {hits[:5]}" if hits else "no collision"
        say(f"Driven in {ticks} recorded ticks: {outcome}")
    draw(view, free, [start, *path])
    picture = view.with_axes([(FREE, "a free cell"), (WAY, "the shortest way")])
    say(f"Cells that are free, and the way: {keep_picture(picture, folder / 'reasoning.png')}")
    return bool(path) and len(path) == least and set(path) <= free and not hits


def query_path(ss: Interpreter, start: Cell, goal: Cell, say: Say) -> list[Cell]:
    """Returns the cells of the path that the query finds, without the first one."""
    near_at = cache(obstacles_of(ss.call_variable("hall")["rover"], CLEARANCE, GROUND))

    def after(at: list[int], move: list[int]) -> list[int]:
        return [at[0] + move[0], at[1] + move[1]]

    def in_the_way(cell: list[int]) -> list[str]:
        return near_at(*GRID.place(cell)) if cell in GRID else ["the edge of the grid"]

    ss.add_function("after", after, "after(at, move): the cell after a move")
    ss.add_function("inTheWay", in_the_way, "inTheWay(cell): what the robot would be too near to")
    ss.add_variable("start", list(start))
    ss.add_variable("goal", list(goal))
    start_time = time.perf_counter()
    paths = ss.eval(PROGRAM)
    seconds, tried = time.perf_counter() - start_time, near_at.cache_info().misses
    path: list[Cell] = [(row[0][0], row[0][1]) for row in paths[0]] if paths else []
    outcome = f"a way of {len(path)} steps, {len(path) * GRID.side:g} m" if path else "no way"
    say(f"The query found {outcome}, in {seconds:.1f} s; it looked at {tried} places")
    return path


def obstacles_of(
    robot: Entity, clearance: float, ignored: Collection[str]
) -> Callable[[float, float], list[str]]:
    """Returns a function that names what a robot would be too near to at x and y, m."""
    world, orientation, height = robot.world, robot.orientation, robot.position[2]
    others = [e for e in world if e.kind != "sensor" and e.name not in {robot.name, *ignored}]

    def near_at(x: float, y: float) -> list[str]:
        what_if = world.what_if({robot: [*orientation, x, y, height]})
        what_if.request_tables(["shapes"])
        shapes = what_if.snapshot.shapes()
        return [other.name for other in others if shapes.near(robot.id, other.id, clearance)]

    return near_at


def drive(ss: Interpreter, path: Sequence[Cell]) -> tuple[int, list[dict[str, object]]]:
    """Drives along cells; returns the number of ticks, and the collisions at them."""
    hall = ss.call_variable("hall")
    rover: Entity = ss.add_variable("rover", hall["rover"])
    first = hall.snapshot.number
    for _ in strides(rover, map(GRID.place, path), STRIDE, round, turns=True):
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
