"""What completes at a place of a program: names by their context, the nearest first."""

from __future__ import annotations

import pytest

import ssduck
from ssduck.errors import ArgumentError, NumberError
from ssduck.interpreter.completion import complete
from ssduck.schema import TABLES


@pytest.fixture(scope="module")
def statements():
    return []


@pytest.fixture(scope="module")
def ss(statements):
    with ssduck.load("kitchen") as loaded:
        loaded.add_function("heavy", lambda entity: True, "Checks the mass. It is slow.")
        loaded.add_variable("height", 1.2)
        loaded.add_variable("robot", loaded["kitchen"]["barrett_4918"])
        loaded._database.connection._tracer = statements.append
        yield loaded


def at(ss, marked, language="selectscript"):
    """The completions at the place of the sign |."""
    return complete(ss, marked.replace("|", ""), marked.index("|"), language)


# The text, what completes first, and what does not complete.
CASES = [
    ("SELECT id(kitchen.frid|)", ["fridge", "fridge_webcam"], "near"),
    ("SELECT id(kitchen . frid|", ["fridge", "fridge_webcam"], "near"),
    ("SELECT id(kitchen.FRID|", ["fridge", "fridge_webcam"], "near"),
    ("SELECT id(kitchen.webcam|", ["fridge_webcam"], "fridge"),
    ("SELECT id(kitchen.frigde|", ["fridge"], "near"),
    ("kitchen.barrett_4918.left_t|", ["left_tyre"], "fridge"),
    ("robot.left_t|", ["left_tyre"], "fridge"),
    ("kitchen.nothing.|", [], "fridge"),
    ("height.|", [], "fridge"),
    ("nothing.|", [], "fridge"),
    ("SELECT id(this) FROM kit|", ["kitchen"], "kinbody"),
    ("SELECT id(this) FROM |", ["kitchen"], "SELECT"),
    ("SELECT id(this) FROM kitchen AS occ|", ["occupancygrid"], "near"),
    ("SELECT id(this) FROM kitchen AS |", [], "near"),
    ("SELECT hea|", ["heavy"], "SELECT"),
    ("SELECT heig|", ["height"], "heavy"),
    ("SEL|", ["SELECT"], "near"),
    ("sel|", ["SELECT"], "near"),
    ("first = 1; fir|", ["first"], "near"),
    ("SELECT a.th| FROM a=kitchen", ["this"], "near"),
    ("SELECT a.zm| FROM a=kitchen", ["zmax", "zmin"], "near"),
    ("SELECT this FROM kitchen WHERE id(this) == 'frid|'", ["fridge", "fridge_webcam"], "near"),
    ('SELECT this FROM kitchen WHERE id(this) == "frid|', ["fridge", "fridge_webcam"], "near"),
    ("'frid'|", ["kitchen"], "fridge"),
    ("1; // nea|", [], "near"),
    ("1; /* nea| */", [], "near"),
    ("12|", [], "near"),
    ("zzzzqq|", [], "near"),
]


@pytest.mark.parametrize(("text", "first", "missing"), CASES)
def test_selectscript(ss, text, first, missing):
    names = [each.text for each in at(ss, text)]
    assert names[: len(first)] == first
    assert missing not in names


SQL_CASES = [
    ("SELECT zm| FROM entities", ["zmax", "zmin"], "entities"),
    ("SELECT e.zm| FROM entities e", ["zmax", "zmin"], "entities"),
    ("SELECT e.zm| FROM kitchen.entities AS e", ["zmax", "zmin"], "entities"),
    ("SELECT E.zm| FROM entities_history e WHERE true", ["zmax", "zmin"], "entities"),
    ("SELECT entities.zm| FROM entities WHERE true", ["zmax", "zmin"], "entities"),
    ("SELECT e.eff| FROM joints e", ["effort"], "zmax"),
    ("SELECT e.dep| FROM entities a, contacts e", ["depth"], "zmax"),
    ("SELECT e.zm| FROM a JOIN entities e ON true", ["zmax", "zmin"], "entities"),
    ("SELECT * FROM kitchen.ent|", ["entities", "entities_history"], "near"),
    ("SELECT * FROM ent|", ["entities", "entities_history"], "near"),
    ("SELECT * FROM kit|", ["kitchen"], "near"),
    ("SELECT nea|", ["near"], "heavy"),
    ("SELECT heav|", [], "heavy"),
    ("SELECT z AS hei|", [], "height"),
    ("SELECT * FROM entities WHERE name = 'frid|", ["fridge", "fridge_webcam"], "near"),
    ("SELECT * FROM entities WHERE name = 'it''s' AND z|", ["z", "zmax", "zmin"], "near"),
    ('SELECT "frid|', [], "fridge"),
    ("SELECT 1 -- nea|", [], "near"),
    ("SELECT 1 -- no\n, nea|", ["near"], "heavy"),
    ("SELECT 1 /* nea|", [], "near"),
    ("SELECT nothing.|", [], "near"),
]


@pytest.mark.parametrize(("text", "first", "missing"), SQL_CASES)
def test_sql(ss, text, first, missing):
    names = [each.text for each in at(ss, text, "sql")]
    assert names[: len(first)] == first
    assert missing not in names


def test_a_completion_says_how_it_is_used_and_what_it_replaces(ss):
    (near,) = (each for each in at(ss, "SELECT ne|") if each.text == "near")
    assert (near.start, near.kind) == (7, "function")
    assert near.usage == "near(a, b, d) -> bool"
    assert near.about == "Checks if the clearance of a and b is at most d."
    (heavy,) = at(ss, "SELECT heav|")
    assert heavy.about == "Checks the mass."
    (fridge, _) = at(ss, "kitchen.frid|")
    assert (fridge.start, fridge.kind, fridge.about) == (8, "entity", "A robot of kitchen.")


def test_columns_are_those_of_the_table(ss):
    for table in TABLES.values():
        names = {each.text for each in at(ss, f"SELECT t.| FROM {table.name} t", "sql")}
        assert names == {column.name for column in table.shown_columns}


def test_it_runs_no_sql_and_takes_no_tick(ss, statements):
    world = ss["kitchen"]
    before = world.snapshot.number
    statements.clear()
    for text, *_ in CASES:
        at(ss, text)
    for text, *_ in SQL_CASES:
        at(ss, text, "sql")
    assert statements == []
    assert world.snapshot.number == before
    ss.sql("SELECT 1")
    assert statements  # the tracer would have seen some


@pytest.mark.parametrize("cursor", [-1, 4, 0.5])
def test_a_place_outside_the_text(ss, cursor):
    with pytest.raises(NumberError):
        complete(ss, "abc", cursor)


def test_an_unknown_language(ss):
    with pytest.raises(ArgumentError, match="selectscript or sql"):
        complete(ss, "abc", 0, "prolog")
