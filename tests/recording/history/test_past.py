"""The past as a source of queries."""

import pybullet
import pytest
from hypothesis import given
from hypothesis import strategies as st

import ssduck
from ssduck import Recording
from ssduck.errors import ArgumentError, EvaluationError, UnsupportedError
from ssduck.recording.replay.record import Record
from ssduck.schema import POSE
from ssduck.world.snapshot import RECORDED_DOUBLES
from tests.support.bodies import solid
from tests.support.cases import generated, sampled
from tests.support.pasts import ALL, _falling, _step


def _both(ss, program):
    """What a program gives as SQL, and row by row, on the same ticks."""
    return [_one(ss, program, row_by_row=row_by_row) for row_by_row in (False, True)]


def _one(ss, program, *, row_by_row):
    if not row_by_row:
        return ss.eval(program)
    rows = ssduck.Interpreter(row_by_row=True, recording=None)
    try:
        rows._database = rows._execution.database = ss._database
        rows._planner._database = ss._database
        rows._execution.variables = ss._execution.variables
        return rows.eval(program)
    finally:
        rows._finalized = True


# -- the past as a source ------------------------------------------------------------------------


PAST = [
    "SELECT id, tick, time, z FROM lab{0.1} AS list;",
    "SELECT id(this), tick(this) FROM lab{-0.1} WHERE id(this) == 'ball_0' AS list;",
    "SELECT tick(this) FROM lab{} WHERE this == ball AND z(this) < 0.8 AS list;",
    "SELECT tick(this) FROM lab{} WHERE this == ball AND near(board, this, 0.05) AS list;",
    "SELECT clearance(this, board) FROM lab{0.2} WHERE this == ball AS value;",
    "SELECT id(this), collides(this, board), on(board, this) FROM lab{0.9} AS list;",
    "SELECT id(a.this), distance(a.this, b.this) FROM a=lab, b=lab{0.0} WHERE a.this == b.this;",
    "SELECT id(a.this), id(b.this), tick(a.this) FROM a=lab{-0.05}, b=lab{-0.05} "
    "WHERE near(a.this, b.this, 0.01) AS list;",
    "SELECT this FROM lab{0.5} ORDER BY z(this) DESC LIMIT 2 AS list;",
    "x = SELECT this FROM lab{-0.02} AS list; SELECT id, tick, position FROM x AS list;",
    "count(SELECT this FROM lab{} WHERE above(board, this) AS list);",
    "SELECT id(this), count(SELECT x.this FROM x=lab{0.3} WHERE above(x.this, board) AS list) "
    "FROM lab{0.2} AS list;",
    "SELECT z FROM lab{-0.05} GROUP BY id(this) AS list;",
    "SELECT tick(this), velocity(this), mass, aabb FROM lab{-0.01} AS list;",
    "SELECT isSphere(this), isEnabled(this), obj FROM lab{0.3} AS list;",
    "SELECT tick(this) FROM lab{} WHERE this == ball AND near(board, ball, 0.05) AS list;",
    "SELECT tick(this), z(ball), z(this) FROM lab{-0.03} WHERE this == ball AS list;",
    "count(SELECT this FROM lab{} WHERE id(this) == 'board' AND z(ball) < 0.8 AS list);",
    "SELECT z(ball) - z(a.this) FROM a=lab{0.2}, b=lab WHERE id(a.this) == id(b.this) AS list;",
    "SELECT (SELECT z(ball) FROM [1] WHERE tick(a.this) > 0 AS value), z(ball) "
    "FROM a=lab{0.0} WHERE id(a.this) == 'board' AS list;",
    "SELECT tick(a.this), count(SELECT b.this FROM b=lab WHERE z(b.this) < z(a.this) AS list) "
    "FROM a=lab{0.0} AS list;",
    "SELECT tick(a.this), count(SELECT b.this FROM b=lab{} WHERE b.this == a.this AND "
    "z(b.this) > z(ball) AS list) FROM a=lab{-0.01} AS list;",
    "SELECT tick(a.this) FROM a=lab{} WHERE (SELECT z(ball) FROM [1] WHERE tick(a.this) > 0 "
    "AS value) > 0.99 AND id(a.this) == 'board' AS list;",
    "SELECT id(a.this), count(SELECT b.this FROM b=lab WHERE z(b.this) < z(ball) AS list) "
    "FROM a=lab{0.0} AS list;",
    *(
        f"SELECT tick(a.this), id(a.this), id(b.this) FROM a=lab{{}}, b=lab{{}} WHERE {where} AS list;"
        for form in ("near(a.this, b.this, 0.3)", "collides(a.this, b.this)")
        for where in (
            f"a.this == ball AND {form}",
            f"id(a.this) == 'ball_0' AND {form}",
            f"id(a.this) == 'ball_0' AND id(b.this) == 'board' AND {form}",
            f"isKinbody(a.this) AND isKinbody(b.this) AND {form}",
            f"{form} AND tick(a.this) % 7 == 0 AND z(b.this) > 0.4",
        )
    ),
]


@pytest.fixture(scope="module")
def fallen():
    """An interpreter on such a world after 300 steps, with handles of the board and of a ball."""
    client, bodies = _falling()
    names = {0: "board", **{body: f"ball_{i}" for i, body in enumerate(bodies)}}
    with ssduck.Interpreter() as ss:
        ss.add_variable("lab", ssduck.World.attach(client, names=names))
        _step(ss, 300)
        ss.eval("board = SELECT obj FROM lab WHERE id(this) == 'board' AS value;")
        ss.eval("ball = SELECT obj FROM lab WHERE id(this) == 'ball_0' AS value;")
        yield ss
    pybullet.disconnect(client)


@sampled("program", PAST, every=4)
def test_both_evaluators_see_one_past(fallen, program):
    as_sql, row_by_row = _both(fallen, program)
    assert repr(as_sql) == repr(row_by_row)
    assert as_sql not in ([], None)


@pytest.mark.slow
@given(heights=st.lists(st.floats(0.2, 3.0), min_size=2, max_size=12), age=st.floats(-0.1, 0.1))
def test_the_past_is_what_was(heights, age):
    client, (ball, _) = _falling()
    world = ssduck.World.attach(client, names={ball: "ball"})
    with ssduck.Interpreter() as ss:
        ss.add_variable("lab", world)
        seen = [(world.time, world["ball"].position[2])]
        for height in heights:
            world["ball"].move(position=[0, 0, height])
            seen.append((world.time, height))
            world.step()
            seen.append((world.time, world["ball"].position[2]))
        now = world.time
        if age < 0:
            wanted = [z for time, z in seen if time >= now + age - 1e-9]
        else:
            before = [z for time, z in seen if time <= age + 1e-9]
            wanted = [before[-1]]
            if age > now:
                with pytest.raises(EvaluationError, match="there is no tick at"):
                    ss.past("lab", age)
                return
        ss.add_variable("then", ss.past("lab", age))
        assert ss.eval("SELECT z FROM then WHERE id(this) == 'ball' AS list;") == wanted
    pybullet.disconnect(client)


def test_handles_of_the_past_stay(falling):
    _step(falling, 20)
    then = falling.eval("SELECT this FROM lab{0.05} WHERE id(this) == 'ball_0' AS value;")
    height = then.position[2]
    _step(falling, 50)
    now = falling.call_variable("lab")["ball_0"]
    assert then == now
    assert then.position[2] == height > now.position[2]
    assert then.state.time == pytest.approx(0.05)
    assert [link.name for link in then.links] == [link.name for link in now.links]
    with pytest.raises(UnsupportedError, match="a recorded tick does not change"):
        then.move([0, 0, 0])


@pytest.mark.slow
def test_a_handle_that_was_not_there_is_unknown(falling):
    _step(falling, 5)
    world = falling.call_variable("lab")
    client = world.simulator.client
    solid(client, pybullet.GEOM_SPHERE, 1, [0, 1, 1], radius=0.1)
    world.step()
    (new,) = [entity for entity in world if entity.id == 4]
    falling.add_variable("new", new)
    program = "SELECT tick(this) FROM lab{} WHERE id(this) == 'board' AND above(this, new) AS list;"
    for found in _both(falling, program):
        assert found == [world.snapshot.number]


@pytest.mark.slow
def test_neither_are_those_of_a_nested_query(fallen):
    program = "SELECT count(SELECT b.this FROM b=lab{{{}}} WHERE near(a.this, b.this, 5) AS list) "
    program += "FROM a=lab{{0.1}} AS list;"
    with pytest.raises(ArgumentError, match=r"of two ticks|at one tick"):
        fallen.eval(program.format(0.02))
    assert fallen.eval(program.format(0.1))


@pytest.mark.parametrize(
    ("program", "told"),
    [
        ("SELECT z FROM lab{9.0};", "'lab' is recorded from 0 s to 0.0"),
        ("SELECT z FROM lab{'now'};", "is a number of seconds, not 'now'"),
        ("SELECT z FROM lab{True};", "is a number of seconds, not True"),
    ],
)
def test_ticks_that_are_not_kept(falling, program, told):
    _step(falling, 12)
    with pytest.raises((EvaluationError, ArgumentError), match=told) as caught:
        falling.eval(program)
    assert "line 1, column 15" in str(caught.value)


@pytest.mark.slow
def test_no_statement_reads_ticks_that_are_not_asked_for(falling):
    _step(falling, 480)
    falling.flush()
    told = []
    falling._database.connection._tracer = told.append
    falling.eval("SELECT z FROM lab{-0.1} WHERE id(this) == 'ball_0' AS list;")
    (query,) = [sql for sql in told if "entities_history" in sql]
    assert "BETWEEN" in query


@pytest.mark.slow
def test_raw_sql_compares_shapes_of_the_past(falling):
    _step(falling, 200)
    rows = falling.sql(
        "SELECT a.tick FROM entities_history a JOIN entities_history b ON a.tick = b.tick "
        "WHERE a.name = 'board' AND b.name = 'ball_0' AND near(a, b, 0.001) ORDER BY 1"
    ).fetchall()
    heights = dict(
        falling.sql("SELECT tick, z FROM entities_history WHERE name = 'ball_0'").fetchall()
    )
    wanted = [tick for tick, z in sorted(heights.items()) if z - 0.6 <= 0.001]
    assert [tick for (tick,) in rows] == wanted
    assert wanted


LOOKED_UP = [
    ("isSensing(a, b)", "isSensing(a.this, b.this)"),
    ("sensingAmount(a, b)", "sensingAmount(a.this, b.this)"),
    ("inContact(a, b)", "inContact(a.this, b.this)"),
    ("hasContact(a, b)", "hasContact(a.this, b.this)"),
    ("contactForce(a, b)", "contactForce(a.this, b.this)"),
    ("sensingEnvIDs(a)", "sensingEnvIDs(a.this)"),
    ("force(a)", "force(a.this)"),
    ("torque(a)", "torque(a.this)"),
    ("isBox(a)", "isBox(a.this)"),
    ("solidVolume(a)", "solidVolume(a.this)"),
    ('"on"(a, b)', "on(a.this, b.this)"),
    ("penetration(a, b)", "penetration(a.this, b.this)"),
    ("nextTo(a, b)", "nextTo(a.this, b.this)"),
    ("enclosed(a, b)", "enclosed(a.this, b.this)"),
    ("supports(a, b)", "supports(a.this, b.this)"),
    ("restsOn(a, b)", "restsOn(a.this, b.this)"),
    ("isOpen(a)", "isOpen(a.this)"),
    ("isClosed(a)", "isClosed(a.this)"),
]


@pytest.fixture(scope="module")
def looked_at():
    """The kitchen with all its tables recorded, the roomba on its way."""
    with ssduck.load("kitchen") as ss:
        ss.record("kitchen", Recording(tables=ALL))
        kitchen = ss.call_variable("kitchen")
        for place in range(8):
            kitchen["roomba_625x"].move([0.2 * place - 0.5, -1.0, 0.1])
            kitchen.step(4)
        yield ss


@pytest.mark.slow
@sampled(("sql", "program"), LOOKED_UP, every=10, ids=[sql for sql, _ in LOOKED_UP])
def test_raw_sql_looks_up_what_was_told_then(looked_at, sql, program):
    ticks = looked_at.past("kitchen").ticks[3 : -1 : 6 if generated(1) > 1 else 12]
    for tick in ticks:
        where = f"a.tick = {tick} AND b.tick = {tick} AND b.name LIKE 'r%'"
        rows = looked_at.sql(
            f"SELECT {sql} FROM entities_history a, entities_history b WHERE {where} "
            "ORDER BY a.kind <> 'sensor', a.id, b.kind <> 'sensor', b.id"
        ).fetchall()
        past = looked_at.past("kitchen")
        looked_at.add_variable("then", type(past)(past.record, tick, tick, is_window=False))
        looked_at.add_function("starts", lambda name: name.startswith("r"), "")
        wanted = looked_at.eval(
            f"SELECT {program} FROM a=then, b=then WHERE starts(id(b.this)) AS list;"
        )
        assert len(rows) > 100
        for (value,), other in zip(rows, wanted, strict=True):
            assert value == (pytest.approx(other, abs=1e-9) if value is not None else other)


@pytest.mark.slow
def test_a_window_is_compared_once(looked_at):
    looked_at.eval("robot = SELECT obj FROM kitchen WHERE id(this) == 'roomba_625x' AS value;")
    looked_at.eval("room = SELECT obj FROM kitchen WHERE id(this) == 'kitchen' AS value;")
    before = looked_at.statistics()["kitchen"].pairs
    found = looked_at.eval("holds(near(robot, room, 0.02));")
    pairs = looked_at.statistics()["kitchen"].pairs - before
    ((meeting,),) = looked_at.sql(
        "SELECT count(*) FROM entities_history a JOIN entities_history b ON a.tick = b.tick "
        "WHERE a.name = 'roomba_625x' AND b.name = 'kitchen' "
        "AND a.xmin <= b.xmax + 0.02 AND b.xmin <= a.xmax + 0.02 AND a.ymin <= b.ymax + 0.02 "
        "AND b.ymin <= a.ymax + 0.02 AND a.zmin <= b.zmax + 0.02 AND b.zmin <= a.zmax + 0.02"
    ).fetchall()
    assert 0 < pairs <= meeting
    assert found


# -- what is kept no longer, and nested queries --------------------------------------------------


def test_a_past_that_is_recorded_anew_is_refused(falling):
    _step(falling, 10)
    then = falling.past("lab", 0.01)
    falling.add_variable("then", then)
    falling.add_variable("handle", then["ball_0"])
    falling.record("lab", Recording())
    _step(falling, 2)
    for program in ("SELECT z FROM then AS list;", "SELECT z(this) FROM [handle] AS list;"):
        with pytest.raises(EvaluationError, match="is kept no longer"):
            falling.eval(program)
    with pytest.raises(EvaluationError, match="is kept no longer"):
        then["ball_0"]
    assert "is kept no longer" in repr(then)


@pytest.mark.slow
def test_a_past_that_was_dropped_is_refused(falling):
    falling.record("lab", Recording(ticks=8))
    _step(falling, 2)
    then = falling.past("lab", falling.call_variable("lab").time)
    falling.add_variable("then", then)
    handle = then["ball_0"]
    assert handle.position[2] < 1.0
    falling.add_variable("handle", handle)
    _step(falling, 60)
    for program in (
        "SELECT z FROM then AS list;",
        "z(handle);",
        "SELECT z(this) FROM [handle] AS list;",
    ):
        with pytest.raises(EvaluationError, match="is kept no longer"):
            falling.eval(program)
    with pytest.raises(EvaluationError, match="is kept no longer"):
        _ = handle.position


def test_the_past_of_another_interpreter_is_refused(falling):
    _step(falling, 3)
    with ssduck.Interpreter() as other:
        other.add_variable("lab", falling.call_variable("lab"))
        falling.add_variable("then", other.past("lab"))
        with pytest.raises(EvaluationError, match="another interpreter's record"):
            falling.eval("SELECT z FROM then AS list;")


def test_a_handle_in_a_nested_query_goes_with_the_row(fallen):
    program = (
        "SELECT (SELECT z(ball) FROM [1] WHERE tick(a.this) > 0 AS value), z(ball) "
        "FROM a=lab{0.0} WHERE id(a.this) == 'board' AS list;"
    )
    assert fallen.eval(program) == [1.0, 1.0]


# What nested queries about the past say, and what raw SQL says of the same.
NESTED = [
    (
        "SELECT o.id, o.tick FROM o=lab{} WHERE EXISTS (SELECT p.this FROM p=lab WHERE p.z > o.z)",
        "o WHERE EXISTS (FROM entities p WHERE p.z > o.z)",
    ),
    (
        "SELECT o.id, o.tick FROM o=lab{} WHERE EXISTS "
        "(SELECT p.this FROM p=lab{} WHERE p.this == o.this AND p.z > o.z + 0.1)",
        "o WHERE EXISTS (FROM entities_history p WHERE p.id = o.id AND p.z > o.z + 0.1)",
    ),
    (
        "SELECT o.id, o.tick FROM o=lab{-0.1} WHERE "
        "count(SELECT p.this FROM p=lab{} WHERE p.time == o.time AND p.z > o.z AS list) > 1",
        "o WHERE time > (SELECT max(time) FROM entities_history) - 0.101 AND "
        "(SELECT count(*) FROM entities_history p WHERE p.tick = o.tick AND p.z > o.z) > 1",
    ),
    (
        "SELECT o.id, o.tick FROM o=lab{} WHERE o.this IN "
        "(SELECT p.this FROM p=lab{0.3}, q=lab{0.1} WHERE p.this == q.this AND p.z < o.z - 0.2 "
        "AND p.z < q.z AS list)",
        "o WHERE EXISTS (FROM entities_history p, entities_history q WHERE p.id = o.id "
        "AND p.tick = (SELECT max(tick) FROM entities_history WHERE time < 0.301) "
        "AND q.tick = (SELECT max(tick) FROM entities_history WHERE time < 0.101) "
        "AND p.id = q.id AND p.z < o.z - 0.2 AND p.z < q.z)",
    ),
    *(
        (
            "SELECT o.id, o.tick FROM o=lab WHERE EXISTS (SELECT p.this FROM p=lab{} "
            f"WHERE p.this == o.this AND {moved})",
            "o WHERE tick = (SELECT max(tick) FROM entities_history) AND EXISTS "
            "(FROM entities_history p WHERE p.id = o.id AND p.z > o.z + 0.1)",
        )
        for moved in (
            "p.z > o.z + 0.1",
            "z(p.this) > z(o.this) + 0.1",
            "distance(p.this, o.this) > 0.1",
        )
    ),
    (
        "SELECT o.id, o.tick FROM o=lab{} WHERE o.tick % 60 == 1 AND count("
        "SELECT p.z FROM p=lab{}, q=lab{}, now=lab WHERE p.z > o.z AND q.z < p.z "
        "AND now.this == o.this AND now.z < o.z AS list) > 100",
        "o WHERE tick % 60 = 1 AND (SELECT count(*) FROM entities_history p JOIN "
        "entities_history q USING (tick), entities now WHERE p.z > o.z AND q.z < p.z "
        "AND now.id = o.id AND now.z < o.z) > 100",
    ),
]


@pytest.mark.parametrize(("program", "same"), NESTED)
def test_nested_queries_about_the_past_are_sql(fallen, program, same):
    assert "left to Python" not in fallen.explain(f"{program} AS list;")
    found = fallen.eval(f"{program};")
    assert 0 < len(found) < fallen.sql("SELECT count(*) FROM entities_history").fetchall()[0][0]
    order = "ORDER BY tick, kind != 'sensor', id"
    rows = fallen.sql(f"SELECT name, tick FROM entities_history {same} {order}").fetchall()
    assert [tuple(row.values()) for row in found] == rows


OF_PAIRS = [
    "p.z > o.z",
    "p.time == o.time AND p.z < o.z",
    "p.this == o.this AND p.z > o.z",
    "p.z >= z(ball) AND o.z > 0.5",
    "p.z > 0.5",
    "tick(p.this) == tick(o.this) AND near(p.this, o.this, 1)",
]
OF_ONE = [
    "SELECT o.id FROM o=lab{{}} WHERE EXISTS (SELECT p.this FROM p={} WHERE {}) AS list;",
    "SELECT o.id, (SELECT p.this, tick(p.this) FROM p={} WHERE {} AS list) FROM o=lab{{}};",
    "SELECT o.id, count(SELECT p.this FROM p={}, q=lab{{}}, r=lab WHERE {} AND q.z < p.z "
    "AND r.this == o.this AS list) FROM o=lab{{0.01}};",
    "SELECT o.id, o.tick, (SELECT z(o.this), o.z, o.tick, distance(o.this, p.this) "
    "FROM p={}, r=lab{{}} WHERE {} AND r.z < 1 AS list) FROM o=lab;",
    "SELECT o.tick FROM o=(SELECT this FROM lab{{0.0}} AS list) WHERE o.this IN "
    "(SELECT p.this FROM p={} WHERE {} AND EXISTS (SELECT r.this FROM r=lab WHERE r.z < p.z) "
    "AS list) AS list;",
]


@pytest.fixture(scope="module")
def started():
    """Such a world after four steps."""
    client, (body, _) = _falling()
    with ssduck.Interpreter() as ss:
        ss.add_variable("lab", ssduck.World.attach(client, names={0: "board", body: "ball"}))
        _step(ss, 4)
        ss.add_variable("ball", ss.call_variable("lab")["ball"])
        yield ss
    pybullet.disconnect(client)


@pytest.mark.slow
@sampled("condition", OF_PAIRS, every=3)
@pytest.mark.parametrize("source", ["lab", "lab{}", "lab{0.01}"])
def test_row_by_row_they_are_the_same(started, source, condition):
    for program in OF_ONE:
        as_sql, row_by_row = _both(started, program.format(source, condition))
        assert repr(as_sql) == repr(row_by_row)


@pytest.mark.slow
def test_a_name_that_two_had():
    client, bodies = _falling(1)
    world = ssduck.World.attach(client, names={0: "board"})
    with ssduck.Interpreter() as ss:
        ss.add_variable("lab", world)
        (name,) = [entity.name for entity in world if entity.name != "board"]
        _step(ss, 3)
        pybullet.removeBody(bodies[0], client)
        _step(ss, 3)
        solid(client, pybullet.GEOM_SPHERE, 1, [0, 0, 0.6], radius=0.1)
        _step(ss, 3)
        program = (
            "SELECT tick(a.this) FROM a=lab{}, b=lab{} WHERE id(a.this) == '" + name + "' "
            "AND id(b.this) == 'board' AND near(a.this, b.this, 1.0) AS list;"
        )
        as_sql, row_by_row = _both(ss, program)
        assert as_sql == row_by_row
        assert len(as_sql) >= 6
        assert ss.eval(program.replace("'board'", "'nobody'")) == []
    pybullet.disconnect(client)


@pytest.mark.slow
def test_the_present_beside_a_past_that_lacks_it(falling):
    falling.record("lab", Recording(every=3, entities=("ball_0",)))
    _step(falling, 2)
    falling.eval("ball = SELECT obj FROM lab WHERE id(this) == 'ball_0' AS value;")
    program = (
        "SELECT id(now.this), near(now.this, ball, 5) FROM now=lab, x=lab{0.0} "
        "WHERE x.this == ball AS list;"
    )
    for found in _both(falling, program):
        assert found == ["board", True, "ball_0", False, "ball_1", True]


@pytest.mark.slow
def test_a_bounded_record_is_exported_in_order(falling, tmp_path):
    falling.record("lab", Recording(ticks=40))
    _step(falling, 170)
    ticks = falling.past("lab").ticks
    falling.export(tmp_path / "run")
    with ssduck.open(tmp_path / "run") as record:
        assert record.past("lab").ticks == ticks
        live = falling.sql("SELECT * FROM entities_history ORDER BY tick, id").fetchall()
        assert record.sql("SELECT * FROM entities_history ORDER BY tick, id").fetchall() == live


@pytest.mark.parametrize(
    ("call", "told"),
    [
        (lambda ss: ss.export("none", entities=[]), "no entities to write"),
        (lambda ss: ss.export("none", start="a"), "number of seconds"),
        (lambda ss: ss.record("lab", "x"), "record: recording: 'x' is no Recording"),
        (lambda ss: ss.eval("least(IF(z(ball) > 0.99; 'a'; 1));"), "expression of numbers"),
    ],
)
def test_what_is_no_argument(falling, call, told):
    falling.eval("ball = SELECT obj FROM lab WHERE id(this) == 'ball_0' AS value;")
    with pytest.raises(ArgumentError, match=told):
        call(falling)


def test_a_tick_that_is_recorded_later_is_told_of_with_the_whole_record(falling):
    _step(falling, 20)
    falling.eval("ball = SELECT obj FROM lab WHERE id(this) == 'ball_0' AS value;")
    end = falling.past("lab").times[-1]
    told = f"'lab' is recorded from 0 s to {end:g} s; at 0 s there is no tick at {end:g} s yet"
    with pytest.raises(EvaluationError, match=told):
        falling.eval(f"holds(at({end}, z(ball)) < z(ball));")
    with pytest.raises(EvaluationError, match=f"to {end:g} s; there is no tick at 9 s"):
        falling.eval("holds(at(9.0, z(ball)) < z(ball));")


@pytest.mark.slow
def test_no_tick_is_restored_for_the_numbers_of_its_rows(falling, looked_at, monkeypatch):
    _step(falling, 20)
    restored, restore = [], Record.restore
    monkeypatch.setattr(Record, "restore", lambda *both: restored.append(both) or restore(*both))
    handles = falling.eval("SELECT this FROM lab{} AS list;")
    links = looked_at.eval("SELECT this FROM links(kitchen{-0.03}) AS list;")
    poses = [link.pose for link in links]
    sums = falling.eval("SELECT this, 1 FROM lab{} AS plane('XZ', [-5, -5], [100, 100, 0.1]);")
    numbers = [[*one.pose, *one.velocity, *one.aabb[0], *one.aabb[1]] for one in handles]
    assert restored == []
    assert sums.cells.sum() == len(handles) > 40
    columns = (*POSE[3:], *POSE[:3], *RECORDED_DOUBLES[8:])
    assert numbers == [[one.column(name) for name in columns] for one in handles]
    assert len({tick for _, tick in restored}) == 20  # the last tick is the world itself
    assert poses == [[link.column(name) for name in columns[:7]] for link in links]
    falling.record("lab", None)
    with pytest.raises(EvaluationError, match="kept no longer"):
        assert handles[0].position
