"""A condition that never holds in the episodes of a lake, always, or at each first tick."""

import shutil

import pyarrow as pa
import pytest

import ssduck
from ssduck.errors import ArgumentError, ParseError, ProgramWarning, SelectScriptError
from ssduck.gym import QueryWrapper
from tests.gym.test_unrecorded import Fall
from tests.support.command_line import answer, fails, ssduck_

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


@pytest.mark.slow
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
    assert lake.lint(f"EXISTS (SELECT id FROM sim WHERE z > {height})", where) == expected
    assert lake.lint(f"once(z(sim.ball) > {height}) -- so far", where, strict=True) == [
        one.replace("holds at the first", "always holds: at all")
        .replace(" tick of each of", " ticks of")
        .partition(", before")[0]
        for one in expected
    ]


def test_what_is_unknown_is_not_told_as_false(tmp_path):
    poses = pa.table({"time": [0.0, 0.1], "name": ["ball"] * 2, "x": [0.0] * 2, "z": [0.0, 9.0]})
    poses = poses.append_column("y", poses["x"])
    ssduck.write_record(tmp_path, {"ball": {"sphere": 0.1}}, poses, world="sim")
    lake = ssduck.lake(tmp_path)
    with pytest.warns(UserWarning, match="velocities were not recorded"):
        told = lake.lint("speed(sim.ball) < 0.1")
    assert told == ["it is unknown at all ticks of 1 episode"]
    assert lake.lint("NOT speed(sim.ball) < 0.1") == told


@pytest.mark.slow
@pytest.mark.parametrize("limits", [None, ssduck.Limits.strict()])
def test_places_are_those_of_the_text_as_it_is_given(runs, limits):
    lake = ssduck.lake(runs, limits=limits)
    for ending in ("", ";", ";  # done", ";;"):
        text = f"z(sim.ball) > 0 AND\n\n  z(sim.bal) > 1{ending}"
        with pytest.raises(SelectScriptError, match="no entity 'bal'") as caught:
            lake.lint(text)
        line = text.splitlines()[2]
        column = line.index("bal") + 1
        place = f"\n  line 3, column {column}\n    {line}\n    {' ' * (column - 1)}^^^"
        assert str(caught.value).endswith(place)
        assert lake.lint(text.replace("bal)", "ball)")) == [
            "it never holds: at no tick of 3 episodes"
        ]
    with pytest.raises(ParseError) as error:
        lake.lint("z(sim.ball) >")
    assert ";" not in str(error.value)
    with pytest.warns(ProgramWarning, match="never negative\n  line 1, column 1\n"):
        lake.lint("near(sim.ball, sim.ball, -1)")


@pytest.mark.slow
def test_some_episodes_fail(runs, tmp_path):
    folder = shutil.copytree(runs, tmp_path / "runs")
    next(folder.glob("entities/world=sim/episode=1/*.parquet")).write_bytes(b"no file of Parquet")
    shutil.rmtree(folder / "index")
    never, failed = sorted(ssduck.lake(folder).lint("z(sim.ball) > 2"), reverse=True)
    assert never == "it never holds: at no tick of 2 episodes"
    assert failed.startswith("1 episode failed: ")


def test_errors_and_what_is_no_condition(runs):
    lake = ssduck.lake(runs)
    for text, error, match in (
        ("z(sim.ball)", ArgumentError, "is not True or False"),
        ("WHY z(sim.ball) > 1", ArgumentError, "one expression"),
        (
            "eventually(z(sim.ball) < 0.9) AND EXISTS (SELECT this FROM sim)",
            ArgumentError,
            "has a query.*looks ahead",
        ),
        ("1 < 2; 2 < 3", ArgumentError, "one expression"),
        ("z(sim.ball >", ParseError, "expected"),
    ):
        with pytest.raises(error, match=match):
            lake.lint(text)


def test_the_command(runs):
    assert answer("lint", str(runs), "z(sim.ball) > 0.7") == ""
    result = ssduck_("lint", str(runs), "z(sim.ball) > 2;", "-w", "episode = 1")
    assert (result.exit_code, result.stdout) == (1, "it never holds: at no tick of 1 episode\n")
    text = "z(sim.bal) > 2"
    result, asked = (
        fails(["lint", str(runs), text], 1, "'bal'"),
        fails(["query", str(runs), text], 1, "'bal'"),
    )
    assert (result.stdout, result.stderr) == ("", asked.stderr)
