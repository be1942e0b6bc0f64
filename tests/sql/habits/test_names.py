"""Names that no entity or link has are told alike at every door."""

import re
import warnings
from pathlib import Path

import numpy as np
import pytest

import ssduck
from ssduck.errors import ProgramWarning, SelectScriptError, UnknownNameError
from tests.support.warned import silent

ROOM = Path(__file__).resolve().parents[2] / "data" / "room.toml"


@pytest.fixture
def ss():
    with ssduck.load(ROOM) as loaded:
        yield loaded


# (statement, the text that nothing has)
UNKNOWN = [
    ("SELECT z FROM entities WHERE name = 'cna'", "cna"),
    ("SELECT z FROM room.entities e WHERE e.name IN ('cup', 'cna')", "cna"),
    ("SELECT z FROM entities WHERE 'cna' <> name", "cna"),
    ("SELECT e.z FROM entities e JOIN links l ON l.entity = e.id WHERE e.name = 'cna'", "cna"),
    ("SELECT (SELECT z FROM entities_history WHERE name != 'cna' LIMIT 1)", "cna"),
    ("SELECT z FROM room.entities WHERE entities.name = 'cna'", "cna"),
    ("WITH a AS (SELECT z FROM entities WHERE name == 'cna') SELECT * FROM a", "cna"),
]
KNOWN = [
    "SELECT z FROM entities WHERE name = 'can'",
    "SELECT z FROM entities WHERE name LIKE 'cna' OR name > 'cna'",
    "SELECT z FROM (SELECT * FROM entities) WHERE name = 'cna'",
    "SELECT 1 FROM links WHERE name = 'link0' AND full_name = 'can.link0' AND kind = 'link'",
    "SELECT 1 FROM entities WHERE kind IN ('robot', 'kinbody', 'sensor')",
    "SELECT 1 FROM contacts c JOIN joints j ON true WHERE j.type = 'cna'",
    "SELECT 1 FROM entities WHERE parent = 'cna'",
    "SELECT 'name' = 'cna'",
    "WITH entities AS (SELECT 'cna' AS name) SELECT 1 FROM (SELECT 1) WHERE 'name' = 'cna'",
]


@pytest.mark.parametrize(("statement", "text"), UNKNOWN)
def test_raw_sql_warns_of_a_name_that_no_entity_has(ss, statement, text):
    with pytest.warns(ProgramWarning, match=f"no entity of room has the name '{text}'") as caught:
        ss.sql(statement).fetchall()
    assert "did you mean 'can'" in str(caught[0].message)
    assert [warning.filename for warning in caught] == [__file__]
    with silent():
        ss.sql(statement)  # once is enough
    ss.strict = True
    with pytest.raises(UnknownNameError) as refused:
        ss.sql(statement)
    assert statement[refused.value.span.start : refused.value.span.end] == f"'{text}'"


@pytest.mark.parametrize("statement", KNOWN)
def test_raw_sql_is_not_suspected(ss, statement):
    ss.strict = True
    ss.sql(statement)


DOORS = {
    "program": lambda ss: ss.eval("SELECT id FROM room WHERE name = 'cna';"),
    "raw SQL": lambda ss: ss.sql("SELECT id FROM entities WHERE name = 'cna'"),
    "key": lambda ss: ss.eval("room.cna;"),
    "Python": lambda ss: ss.call_variable("room")["cna"],
}


@pytest.mark.parametrize("door", DOORS)
def test_all_doors_suggest_the_nearest_name(ss, door):
    ss.strict = True
    with pytest.raises(SelectScriptError, match="did you mean 'can'"):
        DOORS[door](ss)


@pytest.mark.slow
@pytest.mark.parametrize("door", ["program", "raw SQL"])
def test_records_suggest_it_too(ss, door, tmp_path):
    ss.call_variable("room").step(2)
    ss.export(tmp_path / "run")
    with ssduck.open(tmp_path / "run") as opened:
        opened.strict = True
        with pytest.raises(SelectScriptError, match="did you mean 'can'"):
            DOORS[door](opened)
        opened.sql("SELECT id FROM entities WHERE name = 'can'")


def test_a_removed_entity_is_known(ss):
    ss.strict = True
    room = ss.call_variable("room")
    room.step(1)
    room.remove("can")
    assert ss.sql("SELECT z FROM entities WHERE name = 'can'").fetchall() == []
    assert ss.sql("SELECT z FROM entities_history WHERE name = 'can'").fetchall() != []


# (statement, its parameters, the text that nothing has)
PARAMETERS = [
    ("SELECT z FROM entities WHERE name = ?", ["cna"], "cna"),
    ("SELECT z FROM entities WHERE z > $2 AND name = $1", ["cna", 0.0], "cna"),
    ("SELECT z FROM entities WHERE z > $least AND $who <> name", {"who": "cna", "least": 0}, "cna"),
    (
        "SELECT z FROM links WHERE full_name IN ($a, $b)",
        {"a": "can.link0", "b": "can.lnk0"},
        "can.lnk0",
    ),
]


@pytest.mark.parametrize(("statement", "parameters", "text"), PARAMETERS)
def test_a_parameter_is_a_name_too(ss, statement, parameters, text):
    ss.strict = True
    with pytest.raises(UnknownNameError, match=f"has the name '{text}'; did you mean 'can"):
        ss.sql(statement, parameters)
    right = {"cna": "can", "can.lnk0": "can.link0"}
    if isinstance(parameters, dict):
        ss.sql(statement, {key: right.get(value, value) for key, value in parameters.items()})
    else:
        ss.sql(statement, [right.get(value, value) for value in parameters])


@pytest.mark.parametrize("parameters", [None, [], {}, [7], [None], [["cna"]]])
def test_other_parameters_are_not_suspected(ss, parameters):
    assert ss._execution.linter.check_sql(PARAMETERS[0][0], parameters) == []


def test_which_of_several_question_marks_is_a_name_is_not_guessed(ss):
    ss.strict = True
    ss.sql("SELECT z FROM entities WHERE kind <> ? AND name = ?", ["cna", "can"])


# (statement of SQL, what is said)
OTHERS = [
    ("SELECT 1 FROM entities WHERE kind = 'robo'", "is of the kind 'robo'; did you mean 'robot'"),
    ("SELECT 1 FROM links WHERE kind = 'sit'", "no link of room is of the kind 'sit'.*'site'"),
    ("SELECT 1 FROM links WHERE name = 'lnk0'", "no link of room has the name 'lnk0'.*'link0'"),
    ("SELECT 1 FROM links WHERE full_name = 'cna.link0'", "no link of room .*'can.link0'"),
    ("SELECT 1 FROM links_history l WHERE 'can.l' != l.full_name", "has the name 'can.l'"),
    ("SELECT 1 FROM room.joints WHERE name = 'nope'", "no joint of room has the name 'nope'"),
]


@pytest.mark.parametrize(("statement", "message"), OTHERS)
def test_names_of_links_and_joints_and_kinds_in_raw_sql(ss, statement, message):
    with pytest.warns(ProgramWarning, match=message):
        ss.sql(statement)


@pytest.mark.slow
def test_the_joints_of_a_robot_are_known():
    with ssduck.load("kitchen") as ss:
        ss.strict = True
        (name, *_) = ss.sql("SELECT name FROM joints LIMIT 1").fetchone()
        assert ss.sql("SELECT 1 FROM joints WHERE name = ? LIMIT 1", [name]).fetchall() == [(1,)]
        with pytest.raises(UnknownNameError, match=f"did you mean '{name}'"):
            ss.sql("SELECT 1 FROM joints WHERE name = $1", [name + "s"])


# (program, the message; None if there is none)
PROGRAMS = [
    ("SELECT id FROM room WHERE kind == 'robo' AS list;", "is of the kind 'robo'"),
    ("SELECT id FROM room WHERE kind(this) IN ['kinbody', 'sensr'] AS list;", "'sensr'"),
    ("SELECT a.id FROM a=room, b=room WHERE a.kind != 'kinbdy' AS list;", "'kinbdy'"),
    ("SELECT id FROM links(room) WHERE kind(this) == 'kinbody' AS list;", "no link of room is of"),
    ("'cna' IN (SELECT id FROM room AS list);", "no entity of room has the name 'cna'"),
    ("SELECT id FROM room WHERE 'cna' IN [id(this), 'x'] AS list;", "'cna'; did you mean 'can'"),
    ("SELECT id FROM room WHERE kind == 'robot' OR kind(this) == 'kinbody' AS list;", None),
    ("SELECT id FROM links(room) WHERE kind(this) == 'link' AS list;", None),
    ("SELECT kind FROM dicts WHERE kind == 'mine' AS list;", None),
    ("kind = 'mine'; kind == 'yours';", None),
    ("'can' IN (SELECT id FROM room AS list);", None),
    ("'c' IN (SELECT id FROM room WHERE name == 'can' AS value);", None),  # a part of a text
    ("'yours' IN (SELECT kind FROM dicts AS list);", None),
]


@pytest.mark.parametrize(("program", "message"), PROGRAMS)
def test_names_and_kinds_in_programs(ss, program, message):
    ss.strict = True
    ss.add_variable("dicts", [{"kind": "mine"}])
    if message is None:
        ss.eval(program)
        return
    with pytest.raises(UnknownNameError, match=message):
        ss.eval(program)


# (program whose first part decides, the message; None if there is none)
DECIDED = [
    (
        "z(room.can) < 0 AND z(room.cna) > 0;",
        "world 'room' has no entity 'cna'; did you mean 'can'",
    ),
    ("z(room.can) > 0 OR z(room['cna']) > 0;", "no entity 'cna'; did you mean 'can'"),
    ("z(room.can) < 0 IMPLIES NOT z(room.cna) > 0;", "no entity 'cna'; did you mean 'can'"),
    ("IF(z(room.can) > 0; 1; z(room.cna));", "no entity 'cna'; did you mean 'can'"),
    ("z(room.can) < 0 AND z(rom.can) > 0;", "no variable 'rom'; did you mean 'room'"),
    ("z(room.can) < 0 AND z(room.can.lnk0) > 0;", "'lnk0'"),
    ("z(room.can) < 0 AND joint(room.can, 'hinge') > 0;", "no joint of room has the name 'hinge'"),
    ("z(room.can) < 0 AND holds(z(room.cna) > 0) == [];", "no entity 'cna'; did you mean 'can'"),
    ("z(room.can) < 0 AND z(room.can.link0) > dicts.mine;", None),
    ("'ball' IN dicts AND z(room.ball) > 1;", None),  # it may come
    ("IF(z(room.can) > 0; 1; new = 2, new);", None),
    ("IF(z(room.can) < 0; new = 1; 0); IF(z(room.can) > 0; 1; new);", None),
    ("part = 'ball'; part IN room AND z(room.ball) > 1;", None),
    ("'ball' == what AND z(room.ball) > 1;", None),
    ("what IN room AND z(room.ball) > 1;", None),
    ("z(room.can) < 0 AND z(room.cna) > goal[0];", "did you mean 'can'"),
    ("IF(z(room.can) > 0; 1; eval('new = 1'), new);", None),
    ("z(room.can) < 0 AND z(room['can'][fails()]) > 1;", None),  # nothing is called
    ("z(room.can) < 0 AND count(SELECT id FROM rom AS list) > 1;", "did you mean 'room'"),
    ("z(room.can) < 0 AND count(SELECT id AS k FROM room WHERE z > 1 AS list) > 1;", None),
]


@pytest.mark.parametrize(("program", "message"), DECIDED)
def test_names_that_the_value_does_not_need(ss, program, message):
    ss.add_variable("dicts", {"kind": "mine"})
    ss.add_variable("what", "ball")
    ss.add_variable("goal", np.zeros(3))
    ss.add_function("fails", lambda: 1 / 0)
    value = program.startswith(("z(room.can) < 0 IMP", "z(room.can) > 0", "IF"))
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        for _ in range(2):
            assert bool(ss.eval(program)) == value
    assert [message in str(one.message) for one in told] == [True] * (message is not None)
    ss.strict = True
    if message is not None:
        with pytest.raises(SelectScriptError, match=re.escape(message)):
            ss.add_trigger("watch", program, 0.1, print)
    else:
        assert bool(ss.eval(program)) == value


# (condition on a link, whether there is such a one)
LINKS = [
    ("id = 'can.link0'", True),
    ("id(this) == 'can.link0'", True),
    ("name = 'link0'", True),
    ("name(this) IN ['link0']", True),
    ("id = 'can'", False),
    ("id = 'cna.link0'", False),
    ("name(this) == 'link1'", False),
]


@pytest.mark.parametrize(("condition", "is_there"), LINKS)
@pytest.mark.parametrize("source", ["links(room)", "parts"])
def test_names_of_links(ss, condition, is_there, source):
    ss.strict = True
    ss.eval("parts = links(room);")
    program = f"SELECT id FROM {source} WHERE {condition} AS list;"
    if is_there:
        assert "can.link0" in ss.eval(program)
        return
    with pytest.raises(UnknownNameError, match="no link of room"):
        ss.eval(program)
