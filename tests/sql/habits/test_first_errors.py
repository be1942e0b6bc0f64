"""Spellings that new users try: each is an error that says what to write, or works."""

import re
from contextlib import suppress

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import ssduck
from ssduck.errors import EvaluationError, ProgramWarning, SelectScriptError, SqlError
from ssduck.language.sql_suggestions import suggestion_for_name
from ssduck.schema import TABLES
from tests.support.mjcf import simulated
from tests.support.warned import silent

XML = """
<mujoco>
  <asset><material name="wood" rgba="1 0 0 1"/></asset>
  <worldbody>
    <camera name="front" pos="0 -3 1"/>
    <geom name="floor" type="plane" size="0 0 .1"/>
    <body name="table" pos="0 0 .2"><geom type="box" size=".5 .5 .2"/></body>
    <body name="cube" pos="0 0 .5">
      <freejoint/><geom name="cube_visual" type="box" size=".1 .1 .1"/>
    </body>
    <body name="duplo2x4/" pos="1 0 .5"><freejoint/><geom size=".1"/></body>
    <body name="arm" pos="2 0 1">
      <joint name="hinge" axis="0 0 1"/>
      <geom type="box" size=".4 .02 .1"/>
      <body name="hand" pos=".5 0 0"><joint name="hand_joint"/><geom name="pad" size=".05"/><geom name="lpad" size=".04"/></body>
    </body>
  </worldbody>
  <actuator><motor name="motor" joint="hinge"/></actuator>
  <sensor><jointpos name="angle_of_hinge" joint="hinge"/></sensor>
  <keyframe><key name="home" qpos="0 0 .5 1 0 0 0 1 0 .5 1 0 0 0 .3 0"/></keyframe>
</mujoco>
"""


@pytest.fixture(scope="module")
def ss():
    model, data = simulated(XML)
    with ssduck.Interpreter() as ss:
        ss.add_variable("sim", ssduck.World.attach(model, data))
        yield ss


YAW_OF_COLUMNS = "atan2(2 * (qw * qz + qx * qy), 1 - 2 * (qy * qy + qz * qz))"
OF_SQL = [
    ("SELECT on(a, b) FROM entities a, entities b", "on is a word of SQL: write onTop(…)"),
    ("SELECT position(e) FROM entities e", "position is a word of SQL: write positionOf(…)"),
    ("SELECT time(e) FROM entities e", "time is a word of SQL: write timeOf(…)"),
    ("SELECT bx, by, bz FROM contacts", 'by is a word of SQL: write "by"'),
    ("SELECT a FROM contacts ORDER BY by", 'by is a word of SQL: write "by"'),
    ("SELECT a FROM contacts WHERE by > 0 GROUP BY a", 'by is a word of SQL: write "by"'),
    ("SELECT BY FROM contacts GROUP BY a", 'BY is a word of SQL: write "BY"'),
    ("SELECT * FROM entities WHERE id = 'cube'", "their names are in the column name: WHERE name"),
    (
        "SELECT name FROM entities WHERE near(name, 'table', .1)",
        "FROM entities a, entities b WHERE near(a, b, 0.1) AND b.name = 'table'",
    ),
    ("SELECT name FROM entities e WHERE near(e, 'table', .1)", "Relations take rows, not names"),
    ("SELECT name FROM entities WHERE speed > 1", "write speed(e), with FROM entities e"),
    ("SELECT name FROM entities WHERE near > 1", "write near(e, …)"),
    ("SELECT joints(e) FROM entities e", "joint(e, 'its name')"),
    ("SELECT distance(this, sim.arm) FROM entities", "This is SelectScript: ss.eval runs it"),
    ("SELECT id FROM sim WHERE z(this) > 0.1", "This is SelectScript: ss.eval runs it"),
    ("SELECT id FROM sim{0.5}", "This is SelectScript: ss.eval runs it"),
    ("SELECT id, z FROM sim AS df;", "This is SelectScript: ss.eval runs it"),
    ("distance(sim.cube, sim.table) < 1", "This is SelectScript: ss.eval runs it"),
    ("SELECT clip(z, 0, 1) FROM entities", "write least(greatest(x, low), high)"),
    ("SELECT yaw(e) FROM entities e", f"write {YAW_OF_COLUMNS}"),
    ("SELECT yaw FROM entities", f"the yaw is {YAW_OF_COLUMNS}"),
    ("SELECT roll FROM entities", "the roll is atan2("),
    ("SELECT e.pitch FROM entities e", "the pitch is asin("),
    ("SELECT body FROM entities", "A body is a row of entities, with the columns id and name"),
    ("SELECT body FROM contacts", "of contacts in a and b"),
    ("SELECT link FROM entities", "FROM links l JOIN entities e ON e.id = l.entity"),
    ("SELECT link FROM contacts", "contacts have link_a and link_b"),
    ("SELECT 1 FROM entities x, entities y WHERE near(x, y, 1)", "as in FROM entities p"),
    ("SELECT speed(x) FROM entities AS x", "x is an alias of a table here, and the name of a"),
    ("DELETE FROM entities WHERE name = 'cube'", "are read only: world['cup'].move("),
    ("UPDATE sim.entities SET z = 1", "are read only: world['cup'].move("),
    ("INSERT INTO entities VALUES (1)", "are read only: world['cup'].move("),
    ("SELECT dot([1], [2])", "write list_dot_product(a, b)"),
    ("SELECT getTime()", "the simulated time is the column time"),
    ("SELECT heldFor(z(e) > 0) FROM entities e", "This is SelectScript: ss.eval runs it"),
    ("SELECT robustness(e.z > 0) FROM entities e", "This is SelectScript: ss.eval runs it"),
    ("SELECT always(z > 0) FROM entities_history", "This is SelectScript: ss.eval runs it"),
    ("SELECT 1 FROM entities WHERE z > 0 IMPLIES x > 0", "in SQL write NOT (a) OR (b)"),
    ("WHY SELECT z > 0 FROM entities", 'ss.eval("WHY on(table, cup);")'),
    ("SELECT * FROM entities WHERE z => 0.1", "write >="),
    (
        "SELECT name FROM entities e WHERE distance(e, [0, 0, 1]) < 1",
        "A point is {x: 1, y: 2, z: 3}",
    ),
    ("SELECT * FROM bodies", "bodies does not exist!\nwrite entities"),
    ("SELECT * FROM geoms", "geoms does not exist!\nwrite shapes"),
    ("SELECT count(*) FROM frame", "a frame of yours is a table after ss.register('frame', frame)"),
    ("SELECT z FROM entities WHERE name = cube", "A text is in single quotes: 'cube'"),
    ('SELECT z FROM entities WHERE name = "cube"', "A text is in single quotes: 'cube'"),
    ("SELECT distance(sim.cube, sim.table)", "This is SelectScript: ss.eval runs it"),
]


@pytest.mark.parametrize(("sql", "told"), OF_SQL)
def test_raw_sql_says_what_to_write(ss, sql, told):
    with pytest.raises(SelectScriptError, match=re.escape(told)):
        ss.sql(sql)


@pytest.mark.parametrize(
    "sql",
    [
        "SELECT FROM WHERE",
        "SELECT a FROM contacts ORDER BY )",
        'SELECT c.by, "by" FROM contacts c WHERE',
        "SELECT by, $$",
        "SELECT max(z) by kind FROM entities",
        "SELECT nothing FROM entities",
        "SELECT x FROM entities a, entities b",
        "SELECT speed(z) FROM entities",
    ],
)
def test_other_errors_of_sql_have_no_such_hint(ss, sql):
    with pytest.raises(SelectScriptError) as caught:
        ss.sql(sql)
    assert "SelectScript" not in str(caught.value)
    assert "row" not in str(caught.value)
    assert "word of SQL" not in str(caught.value)


def test_each_column_that_has_to_be_quoted_is_told_of(ss):
    for table, name in ((owner, name) for owner in TABLES.values() for name in owner.names):
        sql = f'SELECT {{}} FROM (SELECT 1 AS "{name}") AS {table.name}'
        assert ss.sql(sql.format(f'"{name}"')).fetchall() == [(1,)]
        try:
            ss.sql(sql.format(name))
        except SelectScriptError as error:
            assert str(error).endswith(f'{name} is a word of SQL: write "{name}"')


@pytest.mark.parametrize("name", ["order", "join", "table"])
def test_a_world_whose_name_is_a_word_of_sql(name):
    model = mujoco.MjModel.from_xml_string(XML)
    with ssduck.Interpreter() as ss:
        ss.add_variable(name, ssduck.World.attach(model, mujoco.MjData(model)))
        with pytest.raises(SelectScriptError, match=f'{name} is a word of SQL: write "{name}".ent'):
            ss.sql(f"SELECT count(*) FROM {name}.entities")
        assert ss.sql(f'SELECT count(*) FROM "{name}".entities').fetchall() == [(5,)]
        with pytest.raises(SelectScriptError) as caught:
            ss.sql(f'SELECT count(*) FROM "{name}"..entities')
        assert "word of SQL" not in str(caught.value)


def test_the_name_of_a_users_table_is_still_guessed():
    with ssduck.Interpreter() as ss:
        ss.sql("CREATE TABLE measured (a INT)")
        with pytest.raises(SelectScriptError, match='Did you mean "measured"'):
            ss.sql("SELECT * FROM mesured")


OF_PROGRAMS = [
    ("SELECT id FROM sim WHERE near(name, 'table', .1);", "that of a row this"),
    ("near(sim.cube, 'table', .1);", "the entity of a name is room['cup']"),
    ("SELECT id FROM sim.links;", "its links are FROM links(sim)"),
    ("SELECT id FORM sim;", "did you mean 'FROM'"),
    ("sim.red box;", "a name with blanks is written sim['red box']"),
    ("distance(sim.big red box, sim.cube);", "is written sim['big red box']"),
    ("SELECT z FROM sim.cube WHRE z > 1;", "did you mean 'WHERE'"),
    ("SELECT id FROM sim AT 3.0;", "the world at a time is sim{3.0}"),
    ("SELECT id FROM sim AT TIME 2;", "the world at a time is sim{2}"),
    ("UPDATE sim SET z = 1;", "queries change no world: in Python, room['cup'].move("),
    (
        "SELECT id FROM sim WHERE joint(this, 'hinge') > 1;",
        "WHERE isRobot(this) AND joint(this, 'hinge')",
    ),
    ("avg(SELECT position FROM sim AS list);", "write avg(SELECT x(this) FROM … AS list), …"),
    ("SELECT sum(position) FROM sim GROUP BY kind;", "write sum(x(this)) AS x, sum(y(this)) AS y"),
    ("sim.joints;", "SELECT * FROM sim.joints"),
    ("sim.cube.position;", "position(sim.cube)"),
    ("sim.cube.z;", "z(sim.cube)"),
    ("sim.cube.xmax;", "write aabb(e)[1]"),
    ("sim.arm.hand.zmin;", "write aabb(e)[4]"),
    ("sim['duplo2x4/'].z;", "z(sim['duplo2x4/'])"),
    ("joints(sim.arm);", "joint(entity, 'name')"),
    ("SELECT id FROM sim{1, 2};", "FROM sim{} WHERE time >= 1 AND time <= 2"),
    ('z(sim."duplo2x4/");', "write ['duplo2x4/']"),
    ("z(sim.duplo2x4/);", "is written sim['duplo2x4/']"),
    ("z(sim.robot:arm);", "is written sim['robot:arm']"),
    ("z(sim.duplo2x4);", "are written sim['duplo2x4/']"),
    ("SELECT distance(this, kitchen.robot) FROM sim;", "no variable; the worlds are sim"),
    ("SELECT distance(this, sim.robot) FROM sim;", "name an entity, as in room['panda']"),
    # Functions of other libraries.
    ("dot([1], [2]);", "write sum([a[0] * b[0], a[1] * b[1], a[2] * b[2]])"),
    ("yaw(sim.cube);", "write atan2(rot(e)[1][0], rot(e)[0][0])"),
    ("clamp(3, 0, 1);", "write clip(x, low, high)"),
    ("clip([1], 0, 1);", "clip(number, low, high)"),
    ("jointVelocity(sim.arm, 'hinge');", "is rate(joint(entity, 'name')), and is in the table"),
    ("atLimit(sim.arm, 'hinge');", "write isOpen(entity, 'joint', share)"),
    ("isMoving(sim.cube);", "write speed(e) > 0.01"),
    ("atRest(sim.cube);", "write settled(e)"),
    ("fallen(sim.cube);", "write NOT upright(e)"),
    ("angleBetween(sim.cube, sim.table);", "it is 2 * acos(min([1, abs(dot)]))"),
    ("friction(sim.cube);", "bind a number of the simulator as a variable"),
    ("acceleration(sim.cube);", "write rate(velocity(e))"),
    ("at(z(sim.cube), 0.5);", "takes the time first, as in at(0.5, z(cup))"),
    ("jointLimit(sim.arm, 'hinge');", "SELECT name, lower, upper FROM joints"),
    ("ranges(sim.cube);", "world['name'].ranges"),
    ("under(sim.cube, sim.table);", "write below(a, b)"),
    ("np.tanh(1);", "a function has no dot before it: write tanh(…)"),
    ("sim.cube.z();", "write z(…)"),
    ("qpos[0];", "the position of a joint is joint(entity, 'name')"),
    ("sim.cube.qpos;", "the position of a joint is joint(entity, 'name')"),
    ("sum(sim.ctrl ^ 2);", "ss.add_variable('ctrl', list(data.ctrl))"),
    ("SELECT avg(z), variance(z) FROM sim;", "write stddev(x) ^ 2"),
    ("SELECT count(*), quantile_cont(z, 0.5) FROM sim;", "raw SQL has all of DuckDB: ss.sql("),
    ("SELECT max(z), argmax(z) FROM sim;", "ORDER BY z DESC LIMIT 1"),
    ("all(SELECT z > 0 FROM sim);", "NOT EXISTS (SELECT this FROM room WHERE NOT (condition))"),
    ("any(SELECT z > 0 FROM sim);", "write EXISTS (SELECT this FROM room WHERE condition)"),
    ("z(sim.cube) > ANY (SELECT z FROM sim);", "x > min(SELECT …)"),
    ("z(sim.cube) > ALL (SELECT z FROM sim);", "x > max(SELECT …)"),
    ("z(sim.cube) != nan;", "NaN is x != x"),
    ("z(sim.cube) IS nan;", "NaN is x != x"),
    ("z(sim.cube) < inf;", "infinity float('inf')"),
    ("len('abc');", "write count(x), of a list or of the letters"),
    ("sum([1, 2] ^ 2);", "norm(list) ^ 2"),
    ("[1, 2] * [3, 4];", "the dot product is sum("),
    ("SELECT vy FROM sim;", "write velocity(e)[1]"),
    ("SELECT k.wz FROM sim k;", "write angularVelocity(e)[2]"),
    ("SELECT id FROM sim ORDER BY qw;", "write orientation(e)[0]"),
    ("SELECT id FROM sim AS frame_of_pandas;", "help('AS') lists all"),
    ("SELECT id FROM sim AS array;", "did you mean 'list' or 'numpy'?"),
    ("SELECT id FROM sim AS Scalar;", "did you mean 'value'?"),
    ("SELECT id FROM sim AS rows;", "did you mean 'dict' or 'records'?"),
    ("SELECT id FROM sim AS map;", "its value: The grid of cells"),
    ("SELECT id FROM sim AS 'list';", "expected the name of a result form (without quotes)"),
    ("SELECT id FROM sim AS dict of list;", "a result form is one word"),
    # Time.
    (
        "heldFor(z(sim.cube) > 0, 0.2);",
        "heldFor takes 1 argument, not 2: the time is compared: heldFor",
    ),
    ("since(z(sim.cube) > 0, 0.2);", "heldFor(condition) >= 0.2"),
    ("since(z(sim.cube) > 0, x(sim.cube) > 0);", "write heldSince(condition, start)"),
    ("heldSince(z(sim.cube) > 0);", "for how long heldFor(condition)"),
    ("initially(z(sim.cube), 0.2);", "initially(expression) -> value"),
    ("holds(z(sim.cube) > 0) >= 0.2;", "heldFor(condition) >= 0.2"),
    ("z(sim.cube) > 0 FOR 0.2;", "heldFor(condition) >= 0.2"),
    ("ever(z(sim.cube) > 0);", "write once(condition)"),
    ("globally(z(sim.cube) > 0);", "write always(condition)"),
    ("first(z(sim.cube) > 0);", "holds(condition)[0][0]"),
    ("sim.time > 3;", "the simulated time is getTime()"),
    ("time() > 3;", "the simulated time now is getTime()"),
    ("t > 3;", "the simulated time is getTime()"),
    # Other languages.
    ("z(sim.cube) => 1;", "write >="),
    ("z(sim.cube) > 1 -> z(sim.cube) > 0;", "write a IMPLIES b"),
    ("always[0, 5](z(sim.cube) > 1);", "bounds of time come last: always(condition, 0, 5)"),
    ("finally(z(sim.cube) > 1);", "write once(condition), or eventually(condition)"),
    ("margin(z(sim.cube) > 1);", "write robustness(condition)"),
    ("z(sim.cube) =< 1;", "write <="),
    ("z(sim.cube) === 1;", "write =="),
    ("2 ** 3;", "a power is x ^ y"),
    ("x++;", "write x = x + 1"),
    ("x := 1;", "write x = 1"),
    ("1_000;", "a number is written 1000"),
    ("7 mod 2;", "write x % y"),
    ('f"{x}";', "a text has no letter before its quote"),
    ("while True: 1;", "no statements of Python"),
    ("lambda x: x;", "no statements of Python"),
    ("[1, 2, ];", "leave the comma before it out"),
    ("z(sim.cube, );", "leave the comma before it out"),
    ("SELECT id, z, FROM sim;", "found 'FROM'; leave the comma before it out"),
    ("distance(sim.cube, (1,2,3));", "a list is written in square brackets: [1, 2, 3]"),
    ("x = (1, 2);", "a list is written in square brackets"),
    ("x = {1, 2};", "a list is [1, 2, 3]"),
    ("distance(sim.cube, [0.1 0.2 0.3]);", "array.tolist()"),
    ("distance(sim.cube, [ 1. -2.  3.]);", "array.tolist()"),
    ("distance(sim.cube, np.array([1, 2, 3]));", "given as a parameter: ss.eval("),
    ("distance(sim.cube, [np.float64(0.1), 2, 3]);", "array.tolist()"),
    ("1 if z(sim.cube) > 0 else 0;", "a choice is IF(condition; a; b)"),
    ("z(sim.cube) > 0 ? 1 : 0;", "a choice is IF(condition; a; b)"),
    ("position(sim.cube)[0:2];", "[p[0], p[1]], not p[0:2]"),
    ("position(sim.cube).z;", "write [2], or z(e)"),
    ("z(sim.cube) > 0,1;", "numbers have a point: 0.1"),
    ("IF(z(sim.cube) > 0,1,2);", "a choice is IF(condition; a; b)"),
    ("sum(z(o) for o in sim);", "SELECT z(this) FROM room"),
    ("sim.cube on sim.table;", "write on(a, b)"),
    ("sim.cube under sim.table;", "a relation stands before its entities: under(a, b)"),
    ("in(sim.cube, sim.table);", "within(a, b)"),
    ("sim.cube IN sim.table;", "within(a, b)"),
    # Calls and names.
    ("inContact(sim.cube, sim);", "EXISTS (SELECT this FROM room WHERE inContact(cup, this))"),
    ("inContact(sim.cube);", "EXISTS (SELECT this FROM room WHERE inContact(cup, this))"),
    ("lifted(sim.cube);", "lifted(entity, height)"),
    ("z(sim.cube_visual);", "it is a geom, a shape of the body cube: write sim.cube"),
    ("z(sim.pad);", "a shape of the body hand: write sim.arm.hand"),
    ("inContact(sim.arm.hand.lpad, sim.cube);", "write sim.arm.hand, which has all of its shapes"),
    ("clearance(sim.arm.pad, sim.cube);", "a shape of the body hand: write sim.arm.hand"),
    ("sim.arm.cube;", "for the entity, write sim.cube"),
    ("sim.cube.hand;", "write sim.arm.hand"),
    ("z(hand);", "no variable 'hand'; a part of another one has that name: write sim.arm.hand"),
    ("z(sim['arm.hand']);", "it is a link: write sim.arm.hand; all links are FROM links(sim)"),
    ("sim.angle_of_hinge > 0;", "data.sensor('angle_of_hinge').data.tolist()"),
    ("angle_of_hinge > 0;", "it is a sensor of the model, which a world does not read"),
    ("sim.arm.angle_of_hinge > 0;", "it is a sensor of the model"),
    ("sim.motor;", "it is an actuator of the model"),
    ("sim.front;", "data.camera('front').xpos.tolist()"),
    ("sim.home;", "model.key('home').qpos.tolist()"),
    ("sim.wood;", "it is a material of the model"),
    ("link(sim.arm, 'hand');", "room['panda']['hand']"),
    ("links(sim.arm, 'hand');", "written by its names: room.panda.hand"),
    ("z(sim.arm, 'hand');", "written by its names: room.panda.hand"),
    ("inContact(sim.arm, 'hand');", "its link room['cup'].handle"),
    ("joint(sim.arm, 'motor');", "arm has no joint 'motor', only hinge, hand_joint"),
    ("joint(sim.arm, hinge);", "it is a joint: write joint(sim.arm, 'hinge')"),
    ("sim.hinge;", "it is a joint: write joint(sim.arm, 'hinge')"),
    ("sim.arm.hinge;", "write joint(sim.arm, 'hinge')"),
    ("sim.arm.hand_joint;", "write joint(sim.arm, 'hand_joint')"),  # there is a link 'hand'
    ("sim.cube.links;", "links(sim.cube)"),
    ("z(sim.qwerty);", "has no entity 'qwerty', only world, table, cube, duplo2x4/, arm"),
    # Names that users of PyBullet bring.
    ("getBasePositionAndOrientation(sim.cube);", "write position(e) and orientation(e)"),
    ("getBaseVelocity(sim.cube);", "write velocity(e)"),
    ("getLinkState(sim.cube, 0);", "position(room.panda.hand)"),
    ("getJointState(sim.cube, 0);", "joint(entity, 'name')"),
    ("joint_position(sim.cube, 'j');", "joint(entity, 'name')"),
    ("getNumJoints(sim.cube);", "joint(entity, 'name')"),
    ("getContactPoints(sim.cube);", "inContact(a, b)"),
    ("getClosestPoints(sim.cube, sim.table, 1);", "nearestPoints(a, b)"),
    ("getAABB(sim.cube);", "did you mean 'aabb'?"),
    ("is_on(sim.cube, sim.table);", "did you mean 'on'?"),
    ("get_distance(sim.cube, sim.table);", "did you mean 'distance'?"),
    ("isUpright(sim.cube);", "did you mean 'upright'?"),
    ("stacked(sim.cube, sim.table);", "write on(support, thing)"),
    ("is_stacked_on(sim.cube, sim.table);", "write on(support, thing)"),
    ("isGrasping(sim.cube, sim.table);", "write grasped(a, b)"),
    ("isHolding(sim.cube, sim.table);", "write grasped(a, b)"),
    ("gap(sim.cube, sim.table);", "write clearance(a, b)"),
    ("closestTo(sim.cube);", "ORDER BY distance(this, room.cup) LIMIT 1"),
    ("upsideDown(sim.cube);", "write tilt(e) > 2.8"),
    ("angvel(sim.cube);", "write angularVelocity(e)"),
    ("canSee(sim.cube, sim.table);", "write isSensing(sensor, entity)"),
    ("attached(sim.cube, sim.table);", "constraints of the simulator are not kept"),
    ("between(z(sim.cube), 0, 1);", "write x BETWEEN a AND b"),
    ("range(5);", "a list is written [0, 1, 2]"),
    ("touches(sim.cube, sim.table);", "write touching(a, b)"),
    ("stepSimulation();", "queries change no world"),
    ("abov(sim.cube, sim.table);", "did you mean 'above'?"),
    ("SELECT id FROM sim WHERE on;", "write on(sim.world, this), say"),
    ("SELECT id FROM sim WHERE near;", "write near(a, b, d), say"),
    ("SELECT id FROM sim WHERE mas > 1;", "did you mean 'mass'?"),
]


@pytest.mark.parametrize("name", ["arm.hand", "hand", "hinge"])
def test_a_part_that_is_no_entity_says_what_it_is(ss, name):
    known = {"arm.hand": "it is a link: write sim.arm.hand", "hinge": "it is a joint: write joint("}
    told = known.get(name, "a part of another one has that name: write sim.arm.hand")
    for ask, question in (
        (ss.eval, f"SELECT z FROM sim WHERE id = '{name}';"),
        (ss.sql, f"SELECT z FROM entities WHERE name = '{name}'"),
    ):
        with pytest.warns(ProgramWarning, match=re.escape(f"{name!r}; {told}")):
            ask(question)
    with pytest.raises(SelectScriptError, match=re.escape(told)):
        ss["sim"][name]


def test_what_follows_names_that_mean_other_things_has_no_hint(ss):
    for program in ("f(1, 2 3);", "IF(1 > 2,1,2);", "SELECT id FROM (SELECT id FROM sim, 5);"):
        with pytest.raises(SelectScriptError) as caught:
            ss.eval(program)
        assert "square brackets" not in str(caught.value)
        assert "NumPy" not in str(caught.value)


@pytest.mark.parametrize(("program", "told"), OF_PROGRAMS)
def test_a_program_says_what_to_write(ss, program, told):
    with pytest.raises(SelectScriptError, match=re.escape(told)):
        ss.eval(program)


@pytest.mark.parametrize("word", ["slacker", "gab", "ranged", "canSeam", "stacker"])
def test_what_is_near_to_no_function_is_given_none(ss, word):
    with pytest.raises(SelectScriptError) as caught:
        ss.eval(f"{word}(sim.cube);")
    assert caught.value.suggestions == ()


@pytest.mark.parametrize(
    "program", ["distance(sim.cube, p);", "SELECT id FROM sim WHERE distance(this, p) < 1;"]
)
def test_a_point_with_nan_is_told_of(ss, program):
    with pytest.raises(SelectScriptError, match="a number of the list is NaN"):
        ss.eval(program, {"p": [0, 0, float("nan")]})


@pytest.mark.slow
def test_what_the_errors_say_is_right(ss):
    assert ss.eval("[aabb(sim.cube)[1], aabb(sim.arm.hand)[4]];") == pytest.approx([0.1, 0.95])
    assert ss.eval("z(sim['duplo2x4/']);") == 0.5
    mean = ss.eval("[avg(SELECT x(this) FROM sim AS list), avg(SELECT z(this) FROM sim AS list)];")
    assert mean == pytest.approx(np.mean([body.position for body in ss["sim"]], axis=0)[::2])
    (row,) = ss.eval("SELECT avg(x(this)) AS x, avg(z(this)) AS z FROM sim;")
    assert list(row.values()) == pytest.approx(mean)
    heights = [float(body.position[2]) for body in ss["sim"]]
    (row,) = ss.eval(
        "SELECT stddev(z) AS s, stddev(z) ^ 2 AS v, median(z) AS m, sqrt(avg(z ^ 2) - avg(z) ^ 2) "
        "AS p FROM sim;"
    )
    spread = np.std(heights, ddof=1)
    expected = [spread, spread**2, np.median(heights), np.std(heights)]
    assert list(row.values()) == pytest.approx(expected)
    assert ss.sql("SELECT stddev(z), median(z) FROM entities").fetchone() == pytest.approx(
        [row["s"], row["m"]]
    )
    assert ss.eval("NOT EXISTS (SELECT this FROM sim WHERE NOT (z > -1));") is True
    assert ss.eval("[True IN [z(sim.cube) > 9], NOT False IN [True, False]];") == [False, False]
    assert ss.eval("distance(sim.cube, p);", {"p": np.array([0.0, 0.0, 0.0])}) == 0.5
    assert ss.eval("SELECT id FROM links(sim) WHERE id = 'arm.hand' AS list;") == ["arm.hand"]
    assert ss.eval("SELECT id FROM sim{} WHERE time >= 1 AND time <= 2;") == []
    assert ss.eval("start = initially(z(sim.cube)); holds(z(sim.cube) - start >= 0.1);") == []
    assert ss.sql("SELECT onTop(a, b) FROM entities a, entities b LIMIT 1").fetchall()
    near = "FROM entities a, entities b WHERE near(a, b, 0.2) AND b.name = 'table'"
    assert ("cube",) in ss.sql(f"SELECT a.name {near}").fetchall()
    assert ss.eval("SELECT id FROM sim WHERE id = 'cube' AS dataframe;")["id"].tolist() == ["cube"]


@pytest.mark.slow
def test_what_is_said_of_other_libraries_is_right():
    """The rotation against MuJoCo's own matrix, and SciPy's angles."""
    turned = XML.replace('name="cube" pos="0 0 .5"', 'name="cube" pos="0 0 3" euler="10 20 30"')
    model = mujoco.MjModel.from_xml_string(turned)
    data = mujoco.MjData(model)
    data.qvel[:6] = range(1, 7)
    mujoco.mj_forward(model, data)
    matrix = data.body("cube").xmat.reshape(3, 3)
    yaw, pitch, roll = Rotation.from_matrix(matrix).as_euler("ZYX")
    with ssduck.Interpreter() as ss:
        world = ss.add_variable("sim", ssduck.World.attach(model, data))
        for name, angle in (("YAW", yaw), ("PITCH", pitch), ("ROLL", roll)):
            text = suggestion_for_name(name).removeprefix("write ").partition(";")[0]
            assert ss.eval(f"{text.replace('(e)', '(sim.cube)')};") == pytest.approx(angle)
        for column in ("xmin", "xmax", "ymax", "zmin", "vx", "vz", "wy", "qw", "qz"):
            text = suggestion_for_name(column).removeprefix("write ").replace("(e)", "(sim.cube)")
            (stored,) = ss.sql(f"SELECT {column} FROM entities WHERE name = 'cube'").fetchone()
            assert ss.eval(f"{text};") == stored
        for name, angle in (("yaw", yaw), ("pitch", pitch), ("roll", roll)):
            with pytest.raises(SqlError) as caught:
                ss.sql(f"SELECT {name} FROM entities")
            formula = caught.value.message.partition(f"the {name} is ")[2]
            (found,) = ss.sql(f"SELECT {formula} FROM entities WHERE name = 'cube'").fetchone()
            assert found == pytest.approx(angle)
        row = f"SELECT {YAW_OF_COLUMNS} FROM entities WHERE name = 'cube'"
        assert ss.sql(row).fetchone()[0] == pytest.approx(yaw)
        assert ss.sql("SELECT least(greatest(7, 0), 1), list_dot_product([3], [4])").fetchall() == [
            (1, 12)
        ]
        for name, value in (("DOT", 32), ("CROSS", [-3, 6, -3])):
            text = suggestion_for_name(name).removeprefix("write ")
            assert ss.eval(f"a = [1, 2, 3]; b = [4, 5, 6]; {text};") == value
        of, dot = suggestion_for_name("ANGLE").partition("it is ")[2].split(", with dot = ")
        dot, _, _ = dot.partition(" of p")
        bound = "p = orientation(sim.cube); q = orientation(sim.table);"
        angle = np.arccos((np.trace(matrix) - 1) / 2)  # the table is not turned
        assert ss.eval(f"{bound} dot = {dot}; {of};") == pytest.approx(angle)
        axis = suggestion_for_name("ZAXIS").partition("axis is ")[2].replace("(e)", "(sim.cube)")
        assert ss.eval(f"{axis};") == pytest.approx(matrix[:, 2].tolist())
        for data.time, data.qpos[2] in ((0.25, 3), (0.5, 1)):
            mujoco.mj_forward(model, data)
            world.tick()
        condition = "z(sim.cube) > 2"
        for name, value in (("EVER", True), ("GLOBALLY", False), ("NEVER", False)):
            for text in suggestion_for_name(name).removeprefix("write ").split(", or "):
                call = text.partition(" of ")[0].replace("condition", condition)
                assert ss.eval(f"{call};") is value
        assert ss.eval(f"[holds({condition})[0][0], holds({condition})[-1][1]];") == [0, 0.5]
        touched = "EXISTS (SELECT this FROM sim WHERE touching(sim.{}, this));"
        assert [ss.eval(touched.format(name)) for name in ("cube", "table")] == [False, True]


@pytest.mark.parametrize(
    ("program", "told"),
    [
        ("least(z(sim.cube), z(sim.table));", "of two numbers write min([a, b])"),
        ("greatest(z(sim.cube), 0);", "of two numbers write max([a, b])"),
        ("holds(z(sim.cube) > 0, 0.2);", "heldFor(condition) >= 0.2"),
        ("t = 0.2; holds(z(sim.cube) > 0, t);", "heldFor(condition) >= 0.2"),
        ("changes(z(sim.cube) > 0, 0.2);", "the value at a time is at(0.2, expression)"),
    ],
)
def test_a_second_argument_that_is_no_age_is_told_of(ss, program, told):
    with pytest.warns(ProgramWarning, match=re.escape(told)), suppress(EvaluationError):
        ss.eval(program)


def test_ages_are_not_told_of(ss):
    with silent():
        ss.eval("t = -0.2; [holds(z(sim.cube) > 0, t), least(z(sim.cube), -0.1)];")
        ss.eval("t = 0.2; [changes(z(sim.cube), -t), changes(z(sim.cube), t - 1)];")


def test_save_is_told_of(ss):
    with pytest.raises(AttributeError, match="export"):
        ss.save("run")


@pytest.mark.slow
def test_each_of_many_links_is_a_value():
    """More than a table of 511 links, against MuJoCo."""
    bodies = "".join(
        f"<body name='l{n}' pos='{n} 0 1'><joint axis='0 0 1'/><geom size='.1'/></body>"
        for n in range(600)
    )
    tree = f"<body name='tree'><geom size='.1'/>{bodies}</body>"
    model, data = simulated(f"<mujoco><worldbody>{tree}</worldbody></mujoco>")
    with ssduck.Interpreter(recording=None) as ss:
        ss.add_variable("sim", ssduck.World.attach(model, data))
        assert ss.eval("position(sim.tree.l599);") == data.body("l599").xpos.tolist()
        assert ss.eval("SELECT id FROM links(sim) WHERE x > 598 AS list;") == ["tree.l599"]
        assert ss.sql("SELECT count(DISTINCT id) FROM links").fetchone() == (601,)
