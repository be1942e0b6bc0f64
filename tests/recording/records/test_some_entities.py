"""Records of some entities warn where an answer depends on the others; of worlds, one is the first."""

import json
import warnings

import pybullet
import pytest

import ssduck
from ssduck import Recording
from ssduck.recording.stores.files import json_text
from tests.support.bodies import solid

SOME = ["table", "cup"]
BOTH_TICKS = "FROM entities_history p JOIN entities_history q USING (tick)"
OF_ALL = [
    ("restsOn(lab{0.05}.table, lab{0.05}.cup);", False),
    ("count(holds(supports(lab.table, lab.cup)));", 0),
    ("count(holds(restsOn(lab.table, lab.cup)));", 0),
    ("at(0.05, nextTo(lab.table, lab.cup));", False),
    (
        "SELECT id(a.this) FROM a=lab{0.05} WHERE NOT EXISTS "
        "(SELECT b.this FROM b=lab{0.05} WHERE inContact(a.this, b.this)) AS list;",
        ["table", "cup"],
    ),
    (f"SELECT count(*) = 0 {BOTH_TICKS} WHERE p.time < 0.09 AND restsOn(p, q)", True),
]
OF_SOME = ["on(lab{0.05}.table, lab{0.05}.cup);", "holds(z(lab.cup) > 5);", "SELECT id FROM lab;"]


@pytest.fixture
def lab(client):
    """A cup on a plate on a table."""
    pybullet.setGravity(0, 0, -9.81, physicsClientId=client)
    names = {}
    for name, sides, z, mass in (
        ("table", [0.5, 0.5, 0.3], 0.3, 0),
        ("plate", [0.1, 0.1, 0.01], 0.61, 0.3),
        ("cup", [0.03, 0.03, 0.03], 0.65, 0.2),
    ):
        body = solid(client, pybullet.GEOM_BOX, mass, [0, 0, z], halfExtents=sides)
        names[body] = name
    with ssduck.Interpreter() as ss:
        ss.add_variable("lab", ssduck.World.attach(client, names=names))
        yield ss


def _told(ss, question):
    """Returns the answer, and the warnings of entities that were not recorded."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        ask = ss.eval if question.endswith(";") else lambda sql: ss.sql(sql).fetchone()[0]
        answer = ask(question)
    return answer, [str(w.message) for w in caught if "were recorded" in str(w.message)]


@pytest.mark.slow
@pytest.mark.parametrize(("question", "answer"), OF_ALL)
def test_what_depends_on_all_is_told_of_once(lab, tmp_path, question, answer):
    world = lab.call_variable("lab")
    lab.record("lab", Recording(entities=SOME))
    world.step(24)
    lab.export(tmp_path / "some")
    with ssduck.open(tmp_path / "some") as opened:
        for ss in (lab, opened):
            found, (told,) = _told(ss, question)
            assert found == answer
            assert "only table, cup were recorded" in told
            assert _told(ss, question) == (answer, [])


@pytest.mark.slow
def test_what_depends_on_the_recorded_alone_is_not_told_of(lab, tmp_path):
    world = lab.call_variable("lab")
    lab.record("lab", Recording(entities=SOME))
    world.step(24)
    assert _told(lab, "restsOn(lab.table, lab.cup);") == (True, [])  # the present has all
    lab.export(tmp_path / "some")
    with ssduck.open(tmp_path / "some") as opened:
        for ss in (lab, opened):
            assert [_told(ss, question)[1] for question in OF_SOME] == [[]] * len(OF_SOME)
        assert len(_told(opened, "restsOn(lab.table, lab.cup);")[1]) == 1


@pytest.mark.slow
def test_a_record_of_all_tells_nothing(lab, tmp_path):
    lab.call_variable("lab").step(24)
    lab.export(tmp_path / "all")
    with ssduck.open(tmp_path / "all") as opened:
        assert _told(opened, OF_ALL[0][0]) == (True, [])
        assert [_told(opened, question)[1] for question, _ in OF_ALL] == [[]] * len(OF_ALL)


# The first by name is not the first that was added.
NAMES = ("zoo", "attic", "mill")
FIRST = "SELECT name FROM entities"


@pytest.fixture
def recorded(tmp_path):
    """Records of three worlds, each with an entity of its name: a file and two folders."""
    clients = [pybullet.connect(pybullet.DIRECT) for _ in NAMES]
    with ssduck.Interpreter(tmp_path / "file.duckdb") as ss:
        for name, client in zip(NAMES, clients, strict=True):
            body = pybullet.createMultiBody(1, physicsClientId=client)
            ss.add_variable(name, ssduck.World.attach(client, names={body: f"of_{name}"}))
        # What is written first does not tell.
        with ss.record_to(tmp_path / "live", "attic"), ss.record_to(tmp_path / "live", "zoo"):
            for name in reversed(NAMES):
                ss[name].step()
        ss.export(tmp_path / "folder")
        assert ss.sql(FIRST).fetchall() == [("of_zoo",)]
    for client in clients:
        pybullet.disconnect(client)
    return tmp_path


@pytest.mark.slow
def test_sql_answers_for_the_world_that_was_added_first(recorded):
    with ssduck.open(recorded / "folder") as ss:
        for name in ("mill", "zoo"):  # copied one by one, the first one last
            ss.export(recorded / "copy", name)
    for path in ("file.duckdb", "live", "folder", "copy"):
        with ssduck.open(recorded / path) as ss:
            assert ss.sql(FIRST).fetchall() == [("of_zoo",)], path
            assert next(world.name for world in ss.worlds) == "zoo", path
    with ssduck.open(recorded / "folder", "mill") as ss:
        assert ss.sql(FIRST).fetchall() == [("of_mill",)]


@pytest.mark.slow
def test_a_record_without_an_order_begins_with_the_first_by_name(recorded):
    for file in (recorded / "folder" / "episodes").iterdir():
        about = json.loads(file.read_text())
        del about["order"], about["crc32"]
        file.write_text(json_text(about))
    with ssduck.open(recorded / "folder") as ss:
        assert ss.sql(FIRST).fetchall() == [("of_attic",)]
