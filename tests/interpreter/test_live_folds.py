"""Functions of time that are kept from tick to tick are those of the whole record."""

import gc
from contextlib import contextmanager
from itertools import count
from weakref import ref

import mujoco
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

import ssduck
from ssduck.errors import EvaluationError, SelectScriptError
from ssduck.interpreter.over_time.functions import TEMPORAL_FUNCTIONS
from ssduck.interpreter.over_time.live import LiveFolds
from ssduck.language.builtins import EXTREMES
from tests.support.cases import generated
from tests.support.mjcf import BALL_AND_BOX, simulated

TERMS = [
    "heldFor(z(sim.ball) < limit)",
    "since(near(sim.ball, sim.box, 0.35))",
    "initially(position(sim.ball))",
    "previous(z(sim.ball))",
    "rate(z(sim.ball))",
    "rate(position(sim.ball))",
    "least(distance(sim.ball, sim.box))",
    "greatest(speed(sim.ball))",
    "heldFor(inContact(sim.ball, sim.world))",
    "lifted(sim.ball, -0.05)",
    "heldFor(z(sim.ball) < 0.2) > 0.05 OR rate(z(sim.ball)) > 1.0",
    "once(z(sim.ball) < limit, 0.01, 0.05)",
    "historically(distance(sim.ball, sim.box) < 0.35, 0, 0.04)",
    "heldSince(z(sim.ball) < limit, once(z(sim.ball) > 0.4, 0, 0.02))",
    "heldFor(heldFor(z(sim.ball) < 0.4) > 0.03)",
]
# What is made from the record at each tick: masses are recorded once, what a function of the user's
# gives may change, and the others depend on a row or on a tick of the past.
OF_THE_RECORD = [
    "heldFor(mass(sim.ball) > 0.1)",
    "heldFor(chosen(sim.ball))",
    "SELECT heldFor(z(this) < 0.2) FROM sim AS list",
    "heldFor(z(sim{0.0}.ball) < z(sim.ball))",
]
FOLDS = {
    name
    for name, form in TEMPORAL_FUNCTIONS.items()
    if not form.of_margins
    and (form.fold is not None or (form.operator is not None and not form.looks_ahead))
}
STEPS = ("tick", "tick", "tick", "ask", "same time", "limit", "reset", "lift", "nan")
FRESH = count()


@contextmanager
def opened():
    model, data = simulated(BALL_AND_BOX)
    with ssduck.Interpreter() as ss:
        sim = ssduck.World.attach((model, data))
        ss.add_variable("sim", sim)
        ss.add_variable("limit", 0.25)
        ss.add_function("chosen", lambda ball: ball.z > 0.1)
        sim.tick()
        yield ss, sim, model, data


@pytest.fixture
def scene():
    with opened() as made:
        yield made


def outcome(ss, text):
    try:
        return ss.eval(text)
    except SelectScriptError as error:
        return error.message


def fresh(ss, text):
    """Returns what the record gives: no state is known, and none is kept."""
    folds = ss._execution.folds
    known, folds._folded = folds._folded, {}
    try:
        return outcome(ss, f"{text}; # {next(FRESH)}")
    finally:
        folds._folded = known


def act(scene, step):
    ss, sim, model, data = scene
    match step:
        case "tick":
            mujoco.mj_step(model, data, 2)
            sim.tick()
        case "same time":
            data.qpos[2] += 0.01
            sim.tick()
        case "limit":
            ss.add_variable("limit", 0.29 if ss["limit"] == 0.25 else 0.25)
        case "reset":
            mujoco.mj_resetData(model, data)
            mujoco.mj_forward(model, data)
            sim.begin_episode()
        case "lift":
            data.qpos[2] += 0.2
            mujoco.mj_step(model, data)
            sim.tick()
        case "nan":
            data.xpos[1, 2] = float("nan")
            data.time += 0.01
            sim.tick()
            mujoco.mj_forward(model, data)


def test_each_function_without_an_age_is_a_fold():
    with_age = {name for name, form in TEMPORAL_FUNCTIONS.items() if form.arguments[1] > 1}
    operators = {name for name, form in TEMPORAL_FUNCTIONS.items() if form.operator is not None}
    assert with_age - FOLDS - operators == {"holds", "changes", "at"}
    assert {term.partition("(")[0] for term in TERMS} >= FOLDS


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:ball. the simulator gives a pose")
@settings(max_examples=generated(2))
@given(st.lists(st.sampled_from(STEPS), max_size=15))
@example(["tick"] * 12 + ["lift"] + ["tick"] * 8)
@example(["tick", "limit", "tick", "limit", "tick", "reset", "tick", "tick"])
@example(["tick", "same time", "tick", "nan", "tick", "tick"])
def test_they_are_those_of_the_record(steps):
    with opened() as made:
        for number, step in enumerate(("ask", *steps)):
            act(made, step)
            # Of some terms a state is a tick old, and of some several.
            for term in [*TERMS, *OF_THE_RECORD][number % 5 :: 4 + number % 2]:
                assert outcome(made[0], f"{term};") == fresh(made[0], term), (step, term)


@contextmanager
def unrecorded(made):
    """A world of the same simulation that is not recorded, asked at each tick."""
    _, _, model, data = made
    with ssduck.Interpreter(recording=None) as ss:
        sim = ssduck.World.attach((model, data))
        ss.add_variable("sim", sim)
        ss.add_variable("limit", 0.25)
        sim.begin_episode()
        yield ss, sim


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:ball. the simulator gives a pose")
@settings(max_examples=generated(2))
@given(st.lists(st.sampled_from(sorted({*STEPS} - {"limit"})), max_size=15))
@example(["tick"] * 12 + ["lift"] + ["tick"] * 8)
@example(["tick", "same time", "same time", "tick", "nan", "tick", "reset", "same time", "tick"])
def test_those_of_an_unrecorded_world_that_is_asked_at_each_tick_are_the_same(steps):
    with opened() as made, unrecorded(made) as (ss, sim):
        for step in ("reset", *steps):
            act(made, step)
            if step == "nan":
                made[3].xpos[1, 2] = float("nan")
            if step == "reset":
                sim.begin_episode()
            elif step != "ask":
                sim.tick()
            if step == "nan":
                mujoco.mj_forward(made[2], made[3])
            for term in TERMS:
                assert outcome(ss, f"{term};") == fresh(made[0], term), (step, term)


def test_a_tick_that_an_unrecorded_world_was_not_asked_at_is_an_error(scene):
    with unrecorded(scene) as (ss, sim):
        assert ss.eval("heldFor(z(sim.ball) < limit);") == 0.0
        for step in ("tick", "tick"):
            act(scene, step)
            sim.tick()
        with pytest.raises(EvaluationError, match=r"not recorded.* heldFor.* at each tick"):
            ss.eval("heldFor(z(sim.ball) < limit);")
        with pytest.raises(EvaluationError, match="not recorded"):
            ss.eval("previous(sim.ball);")
        act(scene, "reset")
        sim.begin_episode()
        assert ss.eval("heldFor(z(sim.ball) > 0);") == 0.0
        act(scene, "tick")
        sim.tick()
        assert ss.eval("heldFor(z(sim.ball) > 0);") == pytest.approx(0.02)
        with pytest.raises(EvaluationError, match="not recorded"):
            ss.eval("holds(z(sim.ball) > 0);")


def test_the_error_of_a_tick_stays_until_the_episode_ends(scene):
    term = "heldFor(1 / (z(sim.ball) - start) > 0);"
    with unrecorded(scene) as (ss, sim):
        ss.add_variable("start", ss.eval("z(sim.ball);"))
        for number, _ in enumerate(range(3)):
            with pytest.raises(SelectScriptError, match="zero") as caught:
                ss.eval(term)
            assert caught.value.message.count("zero") == 1, number
            act(scene, "tick")
            sim.tick()
        ss.add_variable("start", -1.0)
        sim.begin_episode()
        assert ss.eval(term) == 0.0


@pytest.mark.slow
@pytest.mark.parametrize(
    "recording", [{"seconds": 0.1}, {"every": 3}, {"entities": ["ball"]}, {"entities": ["box"]}]
)
def test_what_is_dropped_or_not_recorded_is_not_kept(scene, recording):
    ss = scene[0]
    ss.record("sim", ssduck.Recording(**recording))
    for number in range(20):
        act(scene, "tick")
        for term in TERMS[number % 4 :: 4]:
            assert outcome(ss, f"{term};") == fresh(ss, term)


@pytest.mark.slow
@pytest.mark.parametrize("function", ["initially", "previous", "rate", "least", "greatest"])
def test_who_changes_an_answer_changes_no_other(scene, function):
    ss, value = scene[0], "z(sim.ball)" if function in EXTREMES else "position(sim.ball)"
    for _ in range(3):
        act(scene, "tick")
        for _ in range(2):
            answer = ss.eval(f"{function}({value});")
            assert answer == fresh(ss, f"{function}({value})")
            answer[0] = 99.0


def test_a_step_that_ctrl_c_ends_is_not_in_the_state(monkeypatch, scene):
    ss = scene[0]
    for term in ("previous(z(sim.ball))", "rate(z(sim.ball))"):
        ss.eval(f"{term};")
        act(scene, "tick")
        with_present = LiveFolds._with_present

        def interrupted(*args, with_present=with_present):
            with_present(*args)
            raise KeyboardInterrupt

        with monkeypatch.context() as patch:
            patch.setattr(LiveFolds, "_with_present", interrupted)
            with pytest.raises(KeyboardInterrupt):
                ss.eval(f"{term};")
        assert ss.eval(f"{term};") == fresh(ss, term)


@pytest.mark.slow
def test_states_do_not_keep_a_world_that_no_variable_has():
    with ssduck.Interpreter() as ss:
        worlds = []
        for _ in range(2):
            model = mujoco.MjModel.from_xml_string(BALL_AND_BOX)
            world = ss.add_variable("sim", ssduck.World.attach(model, mujoco.MjData(model)))
            worlds.append(ref(world))
            ss.eval(f"previous(z(sim.ball)); # {len(worlds)}")
            del world
        gc.collect()
        assert [world() is None for world in worlds] == [True, False]
