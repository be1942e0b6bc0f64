"""Triggers that are evaluated together give what they give one by one."""

import math
import warnings

import pybullet
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import ssduck
from ssduck.interpreter.triggers import tick_batch
from ssduck.world.handles import Handle
from tests.support.cases import generated
from tests.support.stage import Stage
from tests.support.triggering import state

# Formulas for numpy, and programs that are evaluated by themselves.
PROGRAMS = [
    "SELECT name FROM sim WHERE z(this) < 1.5 AS list;",
    "SELECT name FROM sim WHERE z(this) < limit AS list;",
    "SELECT name, x, z FROM sim WHERE z > limit OR NOT x < 0.25;",
    "SELECT name FROM sim WHERE z(this) < 0.75 AS list;",
    "SELECT name FROM sim WHERE z(this) < 1 AS list;",
    "SELECT z FROM sim WHERE id(this) == 'b1' AS value;",
    "SELECT z FROM sim WHERE id(this) == 'b3' AS value;",
    "SELECT time, z FROM sim WHERE name == 'b2';",
    "SELECT z > limit FROM sim WHERE name == who AS value;",
    "SELECT position FROM sim WHERE kind == 'kinbody' AND z + 2 * x < 3 AS list;",
    "SELECT IF(z > 1; position; [0.5, x, y]) AS place FROM sim;",
    "SELECT this FROM sim WHERE isKinbody(this) AND z BETWEEN 0.5 AND 2 AS list;",
    "SELECT name FROM sim WHERE above(it, this) AS list;",
    "SELECT name FROM sim WHERE below(it, this) AND x < limit AS list;",
    "SELECT x, name FROM sim WHERE z in [0, 1, 2] OR name in ['b0', 'b2'] LIMIT 2;",
    "SELECT name FROM sim WHERE z < 2 LIMIT 2 OFFSET 1 AS list;",
    "SELECT -z FROM sim AS list;",
    "SELECT name FROM sim WHERE distance(it, this) < 1.5 AS list;",
    "SELECT name FROM sim WHERE distance(it, this) < 0.5 AS list;",
    "SELECT distance(it, this), name FROM sim WHERE distance(it, this) < limit;",
    "SELECT volume(this), name FROM sim WHERE volume(this) < 1;",
    "SELECT name FROM sim WHERE near(it, this, 0.1) AS list;",
    "SELECT name FROM sim WHERE near(this, it, 0.4) AND x < limit AS list;",
    "SELECT name FROM sim WHERE near(it, this, limit) OR z > 2 AS list;",
    "SELECT name FROM sim WHERE touching(it, this) AS list;",
    "SELECT name FROM sim WHERE collides(it, this) AND NOT name == 'b0' AS list;",
    "SELECT name FROM sim WHERE collides(it, this, limit) AND z > 0.3 AS list;",
    "SELECT name FROM sim WHERE on(it, this) AS list;",
    "SELECT name FROM sim WHERE supports(this, it) OR contains(it, this) AS list;",
    "SELECT name, clearance(it, this) FROM sim WHERE clearance(it, this) < limit;",
    "SELECT name, penetration(it, this), inside(it, this) FROM sim;",
    "SELECT mass(this) FROM sim WHERE mass(this) > 0.5 AS list;",
    "SELECT name FROM sim WHERE name LIKE 'b%' AND distance(this, [0, 0, 1]) < 1 AS list;",
    "count(SELECT this FROM sim WHERE z < 1 AS list);",
    "SELECT COUNT(*) FROM sim WHERE z < 1 AS value;",
    "SELECT name FROM sim ORDER BY z AS list;",
    "SELECT MAX(z) FROM sim AS value;",
    "SELECT name FROM sim WHERE z > 1 / limit AS list;",
    "SELECT name FROM sim WHERE odd(this) AS list;",
    "SELECT a.name, b.name FROM a=sim, b=sim WHERE a.z < b.z AS list;",
    "getTime();",
    "limit;",
    "SELECT name FROM sim WHERE z < 1 AS list(1);",
    "seen = 1; SELECT z FROM sim AS list;",
    "SELECT STDDEV(z) FROM sim;",
    "SELECT getTime() FROM sim AS list;",
    "SELECT var('limit') FROM sim AS list;",
    "SELECT id FROM still WHERE z(this) > limit AS list;",
    "SELECT a.name, b.name FROM a=sim, b=still WHERE a.z < b.z AS list;",
    "SELECT a.name, b.name FROM a=sim, b=sim WHERE isSensing(a.this, b.this) AS list;",
    "",
]
OPTIONS = [{}, {"rows": True}, {"when": "rising"}, {"when": "falling"}, {"debounce": 2 / 240}]
NUMBERS = st.sampled_from([0, 0.0, 0.5, 1, 1.5, -1.0, 100])


def scene(client):
    """Boxes and balls that fall onto a plate and against each other."""
    pybullet.setGravity(0, 0, -10, physicsClientId=client)
    stage = Stage(client)
    stage.box("plate", half=[2, 2, 0.05])
    for number in range(4):
        name, place = f"b{number}", [number * 0.3, 0, 0.3 + number / 4]
        if number % 2:
            body = stage.box(name, place, half=[0.2, 0.15, 0.1], mass=number / 2)
        else:
            body = stage.sphere(name, place, radius=0.1, mass=number / 2)
        pybullet.resetBaseVelocity(body, [1 - number, 0, 0], physicsClientId=client)
    return stage.open()


class Session:
    """An interpreter with the scene, which writes down all that its triggers call."""

    def __init__(self, *, together):
        self.client = pybullet.connect(pybullet.DIRECT)
        self.ss = ssduck.Interpreter()
        if not together:
            self.ss._triggers._batches._planner = None
        self.world = self.ss.add_variable("sim", scene(self.client))
        self.ss.add_variable("limit", 1)
        self.ss.add_variable("who", "b1")
        self.ss.add_variable("still", self.world.what_if())
        self.ss.add_variable("it", self.world["b2"])
        self.ss.add_function("odd", lambda entity: entity.id % 2 == 1)
        self.calls = []
        self.added = 0

    def close(self):
        self.ss.close()
        pybullet.disconnect(self.client)

    def do(self, action, *values):
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            try:
                getattr(self, action)(*values)
            except ssduck.SelectScriptError as error:
                self.calls.append(("error", action, str(error)))
        self.calls += [("warning", str(warning.message)) for warning in caught]

    def add(self, program, options, interval, reaction):
        name = f"t{self.added}"
        self.added += 1

        def callback(result):
            self.calls.append((name, round(self.world.time, 9), plain(result)))
            if reaction is not None:
                self.do(*reaction)

        self.ss.add_trigger(name, program, interval, callback, **options)

    def step(self, count):
        self.world.step(count)

    def bind(self, name, value):
        self.ss.add_variable(name, value)

    def follow(self, name):
        self.ss.add_variable("it", self.world[name])

    def remove_body(self, number):
        pybullet.removeBody(number, physicsClientId=self.client)

    def add_body(self, x):
        Stage(self.client).box(None, (x, 0, 2), half=[0.2, 0.15, 0.1], mass=1)

    def move(self, name, height):
        self.world[name].move([0, 0, height])

    def change(self, verb, number):
        names = [trigger.name for trigger in self.ss.triggers()]
        if names:
            getattr(self.ss, verb)(names[number % len(names)])

    def override(self, limit):
        self.ss.add_function("z", lambda entity: entity.position[2] + limit)

    def restore(self):
        self.ss.del_function("z")

    def states(self):
        return [
            (s.name, s.evaluations, s.firings, s.failures, s.paused, plain(s.result), str(s.error))
            for s in self.ss.triggers()
        ]


def plain(value):
    """A text of a value that tells 0.0 from -0.0, and the entities of two worlds do not differ."""
    if isinstance(value, ssduck.Changed):
        return plain([value.added, value.removed])
    if isinstance(value, Handle):
        return f"<{value.name}>"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(plain, value))}]"
    if isinstance(value, dict):
        return f"{{{', '.join(f'{key}: {plain(part)}' for key, part in value.items())}}}"
    return repr(value)


BODIES = st.sampled_from(["plate", "b0", "b1", "b2", "b3"])
CHANGES = st.one_of(
    st.tuples(st.just("bind"), st.just("limit"), NUMBERS),
    st.tuples(st.just("bind"), st.just("who"), st.sampled_from(["b0", "b1", "nobody", 3])),
    st.tuples(st.just("follow"), BODIES),
    st.tuples(st.just("remove_body"), st.integers(1, 4)),
    st.tuples(st.just("add_body"), st.floats(-1, 1)),
    st.tuples(st.just("move"), BODIES, st.sampled_from([0.5, 1.0, 3.0])),
    st.tuples(
        st.just("change"),
        st.sampled_from(["pause_trigger", "resume_trigger", "del_trigger"]),
        st.integers(0, 9),
    ),
    st.tuples(st.just("override"), st.sampled_from([0.0, 0.5])),
    st.tuples(st.just("restore")),
    st.tuples(st.just("step"), st.just(1)),
)
ADDED = st.tuples(
    st.just("add"),
    st.sampled_from(PROGRAMS),
    st.sampled_from(OPTIONS),
    st.sampled_from([0, 0, 0, 1 / 120, 0.0125]),
    st.none() | st.none() | CHANGES,
)
STEPS = st.tuples(st.just("step"), st.integers(1, 4))
ACTIONS = st.lists(st.one_of(ADDED, STEPS, CHANGES, STEPS), min_size=2, max_size=14)


def outcome(actions, *, together):
    session = Session(together=together)
    try:
        for action in actions:
            session.do(*action)
        session.do("step", 3)
        return session.calls, session.states()
    finally:
        session.close()


@pytest.mark.long
@settings(max_examples=generated(10))
@given(st.lists(ADDED, min_size=3, max_size=8), ACTIONS)
def test_together_as_one_by_one(added, actions):
    """The same calls in the same order, with the same results, errors, warnings and states."""
    assert outcome([*added, *actions], together=True) == outcome([*added, *actions], together=False)


# -- what it costs -------------------------------------------------------------------------------


@pytest.fixture
def boxes(ss, client):
    world = ss.add_variable("sim", scene(client))
    ss.add_variable("it", world["b2"])
    return world


@pytest.mark.slow
def test_each_result_is_that_of_the_program(ss, boxes):
    """At every tick the last result of each trigger is what its program gives then."""
    ss.add_variable("limit", 1)
    ss.add_variable("who", "b1")
    ss.add_variable("still", boxes.what_if())
    ss.add_function("odd", lambda entity: entity.id % 2 == 1)
    programs = [p for p in PROGRAMS if "list(1)" not in p and "FROM still" not in p]
    for number, program in enumerate(programs):
        ss.add_trigger(str(number), program, 0, lambda _: None)
    for number in range(generated(12)):
        if number % 4 == 3:
            ss.add_variable("limit", number / 6)
        boxes.step() if number % 3 else boxes.tick(steps=0)  # at which no row changes
        for trigger in ss.triggers():
            assert plain(trigger.result) == plain(ss.eval(trigger.program))


def test_a_number_that_is_not_known(ss, boxes, client):
    """Where a pose is not a number, SQL has NULL; the triggers are evaluated by themselves."""
    got = []
    ss.add_trigger("t", "SELECT name FROM sim WHERE NOT z(this) < 0.4 AS list;", 0, got.append)
    boxes.step(2)
    pybullet.resetBasePositionAndOrientation(
        4, [0, 0, math.nan], [0, 0, 0, 1], physicsClientId=client
    )
    with pytest.warns(UserWarning, match="b3"):
        boxes.tick(steps=0)
    assert got[-1] == ss.eval("SELECT name FROM sim WHERE NOT z(this) < 0.4 AS list;")
    assert "b3" not in got[-1]


# -- tables that have not changed ----------------------------------------------------------------

NEAR = "SELECT name FROM sim WHERE near(it, this, 0.5) AS list;"


def moved(world, client, height):
    """Moves a body, and takes a tick without a step."""
    pybullet.resetBasePositionAndOrientation(
        3, [0.6, 0, height], [0, 0, 0, 1], physicsClientId=client
    )
    world.tick(steps=0)


@pytest.mark.parametrize("batched", [True, False])
@pytest.mark.parametrize(
    "program", [NEAR, "SELECT z FROM sim WHERE name == 'b2' AS value;", "SELECT z, x FROM sim;"]
)
def test_threshold(ss, boxes, client, monkeypatch, program, batched):
    """Small changes do not add up: each is compared with the last evaluation."""
    if not batched:
        monkeypatch.setattr(tick_batch._DueFormulas, "evaluate", lambda *_: None)
    moved(boxes, client, 1.0)
    calls = []
    ss.add_trigger("t", program, 0, calls.append, threshold=0.01)
    results = [state(ss, "t").result]
    for height in (1.0, 1.004, 1.008, 1.012, 1.016, 1.0, 2.0):
        moved(boxes, client, height)
        results.append(state(ss, "t").result)
    exact = []
    for height in (1.0, 1.012, 1.0, 2.0):
        moved(boxes, client, height)
        exact.append(ss.eval(program))
    start, higher, low, high = exact
    assert results == [start, start, start, start, higher, higher, low, high]


def test_a_threshold_is_in_radians(ss, boxes, client):
    program = "SELECT orientation FROM sim WHERE name == 'b2' AS value;"
    got = []
    moved(boxes, client, 0.8)  # without velocity
    ss.add_trigger("t", program, 0, got.append, threshold=0.1)
    for angle in (0.09, 0.11):
        turned = pybullet.getQuaternionFromEuler([angle, 0, 0])
        pybullet.resetBasePositionAndOrientation(3, [0.6, 0, 0.8], turned, physicsClientId=client)
        boxes.tick(steps=0)
    assert [orientation[1] for orientation in got] == [0.0, pytest.approx(math.sin(0.055))]


def test_a_threshold_does_not_hold_what_is_not_of_tables(ss, boxes):
    """The time passes, variables are bound, functions change what they return."""
    got = []
    ss.add_variable("limit", 1)
    for name, program in {
        "time": "SELECT time FROM sim WHERE name == 'b2' AS value;",
        "variable": "SELECT name FROM sim WHERE z < limit AS list;",
        "function": "SELECT late(this) FROM sim LIMIT 1 AS value;",
    }.items():
        ss.add_function("late", lambda _: boxes.time)
        ss.add_trigger(
            name, program, 0, lambda value, name=name: got.append((name, value)), threshold=1e9
        )
    got.clear()
    boxes.step()
    assert [name for name, _ in got] == ["time", "function"]
    ss.add_variable("limit", -1)
    boxes.step()
    assert [name for name, _ in got[2:]] == ["time", "variable", "function"]
