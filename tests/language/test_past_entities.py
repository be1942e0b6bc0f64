"""Entities at a tick of the past in expressions, and `previous`, `rate` and `at`."""

import math
import warnings
from itertools import pairwise

import mujoco
import numpy as np
import pytest

import ssduck
from ssduck.errors import ArgumentError, EvaluationError, SelectScriptError
from ssduck.interpreter.over_time import evaluator
from ssduck.interpreter.query_runner import PlannedQuery

XML = """
<mujoco>
  <option timestep="0.01"/>
  <worldbody>
    <body name="ball" pos="0 0 1"><freejoint/><geom size=".05" mass="1"/></body>
    <body name="box" pos="1 0 .1"><geom type="box" size=".1 .1 .1"/></body>
  </worldbody>
</mujoco>
"""
STEPS = 20


class Fall:
    """Bodies that fall, with their heights and joints at each tick from MuJoCo itself."""

    def __init__(self, xml=XML, speeds=0.0, steps=STEPS, **options):
        self.model = mujoco.MjModel.from_xml_string(xml)
        self.data = mujoco.MjData(self.model)
        self.data.qvel[2:] = speeds
        mujoco.mj_forward(self.model, self.data)
        self.ss = ssduck.Interpreter(**options)
        self.world = self.ss.add_variable("sim", ssduck.World.attach(self.model, self.data))
        self.z, self.joints = [self.data.xpos[1:, 2].copy()], [self.data.qpos.copy()]
        self.step(steps)

    def step(self, steps=1):
        for _ in range(steps):
            mujoco.mj_step(self.model, self.data)
            mujoco.mj_forward(self.model, self.data)
            self.world.tick()
            self.z.append(self.data.xpos[1:, 2].copy())
            self.joints.append(self.data.qpos.copy())

    @property
    def heights(self):
        """Those of the first body."""
        return [float(heights[0]) for heights in self.z]


@pytest.fixture(scope="module", params=["compiled", "row by row"])
def fall(request):
    result = Fall(row_by_row=request.param == "row by row")
    with result.ss:
        yield result


def _drop(fall):
    """Returns how far the ball is from where it was at first."""
    return pytest.approx(fall.heights[0] - fall.heights[-1], abs=1e-15)


DISTANCES = (
    "distance(sim.ball, sim{0.0}.ball);",
    "distance(sim{0.0}.ball, sim.ball);",
    "distance(sim{0.0}['ball'], sim.ball);",
    "distance(obj(sim{0.0}.ball), obj(sim.ball));",
    "distance(links(sim{0.0}.ball)[0], sim.ball);",
    "b = sim{0.0}.ball; distance(sim.ball, b);",
    "b = [0, [sim{0.0}.ball]]; distance(sim.ball, b[1][0]);",
    "IF(True; -(-distance(sim.ball, sim{0.0}.ball)); 0);",
    "SELECT distance(sim.ball, sim{0.0}.ball) FROM [0] AS value;",
    "SELECT distance(this, sim{0.0}.ball) FROM sim WHERE id = 'ball' AS value;",
    "b = sim{0.0}.ball; SELECT distance(b, sim.ball) FROM sim AS value;",
    "b = sim{0.0}.ball; SELECT distance(b, this) FROM sim WHERE this = b AS value;",
    "SELECT distance(p.this, q.this) FROM p=sim{0.0}, q=sim WHERE p.id = 'ball' AND q.id = 'ball' AS value;",
    "l = SELECT obj FROM sim{0.0} AS list; "
    "SELECT distance(p.this, q.this) FROM p=l, q=sim WHERE p.this = q.this AND q.id = 'ball' AS value;",
    "at(getTime(), distance(sim.ball, sim{0.0}.ball));",
    "greatest(distance(sim.ball, sim{0.0}.ball))[1];",
    "norm(position(sim.ball) - position(sim{0.0}.ball));",
)


@pytest.mark.parametrize("program", DISTANCES)
def test_a_past_entity_stays_in_the_past(fall, program):
    assert fall.ss.eval(program) == _drop(fall)


def test_beside_rows_of_the_past_an_entity_follows_them(fall):
    heights = fall.heights
    program = (
        "b = sim{0.0}.ball; SELECT distance(b, sim.ball) FROM sim{0.1} WHERE id = 'box' AS value;"
    )
    assert fall.ss.eval(program) == pytest.approx(heights[0] - heights[10], abs=1e-15)
    program = "SELECT distance(sim.ball, this) FROM sim{0.1} WHERE id = 'ball' AS value;"
    assert fall.ss.eval(program) == 0
    program = "SELECT distance(sim{0.0}.ball, this) FROM sim{} WHERE id = 'ball' AS list;"
    assert fall.ss.eval(program) == pytest.approx([heights[0] - z for z in heights], abs=1e-15)


@pytest.mark.parametrize(
    "program",
    [
        "near(sim{0.0}.ball, sim.ball, 0.01);",
        "near(sim{0.0}.ball, sim{0.1}.ball, 0.01);",
        "on(sim.box, sim{0.0}.ball);",
        "inContact(sim{0.0}.ball, sim.box);",
        "b = sim{0.0}.ball; SELECT near(b, this, 0.5) FROM sim AS list;",
        "SELECT touching(sim{0.0}.ball, sim.box) FROM [0] AS list;",
        "SELECT near(sim{0.0}.ball, sim{0.1}.ball, 3) FROM [0] AS list;",
    ],
)
def test_shapes_of_two_ticks_are_an_error_that_says_what_to_write(fall, program):
    with pytest.raises(ArgumentError, match=r"of 0(\.2)? s and of 0(\.[12])? s.*write at\(t, "):
        fall.ss.eval(program)


def test_shapes_of_one_tick_are_compared(fall):
    assert fall.ss.eval("near(sim{0.2}.ball, sim.box, 5);") is True
    ball = [0, 0, fall.heights[10]]
    clearance = math.dist(ball, [0.9, 0, 0.2]) - 0.05
    for program in (
        "clearance(sim{0.1}.ball, sim{0.1}.box);",
        "at(0.1, clearance(sim.ball, sim.box));",
    ):
        assert fall.ss.eval(program) == pytest.approx(clearance, abs=1e-6)


@pytest.mark.parametrize("program", ["z(sim{-0.1}.ball);", "w = sim{}; z(w['ball']);"])
def test_an_entity_of_a_window_is_of_no_tick(fall, program):
    with pytest.raises(ArgumentError, match=r"'ball' of a window .* sim\{t\} .*previous\(…\)"):
        fall.ss.eval(program)


@pytest.mark.slow
def test_terms_and_kept_programs_keep_the_past():
    fall = Fall(steps=1)
    with fall.ss:
        text = "SELECT distance(sim.ball, sim{0.0}.ball), z(sim.ball) - previous(z(sim.ball)) FROM [0] AS list;"
        program = fall.ss.compile(text)
        seen = []
        fall.ss.add_trigger("moved", "distance(sim.ball, sim{0.0}.ball);", 0, seen.append)
        for _ in range(5):
            fall.step()
            drop, change = fall.ss.eval(program)
            assert drop == _drop(fall)
            assert change == pytest.approx(fall.heights[-1] - fall.heights[-2], abs=1e-15)
            assert seen[-1] == _drop(fall)


@pytest.mark.slow
def test_records_keep_the_past(tmp_path):
    fall = Fall(steps=6)
    with fall.ss:
        fall.ss.export(tmp_path / "run")
    with ssduck.open(tmp_path / "run") as record:
        sim = record.call_variable("sim").seek(0.04)
        assert record.eval("distance(sim.ball, sim{0.0}.ball);") == pytest.approx(
            fall.heights[0] - fall.heights[4], abs=1e-15
        )
        assert record.eval("previous(z(sim.ball));") == fall.heights[3]
        sim.step()
        assert record.eval("previous(z(sim.ball));") == fall.heights[4]


@pytest.mark.parametrize(
    ("program", "value"),
    [
        ("[5, 7.5, 9] - [1, 2, 3];", [4, 5.5, 6]),
        ("[] - [];", []),
        ("SELECT [this, 3] - [1, this] FROM [1, 2] AS list;", [[0, 2], [1, 1]]),
        ("c = [1, 2]; SELECT c - [this, this] FROM [1, 2] AS list;", [[0, 1], [-1, 0]]),
        ("sub([3, 4], [1, 1])[1];", 3),
        ("position(sim.box) - [1, 0, 0];", pytest.approx([0, 0, 0.1])),
        (
            "SELECT position - [1, 0, 0] FROM sim WHERE id = 'box' AS value;",
            pytest.approx([0, 0, 0.1]),
        ),
    ],
)
def test_lists_of_numbers_have_a_difference(fall, program, value):
    assert fall.ss.eval(program) == value


@pytest.mark.parametrize(
    ("program", "message"),
    [
        ("[1, 2] - [1];", "lists of one length, not of 2 and 1 elements"),
        ("[1, 'a'] - [1, 2];", "- takes lists of numbers"),
        ("position(sim.box) - sim.box;", "- does not take a list and KinBody"),
    ],
)
def test_lists_without_a_difference(fall, program, message):
    with pytest.raises(ArgumentError, match=message):
        fall.ss.eval(program)


# -- previous, rate, at ----------------------------------------------------------------------------


@pytest.mark.slow
def test_previous_rate_and_at(fall):
    z, eval = fall.heights, fall.ss.eval
    assert eval("previous(z(sim.ball));") == z[-2]
    speeds = [0.0, *((b - a) / 0.01 for a, b in pairwise(z))]
    assert eval("rate(z(sim.ball));") == pytest.approx(speeds[-1], rel=1e-9)
    assert eval("rate(position(sim.ball));") == pytest.approx([0, 0, speeds[-1]], rel=1e-9)
    assert eval("at(0.1, z(sim.ball));") == z[10]
    assert eval("at(0.105, z(sim.ball)) - at(0, z(sim.ball));") == z[10] - z[0]
    assert eval("previous(above(sim.box, sim.ball));") is False
    # They nest: of a rate the rate is the gravity, and each row of the past has its own.
    assert eval("rate(rate(z(sim.ball)));") == pytest.approx(-9.81, abs=1e-9)
    assert eval("at(0.1, previous(z(sim.ball)));") == z[9]
    assert eval("least(rate(z(sim.ball)))[1];") == pytest.approx(min(speeds), rel=1e-9)
    ((start, end),) = eval("holds(rate(z(sim.ball)) < -1);")
    assert (start, end) == pytest.approx((0.11, 0.2))
    rows = "SELECT rate(z(this)) FROM sim{} WHERE id = 'ball' AS list;"
    assert eval(rows) == pytest.approx(speeds, rel=1e-9)
    held = "SELECT heldFor(z(sim.ball) < 0.99) FROM sim{} WHERE id = 'box' AS list;"
    start = next(i for i, height in enumerate(z) if height < 0.99)
    assert eval(held) == pytest.approx([max(0, i - start) * 0.01 for i in range(len(z))])
    assert eval("holds(lifted(sim.ball, -0.05));")[0][0] == 0.0
    fast = "SELECT id FROM sim WHERE rate(z(this)) < -1 AS list;"
    assert eval(fast) == ["ball"]


def test_the_first_tick_has_no_past():
    fall = Fall(steps=0)
    with fall.ss:
        assert fall.ss.eval("[previous(z(sim.ball)), rate(z(sim.ball))];") == [1.0, 0.0]
        assert fall.ss.eval("rate(position(sim.ball));") == [0.0, 0.0, 0.0]
        # Of ticks of one time the last one counts: there is still no past.
        fall.world["ball"].move([0, 0, 2])
        assert fall.ss.eval("[previous(z(sim.ball)), rate(z(sim.ball))];") == [2.0, 0.0]
        fall.step()
        assert fall.ss.eval("previous(z(sim.ball));") == 2.0


def test_previous_at_ticks_that_are_not_recorded():
    fall = Fall(steps=0)
    with fall.ss:
        fall.ss.record("sim", ssduck.Recording(every=4))
        fall.step(7)
        ticks = fall.ss.past("sim").times
        before = max(time for time in ticks if time < fall.world.time)
        assert fall.ss.eval("previous(z(sim.ball));") == fall.heights[round(before / 0.01)]


@pytest.mark.parametrize(
    ("program", "error", "message"),
    [
        (
            "at(-0.1, z(sim.ball));",
            ArgumentError,
            r"at\(max\(\[0, getTime\(\) - 0.5\]\), x\(cup\)\)",
        ),
        ("at(9, z(sim.ball));", EvaluationError, "recorded from 0 s to 0.2 s"),
        ("at(z(sim.ball));", ArgumentError, "at takes 2 arguments"),
        ("previous(1);", ArgumentError, "takes an expression of entities"),
        ("previous(z(sim{0.0}.ball));", ArgumentError, "stays at its tick: write it without"),
        ("rate(id(sim.ball));", ArgumentError, "rate takes an expression of numbers, not 'ball'"),
    ],
)
def test_mistakes(fall, program, error, message):
    with pytest.raises(error, match=message) as caught:
        fall.ss.eval(program)
    assert isinstance(caught.value, SelectScriptError)
    assert "line 1" in str(caught.value)


def test_the_words_may_be_names_of_ones_own(recwarn):
    with ssduck.Interpreter(strict=True) as ss:
        assert ss.eval("rate = 2; previous = 1; at = 3; rate + previous + at;") == 6
    with ssduck.Interpreter() as ss:
        with pytest.warns(UserWarning, match="replaces the language's own at"):
            ss.add_function("at", lambda a, b: a + b)
        assert ss.eval("at(1, 2);") == 3
        assert ss.eval("SELECT at(this, 2) FROM [1, 2] AS list;") == [3, 4]


# (what is asked of the past, whether that is more than what is kept)
ASKED = [
    ("heldFor(z(sim.ball) > 0);", True),
    ("since(z(sim.ball) > 0) > 0;", True),
    ("initially(z(sim.ball));", True),
    ("greatest(z(sim.ball));", True),
    ("holds(z(sim.ball) > 0);", True),
    ("SELECT max(z) FROM sim{} AS value;", True),
    ("SELECT max(z) FROM sim{-1.0} AS value;", True),
    ("heldFor(z(sim.ball) > 9);", False),
    ("holds(z(sim.ball) > 0, -0.02);", False),
    ("SELECT max(z) FROM sim{-0.02} AS value;", False),
    ("previous(z(sim.ball)) > rate(z(sim.ball));", False),
]


@pytest.mark.parametrize(("program", "is_more"), ASKED)
def test_dropped_ticks_are_told_of_once_where_they_are_asked_for(program, is_more):
    fall = Fall(steps=0)
    with fall.ss, warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        fall.ss.record("sim", ssduck.Recording(seconds=0.05))
        fall.step(20)
        first = fall.ss.past("sim", -0.02).record.ticks.times[0]
        assert first > 0.05
        for _ in range(2):
            fall.ss.eval(program)
    messages = [str(one.message) for one in told]
    assert len(messages) == is_more
    assert all(f"the past begins at {first:g} s" in message for message in messages)
    assert all("ss.record('sim', ssduck.Recording(seconds=0.1))" in m for m in messages)


# -- rows: functions of time of all entities are read at once, with the same values ---------------

COUNT, TICKS = 12, 20
BODIES = "".join(
    f'<body name="b{n}" pos="{n} 0 {1 + n / 8}"><freejoint/><geom size=".05" mass="1"/></body>'
    for n in range(COUNT)
)
MANY = f"""
<mujoco>
  <option timestep="0.01"/>
  <worldbody>
    <body name="arm" pos="0 3 1"><joint name="hinge" axis="0 1 0"/><geom pos=".2 0 0" size=".05"/></body>
    <body name="leg" pos="0 5 1"><joint name="hip" axis="0 1 0"/><geom pos=".2 0 0" size=".05"/></body>
    {BODIES}
  </worldbody>
</mujoco>
"""


@pytest.fixture(scope="module")
def many():
    """Bodies that fall with speeds of their own, of whose joints two are hinges."""
    tables = ssduck.Recording(tables=("entities", "links", "joints"))
    speeds = np.linspace(-1, 3, 6 * COUNT)
    result = Fall(MANY, speeds, TICKS, recording=tables)
    with result.ss:
        yield result


def before(many, steps):
    """How much each body has risen since so many steps ago, m."""
    return many.z[-1] - many.z[-1 - steps]


VALUES = [
    ("z(this) - previous(z(this))", lambda many: before(many, 1)),
    ("rate(z(this))", lambda many: before(many, 1) / 0.01),
    ("z(this) - initially(z(this))", lambda many: before(many, TICKS)),
    ("z(this) - at(0.15, z(this))", lambda many: before(many, 5)),
    ("greatest(z(this))[1]", lambda many: np.max(many.z, axis=0)),
    ("initially(distance(this, sim.b3))", None),
]


@pytest.mark.slow
@pytest.mark.parametrize(("column", "expected"), VALUES)
@pytest.mark.parametrize("most", [0, evaluator.MOST_ROWS], ids=["each", "all"])
def test_the_values_are_those_of_each_entity(many, monkeypatch, most, column, expected):
    monkeypatch.setattr(evaluator, "MOST_ROWS", most)
    values = many.ss.eval(f"SELECT {column} FROM sim AS list;")
    if expected is None:
        places = many.ss.eval("SELECT position(this) AS p FROM sim{0.0};")
        places = np.array([row["p"] for row in places])
        other = places[2 + 3]
        assert values == pytest.approx(np.linalg.norm(places - other, axis=1), abs=1e-12)
    else:
        assert values == pytest.approx(expected(many), abs=1e-9)


@pytest.mark.parametrize(("rows_a_query", "singles"), [(1_000, 1), (100, 3)])
def test_the_more_rows_all_have_the_later_they_are_read_at_once(
    many, monkeypatch, rows_a_query, singles
):
    """Reading 14 entities at 21 ticks takes the time of 294 / ROWS_A_QUERY queries of one."""
    queries, run = [], PlannedQuery.run

    def counted(self, *arguments):
        queries.append(self)
        return run(self, *arguments)

    monkeypatch.setattr(evaluator, "ROWS_A_QUERY", rows_a_query)
    monkeypatch.setattr(PlannedQuery, "run", counted)
    risen = many.ss.eval("SELECT id FROM sim WHERE once(z(this) > 2.5) AS list;")
    assert len(queries) == 1 + singles + 1
    rose = [f"b{n}" for n in range(COUNT) if max(heights[2 + n] for heights in many.z) > 2.5]
    assert 0 < len(rose) < COUNT
    assert risen == rose


@pytest.mark.slow
def test_an_expression_that_fails_for_others_is_read_for_each(many):
    """Only the two of the condition have joints, and each has another one."""
    rows = many.ss.eval(
        "SELECT id, initially(joint(this, IF(id == 'arm'; 'hinge'; 'hip'))) AS q FROM sim "
        "WHERE id IN ['arm', 'leg'];"
    )
    assert [row["q"] for row in rows] == pytest.approx([0.0, 0.0])
    moved = "SELECT joint(this, 'hip') - initially(joint(this, 'hip')) FROM {} AS list;"
    of_two = moved.format("[sim.leg, sim.leg]")
    assert many.ss.eval(of_two) == pytest.approx([many.joints[-1][1]] * 2)


@pytest.mark.slow
def test_an_entity_that_came_later_has_no_value(client):
    pybullet = pytest.importorskip("pybullet")
    from tests.support.bodies import solid

    def made(z):
        return solid(client, pybullet.GEOM_SPHERE, 1, [0, 0, z], radius=0.1)

    names = {made(z): f"b{z}" for z in (1, 2, 3)}
    with ssduck.Interpreter() as ss:
        world = ss.add_variable("sim", ssduck.World.attach(client, names=names))
        pybullet.removeBody(1, physicsClientId=client)
        world.tick()
        number = made(5)
        world.tick()
        pybullet.resetBasePositionAndOrientation(number, [0, 0, 6], [0, 0, 0, 1], client)
        world.tick()
        found = ss.eval("SELECT initially(z(this)), previous(z(this)) FROM sim AS list;")
    assert found == [1.0, 1.0, 3.0, 3.0, None, 5.0]
