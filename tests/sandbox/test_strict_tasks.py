"""Tasks of strangers: the whole environment is in a sandbox."""

import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from ssduck.errors import ArgumentError, LimitError, SceneError, SelectScriptError
from ssduck.gym import make_task
from ssduck.limits import Limits
from ssduck.sandbox import SandboxedInterpreter
from ssduck.sandbox.processes import shared_zygote
from tests.sandbox.test_scenes import BOX, CRASHING, ENDED
from tests.support.gym_environments import TASK as PUSH_TASK
from tests.support.gym_environments import TASK_MODEL
from tools.fuzzing.models import VISUAL_MESH

TASK = (
    PUSH_TASK.replace('"x(sim.ball) > goal"', '"heldFor(x(sim.ball) > goal) >= 0.1"')
    .replace("steps = 8", "steps = 50")
    .replace("done = ", 'speed = "rate(x(sim.ball))"\ndone = ')
)
# A task without actions, of a body b.
STILL = 'scene = "{}"\nsuccess = "z(sim.b) > 0"\n[observation]\nz = "z(sim.b)"\n'


@pytest.fixture(autouse=True)
def _shared(zygote, monkeypatch):
    """Forks workers from the zygote of the tests; a process that is forked has its own."""
    monkeypatch.setattr(
        "ssduck.sandbox.interpreter.shared_zygote",
        lambda: zygote if zygote.is_alive else shared_zygote(),
    )


@pytest.fixture
def folder(tmp_path):
    """A folder with tasks and their scenes."""
    folder = tmp_path / "task"
    folder.mkdir()
    (folder / "push.xml").write_text(TASK_MODEL)
    (folder / "task.toml").write_text(TASK)
    (folder / "b.urdf").write_text(BOX)
    (folder / "still.toml").write_text(STILL.format("b.urdf"))
    (folder / "c.dae").write_text(CRASHING)
    return folder


def strict(path, **changes):
    return make_task(path, limits=Limits.strict(**changes))


def test_a_strict_task_is_the_same_environment(folder):
    pytest.importorskip("mujoco")
    actions = np.random.default_rng(4).uniform(-0.2, 1, (50, 1)).astype(np.float32)
    with make_task(folder / "task.toml") as own, strict(folder / "task.toml") as env:
        assert (env.action_space, env.observation_space) == (
            own.action_space,
            own.observation_space,
        )
        assert env.task == own.task
        assert (env.metadata, env.spec, env.render_mode) == (own.metadata, None, None)
        for seed in env.task.seeds:
            for one, other in zip(env.reset(seed=seed), own.reset(seed=seed), strict=True):
                np.testing.assert_equal(one, other)
            for action in actions:
                step, expected = env.step(action), own.step(action)
                np.testing.assert_equal(step, expected)
                assert list(map(type, step)) == list(map(type, expected))
        assert step[3]
        assert {"success", "reward", "parts"} <= step[4]["ssduck"].keys()
        # Without a seed, starts are drawn on.
        np.testing.assert_equal(env.reset(), own.reset())
        assert env.interpreter.eval("SELECT id FROM sim AS list;") == [
            "world",
            "table",
            "pusher",
            "ball",
        ]


def test_gymnasium_accepts_a_strict_task(folder):
    pytest.importorskip("mujoco")
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        env = strict(folder / "task.toml")
        check_env(env)
    assert all(
        "Box observation space" in str(one.message) or "spec" in str(one.message) for one in told
    )
    env.close()
    for act in (lambda: env.step(np.zeros(1, np.float32)), env.reset):
        with pytest.raises(gymnasium.error.ClosedEnvironmentError, match="is closed: make it anew"):
            act()


@pytest.mark.slow
@pytest.mark.parametrize("scene", ["../outside.xml", "{outside}", "link.xml", "inner.xml"])
def test_a_scene_reads_no_file_outside(folder, scene):
    pytest.importorskip("mujoco")
    outside = folder.parent / "outside.xml"
    outside.write_text(TASK_MODEL)
    (folder / "link.xml").symlink_to(outside)
    (folder / "inner.xml").write_text(f'<mujoco><include file="{outside}"/></mujoco>')
    text = TASK.replace("push.xml", scene.replace("{outside}", str(outside)))
    (folder / "task.toml").write_text(text)
    with pytest.raises(SceneError, match=r"\.xml"):
        strict(folder / "task.toml")
    make_task(folder / "task.toml").close()  # in this process it does


def test_a_crash_is_an_error_and_the_host_lives(folder):
    env = strict(folder / "still.toml")
    first, _ = env.reset(seed=1)
    (folder / "b.urdf").write_text(VISUAL_MESH % "c.dae")
    with pytest.raises(LimitError, match=ENDED):
        env.reset(seed=1)
    with pytest.raises(LimitError, match=rf"still\.toml: {ENDED}"):
        strict(folder / "still.toml")
    (folder / "b.urdf").write_text(BOX)
    with pytest.raises(ArgumentError, match="call reset first"):
        env.step([])
    np.testing.assert_equal(env.reset(seed=1)[0], first)
    assert env.step([])[3] is False
    env.close()


def test_errors_are_those_of_the_task(folder):
    for before, after in (
        ('scene = "push.xml"', 'scene = "another.xml"'),
        ("z(sim.ball) < 0.3", "z(sim.bal) < 0.3"),
        ("z(sim.ball) < 0.3", "eval('1') < 0.3"),
        ('joint = "push"', 'joint = "pull"'),
        ("[variables]", "[variable]"),
    ):
        (folder / "task.toml").write_text(TASK.replace(before, after))
        errors = []
        for make in (make_task, strict):
            with pytest.raises(SelectScriptError, match=r"task\.toml: ") as raised:
                make(folder / "task.toml")
            errors.append((type(raised.value), raised.value.message, raised.value.suggestions))
        assert errors[0] == errors[1]


@pytest.mark.slow
def test_what_hangs_is_ended(folder):
    with strict(folder / "still.toml", seconds=3.0) as env:
        first, _ = env.reset(seed=1)
        hang = "worker._opened['task'].step = lambda _: __import__('time').sleep(1000)"
        env.interpreter.ask("worker.python", f"{hang}\n")
        with pytest.raises(LimitError, match="took too long, and its process was ended"):
            env.step([])
        np.testing.assert_equal(env.reset(seed=1)[0], first)


TAKEN = {
    "another shape": "(np.zeros(3), 0.0, False, False, {})",
    "texts": "(['a', 'b'], 0.0, False, False, {})",
    "no reward": "(np.zeros(2), 'much', False, False, {})",
    "no flags": "(np.zeros(2), 0.0, 1, None, {})",
    "no info": "(np.zeros(2), 0.0, False, False, [])",
    "nothing": "None",
}


def test_what_a_taken_process_answers_is_data(folder):
    pytest.importorskip("mujoco")
    with strict(folder / "task.toml") as env:
        env.reset(seed=1)
        for answer in TAKEN.values():
            code = f"import numpy as np\nworker._opened['task'].step = lambda _: {answer}\n"
            env.interpreter.ask("worker.python", code)
            with pytest.raises(LimitError, match="sent no answer"):
                env.step([0.0])


@pytest.mark.parametrize("values", [None, [], {}, {1: 2}, {"scene": "b.urdf", "seeds": 3}])
def test_what_a_taken_process_says_of_the_file_is_data(folder, monkeypatch, values):
    asked = SandboxedInterpreter.ask
    monkeypatch.setattr(
        SandboxedInterpreter,
        "ask",
        lambda self, name, *given, **o: (
            values if name == "task.task.values" else asked(self, name, *given, **o)
        ),
    )
    with pytest.raises((LimitError, SceneError), match=r"still\.toml: "):
        strict(folder / "still.toml")


@pytest.mark.slow
def test_strict_tasks_side_by_side(folder):
    """Each process of `AsyncVectorEnv` has a zygote of its own."""
    makes = [lambda: strict(folder / "still.toml")] * 2
    envs = gymnasium.vector.AsyncVectorEnv(makes)
    with make_task(folder / "still.toml") as own:
        first, _ = own.reset(seed=1)
        expected = own.step([])[0]
    np.testing.assert_equal(envs.reset(seed=1)[0], [first] * 2)
    np.testing.assert_equal(envs.step(np.zeros((2, 0), np.float32))[0], [expected] * 2)
    envs.close()
