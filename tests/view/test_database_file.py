"""A world of a database file: its present is asked in the page, its past is refused with the reason."""

import pytest

import ssduck

pytest.importorskip("websockets", reason="the extra view is not installed")

from ssduck.interpreter.stopping import StopRequest
from ssduck.view.answers import Answers
from ssduck.view.live import LiveSource

REASON = "the past of 'kitchen' is in a database file"
CUP = "cup_905a"


@pytest.fixture(scope="module")
def ss(tmp_path_factory):
    path = tmp_path_factory.mktemp("database") / "kitchen.duckdb"
    with ssduck.load("kitchen", database=path) as ss:
        ss.run(0.1)
        yield ss


@pytest.fixture(scope="module")
def page(ss):
    source = LiveSource(ss, ss.worlds[0], "kitchen")
    yield Answers(source)
    source.close()


@pytest.mark.parametrize(
    "question",
    [
        {"type": "ask", "text": "SELECT id FROM kitchen;", "at": 0.05},
        {"type": "ask", "text": "SELECT id, z FROM kitchen{0.05};"},
        {"type": "ask", "text": "SELECT id, z FROM kitchen{-1.0};"},
        {"type": "ask", "text": "holds(z(kitchen.cup_905a) > 0);"},
        {"type": "ask", "text": "SELECT count(*) FROM entities_history", "language": "sql"},
        {"type": "ask", "text": "SELECT count(*) FROM ticks_history", "language": "sql"},
        {"type": "ask", "text": "SELECT count(*) FROM links_history", "language": "sql"},
        {"type": "ask", "text": "SELECT count(*) FROM entities_model", "language": "sql"},
        {"type": "plot", "entity": 1, "column": "z"},
    ],
    ids=lambda question: question.get("text", question["type"]),
)
def test_its_past_is_refused_with_the_reason(page, ss, question):
    if "entity" in question:
        question = question | {"entity": ss["kitchen"][CUP].id}
    assert REASON in page.answer(question, StopRequest())["error"]["message"]


@pytest.mark.parametrize(
    ("language", "text"),
    [
        ("selectscript", "SELECT id, z FROM kitchen;"),
        ("sql", "SELECT name, z FROM entities"),
        ("sql", "SELECT count(*) FROM contacts"),
    ],
)
def test_its_present_is_asked(page, ss, language, text):
    ss["kitchen"].step()
    answer = page.answer({"type": "ask", "text": text, "language": language}, StopRequest())
    assert answer["rows"]
    if language == "sql":
        assert answer["rows"] == [list(row) for row in ss.sql(text).fetchall()]
    else:
        rows = ss.eval(text)
        assert answer["rows"] == [
            list(row.values()) if isinstance(row, dict) else [row] for row in rows
        ]
