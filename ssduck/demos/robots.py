"""Two robots drive about in the kitchen, and a trigger reports which sensors see which robot.

As in the second demonstration of SelectScript's tutorial: the arm on its base and the vacuum
cleaner go to random places in turns, on shortest paths over places that a second simulation found
to be free. They are placed anew every tenth of a second, a millimetre above the floor, without
gravity. The history has to be without collisions, and to agree with the trigger.
"""

from __future__ import annotations

import math
import random
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeAlias

from ssduck.adapters.display import DisplayTable, text_lines
from ssduck.demos.floor import Cell, Place, SearchGrid, TopView, free_cells, shortest_path, strides
from ssduck.demos.results import Say, keep_picture
from ssduck.interpreter.interpreter import Interpreter
from ssduck.recording.spec import Recording
from ssduck.simulators.scenes import find_scene
from ssduck.world.entities import Entity
from ssduck.world.world import World

Sight: TypeAlias = tuple[str, str]
Cells: TypeAlias = dict[str, set[Cell]]
Paths: TypeAlias = dict[str, list[list[Place]]]

# The colours of the robots in pictures.
ROBOTS = {"barrett_4918": (190, 40, 140), "roomba_625x": (20, 110, 200)}
# The floor between the cabinets, metres.
GRID = SearchGrid(first=(-1.05, -2.05), side=0.15, counts=(21, 25))
# Half a diagonal step, and a margin for turning the vacuum cleaner, which is not quite round.
CLEARANCE = GRID.side * math.sqrt(2) / 2 + 0.02
# Metres a second; seconds a step.
SPEED, STEP = 0.5, 0.1
# The least distance of a trip, m.
MIN_TRIP = 1.0
# The gap between robots and floor, and the height of the floor, m.
FLOOR_GAP, FLOOR = 0.001, 0.157

SENSED = """\
env = kitchen;
SELECT to(id(e1.this), 'sensor'), to(id(e2.this), 'robot')
FROM e1=env, e2=env
WHERE isSensor(e1.this) AND isRobot(e2.this) AND isSensing(e1.this, e2.this)
AS dict;"""

COLLISIONS = "SELECT time(this), id FROM kitchen{} WHERE collides(mover, this);"

SIGHTINGS = """
SELECT g.tick, s.name, r.name
FROM sensings_history g
JOIN entities_history s ON s.tick = g.tick AND s.id = g.sensor
JOIN entities_history r ON r.tick = g.tick AND r.id = g.entity
WHERE r.kind = 'robot' AND list_contains($ticks, g.tick)"""


@dataclass
class Watch:
    """Records the callbacks of the trigger: tick, time, and which sensors see which robots."""

    world: World
    callbacks: list[tuple[int, float, frozenset[Sight]]] = field(default_factory=list)

    def __call__(self, rows: list[dict[str, str]]) -> None:
        """Records a callback."""
        sights = frozenset((row["sensor"], row["robot"]) for row in rows)
        self.callbacks.append((self.world.snapshot.number, self.world.time, sights))

    def spans(self) -> list[tuple[float, float, str, str]]:
        """Returns the intervals, start and end, in which a sensor saw a robot, by start."""
        spans = []
        since: dict[Sight, float] = {}
        for _, time, sights in [*self.callbacks, (0, self.world.time, frozenset[Sight]())]:
            spans += [(since.pop(sight), time, *sight) for sight in since.keys() - sights]
            since |= dict.fromkeys(sights - since.keys(), time)
        return sorted(spans)


def run(folder: Path, say: Say, *, seed: int, trips: int = 3) -> bool:
    """Lets both robots drive, reports what sensors see, checks the history, draws the paths."""
    free = reachable_cells()
    for name, cells in free.items():
        say(f"{name} can be in {len(cells)} of {len(GRID.cells())} places")
    with still_kitchen() as ss:
        ss.record("kitchen", Recording(tables=("entities", "sensings"), seconds=3600))
        kitchen: World = ss.call_variable("kitchen")
        watch = Watch(kitchen)
        say(SENSED)
        ss.add_trigger("seen", SENSED, 0.2, watch)
        drives = drive_about(kitchen, free, random.Random(seed), trips, say)  # noqa: S311
        kitchen.run(0.5)
        say(f"{kitchen.time:.1f} s; the trigger fired {len(watch.callbacks)} times:")
        rows = [[f"{a:.1f}", f"{b:.1f}", *sight] for a, b, *sight in watch.spans()]
        say("\n".join(text_lines(DisplayTable(["from", "until", "sensor", "sees robot"], rows))))
        hits = collisions(ss, say)
        agrees = history_agrees(ss, watch)
        word = "the same at each of these ticks" if agrees else "something else"
        say(f"What the sensors of the record tell is {word}")
        target = draw(kitchen, drives, folder / "robots.png")
    say(f"Their ways: {target}")
    return not hits and agrees and all(len(paths) == trips for paths in drives.values())


def still_kitchen() -> Interpreter:
    """Returns an interpreter with a kitchen without gravity, the robots just above the floor."""
    scene = replace(find_scene("kitchen"), gravity=(0.0, 0.0, 0.0), timestep=STEP)
    ss = Interpreter()
    kitchen = ss.add_variable("kitchen", World.load(scene))
    for name in ROBOTS:
        robot = kitchen[name]
        x, y, z = robot.position
        robot.move([x, y, z + FLOOR + FLOOR_GAP - robot.aabb[0][2]])
    return ss


def reachable_cells() -> Cells:
    """Returns, for each robot, the cells where only the other robot may be near."""
    free = {}
    for name in ROBOTS:
        with still_kitchen() as ss:
            kitchen = ss.call_variable("kitchen")
            # The floor is near everywhere: lowered, it leaves the walls and cabinets.
            kitchen["kitchen"].move([0.0, 0.0, -2 * CLEARANCE])
            free[name] = free_cells(ss, kitchen[name], GRID, CLEARANCE, ROBOTS)
    return free


def drive_about(kitchen: World, free: Cells, rng: random.Random, trips: int, say: Say) -> Paths:
    """Drives the robots to random places in turns; returns the paths of each."""
    drives: Paths = {name: [] for name in ROBOTS}
    for _ in range(trips):
        for name in ROBOTS:
            robot = kitchen[name]
            (other,) = (kitchen[other] for other in ROBOTS if other != name)
            path = random_path(robot, clear_cells(robot, other, free[name]), rng)
            if path is None:
                say(f"{kitchen.time:6.1f} s  {name} is shut in")
                continue
            x, y = path[-1]
            say(f"{kitchen.time:6.1f} s  {name} drives to ({x:.2f}, {y:.2f})")
            turns = name == "roomba_625x"
            for _ in strides(robot, path, SPEED * STEP, math.ceil, turns=turns):
                kitchen.step()
            drives[name].append(path)
    return drives


def clear_cells(robot: Entity, other: Entity, cells: set[Cell]) -> set[Cell]:
    """Returns the cells where a robot keeps clear of another one at any orientation."""
    distance = horizontal_radius(robot) + horizontal_radius(other) + CLEARANCE
    x, y, _ = other.position
    return {cell for cell in cells if math.dist(GRID.place(cell), (x, y)) > distance}


def horizontal_radius(robot: Entity) -> float:
    """Returns the largest horizontal distance of a robot's box from its position, metres."""
    (x0, y0, _), (x1, y1, _) = robot.aabb
    x, y, _ = robot.position
    return math.hypot(max(x - x0, x1 - x), max(y - y0, y1 - y))


def random_path(robot: Entity, free: set[Cell], rng: random.Random) -> list[Place] | None:
    """Returns a path from the robot to a random cell; None if there is none."""
    here: Place = (robot.position[0], robot.position[1])
    start = GRID.cell(here)
    goals = [cell for cell in sorted(free) if math.dist(GRID.place(cell), here) >= MIN_TRIP]
    rng.shuffle(goals)
    for goal in goals:
        if path := shortest_path(free, start, goal, diagonal=True):
            return [here, *map(GRID.place, path[1:])]
    return None


def collisions(ss: Interpreter, say: Say) -> list[dict[str, Any]]:
    """Returns the collisions of the robots at all ticks of the history."""
    say(COLLISIONS)
    all_hits: list[dict[str, Any]] = []
    for name in ROBOTS:
        ss.add_variable("mover", ss.call_variable("kitchen")[name])
        hits = ss.eval(COLLISIONS)
        ((ticks,),) = ss.sql("SELECT count(*) FROM ticks_history").fetchall()
        outcome = f"with others: {hits[:3]}" if hits else "with nothing"
        say(f"In {ticks} ticks {name} collides {outcome}")
        all_hits += hits
    return all_hits


def history_agrees(ss: Interpreter, watch: Watch) -> bool:
    """Checks whether the history agrees with the trigger at each tick at which it fired."""
    recorded: dict[int, set[Sight]] = {tick: set() for tick, _, _ in watch.callbacks}
    for tick, sensor, robot in ss.sql(SIGHTINGS, {"ticks": list(recorded)}).fetchall():
        recorded[tick].add((sensor, robot))
    return all(recorded[tick] == sights for tick, _, sights in watch.callbacks)


def draw(kitchen: World, drives: Paths, target: Path) -> Path:
    """Draws the kitchen from above with the paths of the robots; returns the file."""
    view = TopView(kitchen, (-1.8, -2.6), (2.6, 2.7), floor=FLOOR, width=700)
    for name, paths in drives.items():
        for path in paths:
            view.path(path, ROBOTS[name], 4)
            view.dot(path[0], ROBOTS[name], 4)
        if paths:
            view.dot(paths[-1][-1], ROBOTS[name], 7)
            view.text(paths[-1][-1], name, ROBOTS[name])
    legend = [(colour, f"path of {name}") for name, colour in ROBOTS.items()]
    return keep_picture(view.with_axes(legend), target)
