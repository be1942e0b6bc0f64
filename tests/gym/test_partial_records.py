"""Records without some entities or tables, and terms that need them."""

import warnings

import gymnasium
import numpy as np
import pytest

import ssduck
from ssduck.errors import ProgramWarning, SelectScriptError
from ssduck.gym import QueryWrapper, score
from tests.support.of_model import OfModel

TEXT = """
<mujoco><worldbody><geom name="floor" type="plane" size="0 0 .1"/>
<body name="box" pos="0 0 .0499"><freejoint/><geom type="box" size=".05 .05 .05" mass="1"/></body>
<body name="top" pos="0 0 .1497"><freejoint/><geom type="box" size=".05 .05 .05" mass="1"/></body>
</worldbody></mujoco>"""
WEIGHT = 9.81
NO_CONTACTS = "the table of contacts of 'sim' is not recorded"
TOLD = "only box, world were recorded.*as force, torque, restsOn"


class Stack(OfModel):
    """A box on another one, at rest but for their settling."""

    def __init__(self):
        super().__init__(TEXT, 5)

    def step(self, action):
        observation, *_ = super().step(action)
        return observation, 1.0, False, False, {}


def record(folder, recording=None, steps=6, **terms):
    """Records an episode; returns the rewards."""
    env = QueryWrapper(Stack(), **terms, record_to=folder, recording=recording, forward=False)
    env.reset(seed=0)
    rewards = [env.step(np.zeros(1))[1] for _ in range(steps)]
    env.close()
    return rewards


@pytest.fixture(scope="module")
def without_contacts(tmp_path_factory):
    """A record without the table of contacts."""
    folder = tmp_path_factory.mktemp("tables")
    record(folder, ssduck.Recording(tables=("links",)), 2, success="z(sim.box) > 9")
    return folder


@pytest.fixture(scope="module")
def without_top(tmp_path_factory):
    """A record without the box on top, and the rewards."""
    folder = tmp_path_factory.mktemp("entities")
    recording = ssduck.Recording(entities=("box", "world"))
    return folder, record(folder, recording, reward="force(sim.box)[2]")


@pytest.mark.parametrize(
    "term",
    [
        "inContact(sim.world, sim.box)",
        "hasContact(sim.world, sim.box)",
        "contactForce(sim.world, sim.box) > 0",
        "grasped(sim.box, sim.top)",
        "force(sim.box)[2] > 0",
    ],
)
def test_contacts_that_are_not_recorded_are_an_error(without_contacts, term):
    with ssduck.open(without_contacts) as ss, pytest.raises(SelectScriptError, match=NO_CONTACTS):
        ss.eval(f"{term};")


@pytest.mark.slow
def test_scores_and_lakes_have_the_same_error(without_contacts):
    term = "inContact(sim.world, sim.box)"
    with pytest.raises(SelectScriptError, match=NO_CONTACTS):
        list(score(without_contacts, success=term))
    (answer,) = ssduck.lake(without_contacts).ask(f"{term};").to_pylist()
    assert NO_CONTACTS in answer["error"]


@pytest.mark.parametrize(
    "program", ["force(sim.box);", "torque(sim.box);", "initially(force(sim.box));"]
)
def test_forces_without_some_entities_are_told_of(without_top, program):
    with ssduck.open(without_top[0]) as ss, pytest.warns(UserWarning, match=TOLD):
        ss.eval(program)


@pytest.mark.slow
def test_scores_of_forces_without_some_entities_are_told_of(without_top):
    folder, live = without_top
    with pytest.warns(UserWarning, match=TOLD):
        (scored,) = score(folder, reward="force(sim.box)[2]")
    assert scored.rewards[-1] > live[-1] + WEIGHT / 2  # the box on top is not there


def test_contacts_of_recorded_entities_are_not_told_of(without_top):
    with ssduck.open(without_top[0]) as ss, warnings.catch_warnings():
        warnings.simplefilter("error")
        assert ss.eval("inContact(sim.world, sim.box);")
        assert ss.eval("contactForce(sim.world, sim.box);") > WEIGHT


@pytest.mark.slow
def test_a_score_ends_where_stop_when_ends_the_episode(tmp_path):
    """As it would have live."""
    terms = {"reward": "z(sim.box) * k", "stop_when": "k >= 3"}
    variables = {"k": lambda env: round(env.data.time / env.model.opt.timestep) // 5}
    env = QueryWrapper(Stack(), **terms, variables=variables, forward=False)
    env.reset(seed=0)
    live, over = [], False
    while not over:
        _, reward, over, _, _ = env.step(np.zeros(1))
        live.append(reward)
    env.close()
    env = QueryWrapper(
        Stack(), reward="k + 0", variables=variables, record_to=tmp_path, forward=False
    )
    env.reset(seed=0)
    for _ in range(6):
        env.step(np.zeros(1))
    env.close()
    (scored,) = score(tmp_path, **terms)
    assert (list(scored.rewards), scored.total) == (live, sum(live))
    assert scored.stop == (False, False, True)
    (row,) = ssduck.lake(tmp_path).score(**terms).to_pylist()
    assert (row["steps"], row["return"]) == (3, sum(live))
    (scored,) = score(tmp_path, stop_when=terms["stop_when"])  # the rewards that were recorded
    assert scored.rewards == (1.0, 2.0, 3.0)


def test_steps_after_the_end_by_a_term_are_told_of():
    within = gymnasium.wrappers.Autoreset(Stack())  # it knows no terms
    env = QueryWrapper(within, stop_when="z(sim.box) < 9", forward=False)
    env.reset(seed=0)
    assert env.step(np.zeros(1))[2]
    with pytest.warns(ProgramWarning, match=r"has ended.*call reset; .*around QueryWrapper"):
        env.step(np.zeros(1))
    env.close()
