"""A condition that never holds in the episodes of a lake, always, or at each first tick."""

import pytest

import ssduck
from ssduck.errors import ArgumentError, ParseError
from ssduck.gym import QueryWrapper
from tests.gym.test_unrecorded import Fall
from tests.support.command_line import answer, ssduck_

EPISODES = 3


class Start(Fall):
    """A ball that falls from 1 m, and in the last episode from 0.5 m."""

    def start(self):
        self.data.qpos[2] = 0.5 if self.np_random_seed == EPISODES - 1 else 1.0


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("lint")
    env = QueryWrapper(Start(), "z(sim.ball) > 0.9", record_to=folder, forward=False)
    for seed in range(EPISODES):
        env.reset(seed=seed)
        for _ in range(10 + seed):
            env.step(env.action_space.sample())
    env.close()
    return folder


@pytest.fixture(scope="module")
def heights(runs):
    """The heights of the ball at the ticks of each episode."""
    found = []
    for episode in range(EPISODES):
        with ssduck.open(runs, episode=episode) as ss:
            rows = ss.sql("SELECT z FROM entities_history WHERE name = 'ball' ORDER BY tick")
            found.append([z for (z,) in rows.fetchall()])
    assert len(found[0]) == 11
    return found


@pytest.mark.parametrize("height", [0.2, 0.45, 0.7, 0.999, 1.1])
@pytest.mark.parametrize("where", [None, "episode < 2"])
def test_what_is_told_is_what_the_ticks_say(runs, heights, height, where):
    values = [[z > height for z in one] for one in heights[: 2 if where else EPISODES]]
    count = f"{len(values)} episodes"
    expected = []
    if not any(map(any, values)):
        expected = [f"it never holds: at no tick of {count}"]
    elif all(map(all, values)):
        expected = [f"it always holds: at all ticks of {count}"]
    elif all(one[0] for one in values):
        expected = [f"it holds at the first tick of each of {count}, before anything is done"]
    lake = ssduck.lake(runs)
    assert lake.lint(f"z(sim.ball) > {height};", where) == expected
    assert lake.lint(f"once(z(sim.ball) > {height}) -- so far", where, strict=True) == [
        one.replace("holds at the first", "always holds: at all")
        .replace(" tick of each of", " ticks of")
        .partition(", before")[0]
        for one in expected
    ]


def test_errors_and_what_is_no_condition(runs):
    lake = ssduck.lake(runs)
    with pytest.warns(UserWarning, match=r"no answer[^$]*\n    z\(sim.bal\) > 1\n"):
        (told,) = lake.lint("z(sim.bal) > 1")
    assert told.startswith("world 'sim' has no entity 'bal'")
    for text, error, match in (
        ("z(sim.ball)", ArgumentError, "is not True or False"),
        ("WHY z(sim.ball) > 1", ArgumentError, "one expression"),
        ("1 < 2; 2 < 3", ArgumentError, "one expression"),
        ("z(sim.ball >", ParseError, "expected"),
    ):
        with pytest.raises(error, match=match):
            lake.lint(text)


def test_the_command(runs):
    assert answer("lint", str(runs), "z(sim.ball) > 0.7") == ""
    result = ssduck_("lint", str(runs), "z(sim.ball) > 2;", "-w", "episode = 1")
    assert (result.exit_code, result.stdout) == (1, "it never holds: at no tick of 1 episode\n")
    result = ssduck_("lint", str(runs), "z(sim.bal) > 2")
    assert result.exit_code == 1
    assert result.output.count("has no entity 'bal'") == 1
    assert "SELECT" not in result.output
