"""Functions of time over a batch are those of recorded worlds, of which each is one environment."""

import gc
import re
import weakref

import mujoco
import numpy as np
import pytest

import ssduck
from ssduck.errors import ArgumentError, ProgramWarning, UnsupportedError
from ssduck.interpreter.over_time.functions import TEMPORAL_FUNCTIONS
from tests.batches.conftest import simulations
from tests.support.cases import generated

TERMS = [
    "heldFor(z(sim.ball) < 0.37)",
    "since(z(sim.ball) < 0.37)",
    "initially(position(sim.ball))",
    "previous(z(sim.ball))",
    "rate(z(sim.ball))",
    "rate(position(sim.ball))",
    "least(distance(sim.ball, sim.cube))",
    "greatest(speed(sim.ball))",
    "heldFor(inContact(sim.ball, sim.table))",
    "lifted(sim.ball, -0.02)",
    "heldFor(z(sim.ball) < 0.37) > 0.02 OR rate(z(sim.ball)) > 1.0",
    "IF(z(sim.ball) > 0.36; heldFor(near(sim.ball, sim.cube, 0.2)); getTime())",
    "greatest(rate(z(sim.ball)))[1]",
    "once(z(sim.ball) < 0.37, 0.004, 0.012)",
    "historically(near(sim.ball, sim.cube, 0.2), 0, 0.008)",
    "heldSince(z(sim.ball) < 0.38, once(inContact(sim.ball, sim.table)), 0.002)",
    "heldFor(heldFor(z(sim.ball) < 0.37) > 0.004)",
    "IF(always(z(sim.ball) < 0.38, 0.001, 0.014); TRUE; FALSE)",
    "IF(eventually(once(z(sim.ball) < 0.37, 0, 0.004), 0.003); TRUE; FALSE)",
    "IF(until(z(sim.ball) > 0.3, z(sim.ball) > 0.4, 0.002, 0.02); TRUE; FALSE)",
    "IF(always(z(sim.ball) > 0.3 OR NOT inContact(sim.ball, sim.table), 0, 0.02); 1; 0)",
    "robustness(always(z(sim.ball) < 0.38, 0, 0.01))",
    "robustness(once(z(sim.ball) > 0.36, 0.002, 0.01))",
    "robustness(historically(z(sim.ball) > 0.36 AND z(sim.cube) < 1))",
]
COUNT = 4


def test_each_fold_is_compared():
    folds = {
        name
        for name, form in TEMPORAL_FUNCTIONS.items()
        if form.fold is not None or (form.operator and not form.of_margins)
    }
    assert {name for term in TERMS for name in re.findall(r"\w+(?=\()", term)} >= folds


@pytest.fixture
def both():
    """A batch, and each of its simulations as a recorded world of its own."""
    model, states = simulations(COUNT)
    singles = []
    for data in states:
        mujoco.mj_resetData(model, data)
        mujoco.mj_forward(model, data)
        ss = ssduck.Interpreter()
        singles.append((ss, ss.add_variable("sim", ssduck.World.attach(model, data))))
    with ssduck.Interpreter(recording=None) as ss:
        sim = ss.add_variable("sim", ssduck.World.batch(model, COUNT))
        yield ss, sim, model, states, singles
    for one, _ in singles:
        one.close()


def compared(found, expected):
    values = [np.nan if value is None else value for value in expected]
    return np.allclose(np.array(found, float), np.array(values, float), atol=1e-9, equal_nan=True)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*time fell", "ignore:.*begin")
def test_they_are_those_of_recorded_worlds(both):
    ss, sim, model, states, singles = both
    draw = np.random.default_rng(2)
    programs = [ss.compile(f"{term};") for term in TERMS]
    for _, world in singles:
        world.begin_episode()
    sim.tick(states)
    for step in range(generated(9)):
        for term, program in zip(TERMS, programs, strict=True):
            if step % 3 != 1:  # what is not asked at a tick counts nevertheless
                found = ss.eval(program)
                expected = [one.eval(f"{term};") for one, _ in singles]
                if "least" in term or "greatest" in term:
                    expected = [[np.nan] * 2 if v is None else v for v in expected]
                assert compared(found, expected), (step, term, found, expected)
        ended = draw.random(COUNT) < 0.15
        for number, (data, (_, world)) in enumerate(zip(states, singles, strict=True)):
            if ended[number]:
                mujoco.mj_resetData(model, data)
                data.qpos[9] = draw.uniform(0.36, 0.5)
                mujoco.mj_forward(model, data)
                world.begin_episode()
            else:
                data.qfrc_applied[8] = draw.normal()
                mujoco.mj_step(model, data, 2)
                world.tick()
        sim.reset(ended)
        sim.tick(states)


def test_a_term_that_is_not_decided_does_not_hold(both):
    ss, sim, model, states, _ = both
    judge = ss.terms(success="eventually(z(sim.ball) > 0.6)")
    for step in range(6):
        for data in states:
            data.time, data.qpos[9] = 0.002 * step, 0.7 if step == 3 else 0.5
            mujoco.mj_forward(model, data)
        sim.tick(states)
        assert judge().success.tolist() == [step >= 3] * COUNT
        if step < 3:
            with pytest.raises(ArgumentError, match="it is not decided yet"):
                ss.eval("eventually(z(sim.ball) > 0.6);")


def test_what_looks_ahead_of_each_tick_is_an_error(both):
    ss, sim, _, states, _ = both
    sim.tick(states)
    with pytest.raises(UnsupportedError, match="eventually inside always needs later ticks"):
        ss.eval("always(z(sim.ball) > 0.3 IMPLIES eventually(z(sim.ball) < 0.2, 0, 1));")


def test_they_need_the_time(both):
    ss, sim, _, states, _ = both
    sim.tick(qpos=np.stack([data.qpos for data in states]))
    with pytest.raises(ArgumentError, match="give tick time="):
        ss.eval("heldFor(z(sim.ball) > 0.3);")


def test_a_past_that_is_not_kept_is_warned_of(both):
    ss, sim, _, states, _ = both
    for _ in range(3):
        sim.tick(states)
    with pytest.warns(ProgramWarning, match="its past begins now"):
        ss.eval("initially(z(sim.ball));")


def test_before_the_first_tick_there_is_no_past(both):
    ss, sim, model, states, _ = both
    program = ss.compile("initially(z(sim.ball));")
    assert ss.eval(program).tolist() == [pytest.approx(model.body("ball").pos[2])] * COUNT
    for data in states:
        data.qpos[9] = 0.7
        mujoco.mj_forward(model, data)
    sim.tick(states)
    assert ss.eval(program).tolist() == [pytest.approx(0.7)] * COUNT


@pytest.mark.parametrize("environments", [[4], -1, [0.5], [True, False], "a"])
def test_resets_of_others_are_errors(both, environments):
    with pytest.raises(ArgumentError):
        both[1].reset(environments)


def test_terms(both):
    ss, sim, _, states, singles = both
    sim.tick(states)
    terms = ss.terms(
        success="heldFor(z(sim.ball) > 0.3) >= 0.02",
        failure="z(sim.ball) < 0.1",
        reward={"height": "z(sim.ball)", "bonus": "IF(success; 1; 0)"},
        stop_when="success OR failure",
    )
    heights = [one.eval("z(sim.ball);") for one, _ in singles]
    judged = terms()
    assert (
        judged.success.tolist()
        == judged.stop.tolist()
        == judged.failure.tolist()
        == [False] * COUNT
    )
    assert judged.reward.tolist() == judged.parts["height"].tolist() == pytest.approx(heights)
    states[1].time = 0.02
    sim.tick(states)
    judged = terms()
    assert judged.success.tolist() == judged.stop.tolist() == [False, True, False, False]
    assert judged.reward.tolist() == pytest.approx([h + (n == 1) for n, h in enumerate(heights)])


def test_terms_where_a_number_is_nan(both):
    ss, sim, _, states, _ = both
    sim.tick(states)
    texts = {"success": "z(sim.ball) > 0.3", "reward": "z(sim.ball)"}
    error, failure, number = (ss.terms(**texts, nan=nan) for nan in ("error", "failure", -2.0))
    states[2].xpos[3] = np.nan
    sim.tick(states)
    with pytest.raises(ArgumentError, match=r"environment 2"):
        error()
    judged = failure()
    assert judged.failure.tolist() == judged.stop.tolist() == [False, False, True, False]
    assert judged.success.tolist() == [True, True, False, True]
    assert judged.reward[2] == 0.0
    judged = number()
    assert judged.failure is None
    assert judged.success.tolist() == [True, True, False, True]
    assert judged.reward[2] == -2.0


@pytest.mark.parametrize(
    ("terms", "message"),
    [
        ({"success": "z(sim.ball)"}, "success: .*True or False"),
        ({"reward": "z(sim.ball) > 1"}, "reward: .*a number"),
        ({"success": "z(sim.bal) > 1"}, "success: .*ball"),
        ({"success": "success"}, "cannot use success"),
        ({"reward": "failure"}, "no such term"),
        ({}, "give a term"),
    ],
)
def test_wrong_terms(both, terms, message):
    with pytest.raises(ssduck.SelectScriptError, match=message):
        both[0].terms(**terms)()


def test_an_error_at_a_tick_is_told_when_somebody_asks(both):
    ss, sim, _, states, _ = both
    sim.tick(states)
    program = ss.compile("heldFor(1 / z(sim.ball) > 0) >= 0;")
    assert ss.eval(program).all()
    height = states[1].xpos[3, 2]
    states[1].xpos[3, 2] = 0.0
    for _ in range(2):
        sim.tick(states)
    states[1].xpos[3, 2] = height
    sim.tick(states)
    with pytest.raises(ssduck.SelectScriptError, match="environment 1"):
        ss.eval(program)
    sim.reset()
    sim.tick(states)
    assert ss.eval(program).all()


def test_a_batch_that_no_variable_has_is_gone():
    model, states = simulations(2)
    with ssduck.Interpreter(recording=None) as ss:
        gone = []
        for _ in range(3):
            sim = ss.add_variable("sim", ssduck.World.batch(model, 2))
            sim.tick(states)
            ss.eval("heldFor(z(sim.ball) > 0) >= 0;")
            gone.append(weakref.ref(sim))
        del sim
        gc.collect()
        assert [one() is None for one in gone] == [True, True, False]
