"""What raw SQL can call and name: relations behind their world, and words that need no quotes."""

import pybullet
import pytest

import ssduck
from ssduck.recording.spec import Recording
from ssduck.schema import MODELS, RECORDABLE, TABLES
from ssduck.sql.relations.registry import RELATIONS
from tests.support.bodies import create_linked_body, solid
from tests.support.cases import sampled

# A literal for each type of parameter; entities are the rows a and b.
LITERALS = {
    "place": "{'x': 0.0, 'y': 0.0, 'z': 1.0}",
    "double": "0.5",
    "integer": "1",
    "number": "1",
    "list": "[0.0, 0.0, 0.0]",
    "string": "'joint1'",
}
# Names of worlds that SQL has to quote, and some that it need not.
NAMES = ("sim", "Übung", "on")


def called(relation):
    """The text of a call, with the names of the relations unquoted."""
    rows = iter("aba")
    given = [
        next(rows) if p.type in ("entity", "place") and i < 2 else LITERALS.get(p.type, "a")
        for i, p in enumerate(relation.parameters)
        if not p.optional
    ]
    return f"{relation.name}({', '.join(given)})"


def boxes(client, count=2):
    for number in range(count):
        solid(client, pybullet.GEOM_BOX, 1.0, [0.15 * number, 0, 0.1], halfExtents=[0.1] * 3)
    return client


def jointed(client):
    """A box with a link on a revolute joint, which PyBullet calls joint1."""
    shape = pybullet.createCollisionShape(
        pybullet.GEOM_BOX, halfExtents=[0.1] * 3, physicsClientId=client
    )
    create_linked_body(
        client,
        1.0,
        shape,
        link_shape=-1,
        basePosition=[0.15, 0, 0.1],
        linkPositions=[[0, 0, 0.1]],
        linkJointTypes=[pybullet.JOINT_REVOLUTE],
    )
    return client


@pytest.fixture(scope="module")
def worlds():
    """An interpreter with a world under each of the names, and one with a world alone."""
    client = jointed(boxes(pybullet.connect(pybullet.DIRECT), 1))
    with ssduck.Interpreter() as ss, ssduck.Interpreter() as alone:
        for name in NAMES:
            ss.add_variable(name, ssduck.World.attach(client))
        alone.add_variable("sim", ssduck.World.attach(client))
        yield ss, alone
    pybullet.disconnect(client)


@pytest.mark.parametrize(
    "call",
    [
        'sim."above"(a, b)',
        '"sim" . above (a, b)',
        "sim./* the\nupper */above(a, b)",
        "SIM.ABOVE(a, b)",
        "sim.--\nabove(a, b)",
        "memory.sim.above(a, b)",
        '"Übung".above(a, b)',
        '"on".above(a, b)',
    ],
)
def test_however_it_is_written(worlds, call):
    assert len(worlds[0].sql(f"SELECT {call} FROM sim.entities a, sim.entities b")) == 4


@pytest.mark.parametrize("comment", ["-" * 400, "/**/" * 100], ids=["a line", "one by one"])
def test_a_dot_before_long_comments_is_read_at_once(worlds, comment):
    text = f"SELECT 1. {comment}"  # trying all ways to divide the comment would never end
    assert worlds[0].sql(text).fetchall() == [(1,)]


@pytest.mark.slow
def test_it_stays_with_worlds_that_change(client):
    boxes(client)
    asked = "SELECT count(*) FROM sim.entities a, sim.entities b WHERE sim.overlaps(a, b)"
    with ssduck.Interpreter() as ss:
        ss.add_variable("sim", ssduck.World.attach(client))
        assert ss.sql(asked).fetchall() == [(2,)]
        ss.sql("CREATE VIEW kept AS SELECT sim.aabbVolume(e) AS v FROM sim.entities e")
        boxes(client, 1)
        ss.call_variable("sim").tick()
        assert ss.sql(asked).fetchall() == [(6,)]
        pybullet.removeBody(0, client)
        ss.call_variable("sim").tick()
        assert ss.sql(asked).fetchall() == [(2,)]
        ss.add_variable("sim", ss.call_variable("sim").what_if({}))  # another one
        assert ss.sql(asked).fetchall() == [(2,)]
        assert ss.sql("FROM kept").fetchall() == [(pytest.approx(0.008),)] * 2
        other = ssduck.World.attach(client)
        ss.add_variable("later", other)
        assert ss.sql(asked.replace("sim", "later")).fetchall() == [(2,)]


@pytest.mark.slow
def test_what_a_file_keeps_may_call_them(client, tmp_path):
    boxes(client)
    path = tmp_path / "own.duckdb"
    for _ in range(2):
        with ssduck.Interpreter(path, recording=None) as ss:
            ss.add_variable("sim", ssduck.World.attach(client))
            ss.sql("CREATE MACRO IF NOT EXISTS main.tall(e) AS sim.aabbVolume(e) > 1")
            ss.sql("CREATE TABLE IF NOT EXISTS notes(n INTEGER)")
            assert ss.sql("SELECT tall(e) FROM sim.entities e").fetchall() == [(False,)] * 2
        # Nothing in the statement says what it needs: only the file does.
        with ssduck.Interpreter(path, recording=None) as ss:
            ss.add_variable("sim", ssduck.World.attach(client))
            assert ss.sql("SELECT tall(e) FROM sim.entities e").fetchall() == [(False,)] * 2


# -- words that need no quotes ---------------------------------------------------------------


@pytest.fixture(scope="module")
def one():
    """An interpreter with one world, whose ticks are recorded."""
    client = jointed(boxes(pybullet.connect(pybullet.DIRECT), 1))
    with ssduck.Interpreter() as ss:
        ss.add_variable("sim", ssduck.World.attach(client))
        ss.record("sim", Recording(tables=("entities", "contacts")))
        ss.call_variable("sim").step(2)
        yield ss
    pybullet.disconnect(client)


VIEWS = {
    **{table: table for table in TABLES},
    **{TABLES[table].history_view: table for table in ("entities", "contacts", "ticks")},
}


@pytest.mark.parametrize("view", VIEWS)
def test_every_column_has_a_name_that_needs_no_quotes(one, view):
    table = VIEWS[view]
    seconds = TABLES[table].second_names
    # A view of links lacks what only sites have.
    columns = [c for c in TABLES[table].columns if TABLES[table].part_of or not c.is_of_sites]
    names = [seconds.get(column.name, column.name) for column in columns]
    for form in (
        "SELECT {list} FROM {view}",
        "SELECT {each} FROM {view}",
        "SELECT {list} FROM {view} ORDER BY {list}",
        "SELECT count(*) FROM {view} GROUP BY {list}",
        "SELECT max({first}) FROM {view} WHERE {every}",
    ):
        sql = form.format(
            view=view,
            list=", ".join(names),
            first=names[-1],
            each=", ".join(f"v.{name}" for name in names) + f" FROM {view} v --",
            every=" AND ".join(f"{name} IS NOT DISTINCT FROM {name}" for name in names),
        )
        one.sql(sql)
    for name, second in seconds.items():
        differing = f'SELECT * FROM {view} WHERE "{name}" IS DISTINCT FROM {second}'
        assert one.sql(differing).fetchall() == []


@pytest.mark.parametrize("table", MODELS)
def test_what_entities_are_needs_no_quotes_either(one, table):
    names = ", ".join(column.name for column in MODELS[table].model)
    one.sql(f"SELECT {names} FROM {MODELS[table].model_view}")


def test_the_contacts_have_second_names():
    second_names = TABLES["contacts"].second_names
    assert set(second_names) >= {"by", "ny"}
    assert second_names["by"] == "point_b_y"
    assert second_names["nz"] == "normal_z"
    assert not any(TABLES[table].second_names for table in RECORDABLE if table != "contacts")


@sampled("name", [r.name for r in RELATIONS.values() if not r.alias_of], every=4)
@pytest.mark.parametrize("schema", ["", "sim"])
def test_every_relation_has_a_name_that_needs_no_quotes(one, name, schema):
    relation = RELATIONS[name]
    relation = RELATIONS[relation.aliases[0]] if relation.aliases else relation
    call = called(relation)
    before = f"{schema}." if schema else ""
    one.sql(f"SELECT {before}{call} FROM entities a, entities b WHERE {before}{call} IS NOT NULL")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("first", "second"), [("on", "onTop"), ("position", "positionOf"), ("time", "timeOf")]
)
def test_second_names_mean_the_same(first, second, one):
    relation = RELATIONS[first]
    assert RELATIONS[second].alias_of == first
    assert f"Also called {second}" in one.eval(f"help('{first}');")
    assert f"same as {first}" in one.eval(f"help('{second}');")
    more = "a.this, b.this" if relation.required_count == 2 else "a.this"
    for row_by_row in (False, True):
        ss = ssduck.Interpreter(row_by_row=row_by_row)
        ss.add_variable("sim", one.call_variable("sim").what_if({}))
        program = "SELECT {}({}) FROM a = sim, b = sim AS list;"
        assert ss.eval(program.format(first, more)) == ss.eval(program.format(second, more))
        if first == "on":
            assert "narrow phase: onTop" in ss.explain(program.format(second, more))
    quoted = called(relation).replace(f"{first}(", f'"{first}"(')
    differing = f"{quoted} IS DISTINCT FROM {called(RELATIONS[second])}"
    assert one.sql(f"SELECT * FROM entities a, entities b WHERE {differing}").fetchall() == []
