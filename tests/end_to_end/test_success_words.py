"""The words of other predicate libraries: each condition of the page runs on the page's scene."""

import copy
import math
import re
from pathlib import Path

import numpy as np
import pytest

import ssduck

pytest.importorskip("mujoco")

PAGE = Path(__file__).parents[2].joinpath("docs/reference/success-words.md").read_text("utf-8")
# The rows of tables that have four columns: the word, its definition, the condition, the difference.
ROWS = re.findall(r"^\| (?!word|-)([^|]*) \|[^|]*\| `([^|]*)` \|[^|]*\|$", PAGE, re.MULTILINE)
# LIBERO's thresholds: the classes of fixtures, Open or TurnOn, Close or TurnOff.
CLASSES = re.findall(r"^\| ([\w, ]+) \| `(q [^|]*)` \| `(q [^|]*)` \|$", PAGE, re.MULTILINE)
# LIBERO's words of regions.
IN, ON = re.findall(r"```sql\n(.*?)```", PAGE, re.DOTALL)


@pytest.fixture(scope="module")
def scene():
    names = {}
    for code in re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL):
        exec(compile(code, "success-words.md", "exec"), names)  # noqa: S102
    with names["ss"]:
        yield names


@pytest.fixture(scope="module")
def lab(scene):
    return scene["ss"]


def test_all_rows_are_read():
    tables = re.findall(r"^\| (?!word|class)\S", PAGE, re.MULTILINE)
    assert len(ROWS) + len(CLASSES) == len(tables) > 40


@pytest.mark.parametrize("condition", dict.fromkeys([IN, ON, *(text for _, text in ROWS)]))
def test_a_condition_has_a_value(lab, condition):
    rewards = [row for row in ROWS if "reward" in row[0]]
    expected = float if condition in [text for _, text in rewards] else bool
    value = lab.eval(f"{condition};")
    assert isinstance(value, int | float) if expected is float else type(value) is bool


def _reach(data):
    return math.dist(data.site("tool").xpos, data.body("bowl").xpos)


def _drawer(data):
    return float(data.joint("slide").qpos[0])


# By hand, from the states of MuJoCo before a step and after it.
REWARDS = {
    "-distance(lab.arm.tool, lab.bowl)": lambda _, now: -_reach(now),
    "previous(distance(lab.arm.tool, lab.bowl)) - distance(lab.arm.tool, lab.bowl)": (
        lambda before, now: _reach(before) - _reach(now)
    ),
    "rate(x(lab.cabinet.drawer))": lambda before, now: (
        (now.body("drawer").xpos[0] - before.body("drawer").xpos[0]) / (now.time - before.time)
    ),
    "joint(lab.cabinet, 'slide') / 0.16": lambda _, now: _drawer(now) / 0.16,
    "exp(-((speed(lab.bowl) - 0.2)^2) / 0.25)": lambda _, now: math.exp(
        -((math.hypot(*now.joint(1).qvel[:3]) - 0.2) ** 2) / 0.25
    ),
    "int(inContact(lab.arm, lab.bowl)) + 2 * int(z(lab.bowl) > 0.5)": lambda *_: 0,
}


def test_rewards_are_what_they_are_by_hand(lab, scene):
    rewards = [text for word, text in ROWS if "reward" in word]
    assert rewards == [*REWARDS]
    mujoco, model, data = scene["mujoco"], scene["model"], scene["data"]
    mujoco.mj_forward(model, data)  # poses and velocities of the present state
    scene["lab"].tick()
    before = copy.copy(data)
    mujoco.mj_step(model, data)
    mujoco.mj_forward(model, data)
    scene["lab"].tick()
    for text in rewards:
        assert lab.eval(f"{text};") == pytest.approx(REWARDS[text](before, data), abs=1e-12), text
    # Standing still is 0.2 m/s too slow: exp(-0.04 / 0.25), and not more than 1.
    assert lab.eval(f"{rewards[4]};") == pytest.approx(0.852, abs=1e-3)


TRUE = [
    "on(lab.plate, lab.bowl)",
    "supports(lab.plate, lab.bowl) AND speed(lab.bowl) < 0.1",
    "heldFor(settled(lab.bowl)) >= 0.1",
    "upright(lab.bowl, 0.2)",
    "hasContact(lab.bowl, lab.plate)",
    "isClosed(lab.cabinet, 'slide')",
]


@pytest.mark.parametrize("condition", TRUE)
def test_what_holds_in_the_scene(lab, condition):
    assert condition in [text for _, text in ROWS]
    assert lab.eval(f"{condition};") is True


def test_the_bowl_is_on_the_plate_as_libero_means_it(lab):
    ((_, condition),) = [row for row in ROWS if row[0] == "`(On bowl plate)`"]
    assert lab.eval(f"{condition};") is True
    with pytest.raises(ssduck.SelectScriptError, match="bowll"):
        lab.eval(condition.replace("lab.bowl", "lab.bowll") + ";")


@pytest.mark.parametrize(
    ("name", "word", "other", "joint"),
    [("ShortCabinet", "Open", "Close", "slide"), ("FlatStove", "TurnOn", "TurnOff", "turn")],
)
def test_the_words_of_joints_have_the_thresholds_of_a_class(name, word, other, joint):
    (thresholds,) = [found for names, *found in CLASSES if name in names]
    rows = {row[2:].split()[0]: text for row, text in ROWS if row.startswith("`(")}
    asked = [text.replace("q", f"joint(lab.cabinet, '{joint}')") for text in thresholds]
    assert [rows[word], rows[other]] == asked


REGION = """
<mujoco>
  <worldbody>
    <body name="cabinet" pos="0 0 .5">
      <joint type="ball"/>
      <geom type="box" size=".3 .3 .3" mass="1"/>
      <site name="inside" type="box" size=".12 .03 .05" pos=".02 0 .01"/>
    </body>
    <body name="bowl"><freejoint/><geom size=".02" mass=".1"/></body>
  </worldbody>
</mujoco>
"""


def libero_in(half, turn, d):
    total = np.abs(turn @ half)
    return bool(np.all(d > -total - [0, 0, 0.01]) and np.all(d < total))


def libero_on(half, turn, d):
    d = turn @ d
    return bool(half[2] - 0.005 < d[2] < half[2] + 0.1 and np.all(np.abs(d[:2]) < half[:2]))


@pytest.mark.slow
@pytest.mark.parametrize(("text", "meant"), [(IN, libero_in), (ON, libero_on)], ids=["in", "on"])
def test_words_of_turned_regions_are_libero_s_formulas(text, meant):
    import mujoco

    model = mujoco.MjModel.from_xml_string(REGION)
    data, rng = mujoco.MjData(model), np.random.default_rng(1)
    half, flags = model.site("inside").size, []
    with ssduck.Interpreter() as ss:
        lab = ss.add_variable("lab", ssduck.World.attach(model, data))
        ss["half"] = half.tolist()
        for number in range(12):
            turn = rng.normal(size=4) if number % 3 else np.array([1.0, 0, 0, 0])
            data.qpos[:4] = turn / np.linalg.norm(turn)
            mujoco.mj_kinematics(model, data)
            site, turn = data.site("inside").xpos, data.site("inside").xmat.reshape(3, 3)
            data.qpos[4:7] = site + turn.T @ (rng.uniform(-1.2, 1.2, 3) * half + [0, 0, half[2]])
            mujoco.mj_forward(model, data)  # it touches the cabinet, whose box is larger
            lab.tick()
            flags.append(meant(half, turn, data.qpos[4:7] - site))
            assert ss.eval(f"{text};") == flags[-1]
    assert 0 < sum(flags) < 12
