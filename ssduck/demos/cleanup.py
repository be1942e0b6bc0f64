"""A robot takes the cups from the kitchen's table to the sink, on paths that it plans itself.

As in SelectScript's tutorial: a query selects the cups that are less than 1.3 m away from the
robot, and another checks the result. `run` asks a recorded run, which comes with ssduck; the
program `examples/cleanup` plans and drives, and asks the same while it works.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from ssduck.demos.kitchen import on
from ssduck.demos.results import Say, keep_picture
from ssduck.errors import ArgumentError
from ssduck.interpreter.archives import episodes
from ssduck.interpreter.interpreter import Interpreter
from ssduck.interpreter.opening import load, open_record
from ssduck.recording.replay.replayed_world import ReplayedWorld
from ssduck.simulators.scenes import Camera
from ssduck.world.entities import Entity
from ssduck.world.world import World

RUN = Path(__file__).with_name("cleanup_run")
PROGRAM = "python -m examples.cleanup"
ROBOT = "barrett_4918"
JOB = """\
barrett = SELECT obj FROM kitchen WHERE id(this) == 'barrett_4918' AS value;
table   = SELECT obj FROM kitchen WHERE id(this) == 'table' AS value;
sink    = SELECT obj FROM kitchen WHERE id(this) == 'sink' AS value;
cleanUp = SELECT obj FROM kitchen
          WHERE isCup(this) AND onX(table, this) AND distance(barrett, this) < 1.3
          AS list;"""
ON_TABLE = "SELECT obj FROM kitchen WHERE isCup(this) AND onX(table, this) AS list;"
IN_SINK = "SELECT obj FROM kitchen WHERE isCup(this) AND onX(sink, this) AS list;"
DEEPEST = """\
SELECT kitchen.penetration(a, b) AS depth, tick
FROM entities_history a JOIN entities_history b USING (tick)
WHERE a.name = ? AND b.mass = 0 ORDER BY depth DESC NULLS LAST LIMIT 1"""
# The allowed penetration of robot and furniture, m: wheels on the floor, a finger that slips.
ALLOWED = 1e-3
VIEW = Camera(eye=(2.6, -0.6, 2.7), target=(0.6, 1.1, 0.8), fov=50.0)


@dataclass
class Outcome:
    """The outcome of cleaning up.

    Attributes:
        cups: the names of the cups to be taken away.
        trouble: the failures by the name of the cup, the latest last.
        left: the names of the cups on the table.
        washed: the names of the cups in the sink.
        deepest: the largest penetration of robot and furniture at a recorded tick, m.
        seconds: the simulated time.
        events: numbers of ticks: when the robot held a cup and when it had dropped it, by
            `"holding "` or `"dropped "` and the name of the cup, and when it was `"deepest"`.
    """

    cups: list[str] = field(default_factory=list)
    trouble: dict[str, list[str]] = field(default_factory=dict)
    left: list[str] = field(default_factory=list)
    washed: list[str] = field(default_factory=list)
    deepest: float = 0.0
    seconds: float = 0.0
    events: dict[str, int] = field(default_factory=dict)

    @property
    def succeeded(self) -> bool:
        """Whether all cups are in the sink and the robot ran into nothing."""
        return not self.left and set(self.cups) <= set(self.washed) and self.deepest <= ALLOWED


def run(folder: Path, say: Say, *, seed: int) -> bool:
    """Asks the recorded run, which has one seed, what happened, and draws pictures of it."""
    (episode,) = episodes(RUN)
    recorded = episode.tags["seed"]
    if seed != recorded:
        raise ArgumentError(
            f"the recorded run has the seed {recorded}, not {seed}; in a checkout of ssduck, "
            f"{PROGRAM} --seed {seed} makes another"
        )
    with open_record(RUN) as ss, load("kitchen", recording=None) as drawn:
        report = Report(ss, folder, say, drawn.call_variable("kitchen"))
        world: ReplayedWorld = ss.call_variable("kitchen")
        world.seek(0.0)
        report.begin()
        for event, tick in sorted(episode.tags.items(), key=lambda item: item[1]):
            what, _, name = event.partition(" ")
            if what == "holding":
                report.approaches(name)
                report.holds(world.seek_tick(int(tick))[name])
            elif what == "dropped":
                report.has_dropped(world.seek_tick(int(tick))[name])
        world.seek_tick(int(episode.last_tick or 0))
        outcome = report.conclude()
    say(f"This was a recorded run. {PROGRAM} in a checkout of ssduck plans and simulates one.")
    return outcome.succeeded


class Report:
    """Reports on a run, live or recorded: its questions, their answers, and pictures.

    Args:
        ss: an interpreter with the world `kitchen`.
        folder: the folder for pictures; None for none.
        say: writes lines of the report.
        drawn: a running kitchen in which the pictures are drawn, for a run that is recorded.
    """

    def __init__(
        self, ss: Interpreter, folder: Path | None, say: Say, drawn: World | None = None
    ) -> None:
        self.ss, self.folder, self.say, self._drawn = ss, folder, say, drawn
        self.world: World = ss.call_variable("kitchen")
        self.outcome = Outcome()
        self._pictures = 0
        ss.add_function("onX", on, "onX(o1, o2): whether the position of o2 is over o1")
        ss.add_function("isCup", lambda e: e.name.startswith("cup"), "isCup(e): by its name")

    def begin(self) -> list[Entity]:
        """Reports the task at the start of a run, and returns the cups to be cleaned up."""
        self._start = self.world.time
        self._draw("before")
        self.say(JOB)
        self.ss.eval(JOB)
        cups: list[Entity] = self.ss.call_variable("cleanUp")
        self.outcome.cups = [cup.name for cup in cups]
        self.say(f"To be taken to the sink: {', '.join(self.outcome.cups) or 'nothing'}.")
        return cups

    def approaches(self, cup: str) -> None:
        """Reports that the robot begins with a cup."""
        self.say(f"{cup}: the robot drives to it, and takes it.")

    def holds(self, cup: Entity) -> None:
        """Reports that the robot has a cup in its hand."""
        self.outcome.events[f"holding {cup.name}"] = self.world.tick_number
        self._draw(f"holding_{cup.name}")

    def has_dropped(self, cup: Entity) -> bool:
        """Reports that the robot has dropped a cup; returns whether it is in the sink."""
        self.outcome.events[f"dropped {cup.name}"] = self.world.tick_number
        if cup not in self.ss.eval(IN_SINK):
            return False
        self.say(f"{cup.name}: is in the sink, at {coordinates(cup)}.")
        return True

    def conclude(self) -> Outcome:
        """Queries and reports the outcome, and returns it."""
        self._draw("after")
        outcome = self.outcome
        outcome.seconds = self.world.time - self._start
        outcome.left = [cup.name for cup in self.ss.eval(ON_TABLE)]
        outcome.washed = [cup.name for cup in self.ss.eval(IN_SINK)]
        ((depth, tick),) = self.ss.sql(DEEPEST, [ROBOT]).fetchall()
        outcome.deepest, outcome.events["deepest"] = depth or 0.0, tick
        self.say(ON_TABLE)
        self.say(f"On the table: {', '.join(outcome.left) or 'no cup'}.")
        self.say(f"In the sink: {', '.join(outcome.washed) or 'no cup'}.")
        for name in outcome.cups:
            if name not in outcome.washed:
                reasons = "; ".join(outcome.trouble.get(name, ["nobody tried"]))
                place = coordinates(self.world[name])
                self.say(f"{name} is not in the sink, but at {place}: {reasons}.")
        self.say(
            f"{outcome.seconds:.0f} s of simulation; the robot was at most "
            f"{1000 * outcome.deepest:.2f} mm deep in furniture or floor."
        )
        return outcome

    def _draw(self, name: str) -> None:
        """Writes a picture of the current tick."""
        if self.folder is None:
            return
        self.folder.mkdir(parents=True, exist_ok=True)
        drawn = self.world if self._drawn is None else _posed(self._drawn, self.world)
        picture = drawn.render(800, 600, VIEW)
        path = keep_picture(picture, self.folder / f"cleanup_{self._pictures}_{name}.png")
        self._pictures += 1
        self.say(f"picture: {path}")


def _posed(drawn: World, recorded: World) -> World:
    """Moves the bodies of a world, and their joints, to where they are in a recorded one."""
    for entity in recorded:
        joints = {joint.name: joint.position for joint in entity.joints if joint.type != "fixed"}
        drawn[entity.name].move(entity.position, wxyz=entity.orientation, joints=joints)
    return drawn


def coordinates(entity: Entity) -> str:
    """Returns the position of an entity, m, as text."""
    return "(" + ", ".join(f"{number:.2f}" for number in entity.position) + ")"
