"""`make_task`: an environment from a file."""

import os

import gymnasium
import numpy as np
import pytest

from ssduck.errors import ArgumentError, ProgramWarning, SceneError, SelectScriptError
from ssduck.gym import make_task
from ssduck.gym.tasks import MAX_BYTES
from tests.support.cases import sampled
from tests.support.gym_environments import TASK, TASK_MODEL


@pytest.fixture
def folder(tmp_path):
    """A folder with a task and its scene."""
    (tmp_path / "push.xml").write_text(TASK_MODEL)
    (tmp_path / "task.toml").write_text(TASK)
    return tmp_path


@pytest.mark.slow
def test_the_ends_of_the_action_space_are_those_of_the_range(folder):
    """The nearest float32 is beyond 0.07, which is all that the actuator takes."""
    (folder / "push.xml").write_text(TASK_MODEL.replace('"-1 1"/>', '"-0.07 0.07"/>'))
    text = TASK.replace("low = -1", "low = -0.07").replace("high = 1", "high = 0.07")
    (folder / "task.toml").write_text(text)
    env = make_task(folder / "task.toml")
    assert float(env.action_space.high[0]) > 0.07
    env.reset(seed=1)
    for action in (env.action_space.high, env.action_space.low, [9.0]):
        env.step(action)
    env.close()


def test_a_step_that_is_no_steps_of_the_simulator_is_told_of(folder):
    """Its time step is 0.002 s."""
    for step_time in ("0.005", "0.0005"):
        (folder / "task.toml").write_text(TASK.replace("= 0.02\n\n", f"= {step_time}\n\n"))
        if step_time == "0.0005":
            with pytest.raises(
                SceneError, match=r"0\.0005 s is less than the simulator's time step"
            ):
                make_task(folder / "task.toml")
        else:
            with pytest.warns(ProgramWarning, match="a step takes 0.004 s"):
                make_task(folder / "task.toml").close()


def test_a_start_that_cannot_be_has_its_file_and_key(folder):
    (folder / "task.toml").write_text(TASK.replace('entity = "ball"', 'entity = "pusher"'))
    env = make_task(folder / "task.toml")
    with pytest.raises(SelectScriptError, match=r"task.toml: starts\[0\]: .* moves by its joints"):
        env.reset(seed=0)
    env.close()


@pytest.mark.slow
def test_a_task_runs(folder):
    env = make_task(folder / "task.toml")
    assert env.task.seeds == (1, 2)
    starts = []
    for seed in (*env.task.seeds, 1):
        observation, info = env.reset(seed=seed)
        starts.append(observation[1])
        assert 0 <= observation[1] <= 0.04
        assert info["ssduck"]["success"] is False
        ends = []
        for _ in range(8):
            observation, reward, terminated, truncated, info = env.step(np.ones(1, np.float32))
            assert reward == sum(info["ssduck"]["parts"].values())
            assert info["ssduck"]["success"] == (observation[1] > 0.05)
            ends.append(terminated or truncated)
        assert observation[0] > -0.25
        assert ends[-1]
    assert starts[0] == starts[2] != starts[1]
    env.close()


@pytest.mark.slow
@sampled(
    ("before", "after", "message"),
    [
        ('"push.xml"', '"../push.xml"', r"task.toml: scene: there is no file '../push.xml'"),
        ('"push.xml"', '"gone.xml"', "gone.xml"),
        ('joint = "push"', 'joint = "pusch"', r"task.toml: actions\[0\].*'pusch'.*'push'"),
        ('entity = "pusher"', 'entity = "pushr"', r"actions\[0\].entity.*'pushr'.*'pusher'"),
        ('entity = "ball"', 'entity = "bal"', r"starts\[0\].entity.*'bal'.*'ball'"),
        ("steps = 8", "step = 8", r"task.toml: step: there is no such key.*'steps'"),
        ("steps = 8", "steps = 0.5", "task.toml: steps"),
        ("high = 1\n", "high = -1\n", r"actions\[0\].high: -1 is not above"),
        ("seeds = [1, 2]", "seeds = [-1]", "task.toml: seeds"),
        ('"x(sim.ball) > goal"', '"x(sim.ball) > gaol"', "task.toml: success: .*'gaol'"),
        ('"x(sim.ball) > goal"', '"x(sim.ball)"', "task.toml: success: .* not True or False"),
        ('"x(sim.ball) > goal"', "3", "task.toml: success: expected a text"),
        ('"-distance(sim.pusher, sim.ball)"', "3", r"task.toml: reward\['near'\]"),
        ('ball = "x(sim.ball)"', "ball = 3", r"task.toml: observation\['ball'\]"),
        ('ball = "x(sim.ball)"', 'ball = "id(sim.ball)"', r"observation\['ball'\]: .* a number"),
        ("[observation]\npusher", "[observations]\npusher", "task.toml: observation"),
        ('control = "velocity"', 'control = "torque"', r"actions\[0\].control"),
        ("goal = 0.05", "goal = 0.05\nsim = 1", r"task.toml: variables.sim is the world"),
        ('"push.xml"', '"push.xml\\u0000"', "task.toml: scene: .* is no path"),
        ('"x(sim.ball) > goal"', "\"clear('sim')\"", "sim is a world"),
        ('"x(sim.ball) > goal"', '"sim = 1"', "sim is a world|== 1"),
        ('"x(sim.ball) > goal"', '"x(sim.ball) > 10 ^ (10 ^ 10)"', "too large"),
        ('"x(sim.ball) > goal"', "\"count('a' * 10 ^ 11) > x(sim.ball)\"", "too large"),
        (
            '"x(sim.ball) > goal"',
            "\"count(SELECT obj FROM sim AS glb('stolen.glb')) > x(sim.ball)\"",
            "files are switched off",
        ),
        ('"push.xml"', '"kitchen"', "kitchen"),
        ("high = 1\n", "high = inf\n", r"actions\[0\].high"),
        ("low = [0, -0.1, 0.45]", "low = [nan, -0.1, 0.45]", r"starts\[0\].low"),
        ('success = "x', 'succes = "x', r"task\.toml: succes: there is no such key; did you"),
        ('scene = "push.xml"', 'scene = "pusch.xml"', r"scene: there is no file .*'push\.xml'"),
        ('joint = "push"', 'joint = "pus"', r"actions\[0\]\.joint: pusher has no joint 'pus'"),
        ("high = 1\n", "high = 99\n", r"actions\[0\]\.high: pusher: "),
        (
            'ball = "x(sim.ball)"',
            "ball = \"IF(getTime() > 0.03; joint(sim.pusher, 'x'); 1)\"",
            r"task.toml: observation\['ball'\]: no joint of push has the name 'x'",
        ),
        ('"x(sim.ball) > goal"', "\"eval('1') == x(sim.ball)\"", "eval is switched off"),
    ],
    every=2,
)
def test_errors_name_file_and_key(folder, before, after, message):
    assert before in TASK
    (folder / "task.toml").write_text(TASK.replace(before, after))
    with pytest.raises(SelectScriptError, match=message):
        make_task(folder / "task.toml")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("before", "after", "message"),
    [
        (
            'done = "10',
            'done = "log(0.03 - getTime()) + 10',
            r"reward\['done'\]: log does not take",
        ),
        (
            'ball = "x(sim.ball)"',
            'ball = "IF(getTime() > 0.03; log(-1); 1)"',
            r"observation\['ball'\]: log does not take",
        ),
    ],
)
def test_an_error_of_a_later_step_names_file_and_key(folder, before, after, message):
    (folder / "task.toml").write_text(TASK.replace(before, after))
    env = make_task(folder / "task.toml")
    env.reset(seed=1)
    env.step([0.0])
    with pytest.raises(SelectScriptError, match=rf"^\S*task\.toml: {message}"):
        env.step([0.0])
    env.close()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["../scenes/push.xml", "link.xml", "sub"])
def test_a_scene_may_be_anywhere(folder, name):
    """Without limits it is one's own."""
    place = folder / "tasks"
    for inner in (place / "sub", folder / "scenes"):
        inner.mkdir(parents=True)
    (folder / "push.xml").rename(folder / "scenes" / "push.xml")
    (place / "link.xml").symlink_to(folder / "scenes" / "push.xml")
    (place / "sub" / "scene.toml").write_text(BALL.replace("[[body]]", "[[body]]\nmass = 1.0"))
    text = TASK.partition("[[actions]]")[0] if name == "sub" else TASK
    (place / "task.toml").write_text(text.replace("push.xml", name))
    with make_task(place / "task.toml") as env:
        observation, _ = env.reset(seed=1)
    assert env.observation_space.contains(observation)


def test_a_model_that_reads_what_is_not_there(folder):
    asset = '<asset><mesh name="m" file="/etc/hostname.stl"/></asset><worldbody>'
    (folder / "push.xml").write_text(TASK_MODEL.replace("<worldbody>", asset, 1))
    with pytest.raises(SelectScriptError, match="hostname"):
        make_task(folder / "task.toml")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("part", "message"),
    [
        ('<option timestep="1e-9"/>', "task.toml: step_time: .* steps of the simulator"),
        ('<option timestep="0"/>', "the timestep is not a number above 0"),
        ('<include file="push.xml"/>', "include"),
    ],
)
def test_a_model_that_cannot_be_stepped_is_an_error(folder, part, message):
    (folder / "push.xml").write_text(TASK_MODEL.replace("<worldbody>", f"{part}<worldbody>", 1))
    with pytest.raises(SelectScriptError, match=message):
        make_task(folder / "task.toml")


BALL = """
[[body]]
name = "ball"
sphere = 0.1

[[body]]
name = "pusher"
sphere = 0.1
position = [1, 1, 1]
"""
GEAR = """
[[constraint]]
type = "gear"
on = "ball"
to = "pusher"
gear_link = 1e30
"""


@pytest.mark.parametrize(
    ("part", "message"),
    [
        ("[engine]\nsubsteps = 10000\n", r"task.toml: step_time: .*10,000 substeps each"),
        ("[engine]\nsubsteps = 1000000000\n", r"scene.toml: engine.substeps: .* more than 10000"),
        ("[engine]\nsubsteps = 1e30\n", r"engine.substeps: 1e\+30 is more than"),
        ("[engine]\niterations = 1e30\n", r"engine.iterations: 1e\+30 is more than"),
        ("[engine]\njoint_iterations = 101\n", r"engine.joint_iterations: 101 is more than 100"),
        (GEAR, r"gear_link: 1e\+30 is more than"),
        (GEAR.replace("1e30", "-1e30"), r"gear_link: -1e\+30 is less than"),
    ],
)
def test_a_scene_with_numbers_beyond_bounds_is_refused(folder, part, message):
    (folder / "scene.toml").write_text(BALL + part)
    task = TASK.split("[[actions]]", maxsplit=1)[0].replace("push.xml", "scene.toml")
    (folder / "task.toml").write_text(task.replace("step_time = 0.02", "step_time = 1"))
    with pytest.raises(SceneError, match=message):
        make_task(folder / "task.toml")


@pytest.mark.slow
@pytest.mark.parametrize("term", ["10^400", "-(10^400)"])
@pytest.mark.parametrize(
    ("before", "key"), [('"x(sim.ball)"', "ball"), ('"10 * int(success)"', "done")]
)
def test_a_number_that_is_no_float_is_an_error(folder, before, key, term):
    (folder / "task.toml").write_text(TASK.replace(before, f'"{term}"'))
    with pytest.raises(
        ArgumentError, match=rf"task.toml: (reward|observation)\['{key}'\].*a float"
    ):
        make_task(folder / "task.toml")


@pytest.mark.parametrize("kind", ["a pipe", "a device", "a folder", "nothing", "a large file"])
def test_a_task_is_a_file(folder, kind):
    task = folder / "task.toml"
    task.unlink()
    if kind == "a pipe":
        os.mkfifo(task)
    elif kind == "a device":
        task.symlink_to("/dev/zero")
    elif kind == "a folder":
        task.mkdir()
    elif kind == "a large file":
        task.write_text(TASK + "#" * MAX_BYTES)
    with pytest.raises(SceneError, match=r"task.toml: (there is no such file|it has more than)"):
        make_task(task)


@pytest.mark.slow
@pytest.mark.parametrize("action", [[0.0, 0.0], 0.0, [[0.0]], []])
def test_an_action_of_another_shape_is_an_error(folder, action):
    with make_task(folder / "task.toml") as env:
        with pytest.raises(ArgumentError, match="call reset first"):
            env.step([0.0])
        env.reset(seed=1)
        with pytest.raises(ArgumentError, match="an action of this task has 1 numbers"):
            env.step(action)


@pytest.mark.slow
def test_a_closed_task_takes_no_step(folder):
    env = make_task(folder / "task.toml")
    env.reset(seed=1)
    env.close()
    for act in (lambda: env.step(np.zeros(1, np.float32)), env.reset):
        with pytest.raises(gymnasium.error.ClosedEnvironmentError, match="is closed: make it anew"):
            act()


@pytest.mark.slow
@pytest.mark.parametrize(("nan", "expected"), [("-2.5", (-2.5, False)), ("'failure'", (0.0, True))])
@pytest.mark.filterwarnings("ignore:.*no number")
def test_where_the_state_is_nan(folder, nan, expected):
    model = TASK_MODEL.replace(
        "<worldbody>", '<option><flag autoreset="disable"/></option><worldbody>'
    )
    (folder / "push.xml").write_text(model)
    text = TASK.replace("[reward]\n", "[reward]\nhigh = 'z(sim.ball)'\n")
    (folder / "task.toml").write_text(f"nan = {nan}\n{text}")
    env = make_task(folder / "task.toml")
    env.reset(seed=1)
    _, _, is_over, _, info = env.step(np.zeros(1, np.float32))
    assert (info["ssduck"]["parts"]["high"], is_over) == (pytest.approx(0.45, abs=0.01), False)
    env._world.simulator.data.qpos[:] = np.nan
    observation, _, is_over, _, info = env.step(np.zeros(1, np.float32))
    assert (info["ssduck"]["parts"]["high"], is_over) == expected
    assert observation.tolist() == [expected[0]] * 2
    env.close()


def test_another_value_of_nan(folder):
    (folder / "task.toml").write_text(f"nan = 'fail'\n{TASK}")
    with pytest.raises(SceneError, match=r"task\.toml: nan: give 'error', 'failure' or a number"):
        make_task(folder / "task.toml")
