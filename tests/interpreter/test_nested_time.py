"""Functions of time of functions of time are what the definitions make of the simulator's values."""

from __future__ import annotations

import math
import random
from unittest.mock import patch

import mujoco
import pytest

import ssduck
from ssduck.errors import ArgumentError, SelectScriptError
from ssduck.interpreter.execution import Execution
from tests.support.cases import generated
from tests.support.mjcf import BALL_AND_BOX, simulated
from tests.support.temporal_logic import Formula, value
from tools import check_live

# Comparisons, with what they are of the simulator's positions.
SIGNALS = {
    "z(sim.ball) > 0.5": lambda ball, box: ball[2] > 0.5,
    "x(sim.box) <= 0.4": lambda ball, box: box[0] <= 0.4,
    "z(sim.ball) > z(sim.box)": lambda ball, box: ball[2] > box[2],
    "distance(sim.ball, sim.box) < 0.5": lambda ball, box: math.dist(ball, box) < 0.5,
}
WINDOWS = [(), (0,), (0, 0.05), (0.03, 0.1), (0.02,), (0.0, 0.015)]
AHEAD, BACK = ("always", "eventually"), ("once", "historically")
TICKS = 25


def formula(draw, depth, *, ahead=True):
    """Returns a generated formula."""
    if depth == 0:
        return Formula(draw.choice(list(SIGNALS)))
    name = draw.choice(
        ["NOT", "AND", "OR", "IMPLIES", *BACK, "heldSince"] + ahead * [*AHEAD, "until"]
    )
    count = 2 if name in ("AND", "OR", "IMPLIES", "until", "heldSince") else 1
    parts = tuple(formula(draw, depth - 1, ahead=ahead) for _ in range(count))
    is_logic = name in ("NOT", "AND", "OR", "IMPLIES")
    return Formula(name, parts, () if is_logic else draw.choice(WINDOWS))


class Scene:
    """Two bodies that are put somewhere at each tick."""

    def __init__(self, seed):
        self.model, self.data = simulated(BALL_AND_BOX)
        self.draw = random.Random(seed)  # noqa: S311  # for a test
        self.times, self.signals = [], {text: [] for text in SIGNALS}

    def note(self):
        """Notes what the comparisons are of the simulator's positions."""
        self.times.append(self.data.time)
        ball, box = self.data.body("ball").xpos, self.data.body("box").xpos
        for text, holds in SIGNALS.items():
            self.signals[text].append(bool(holds(ball, box)))

    def move(self):
        """Takes some steps, and puts the bodies elsewhere."""
        self.data.time += 0.01 * self.draw.choice([1, 1, 2, 3])
        for body, axis in (("ball", 2), ("box", 0)):
            self.data.joint(self.model.body(body).jntadr[0]).qpos[axis] = self.draw.random()
        mujoco.mj_kinematics(self.model, self.data)

    def expected(self, wanted, tick, *, is_open=True):
        """Returns a formula by the definitions, of the ticks so far."""
        return value(wanted, tick, self.times, self.signals, is_open=is_open)


@pytest.mark.parametrize("seed", range(generated(2)))
def test_nested_conditions_are_those_of_the_definitions(seed):
    scene = Scene(seed)
    draw = scene.draw
    wanted = [formula(draw, draw.randint(1, 3)) for _ in range(6)]
    with ssduck.Interpreter() as ss:
        sim = ss.add_variable("sim", ssduck.World.attach((scene.model, scene.data)))
        scene.note()
        for _ in range(TICKS):
            scene.move()
            sim.tick()
            scene.note()
        for part in wanted:
            one = Formula("once", (part,), (0, 0))  # the same, as a function of time
            text = f"SELECT {one.text} AS holds FROM sim{{}} WHERE name = 'ball' AS list;"
            expected = [scene.expected(one, tick) for tick in range(TICKS + 1)]
            assert ss.eval(text) == expected, one.text


@pytest.mark.parametrize("seed", range(generated(2)))
def test_a_simulation_that_goes_on_tells_at_each_tick_what_its_record_tells(seed):
    scene = Scene(seed)
    draw = scene.draw
    wanted = [
        Formula(draw.choice(BACK), (formula(draw, draw.randint(0, 2), ahead=False),), window)
        for window in WINDOWS
    ]
    looking_ahead = [Formula(draw.choice(AHEAD), (formula(draw, 2),), w) for w in WINDOWS[:3]]
    at_first = [
        Formula("until", tuple(formula(draw, n, ahead=False) for n in (0, 1)), window)
        for window in WINDOWS
    ] + [Formula(name, (formula(draw, 1, ahead=False),), w) for name in AHEAD for w in WINDOWS]
    with ssduck.Interpreter() as ss, ssduck.Interpreter(recording=None) as unrecorded:
        sim = ss.add_variable("sim", ssduck.World.attach((scene.model, scene.data)))
        other = unrecorded.add_variable("sim", ssduck.World.attach((scene.model, scene.data)))
        other.begin_episode()
        scene.note()
        for number in range(TICKS):
            for one in wanted:
                expected = scene.expected(one, number)
                assert ss.eval(f"{one.text};") == expected, one.text
                assert unrecorded.eval(f"{one.text};") == expected, one.text
                margin = ss.eval(f"robustness({one.text});")
                assert unrecorded.eval(f"robustness({one.text});") == margin
                assert margin > 0 if expected else margin < 0, one.text
            for one in looking_ahead:
                assert ss.eval(f"{one.text};") == scene.expected(one, 0), one.text
            for one in at_first:
                expected = scene.expected(one, 0)
                margin = ss.eval(f"robustness({one.text});")
                for each in (ss, unrecorded):
                    assert each.eval(f"{one.text};") == expected, one.text
                    assert each.eval(f"robustness({one.text});") == margin
                assert margin is None or (margin > 0) is expected, one.text
            scene.move()
            sim.tick()
            other.tick()
            scene.note()


def test_a_margin_is_known_where_what_is_to_come_cannot_change_it():
    scene = Scene(0)
    text = "eventually(z(sim.ball) > 0.5 OR always(z(sim.ball) > 2), 0, 0.1)"
    heights = []
    with ssduck.Interpreter() as ss:
        sim = ss.add_variable("sim", ssduck.World.attach((scene.model, scene.data)))
        for _ in range(TICKS):
            if scene.data.time <= 0.1 + 1e-9:
                heights.append(scene.data.body("ball").xpos[2])
            is_over = scene.data.time > 0.1 - 1e-9
            # `always` is never decided: its margin is at most z - 2, which is less.
            expected = max(heights) - 0.5 if is_over else None
            assert ss.eval(f"robustness({text});") == expected
            inner = f"historically(NOT {text}, 0, 0)"  # at the last tick
            margin = ss.eval(f"SELECT robustness({inner}) AS m FROM sim{{0.0}} LIMIT 1 AS list;")
            assert margin == [None if expected is None else -expected]
            scene.move()
            sim.tick()


@pytest.fixture
def moved():
    scene = Scene(0)
    with ssduck.Interpreter() as ss:
        sim = ss.add_variable("sim", ssduck.World.attach((scene.model, scene.data)))
        scene.note()
        for _ in range(TICKS):
            scene.move()
            sim.tick()
            scene.note()
        yield ss, scene


def test_values_of_functions_of_time_are_compared_at_each_tick(moved):
    ss, scene = moved
    high = scene.signals["z(sim.ball) > 0.5"]
    held = []
    for tick in range(TICKS + 1):
        since = max((i for i in range(tick + 1) if not high[i]), default=-1) + 1
        held.append(scene.times[tick] - scene.times[since] if high[tick] else 0.0)
    text = "heldFor(z(sim.ball) > 0.5)"
    assert ss.eval(f"SELECT {text} AS t FROM sim{{}} WHERE name = 'ball' AS list;") == held
    changes = ss.eval(f"changes({text});")
    assert [value for _, value in changes] == [
        v for v, before in zip(held, [None, *held], strict=False) if v != before
    ]
    assert ss.eval(f"greatest({text});")[1] == max(held)
    long = [value > 0.02 for value in held]
    assert ss.eval(f"once({text} > 0.02);") is any(long)
    assert ss.eval(f"historically(2 * {text} + 0.01 > 0.05);") is all(
        2 * t + 0.01 > 0.05 for t in held
    )
    assert ss.eval(f"holds({text} > 0.02);") == ss.eval(f"holds(NOT {text} <= 0.02);")


def test_each_row_is_of_its_entity_and_of_its_tick(moved):
    ss, scene = moved
    names = ss.eval("SELECT name FROM sim WHERE once(z(this) > 0.5) AND isKinbody(this) AS list;")
    assert names == (["ball"] if any(scene.signals["z(sim.ball) > 0.5"]) else [])
    rows = ss.eval(
        "SELECT time, name, once(z(this) > 0.5, 0, 0.03) AS v FROM sim{} WHERE isKinbody(this);"
    )
    one = Formula("once", (Formula("z(sim.ball) > 0.5"),), (0, 0.03))
    found = [row["v"] for row in rows if row["name"] == "ball"]
    assert found == [scene.expected(one, tick) for tick in range(TICKS + 1)]


@pytest.mark.parametrize(
    "text",
    [
        "heldFor(z(this) > 0.5)",
        "heldFor(distance(this, sim.ball) < 0.5)",
        "since(z(sim.ball) > 0.5)",
        "previous(position(this))",
        "rate(z(sim.ball) + z(this))",
        "greatest(z(this))",
        "initially(sim.ball)",
        "eventually(z(this) > z(sim.box), 0, 0.05)",
        "robustness(heldSince(z(sim.ball) > 0.4, touching(this, sim.world)))",
    ],
)
def test_all_rows_are_read_at_once_and_are_those_of_each_tick_by_itself(moved, text):
    ss, scene = moved
    query = f"SELECT name, {text} AS v FROM sim{{}} WHERE isKinbody(this) ORDER BY tick, name;"
    with patch.object(Execution, "series", autospec=True, side_effect=Execution.series) as read:
        rows = ss.eval(query)
    names = {row["name"] for row in rows}
    assert len(names) > 1
    assert read.call_count <= 3 * len(names)
    by_itself = [
        row
        for time in scene.times
        for name in sorted(names)
        for row in ss.eval(
            query.replace("{}", f"{{{time}}}").replace("isKin", f"name = '{name}' AND isKin")
        )
    ]
    assert repr(rows) == repr(by_itself)


def test_a_tick_that_another_one_of_its_time_replaces_has_its_values():
    scene = Scene(3)
    with ssduck.Interpreter() as ss:
        sim = ss.add_variable("sim", ssduck.World.attach((scene.model, scene.data)))
        sim.tick()
        heights = []
        for step in (0, 1, 0):
            scene.data.time += 0.01 * step
            scene.data.joint(0).qpos[2] = heights[-1] + 1 if heights else 2.0
            mujoco.mj_kinematics(scene.model, scene.data)
            sim.tick()
            heights.append(scene.data.body("ball").xpos[2])
        text = "initially(previous(z(sim.ball)))"
        rows = ss.eval(f"SELECT time, {text} AS z FROM sim{{}} WHERE name = 'ball';")
        assert {row["time"] for row in rows} == {0.0, 0.01}
        assert {row["z"] for row in rows} == {heights[0]}


@pytest.mark.slow
@pytest.mark.parametrize("simulator", check_live.SIMULATORS)
@pytest.mark.parametrize("seed", range(generated(2)))
def test_generated_programs_tell_live_what_the_record_tells(simulator, seed):
    draw = random.Random(seed)  # noqa: S311  # for a test
    programs = [check_live.program(draw) for _ in range(check_live.PER_RUN)]
    assert check_live.Run(simulator, seed, programs).differences() == []


def test_a_finished_record_is_decided_and_a_replay_sees_no_later_tick(moved, tmp_path):
    ss, scene = moved
    ss.export(tmp_path / "run")
    wanted = [
        Formula("always", (Formula("z(sim.ball) > z(sim.box)"),)),
        Formula("eventually", (Formula("x(sim.box) <= 0.4"),), (0.03, 0.1)),
        Formula("always", (Formula("z(sim.ball) > -1.0"),)),
        Formula("eventually", (Formula("z(sim.ball) > 1.0"),), (0, 1)),
    ]
    scene.signals |= {
        "z(sim.ball) > -1.0": [True] * len(scene.times),
        "z(sim.ball) > 1.0": [False] * len(scene.times),
    }
    with ssduck.open(tmp_path / "run") as other:
        for one in wanted:
            verdict = scene.expected(one, 0, is_open=False)
            assert other.eval(f"{one.text};") == verdict
            why = other.why(f"{one.text};")
            assert (why.value, why.complete) == (verdict, scene.expected(one, 0) is not None)
            other["sim"].seek(scene.times[2])
            early = Scene(0)
            early.times = scene.times[:3]
            early.signals = {text: values[:3] for text, values in scene.signals.items()}
            assert other.eval(f"{one.text};") == early.expected(one, 0)
            other["sim"].seek(scene.times[-1])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("once(z(sim.ball) > 1, -1)", "from is a time before the tick, 0 s or more, not -1"),
        ("always(z(sim.ball) > 1, 2, 1)", "from is 2 s and to is 1 s"),
        ("always(True)", "always takes an expression of entities"),
        ("until(z(sim.ball) > 1)", "until takes 2 to 4 arguments"),
        ("robustness(near(sim.ball, sim.box))", r"near takes 3 arguments, not 2: near\(a, b, d\)"),
        ("robustness(NOT inBox(sim.ball, [0, 0, 0]))", "inBox takes 3 to 4 arguments, not 2"),
        ("once(z(sim.ball) > 1, 'a')", "not 'a'"),
        ("once(z(sim.ball) > 1, 0, getTime())", "to is to be the same at all ticks"),
        ("once(z(sim.ball) > 1, z(sim.box))", "from is to be the same at all ticks"),
    ],
)
def test_mistakes_are_told_of(moved, text, message):
    with pytest.raises(ArgumentError, match=message):
        moved[0].eval(f"{text};")


@pytest.mark.parametrize(
    ("text", "decided"),
    [
        ("NOT always({high})", True),
        ("NOT eventually(NOT {high})", False),  # which is always({high})
        ("NOT until({high}, {high}, 0.06)", True),
        ("always({high}) IMPLIES False", True),
        ("NOT (always({high}) AND True)", True),
        ("NOT (always({high}) OR False) OR False", True),
        ("robustness(NOT always({high}))", None),
        ("robustness(scale(always({high}), 2))", None),
    ],
)
def test_the_opposite_of_what_is_not_decided_is_not_decided_either(text, decided):
    scene = Scene(0)
    with ssduck.Interpreter() as ss:
        world = ss.add_variable("sim", ssduck.World.attach(scene.model, scene.data))
        for height, expected in ((0.3, None), (0.4, None), (0.0, decided)):
            scene.data.qpos[2] = height
            scene.data.time += 0.02
            mujoco.mj_kinematics(scene.model, scene.data)
            world.tick()
            value = ss.eval(text.format(high="z(sim.ball) > 0.25") + ";")
            assert value is expected


def test_implies_is_looser_than_or_and_right_associative():
    with ssduck.Interpreter() as ss:
        for a in (True, False):
            for b in (True, False):
                for c in (True, False):
                    ss.add_variable("a", a), ss.add_variable("b", b), ss.add_variable("c", c)
                    assert ss.eval("a IMPLIES b IMPLIES c;") is ((not a) or (not b) or c)
                    assert ss.eval("a OR b IMPLIES c AND a;") is ((not (a or b)) or (c and a))
        with pytest.raises(SelectScriptError):
            ss.eval("a IMPLIES;")


def test_what_is_compared_with_an_undecided_margin_is_not_decided():
    scene = Scene(0)
    with ssduck.Interpreter() as ss:
        ss.add_variable("sim", ssduck.World.attach((scene.model, scene.data)))
        undecided = "robustness(always(z(sim.ball) <= 5)) > 0.1"
        assert ss.eval(f"{undecided};") is None
        assert ss.eval(f"NOT 0 < {undecided.partition(' > ')[0]};") is None
        assert ss.eval(f"{undecided} AND z(sim.ball) > 5;") is False
        assert ss.eval(f"{undecided} OR z(sim.ball) < 5;") is True
        assert ss.why(f"{undecided};").value is None
        fired = []
        ss.add_trigger("close", f"{undecided};", 0, fired.append)
        assert fired in ([], [None])


def test_a_part_that_is_an_error_is_one_at_the_ticks_that_need_it():
    model, data = simulated(
        "<mujoco><worldbody><body name='ball' pos='0 0 1'><freejoint/><geom size='.05'/></body>"
        "<body name='door' pos='1 0 0'><joint name='hinge'/><geom size='.1'/></body>"
        "</worldbody></mujoco>"
    )
    by_zero = "historically(z(sim.ball) > -5 OR once(1 / (z(sim.ball) - z(sim.ball)) > 2));"
    # The ball is so high only at first; then, the hinge, which has no range, is looked at.
    by_hinge = "historically(z(sim.ball) > 0.9 IMPLIES once(isOpen(sim.door, 'hinge')));"
    recording = ssduck.Recording(tables=("entities", "joints"))
    with (
        ssduck.Interpreter(recording=recording) as ss,
        ssduck.Interpreter(recording=None) as unrecorded,
    ):
        worlds = [
            each.add_variable("sim", ssduck.World.attach((model, data)))
            for each in (ss, unrecorded)
        ]
        worlds[1].begin_episode()
        for number in range(8):
            for each in (ss, unrecorded):
                assert each.eval(by_zero) is True
                if each is unrecorded or number != 3:  # of that tick, the record tells
                    with pytest.raises(SelectScriptError, match="has no range"):
                        each.eval(by_hinge)
            data.qpos[2] -= 0.05
            data.time += 0.01
            mujoco.mj_kinematics(model, data)
            for world in worlds:
                world.tick()
        text = f"SELECT {by_zero[:-1]} AS holds FROM sim{{}} WHERE name = 'ball' AS list;"
        assert ss.eval(text) == [True] * 9
