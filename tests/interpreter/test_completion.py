"""What completes at a place of a program: names by their context, the nearest first."""

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

import ssduck
from ssduck.errors import ArgumentError, NumberError
from ssduck.interpreter.completion import complete
from ssduck.language.tokens import escaped, unquoted
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
    ("1 < 2 IMP|", ["IMPLIES"], "near"),
    ("rob|", ["robot", "robustness"], "robustness of once"),
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


@pytest.mark.parametrize(
    ("language", "text", "first", "missing"),
    [*(("selectscript", *case) for case in CASES), *(("sql", *case) for case in SQL_CASES)],
)
def test_what_completes_first(ss, language, text, first, missing):
    names = [each.text for each in at(ss, text, language)]
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


# -- names from elsewhere -----------------------------------------------------------------------

NAMES = ["c' OR True #", 'c" OR True #', "c\\", "c\\' OR 1=1 --", "c''", 'c\\\\"', "c\\d"]
UNWRITABLE = ["c\u001b[2J", "c\u202eb", "c\n.quit", "c\u0007"]


@pytest.fixture(scope="module")
def hostile(tmp_path_factory):
    scene = tmp_path_factory.mktemp("hostile") / "scene.toml"
    bodies = (f"[[body]]\nname={json.dumps(name)}\nbox=[1,1,1]\n" for name in NAMES + UNWRITABLE)
    scene.write_text('name = "lab"\n' + "".join(bodies), encoding="utf-8")
    with ssduck.load(scene) as loaded:
        yield loaded


def chosen(ss, program, language):
    """Each program in which a choice replaces what is typed, with the end of its text."""
    for choice in complete(ss, program, len(program), language):
        yield program[: choice.start] + choice.text


@pytest.mark.parametrize("quote", ["'", '"'])
def test_a_choice_inside_a_text_is_the_name(hostile, quote):
    typed = f"SELECT id(this) FROM lab WHERE id(this) == {quote}c"
    programs = [f"{begun}{quote} AS list;" for begun in chosen(hostile, typed, "selectscript")]
    assert sorted(hostile.eval(program) for program in programs) == sorted([n] for n in NAMES)


@pytest.mark.parametrize("prefix", ["", "E", "e"])
def test_a_choice_inside_a_text_of_sql_is_the_name(hostile, prefix):
    typed = f"SELECT name FROM lab.entities WHERE name = {prefix}'c"
    programs = [f"{begun}'" for begun in chosen(hostile, typed, "sql")]
    found = [hostile.sql(program).fetchall() for program in programs]
    wanted = [name for name in NAMES if not (prefix and "\\" in name)]
    assert sorted(found) == sorted([(name,)] for name in wanted)


@pytest.mark.parametrize("before", ["LIKE", "= 'E' || ", "= e || "])
def test_a_word_that_ends_in_e_gives_a_text_no_escapes(hostile, before):
    typed = f"SELECT name FROM lab.entities WHERE name {before}'c"
    found = [each.text for each in complete(hostile, typed, language="sql")]
    assert found == [each.text for each in complete(hostile, "SELECT 'c", language="sql")]
    assert any("\\" in text for text in found)


@pytest.mark.parametrize("text", ["lab.", "x = lab.c", "'c", '"c', "SELECT this FROM lab WHERE '"])
@pytest.mark.parametrize("language", ["selectscript", "sql"])
def test_no_choice_has_control_characters(hostile, text, language):
    choices = complete(hostile, text, len(text), language)
    assert all(each.text.isprintable() for each in choices)
    assert choices or "lab." in text or '"' in text or "lab.c" in text


@given(text=st.text("'\"\\\\ab #", max_size=8), quote=st.sampled_from(["'", '"']))
def test_an_escaped_text_is_read_as_it_was(text, quote):
    assert unquoted(f"{quote}{escaped(text, quote)}{quote}") == text


@pytest.mark.parametrize(
    "before", ["a" + ".b" * 25_000, "x" * 50_000, "'" * 50_000, "x = 1; " * 7_000]
)
@pytest.mark.parametrize("language", ["selectscript", "sql"])
def test_a_long_program_before_the_cursor(hostile, before, language):
    """What is there is looked at once: in the square of the length, each would take a minute."""
    short = complete(hostile, "; l", language=language)
    found = complete(hostile, f"{before}; l", language=language)
    assert [each.text for each in found] == [each.text for each in short] != []
