"""A page of queries as users of SQL write them: `tests/data/sql_queries.toml`.

Each gives the value that one works out by hand, or an error that shows the right spelling.
"""

import ast
import tomllib
import warnings
from pathlib import Path

import pytest

import ssduck
from ssduck.errors import ProgramWarning, SelectScriptError
from ssduck.interpreter import query_runner

DATA = Path(__file__).resolve().parents[2] / "data"
QUERIES = tomllib.loads((DATA / "sql_queries.toml").read_text(encoding="utf-8"))["query"]


@pytest.fixture(scope="module", params=["as SQL", "row by row"])
def room(request):
    few, query_runner.FEW_ROWS = query_runner.FEW_ROWS, 0
    with ssduck.load(DATA / "room.toml") as loaded:
        world = loaded.call_variable("room")
        with ssduck.Interpreter(row_by_row=request.param == "row by row", recording=None) as ss:
            ss.add_variable("room", world)
            yield ss
    query_runner.FEW_ROWS = few


def test_there_are_sixty_queries():
    assert len({query["text"] for query in QUERIES}) == len(QUERIES) >= 60


def is_equal(found, expected):
    """Checks equality, of floats up to rounding, and of the order and the types of all else."""
    if isinstance(expected, float):
        return type(found) is float and found == pytest.approx(expected, abs=1e-12)
    if isinstance(expected, list):
        pairs = zip(found, expected, strict=False)
        return len(found) == len(expected) and all(is_equal(*pair) for pair in pairs)
    if isinstance(expected, dict):
        return list(found) == list(expected) and all(
            is_equal(found[key], value) for key, value in expected.items()
        )
    return type(found) is type(expected) and found == expected


# A third of the queries also with a semicolon.
ENDED = [*((query, "") for query in QUERIES), *((query, ";") for query in QUERIES[::3])]


@pytest.mark.parametrize(
    ("query", "end"), ENDED, ids=[f"{query['text']}{end}" for query, end in ENDED]
)
def test_query(room, query, end):
    program = query["text"] + ("\n" if "--" in query["text"] else "") + end
    before = set(room)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", ProgramWarning)
        if "error" in query:
            with pytest.raises(SelectScriptError) as refused:
                room.eval(program)
            assert query["error"] in str(refused.value)
            assert refused.value.line == 1
        elif query["value"] == "[room.can]":
            assert room.eval(program) == [room.eval("room.can;")]
        else:
            assert is_equal(room.eval(program), ast.literal_eval(query["value"]))
    messages = [str(warning.message) for warning in caught]
    if end == "":
        assert ["warning" in query] == [bool(messages)]
        assert all(query["warning"] in message for message in messages)
    assert set(room) == before  # no query sets a variable


@pytest.mark.parametrize("query", [q for q in QUERIES if "warning" in q], ids=lambda q: q["text"])
def test_a_warning_is_an_error_in_a_strict_interpreter(room, query):
    room.strict = True
    try:
        with pytest.raises(SelectScriptError) as refused:
            room.eval(query["text"])
        assert query["warning"] in str(refused.value)
    finally:
        room.strict = False
