"""Variables of an interpreter as items, and what the `repr` of interpreters and worlds says."""

import copy
import re
from pathlib import Path
from typing import get_type_hints

import pytest

import ssduck
from ssduck.errors import ArgumentError, SqlError, UnknownNameError

ROOM = Path(__file__).resolve().parents[1] / "data" / "room.toml"


@pytest.fixture
def ss():
    with ssduck.load(ROOM) as loaded:
        yield loaded


def test_variables_are_items(ss):
    assert ss["room"] is ss.call_variable("room")
    assert isinstance(ss["room"], ssduck.World)
    ss["heights"] = [0.4, 1.2]
    assert ss.eval("SELECT this FROM heights WHERE this > 1 AS list;") == [1.2]
    assert ss["heights"] == [0.4, 1.2]
    assert list(ss) == ["room", "heights"]
    assert "heights" in ss
    assert "height" not in ss
    assert 5 not in ss
    ss.eval("n{} = 3;")
    assert ss["n"] == 3


UNKNOWN = [
    ("kitchen;", "there is no variable 'kitchen'; the world is 'room'"),
    ("SELECT id FROM kitchen;", "there is no variable 'kitchen'; the world is 'room'"),
    ("SELECT id FROM romo;", "there is no variable 'romo'; did you mean 'room'?"),
    ("z(can);", "there is no variable 'can'; for the entity, write room.can"),
    ("SELECT id FROM room WHERE above(table, this);", "write room.table"),
    ("SELECT id FROM room WHERE positon == 1;", "did you mean 'position'"),
    ("SELECT id FROM room AS lst;", "there is no result form 'lst'; did you mean 'list'?"),
]


@pytest.mark.parametrize(("program", "words"), UNKNOWN)
def test_an_unknown_name_names_what_there_is(ss, program, words):
    with pytest.raises(UnknownNameError) as caught:
        ss.eval(program)
    assert words in str(caught.value)


def test_functions_are_suggested_only_if_they_are_near(ss):
    """The function `robot` is not what `rooom` means."""
    with pytest.raises(UnknownNameError, match=r"'rooom'; did you mean 'room'\?$"):
        ss["rooom"]
    with pytest.raises(UnknownNameError, match=r"'sim'; the world is 'room'$"):
        ss["sim"]
    ss["other"] = ss["room"].what_if()
    with pytest.raises(UnknownNameError, match=r"'sim'; worlds are 'room', 'other'$"):
        ss["sim"]
    with pytest.raises(UnknownNameError, match=r"write room\.can or other\.can$"):
        ss["can"]
    with ssduck.Interpreter() as empty, pytest.raises(UnknownNameError, match=r"'sim'$"):
        empty["sim"]


def test_an_item_is_no_attribute(ss):
    """The error shows how to get it; private names and others have Python's message."""
    for thing, name in ((ss, "room"), (ss["room"], "can")):
        hint = rf"has no attribute '{name}'; write \['{name}'\] instead of \.{name}$"
        with pytest.raises(AttributeError, match=hint):
            getattr(thing, name)
        with pytest.raises(
            AttributeError, match=r"'(Interpreter|World)' object has no attribute 'x'$"
        ):
            thing.x  # noqa: B018
        assert not hasattr(thing, "_ipython_display_")
    with pytest.raises(AttributeError, match=r"'KinBody' object has no attribute 'positon'$"):
        ss["room"]["can"].positon  # noqa: B018
    assert copy.copy(ss["room"]["can"]) == ss["room"]["can"]


@pytest.mark.slow
def test_a_world_is_no_table(ss):
    with pytest.raises(
        SqlError, match=r"no table 'room'; of the world, there are room\.entities, "
    ):
        ss.sql("SELECT name FROM room WHERE z > 1")
    with pytest.raises(SqlError, match="Table with name rooms does not exist"):
        ss.sql("SELECT name FROM rooms")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("sql", "hint"),
    [
        (
            "SELECT t.name FROM Room AS t, entities",
            "no table 'Room'; of the world, there are room.",
        ),
        ("SELECT name FROM rom.entities", "no world or schema 'rom'; did you mean 'room'?"),
        ("SELECT count(position) FROM entities", "in the columns x, y and z; positionOf(e) is"),
        (
            "SELECT e.orientation FROM entities e",
            "the columns qw, qx, qy and qz; orientation(e) is",
        ),
        ("SELECT velocity FROM entities", "the columns vx, vy and vz"),
        ("SELECT l.entity.id FROM links l", "id of an entity; a join has its columns: JOIN"),
    ],
)
def test_errors_of_sql_name_what_there_is(ss, sql, hint):
    with pytest.raises(SqlError, match=re.escape(hint)):
        ss.sql(sql)
    for right in (
        "SELECT positionOf(e), orientation(e) FROM entities e",
        "SELECT e.name FROM links l JOIN entities e ON e.id = entity",
    ):
        assert len(ss.sql(right).fetchall()) >= 6


@pytest.mark.slow
def test_explain_of_sql_logs_nothing(ss, caplog):
    plan = ss.sql('EXPLAIN SELECT "name" FROM entities WHERE "name" = \'can\'').fetchall()
    assert "name = 'can'" in plan[0][1]
    assert [record for record in caplog.records if record.levelname == "WARNING"] == []


def test_what_is_no_item(ss):
    with pytest.raises(ArgumentError):
        ss[5]
    for name in ("select", "a b", 5):
        with pytest.raises(ArgumentError):
            ss[name] = 1


def test_repr_says_what_is_there(ss):
    assert repr(ss) == "<Interpreter: worlds room (6 entities, t=0 s)>"
    for number in range(10):
        ss[f"v{number}"] = number
    ss.add_function("double", lambda number: 2 * number)
    ss.add_trigger("seen", "SELECT id FROM room;", 0.1, print)
    assert repr(ss) == (
        "<Interpreter: worlds room (6 entities, t=0 s); "
        "variables v0, v1, v2, v3, v4, v5, v6, v7 and 2 more; functions double; triggers seen>"
    )
    names = "table, can, cup, ball, lamp, rover"
    assert repr(ss["room"]) == (
        f"<World 'room': 6 entities (5 kinbodies, 1 robot: {names}), t=0 s>"
    )
    with ssduck.Interpreter() as empty:
        assert repr(empty) == "<Interpreter: empty>"
    ss.close()
    assert "room" in repr(ss)


def test_load_and_worlds_are_typed(ss):
    assert get_type_hints(ssduck.load)["return"] is ssduck.Interpreter
    assert all(isinstance(world, ssduck.World) for world in ss.worlds)


def test_dir_lists_what_is_public(ss):
    """Each public name has a docstring, and no name is one that only ssduck itself uses."""
    room = ss["room"]
    internal = {"assign", "check_call", "keep", "meter", "variable", "notify_observers", "pinned"}
    for thing in (ss, room, room["can"], room["can"].links[0]):
        names = {name for name in dir(thing) if not name.startswith("_")}
        assert not names & (internal | {"INTERNAL_NAMES", "request_tables", "column", "KEY_HINT"})
        for name in names:
            member = getattr(type(thing), name, None)
            assert not callable(member) or member.__doc__, name
    assert {"eval", "sql", "run", "worlds", "strict", "history", "help"} <= set(dir(ss))
    assert {"step", "tick", "run", "what_if", "time", "name", "simulator"} <= set(dir(room))
    assert {"position", "aabb", "links", "move", "full_name"} <= set(dir(room["can"]))


@pytest.mark.parametrize("of", [ssduck.World, ssduck.Entity, ssduck.Link])
def test_classes_list_what_their_objects_do(of):
    names = {name for name in dir(of) if not name.startswith("_")}
    assert names
    assert names.isdisjoint(of.INTERNAL_NAMES)


def test_strict_is_a_flag(ss):
    assert not ss.strict
    ss.strict = True
    assert ss.strict
