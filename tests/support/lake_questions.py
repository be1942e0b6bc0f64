"""Questions for the episodes of `lake_episodes`, and the answers that each gives by itself."""

import json
import os
import signal
from dataclasses import dataclass
from pathlib import Path

import ssduck
from ssduck.gym import score
from ssduck.interpreter.episode_batches import collected_doubts
from ssduck.lakes.questions import ProgramQuestion, plain
from ssduck.lakes.workers import Answer
from tests.support.lake_episodes import REWARD, SUCCESS

# Those of the last tick, the first touch, the longest rest and the least clearance.
PROGRAMS = {
    "last tick": "[on(sim.table, sim.cup), z(sim.cup)];",
    "first touch": (
        "t = holds(touching(sim.gripper, sim.cup)); SELECT this[0] FROM t LIMIT 1 AS list;"
    ),
    "longest rest": (
        "t = holds(on(sim.table, sim.cup)); max(SELECT this[1] - this[0] FROM t AS list);"
    ),
    "least clearance": "least(clearance(sim.gripper, sim.wall));",
}
# Others, with what may go wrong when episodes are one record.
FURTHER = {
    "formula": "holds(above(sim.table, sim.cup));",
    "rows": "SELECT id, x, z FROM sim WHERE x(this) > 0.2;",
    "window": "SELECT time, z FROM sim{-0.05} WHERE id = 'cup';",
    "a tick": "SELECT tick, z FROM sim{0.05} WHERE id = 'cup';",
    "changes": "changes(x(sim.gripper) > -0.5);",
    "since": "since(near(sim.gripper, sim.cup, 0.3));",
    "initially": "x(sim.gripper) - initially(x(sim.gripper));",
    "window of a function": "holds(z(sim.cup) > 0.44, -0.05);",
    "greatest": "greatest(distance(sim.gripper, sim.cup));",
    "pairs": "SELECT a.this, b.this FROM a=sim, b=sim WHERE touching(a.this, b.this) AS list;",
    "contacts": "contactForce(sim.table, sim.cup);",
    "entities": "SELECT this FROM sim WHERE near(sim.gripper, this, 0.2) AS list;",
    "links": "SELECT this FROM links(sim) WHERE z(this) > 0.6 AS list;",
    "an assignment": "a = x(sim.cup); b = a + 1; [a, b];",
    "the least of others": "least(clearance(sim.cup, sim.thing_5));",
    "a part of the least": "least(clearance(sim.wall, sim.gripper), -0.1);",
    "error": "x(sim.spoon);",
    "error of some": "sqrt(x(sim.gripper) + 0.5);",
    "no value": "SELECT this FROM sim AS environment;",
}


def by_itself(folder, number, program):
    """Returns the answer of an episode, as a text, and its error."""
    with ssduck.open(folder, "sim", number) as ss:
        return answer_of(ss, program)


def answer_of(ss, program):
    """Returns the answer of an opened episode, as a text, and its error."""
    return whole_answer_of(ss, program)[:2]


def whole_answer_of(ss, program):
    """Returns the answer of an opened episode, with its error and the doubts."""
    try:
        with collected_doubts(ss) as doubts:
            text = json.dumps(plain(ss.eval(program)))
    except ssduck.SelectScriptError as error:
        return Answer(None, str(error))
    return Answer(text, None, tuple(doubts))


def scores(folder):
    """Returns the scores of all episodes."""
    return [(one.total, one.succeeded) for one in score(folder, SUCCESS, reward=REWARD)]


@dataclass(frozen=True)
class KillingQuestion(ProgramQuestion):
    """A program; the process that begins to answer episode 2 is killed, but for the second time."""

    mark: str = ""

    @property
    def key(self):
        return f"{super().key} {self.mark}"

    def answering(self, interpreter):
        answer = super().answering(interpreter)

        def answer_or_die(present, entry):
            if entry.episode == 2:
                try:
                    Path(self.mark).touch(exist_ok=False)
                except FileExistsError:
                    return answer(present, entry)
                os.kill(os.getpid(), signal.SIGKILL)
            return answer(present, entry)

        return answer_or_die


def tags_by_two_lakes(place):
    """Returns `seen` and `heard` of an episode, as the second of two lakes and a new one have them.

    The first lake gives the one tag, the second, which has not read of it, the other.
    """
    first, second = ssduck.lake(place), ssduck.lake(place)
    assert first.set_tags({"seen": 1}, "episode = 3") == 1
    assert second.set_tags({"heard": 2}, "episode = 3") == 1
    (known,), (new,) = (
        lake.select("episode = 3").to_pylist() for lake in (second, ssduck.lake(place))
    )
    return [(row["seen"], row["heard"]) for row in (known, new)]
