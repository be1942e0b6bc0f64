"""Two robots drive about in the kitchen, and a trigger tells which sensors see which robot.

As in the second demonstration of SelectScript's tutorial: the arm on its base and the vacuum
cleaner go to random places, in turns. Where each of them can be is tried out in a second
simulation, about whose ticks one query asks; ways are the shortest over the places that are
free. The arm's base goes in any direction without turning, the vacuum cleaner turns.

The robots are put from place to place, a tenth of a second apart: nothing is pushed and
nothing falls. So the kitchen is without gravity here, a step of it takes as long, and the robots
are a millimetre above the floor, which they would else press upon.

In the end the record is asked: no tick may find a robot colliding with anything, and what the
trigger told has to be what the record tells.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from ssduck.adapters.display import DisplayTable, text_lines
from ssduck.demos.drawing import Colour, TopView
from ssduck.demos.grid import Cell, Place, SearchGrid, free_cells, shortest_way
from ssduck.demos.results import keep_picture

if TYPE_CHECKING:
    from ssduck.interpreter.interpreter import Interpreter
    from ssduck.world.entities import Entity
    from ssduck.world.world import World

Sight: TypeAlias = tuple[str, str]

# So many trips a robot makes.
TRIPS = 3
# How each robot is drawn.
ROBOTS: dict[str, Colour] = {"barrett_4918": (190, 40, 140), "roomba_625x": (20, 110, 200)}
# The floor between the cabinets, metres.
GRID = SearchGrid(first=(-1.05, -2.05), side=0.15, counts=(21, 25))
# Half of a diagonal step, and what the vacuum cleaner needs to turn: it is not quite round.
APART = GRID.side * math.sqrt(2) / 2 + 0.02
# Metres a second; seconds a step.
SPEED, STEP = 0.5, 0.1
# A trip is at least that far, m.
LEAST = 1.0
# How far above the floor the lowest point of a robot is, and where the floor is, m.
ABOVE, FLOOR = 0.001, 0.157

SEEN = """\
env = kitchen;
SELECT to(id(e1.this), 'sensor'), to(id(e2.this), 'robot')
FROM e1=env, e2=env
WHERE isSensor(e1.this) AND isRobot(e2.this) AND isSensing(e1.this, e2.this)
AS dict;"""

HIT = "SELECT time(this), id FROM kitchen{} WHERE collides(mover, this);"

TOLD = """
SELECT g.tick, s.name, r.name
FROM sensings_history g
JOIN entities_history s ON s.tick = g.tick AND s.id = g.sensor
JOIN entities_history r ON r.tick = g.tick AND r.id = g.entity
WHERE r.kind = 'robot' AND list_contains($ticks, g.tick)"""


@dataclass
class Watch:
    """What the trigger told: at which tick and time, and which sensors saw which robots then."""

    world: World
    told: list[tuple[int, float, frozenset[Sight]]] = field(default_factory=list)

    def __call__(self, rows: list[dict[str, str]]) -> None:
        """Take it down."""
        seen = frozenset((row["sensor"], row["robot"]) for row in rows)
        self.told.append((self.world.snapshot.number, self.world.time, seen))

    def spans(self) -> list[tuple[float, float, str, str]]:
        """From when until when which sensor saw which robot; the first seen first."""
        spans = []
        since: dict[Sight, float] = {}
        for _, time, seen in [*self.told, (0, self.world.time, frozenset[Sight]())]:
            spans += [(since.pop(sight), time, *sight) for sight in since.keys() - seen]
            since |= dict.fromkeys(seen - since.keys(), time)
        return sorted(spans)


def run(folder: Path, say: Callable[[str], None], *, seed: int, trips: int = TRIPS) -> bool:
    """Let both robots drive, tell what was seen, check the record, draw their ways."""
    from ssduck.recording.spec import Recording

    free = tried()
    for name, cells in free.items():
        say(f"{name} can be in {len(cells)} of {len(GRID.cells())} places")
    with still_kitchen() as ss:
        ss.record("kitchen", Recording(tables=("entities", "sensings"), seconds=3600))
        kitchen: World = ss.call_variable("kitchen")
        watch = Watch(kitchen)
        say(SEEN)
        ss.add_trigger("seen", SEEN, 0.2, watch)
        drives = drive_about(kitchen, free, random.Random(seed), trips, say)  # noqa: S311
        kitchen.run(0.5)
        say(f"{kitchen.time:.1f} s; the trigger fired {len(watch.told)} times:")
        rows = [[f"{a:.1f}", f"{b:.1f}", *sight] for a, b, *sight in watch.spans()]
        say("\n".join(text_lines(DisplayTable(["from", "until", "sensor", "sees robot"], rows))))
        hits = checked(ss, say)
        agrees = told_by_record(ss, watch)
        word = "the same at each of these ticks" if agrees else "something else"
        say(f"What the sensors of the record tell is {word}")
        target = draw(kitchen, drives, folder / "robots.png")
    say(f"Their ways: {target}")
    return not hits and agrees and all(len(ways) == trips for ways in drives.values())


def still_kitchen() -> Interpreter:
    """The kitchen without gravity, its robots just above the floor."""
    from ssduck.interpreter.interpreter import Interpreter
    from ssduck.simulators.scenes import find_scene
    from ssduck.world.world import World

    scene = replace(find_scene("kitchen"), gravity=(0.0, 0.0, 0.0), timestep=STEP)
    ss = Interpreter()
    kitchen = ss.add_variable("kitchen", World.load(scene))
    for name in ROBOTS:
        robot = kitchen[name]
        x, y, z = robot.position
        robot.move([x, y, z + FLOOR + ABOVE - robot.aabb[0][2]])
    return ss


def tried() -> dict[str, set[Cell]]:
    """By robot, the cells in which it is near to nothing but the other one."""
    free = {}
    for name in ROBOTS:
        with still_kitchen() as ss:
            kitchen = ss.call_variable("kitchen")
            # The floor is near wherever one stands; without it, walls and cabinets stay.
            kitchen["kitchen"].move([0.0, 0.0, -2 * APART])
            free[name] = free_cells(ss, kitchen[name], GRID, APART, ROBOTS)
    return free


def drive_about(
    kitchen: World,
    free: dict[str, set[Cell]],
    draw: random.Random,
    trips: int,
    say: Callable[[str], None],
) -> dict[str, list[list[Place]]]:
    """Let the robots go to random places in turns: the ways of each."""
    drives: dict[str, list[list[Place]]] = {name: [] for name in ROBOTS}
    for _ in range(trips):
        for name in ROBOTS:
            robot = kitchen[name]
            others = [kitchen[other] for other in ROBOTS if other != name]
            way = random_way(robot, apart_from(others, robot, free[name]), draw)
            if way is None:
                say(f"{kitchen.time:6.1f} s  {name} is shut in")
                continue
            x, y = way[-1]
            say(f"{kitchen.time:6.1f} s  {name} drives to ({x:.2f}, {y:.2f})")
            drive(robot, way)
            drives[name].append(way)
    return drives


def apart_from(others: Iterable[Entity], robot: Entity, cells: set[Cell]) -> set[Cell]:
    """The cells in which the robot's box, however it is turned, is apart from the others'."""
    for other in others:
        far = reach(robot) + reach(other) + APART
        cells = {cell for cell in cells if math.dist(GRID.place(cell), other.position[:2]) > far}
    return cells


def reach(robot: Entity) -> float:
    """How far the box of a robot is at most from the vertical through its position, metres."""
    (x0, y0, _), (x1, y1, _) = robot.aabb
    x, y, _ = robot.position
    return math.hypot(max(x - x0, x1 - x), max(y - y0, y1 - y))


def random_way(robot: Entity, free: set[Cell], draw: random.Random) -> list[Place] | None:
    """A way from where the robot is to a cell that is drawn; None if it cannot leave."""
    here: Place = (robot.position[0], robot.position[1])
    start = GRID.cell(here)
    far = [cell for cell in sorted(free) if math.dist(GRID.place(cell), here) >= LEAST]
    draw.shuffle(far)
    for goal in far:
        way = shortest_way(free, start, goal, diagonal=True)
        if way:
            return [here, *map(GRID.place, way[1:])]
    return None


def drive(robot: Entity, way: Sequence[Place]) -> None:
    """Move a robot along its way, the simulation running on."""
    world, height = robot.world, robot.position[2]
    for before, after in pairwise(way):
        dx, dy = after[0] - before[0], after[1] - before[1]
        yaw = math.atan2(dy, dx) if robot.name == "roomba_625x" else 0.0
        strides = math.ceil(math.hypot(dx, dy) / (SPEED * STEP))
        for number in range(1, strides + 1):
            part = number / strides
            place = [before[0] + part * dx, before[1] + part * dy, height]
            robot.move(place, [math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)])
            world.step()


def checked(ss: Interpreter, say: Callable[[str], None]) -> list[dict[str, Any]]:
    """What the record tells of collisions, at all of its ticks."""
    say(HIT)
    found: list[dict[str, Any]] = []
    for name in ROBOTS:
        ss.add_variable("mover", ss.call_variable("kitchen")[name])
        hits = ss.eval(HIT)
        ((ticks,),) = ss.sql("SELECT count(*) FROM ticks_history").fetchall()
        told = "with nothing" if not hits else f"with others: {hits[:3]}"
        say(f"In {ticks} ticks {name} collides {told}")
        found += hits
    return found


def told_by_record(ss: Interpreter, watch: Watch) -> bool:
    """Whether the record tells the same as the trigger did, at each tick at which it fired."""
    seen: dict[int, set[Sight]] = {tick: set() for tick, _, _ in watch.told}
    for tick, sensor, robot in ss.sql(TOLD, {"ticks": list(seen)}).fetchall():
        seen[tick].add((sensor, robot))
    return all(seen[tick] == sights for tick, _, sights in watch.told)


def draw(kitchen: World, drives: dict[str, list[list[Place]]], target: Path) -> Path:
    """Draw the kitchen from above, with the ways of the robots; tells where."""
    view = TopView(kitchen, (-1.8, -2.6), (2.6, 2.7), floor=FLOOR, width=700)
    for name, ways in drives.items():
        colour = ROBOTS[name]
        for way in ways:
            view.path(way, colour, 4)
            view.dot(way[0], colour, 4)
        if ways:
            view.dot(ways[-1][-1], colour, 7)
            view.text(ways[-1][-1], name, colour)
    return keep_picture(view.image, target)
