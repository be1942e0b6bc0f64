"""`score` gives for recorded episodes what `QueryWrapper` gave live, to the last digit."""

import json
import math
import shutil

import numpy as np
import pytest

import ssduck
from ssduck.errors import RecordError, SelectScriptError, UnknownNameError
from ssduck.gym import QueryWrapper, score
from tests.support.cases import generated, sampled
from tests.support.gym_environments import Push

VARIABLES = {"goal": lambda env: env.goal}
TERMS = {
    "success": "on(sim.table, sim.ball) AND x(sim.ball) > goal[0]",
    "failure": "z(sim.ball) < 0.3",
    "reward": {
        "goal": "-sqrt((x(sim.ball) - goal[0])^2 + (z(sim.ball) - goal[2])^2)",
        "near": "-clearance(sim.pusher, sim.ball)",
        "push": "contactForce(sim.pusher, sim.ball)",
        "done": "10 * int(success)",
        "hold": "heldFor(on(sim.table, sim.ball))",
    },
    "stop_when": "success",
}
# Terms of today, for the episodes of yesterday.
OTHER = {"success": "heldFor(x(sim.ball) > goal[0] / 2) >= 0.02", "reward": "-z(sim.pusher)"}
EPISODES = generated(4)


def nested(depth):
    """Returns lists in each other."""
    value = 1.0
    for _ in range(depth):
        value = [value]
    return value


def run(env, generator, number):
    """Runs an episode; returns its rewards and what `info` says after each step."""
    env.reset(seed=number, options={"number": number})
    rewards, infos = [], []
    for _ in range(6):
        _, reward, terminated, _, info = env.step(generator.uniform(-1, 1, 1))
        rewards.append(reward)
        infos.append(info["ssduck"])
        if terminated:
            break
    return rewards, infos


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """A record of episodes, and what two wrappers around each other gave for them."""
    folder = tmp_path_factory.mktemp("episodes")
    inner = QueryWrapper(Push(), **OTHER, variables=VARIABLES)
    env = QueryWrapper(inner, **TERMS, variables=VARIABLES, record_to=folder)
    generator = np.random.default_rng(7)
    others = []
    step = inner.step

    def noted(action):
        result = step(action)
        others[-1].append((result[1], result[4]["ssduck"]["success"]))
        return result

    inner.step = noted
    live = []
    for number in range(EPISODES):
        others.append([])
        live.append(run(env, generator, number))
    env.close()
    return folder, live, others


@pytest.mark.slow
def test_scores_are_those_of_the_wrapper(recorded):
    folder, live, _ = recorded
    scores = list(score(folder, **TERMS))
    assert [(one.episode, one.seed) for one in scores] == [(n, n) for n in range(EPISODES)]
    for one, (rewards, infos) in zip(scores, live, strict=True):
        assert one.options == {"number": one.episode}
        assert list(one.rewards) == rewards
        assert one.total == sum(rewards)
        assert list(one.success) == [info["success"] for info in infos] == list(one.stop)
        assert list(one.failure) == [info["failure"] for info in infos]
        for name, values in one.parts.items():
            assert list(values) == [info["parts"][name] for info in infos]


@pytest.mark.slow
def test_other_terms_score_as_they_would_have_live(recorded):
    folder, _, others = recorded
    for one, expected in zip(score(folder, **OTHER), others, strict=True):
        assert list(zip(one.rewards, one.success, strict=True)) == expected


@pytest.fixture(scope="module")
def few(tmp_path_factory):
    """A record of two episodes."""
    folder = tmp_path_factory.mktemp("few")
    env = QueryWrapper(Push(), **TERMS, variables=VARIABLES, record_to=folder)
    for number in range(2):
        run(env, np.random.default_rng(number), number)
    env.close()
    return folder


def test_without_a_reward_it_is_that_of_the_steps(few):
    first = next(score(few, success="x(sim.ball) > 0"))
    stored = json.loads((few / "gym/sim-0.json").read_text())
    assert list(first.rewards) == stored["rewards"]
    assert first.total == stored["return"]
    assert stored["seed"] == 0
    assert stored["options"] == {"number": 0}


def test_a_wrong_name_is_an_error(few):
    with pytest.raises(UnknownNameError, match=r"success: .*'bal'.*'ball'"):
        next(score(few, success="x(sim.bal) > 0"))


@pytest.mark.slow
@sampled(
    ("change", "message"),
    [
        ({"version": 2}, "later|newer"),
        ({"rewards": [1.0]}, "different lengths"),
        ({"times": "now"}, "'times'"),
        ({"times": [math.nan] * 7}, "'times'"),
        ({"times": [10**400] * 7}, "'times'"),
        ({"times": [0.6, 0.5, 0.4, 0.3, 0.2, 0.1, 0.0]}, "'times'"),
        ({"seed": {"a": 1}}, "'seed'"),
        ({"variables": {"goal": 3}}, "'variables'"),
    ],
    every=2,
)
def test_damaged_steps_are_errors(few, tmp_path, change, message):
    folder = shutil.copytree(few, tmp_path / "damaged")
    file = folder / "gym/sim-0.json"
    content = json.loads(file.read_text()) | change
    del content["crc32"]
    file.write_text(json.dumps(content))
    with pytest.raises(RecordError, match=message) as caught:
        next(score(folder, reward="x(sim.ball)"))
    assert str(file) in str(caught.value)
    (damage,) = ssduck.check(folder)
    assert damage.file == file
    assert damage.problem in str(caught.value)
    (repaired,) = ssduck.check(folder, repair=True)
    if "newer" in message:  # a newer ssduck reads it
        assert not repaired.is_repaired
        assert file.exists()
        return
    assert repaired.is_repaired
    assert not ssduck.check(folder)
    assert [one.episode for one in score(folder, reward="x(sim.ball)")] == [1]


def test_steps_that_cannot_be_read_are_damages(few, tmp_path):
    folder = shutil.copytree(few, tmp_path / "damaged")
    for file, content in zip(sorted((folder / "gym").iterdir()), ("", "{}"), strict=True):
        file.write_text(content)
    assert [one.file.name for one in ssduck.check(folder)] == ["sim-0.json", "sim-1.json"]


def test_variables_are_arrays_of_any_dimension_numpy_has(few, tmp_path):
    folder = forged(few, tmp_path, v=nested(64))
    assert next(score(folder, success="z(sim.ball) > -9")).success


def test_a_record_without_steps_is_an_error(few):
    with pytest.raises(RecordError, match=r"no episode of an environment with the world 'other'"):
        score(few, reward="x(other.ball)", world="other")


def forged(few, place, **variables):
    """Returns a copy whose first episode has more variables, with one value at each tick."""
    folder = shutil.copytree(few, place / "forged")
    (file, *_) = sorted((folder / "gym").iterdir())
    content = json.loads(file.read_text())
    content.pop("crc32", None)
    for name, value in variables.items():
        content["variables"][name] = [value] * len(content["times"])
    file.write_text(json.dumps(content))
    return folder


@pytest.mark.slow
@pytest.mark.parametrize(
    ("variables", "message"),
    [
        ({"success": True}, "'success' is the name of a term"),
        ({"failure": False}, "'failure' is the name of a term"),
        ({"sim": 1}, "'sim' is the name of the world"),
        ({"a b; x": 1}, "cannot be a variable's name"),
        ({"SELECT": 1}, "cannot be a variable's name"),
        ({"v": {"__class__": 1}}, "a variable is True, False, a number"),
        ({"v": None}, "a variable is True, False, a number"),
        ({"v": [[None]]}, "a variable is True, False, a number"),
    ],
)
def test_forged_variables_are_errors(few, tmp_path, variables, message):
    folder = forged(few, tmp_path, **variables)
    terms = {"success": "z(sim.ball) > 9", "failure": "z(sim.ball) < 0"}
    with pytest.raises(SelectScriptError, match=message):
        list(score(folder, **terms))
    answers = ssduck.lake(folder).score(**terms)
    (first, *others) = answers["error"].to_pylist()
    assert message in first
    assert others == [None] * len(others)


@pytest.mark.slow
def test_an_element_is_of_its_own_variable(few, tmp_path):
    folder = forged(few, tmp_path, v=[1, 2], v__0=9)
    right = "v[0] == 1 AND v[1] == 2 AND v__0 == 9 AND z(sim.ball) > -9"
    assert all(next(iter(score(folder, success=right))).success)


@pytest.mark.slow
def test_terms_may_end_with_comments(few):
    """All terms are one statement."""
    plain = {
        "success": "z(sim.ball) > 0.4",
        "reward": {"a": "IF(success; 1; 0)", "b": "z(sim.ball)"},
    }
    told = {
        "success": f"{plain['success']} # high",
        "reward": {"a": "IF(success; 1; 0) -- done", "b": "z(sim.ball)"},
    }
    assert [one.rewards for one in score(few, **told)] == [
        one.rewards for one in score(few, **plain)
    ]
