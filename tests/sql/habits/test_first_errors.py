"""Spellings that new users try: each is an error that says what to write, or works."""

from __future__ import annotations

import re

import mujoco
import pytest

import ssduck
from ssduck.errors import SelectScriptError

XML = """
<mujoco>
  <worldbody>
    <geom name="floor" type="plane" size="0 0 .1"/>
    <body name="table" pos="0 0 .2"><geom type="box" size=".5 .5 .2"/></body>
    <body name="cube" pos="0 0 .5"><freejoint/><geom type="box" size=".1 .1 .1"/></body>
    <body name="duplo2x4/" pos="1 0 .5"><freejoint/><geom size=".1"/></body>
    <body name="arm" pos="2 0 1">
      <joint name="hinge" axis="0 0 1"/>
      <geom type="box" size=".4 .02 .1"/>
      <body name="hand" pos=".5 0 0"><joint name="wrist"/><geom size=".05"/></body>
    </body>
  </worldbody>
</mujoco>
"""


@pytest.fixture(scope="module")
def ss():
    model = mujoco.MjModel.from_xml_string(XML)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    with ssduck.Interpreter() as ss:
        ss.add_variable("sim", ssduck.World.attach(model, data))
        yield ss


OF_SQL = [
    ("SELECT on(a, b) FROM entities a, entities b", "on is a word of SQL: write onTop(…)"),
    ("SELECT position(e) FROM entities e", "position is a word of SQL: write positionOf(…)"),
    ("SELECT time(e) FROM entities e", "time is a word of SQL: write timeOf(…)"),
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
    ("SELECT distance(sim.cube, sim.table)", "This is SelectScript: ss.eval runs it"),
]


@pytest.mark.parametrize(("sql", "told"), OF_SQL)
def test_raw_sql_says_what_to_write(ss, sql, told):
    with pytest.raises(SelectScriptError, match=re.escape(told)):
        ss.sql(sql)


@pytest.mark.parametrize("sql", ["SELECT FROM WHERE", "SELECT nothing FROM entities"])
def test_other_errors_of_sql_have_no_such_hint(ss, sql):
    with pytest.raises(SelectScriptError) as caught:
        ss.sql(sql)
    assert "SelectScript" not in str(caught.value)
    assert "row" not in str(caught.value)


@pytest.mark.parametrize(
    ("program", "told"),
    [
        ("SELECT id FROM sim WHERE near(name, 'table', .1);", "that of a row this"),
        ("near(sim.cube, 'table', .1);", "the entity of a name is room['cup']"),
        ("SELECT id FROM sim.links;", "its links are FROM links(sim)"),
        ("sim.joints;", "SELECT * FROM sim.joints"),
        ("sim.cube.position;", "position(sim.cube)"),
        ("sim.cube.z;", "z(sim.cube)"),
        ("sim.cube.xmax;", "aabb(sim.cube)[1]"),
        ("sim.arm.hand.zmin;", "aabb(sim.arm.hand)[4]"),
        ("sim['duplo2x4/'].z;", "z(sim['duplo2x4/'])"),
        ("joints(sim.arm);", "joint(entity, 'name')"),
        ("SELECT id FROM sim{1, 2};", "FROM sim{} WHERE time >= 1 AND time <= 2"),
        ('z(sim."duplo2x4/");', "write ['duplo2x4/']"),
        ("z(sim.duplo2x4/);", "is written sim['duplo2x4/']"),
        ("z(sim.robot:arm);", "is written sim['robot:arm']"),
        ("z(sim.duplo2x4);", "are written sim['duplo2x4/']"),
        ("SELECT distance(this, kitchen.robot) FROM sim;", "no variable; the worlds are sim"),
        ("SELECT distance(this, sim.robot) FROM sim;", "name an entity, as in room['panda']"),
    ],
)
def test_a_program_says_what_to_write(ss, program, told):
    with pytest.raises(SelectScriptError, match=re.escape(told)):
        ss.eval(program)


@pytest.mark.slow
def test_what_the_errors_say_is_right(ss):
    assert ss.eval("[aabb(sim.cube)[1], aabb(sim.arm.hand)[4]];") == pytest.approx([0.1, 0.95])
    assert ss.eval("z(sim['duplo2x4/']);") == 0.5
    assert ss.eval("SELECT id FROM links(sim) WHERE id = 'arm.hand' AS list;") == ["arm.hand"]
    assert ss.eval("SELECT id FROM sim{} WHERE time >= 1 AND time <= 2;") == []
    assert ss.eval("start = initially(z(sim.cube)); holds(z(sim.cube) - start >= 0.1);") == []
    assert ss.sql("SELECT onTop(a, b) FROM entities a, entities b LIMIT 1").fetchall()
    near = "FROM entities a, entities b WHERE near(a, b, 0.2) AND b.name = 'table'"
    assert ("cube",) in ss.sql(f"SELECT a.name {near}").fetchall()
    assert ss.eval("SELECT id FROM sim WHERE id = 'cube' AS dataframe;")["id"].tolist() == ["cube"]


def test_save_is_told_of(ss):
    with pytest.raises(AttributeError, match="export"):
        ss.save("run")


def test_limits_name_the_tables():
    with (
        ssduck.Interpreter(limits=ssduck.Limits.strict()) as strict,
        pytest.raises(SelectScriptError, match=r"one of contacts, .*entities"),
    ):
        strict.sql("SHOW TABLES")


@pytest.mark.slow
def test_each_of_many_links_is_a_value():
    """More than a table of 511 links, against MuJoCo."""
    bodies = "".join(
        f"<body name='l{n}' pos='{n} 0 1'><joint axis='0 0 1'/><geom size='.1'/></body>"
        for n in range(600)
    )
    tree = f"<body name='tree'><geom size='.1'/>{bodies}</body>"
    model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{tree}</worldbody></mujoco>")
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    with ssduck.Interpreter(recording=None) as ss:
        ss.add_variable("sim", ssduck.World.attach(model, data))
        assert ss.eval("position(sim.tree.l599);") == data.body("l599").xpos.tolist()
        assert ss.eval("SELECT id FROM links(sim) WHERE x > 598 AS list;") == ["tree.l599"]
        assert ss.sql("SELECT count(DISTINCT id) FROM links").fetchone() == (601,)
