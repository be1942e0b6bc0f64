"""A condition that is evaluated again and again is planned once, and is right after any change."""

from unittest.mock import patch

import mujoco
import numpy as np
import pytest

import ssduck
from ssduck.database.connection import Connection
from ssduck.errors import SelectScriptError
from ssduck.interpreter import planner
from ssduck.interpreter.scalar_select import RepeatedSelect
from tests.support.cases import sampled
from tests.support.recorded import answer

PILE = """
<mujoco>
  <option timestep="0.004" {cone}/>
  <worldbody>
    <geom name="floor" type="plane" size="0 0 .1"/>
    <body name="gripper">
      <body name="left" pos="-.1 0 .1"><joint name="l" type="slide" axis="1 0 0" damping="9"/>
        <geom type="box" size=".02 .1 .1" mass="1"/></body>
      <body name="right" pos=".1 0 .1"><joint name="r" type="slide" axis="-1 0 0" damping="9" range="0 .2"
        limited="true"/><geom type="box" size=".02 .1 .1" mass="1"/></body>
    </body>
    <body name="cube" pos="0 0 .05"><freejoint/><geom type="box" size=".05 .05 .05" mass=".2"/></body>
    <body name="ball" pos="0 .02 .16"><freejoint/><geom size=".04" mass=".1"/></body>
    <body name="can" pos=".01 0 .3"><freejoint/><geom type="cylinder" size=".04 .05" mass=".1"/></body>
  </worldbody>
  <actuator><motor joint="l"/><motor joint="r"/></actuator>
</mujoco>
"""


class Lab:
    """A pile between the fingers of a gripper, in an interpreter."""

    def __init__(self, cone=""):
        self.model = mujoco.MjModel.from_xml_string(PILE.format(cone=cone))
        self.data = mujoco.MjData(self.model)
        self.ss = ssduck.Interpreter(strict=False)
        self.world = self.ss.add_variable("lab", ssduck.World.attach(self.model, self.data))

    def run(self, steps, force=5.0):
        self.data.ctrl[:] = force
        mujoco.mj_step(self.model, self.data, steps)
        self.world.tick()


@pytest.fixture
def lab():
    lab = Lab()
    yield lab
    lab.ss.close()


CONTACTS = "inContact({0}), contactForce({0}), grasped({0}), hasContact({0})"
OF_ENTITIES, OF_LINKS = "a=lab, b=lab", "a=links(lab), b=links(lab)"


@pytest.mark.slow
@sampled(
    ("sources", "cone"),
    [
        (OF_ENTITIES, ""),
        (OF_LINKS, ""),
        ("a=links(lab), b=lab", ""),
        (OF_ENTITIES, 'cone="elliptic"'),
    ],
    every=3,
)
def test_contacts_of_two_are_those_of_all_pairs(sources, cone):
    lab = Lab(cone)
    expected = set()
    for _ in range(4):
        lab.run(40)
        rows = lab.ss.eval(f"SELECT a, b, {CONTACTS.format('a, b')} FROM {sources} AS list;")
        for start in range(0, len(rows), 6):
            lab.ss["one"], lab.ss["other"], *values = rows[start : start + 6]
            for pair in ("one, other", "other, one"):
                found = lab.ss.eval(f"SELECT {CONTACTS.format(pair)} FROM [0] AS list;")
                assert found == values, (lab.ss["one"], lab.ss["other"], pair)
            expected.add((values[0], values[1] > 0, values[2]))
    assert expected >= {(False, False, False), (True, True, False)}
    assert sources == OF_LINKS or (True, True, True) in expected
    lab.ss.close()


@pytest.mark.parametrize(
    "term",
    [
        "inContact(lab.cube, lab.ball)",
        "inContact(lab.gripper.left, lab.cube) AND NOT inContact(lab.gripper.right, lab.ball)",
        "contactForce(lab.cube, lab.gripper.right) > 0.1 OR grasped(lab.gripper.left, lab.cube)",
        "contactForce(lab.gripper, lab.cube) > 0.1",
        "grasped(lab.gripper, lab.cube) OR z(lab.ball) > 0.1",
        "joint(lab.gripper, 'r') < 0.05",
        "isOpen(lab.gripper) OR isClosed(lab.gripper, 'r')",
        "below(lab.cube, lab.ball)",
        "distance(lab.ball, goal) < 0.3",
        "-distance(lab.ball, goal) + joint(lab.gripper, 'l')",
        "norm([x(lab.ball) - goal[0], y(lab.ball) - 0.5]) < limit",
        "z(ball) < limit AND on(lab.cube, ball)",
        "on(lab.cube, lab.ball) AND speed(lab.ball) < limit",
    ],
)
def test_terms_are_what_a_new_plan_gives(lab, monkeypatch, term):
    lab.ss["goal"], lab.ss["limit"] = [0.1, 0.2, 0.3], 0.4
    lab.ss["ball"] = lab.world["ball"]
    program = lab.ss.compile(f"SELECT ({term}) FROM [0] AS list;")
    for number in range(5):
        lab.run(10)
        lab.ss["goal"] = [0.1 * number, 0.0, 0.3]
        value = lab.ss.eval(program)
        with monkeypatch.context() as patch:
            patch.setattr(RepeatedSelect, "rows", lambda *_: None)
            assert lab.ss.eval(program) == value


@pytest.mark.parametrize(
    "goal", [[0.1, 0, 0.3], [1, 2, 3], np.array([0.1, 0, 0.3]), np.array([1, 2, 3])], ids=str
)
def test_points_of_any_numbers_need_no_statement(lab, monkeypatch, goal):
    lab.ss["goal"] = goal
    program = lab.ss.compile("SELECT distance(lab.ball, goal) FROM [0] AS value;")
    lab.ss.eval(program)
    monkeypatch.setattr(Connection, "rows", None)
    for _ in range(3):
        lab.run(10)
        expected = np.linalg.norm(lab.data.body("ball").xpos - np.asarray(goal))
        assert lab.ss.eval(program) == pytest.approx(expected, rel=1e-12)


CHANGES = {
    "an integer": lambda lab: lab.ss.add_variable("limit", 1),
    "a text": lambda lab: lab.ss.add_variable("limit", "high"),
    "nothing": lambda lab: lab.ss.add_variable("limit", None),
    "not a number": lambda lab: lab.ss.add_variable("limit", float("nan")),
    "a longer list": lambda lab: lab.ss.add_variable("goal", [0.1, 0.2, 0.3, 0.4]),
    "a list of integers": lambda lab: lab.ss.add_variable("goal", [1, 2, 3]),
    "a list of both": lambda lab: lab.ss.add_variable("goal", [1, 0.5, 0]),
    "an array": lambda lab: lab.ss.add_variable("goal", np.array([0.4, 0.5, 0.6], np.float32)),
    "an array of integers": lambda lab: lab.ss.add_variable("goal", np.array([1, 2, 3])),
    "a longer array": lambda lab: lab.ss.add_variable("goal", np.array([1.0, 2.0, 3.0, 4.0])),
    "an array with NaN": lambda lab: lab.ss.add_variable("goal", np.array([1.0, np.nan, 3.0])),
    "an array of texts": lambda lab: lab.ss.add_variable("goal", np.array(["a", "b", "c"])),
    "an empty list": lambda lab: lab.ss.add_variable("goal", []),
    "an entity": lambda lab: lab.ss.add_variable("goal", lab.world["cube"]),
    "a link": lambda lab: lab.ss.add_variable("ball", lab.world["gripper"].links[0]),
    "another entity": lambda lab: lab.ss.add_variable("ball", lab.world["cube"]),
    "no variable": lambda lab: lab.ss.eval("clear('limit');"),
    "a function": lambda lab: lab.ss.add_function("z", lambda _: -1.0),
    "another world": lambda lab: lab.ss.add_variable("lab", Lab().world),
    "no such entity": lambda lab: lab.ss.add_variable(
        "lab", ssduck.World.attach(lab.model, lab.data, names={"ball": "sphere"})
    ),
    "a record": lambda lab: lab.ss.record("lab", ssduck.Recording()),
    "an infinite velocity": lambda lab: lab.data.qvel.fill(np.inf),
}


@pytest.mark.filterwarnings("ignore:your function")
@pytest.mark.parametrize("change", CHANGES.values(), ids=CHANGES)
def test_after_a_change_the_value_is_that_of_a_new_plan(lab, monkeypatch, change):
    program = lab.ss.compile(
        "SELECT z(lab.ball) > limit, distance(lab.cube, goal), x(ball) FROM [0] AS list;"
    )
    lab.ss["ball"] = lab.world["ball"]
    lab.ss["goal"], lab.ss["limit"] = [0.1, 0.2, 0.3], 0.4
    for _ in range(3):
        lab.run(3)
        before = lab.ss.eval(program)
    assert [type(value) for value in before] == [bool, float, float]

    def outcomes():
        yield answer(lab.ss, program)
        lab.world.tick()
        yield answer(lab.ss, program)

    change(lab)
    kept = list(outcomes())
    with monkeypatch.context() as patch:
        patch.setattr(RepeatedSelect, "rows", lambda *_: None)
        planned = list(outcomes())
    assert kept[1] == planned[0] == planned[1]


class _Loud(ssduck.Interpreter):
    """An interpreter with result forms of its own."""

    def evalAs(self, form, select, elements, names, where):  # noqa: N802
        return ("own", form, super().evalAs(form, select, elements, names, where))


@pytest.mark.slow
def test_a_repeated_row_is_what_the_program_gives(lab, monkeypatch, capsys):
    calls = []
    lab.ss.add_function("noted", lambda x: calls.append(x) or x + 1.0)
    texts = [
        "SELECT x(lab.ball), z(lab.ball) > 0.1 FROM [0] AS list;",
        "SELECT noted(x(lab.ball)) FROM [0] AS list;",
        "SELECT print(z(lab.ball)) FROM [0] AS list;",
        "SELECT x(lab.ball), 1 FROM [0] GROUP BY 1 AS list;",
        "SELECT x(lab.ball) FROM [0] AS value;",
        "SELECT x(lab.ball) AS a FROM [0];",
    ]
    programs = [lab.ss.compile(text) for text in texts]
    for _ in range(4):
        lab.run(5)
        calls.clear()
        capsys.readouterr()
        again = [lab.ss.eval(program) for program in programs]
        assert len(calls) == 1
        assert len(capsys.readouterr().out.splitlines()) == 1
        with monkeypatch.context() as patch:
            patch.setattr(RepeatedSelect, "rows", lambda *_: None)
            assert [lab.ss.eval(program) for program in programs] == again


def test_own_forms_are_asked_each_time(lab):
    with _Loud(strict=False) as own:
        own.add_variable("lab", lab.world)
        program = own.compile("SELECT x(lab.ball) FROM [0] AS list;")
        for _ in range(4):
            assert own.eval(program)[:2] == ("own", "list")


def test_an_entity_that_is_gone_is_an_error_of_the_next_run(lab):
    program = lab.ss.compile("SELECT x(lab.ball) FROM [0] AS list;")
    for _ in range(3):
        lab.run(1)
        lab.ss.eval(program)
    model = mujoco.MjModel.from_xml_string(PILE.format(cone="").replace('"ball"', '"egg"'))
    lab.ss["lab"] = ssduck.World.attach(model, mujoco.MjData(model))
    with pytest.raises(SelectScriptError, match="no entity 'ball'") as raised:
        lab.ss.eval(program)
    assert "line 1, column 14" in str(raised.value)


def test_a_relation_is_planned_once_for_all_texts(lab):
    lab.run(50)
    with patch.object(planner, "translate", side_effect=planner.translate) as plan:
        for n in range(5):
            distance = 0.02 * n
            assert lab.ss.eval(f"near(lab.cube, lab.ball, {distance});") == (
                lab.ss.eval("clearance(lab.cube, lab.ball);") <= distance
            )
    assert plan.call_count == 2
    with pytest.raises(SelectScriptError) as info:
        lab.ss.eval("3 > 2 AND near(lab.cube, 'ball', 0.1);")
    assert info.value.span.start == 25  # the place of the text


@pytest.mark.parametrize("sources", [OF_ENTITIES, OF_LINKS])
def test_pairs_that_press_are_found_by_their_contacts(lab, sources):
    lab.run(200)
    value, names = (
        "contactForce(a.this, b.this)",
        "tick(a.this) AS t, id(a.this) AS a, id(b.this) AS b",
    )
    for past in ("", "{}"):
        of = sources.replace("lab", f"lab{past}") if sources == OF_ENTITIES else sources
        rows = lab.ss.eval(f"SELECT {names}, {value} AS force FROM {of};")
        for condition, holds in (
            ("{} > 0", lambda force: force > 0),
            ("1 <= {}", lambda force: force >= 1),
            ("{} >= 0", lambda force: force >= 0),
            ("{} < 2", lambda force: force < 2),
            ("NOT {} > 1", lambda force: force <= 1),
        ):
            text = f"SELECT {names} FROM {of} WHERE {condition.format(value)};"
            expected = sorted((r["t"], r["a"], r["b"]) for r in rows if holds(r["force"]))
            assert sorted(tuple(row.values()) for row in lab.ss.eval(text)) == expected != []
        text = f"SELECT {names} FROM {of} WHERE {value} > 1 AS list;"
        assert past or " IN (" in lab.ss.explain(text)
