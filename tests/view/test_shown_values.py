"""What a page gets of long values: their beginning, before all of them are made into JSON."""

import json
from decimal import Decimal

import numpy as np
import pytest

import ssduck
from ssduck.view.answers import MAX_LETTERS, MAX_VALUES, _ShownValues, shown_rows

pytest.importorskip("websockets", reason="the extra view is not installed")

from ssduck.interpreter.stopping import StopRequest
from ssduck.view.answers import Answers
from ssduck.view.live import LiveSource

INF, NAN, LARGE = float("inf"), float("nan"), 2**53 + 1
ROWS = [
    ([1, "a", None, ""], [1, "a", None, ""]),
    ([INF, -INF, NAN, True], ["inf", "-inf", "nan", "True"]),
    ([LARGE, -LARGE, 10**40, LARGE - 1], [f"{2**53 + 1}", f"-{2**53 + 1}", f"1{'0' * 40}", 2**53]),
    ([1e300, 1e15 + 0.5, 1 / 3, Decimal("1.10")], [1e300, 1e15 + 0.5, 1 / 3, 1.1]),
    ([Decimal(LARGE), Decimal("-12345678901234567.25")], [f"{LARGE}", "-12345678901234567.25"]),
    ([[LARGE, [INF, None]], {"x": [4], 5: b"6"}], [f"[{LARGE}, [inf, NULL]]", "{'x': [4], 5: 36}"]),
    ([np.array([[1.5, 2], [3, 4]]), (7,)], ["[[1.5, 2], [3, 4]]", "[7]"]),
    ([np.float64(0.5), np.float32(INF), np.int64(3), np.array(7)], [0.5, "inf", 3, 7]),
    ([[], {}], ["[]", "{}"]),
]


@pytest.mark.parametrize(("row", "shown"), ROWS)
def test_short_values_are_whole(row, shown):
    assert shown_rows([row]) == [shown]
    # A double of JavaScript has each number.
    assert all(float(cell) == cell for cell in shown if isinstance(cell, int | float))


@pytest.mark.parametrize(
    ("rows", "shown"),
    [
        ([[[1, 2, 3, 4, 5, 6]]], [["[1, 2, '… (4 more)']"]]),
        ([[1, 2, 3, 4]], [[1, 2, 3, "… (1 more)"]]),
        ([[1], [2], [3], [4]], [[1], [2], [3]]),
        ([[{"a": 1, "b": 2, "c": 3}]], [["{'a': 1, 'b': 2, '…': '… (1 more)'}"]]),
        ([[[[1, 2], [3]], 4]], [["[[1, '… (1 more)'], '… (1 more)']", "… (1 more)"]]),
        ([[np.arange(9)]], [["[0, 1, '… (7 more)']"]]),
    ],
)
def test_long_values_end_in_what_is_left_out(rows, shown):
    assert shown_rows(rows, 3) == shown


def test_long_texts_are_cut():
    ((text, content),) = shown_rows([["x" * (MAX_LETTERS + 5), b"y" * (MAX_LETTERS + 7)]])
    assert text == "x" * MAX_LETTERS + "… (5 more)"
    assert content.endswith("79… (7 more)")


@pytest.fixture(scope="module")
def page():
    with ssduck.load("kitchen", recording=None) as ss:
        source = LiveSource(ss, ss.worlds[0], "kitchen")
        yield Answers(source)
        source.close()


@pytest.mark.slow
@pytest.mark.parametrize(
    "text",
    [
        "SELECT list([range]) FROM range(900000)",
        "SELECT list(range) FROM range(900000) GROUP BY range // 1000",
    ],
)
def test_a_page_gets_the_beginning_of_a_nested_list(page, monkeypatch, text):
    made, of = [], _ShownValues.of
    monkeypatch.setattr(_ShownValues, "of", lambda *both: made.append(both) or of(*both))
    answer = page.answer({"type": "ask", "text": text, "language": "sql"}, StopRequest())
    assert "error" not in answer
    assert 0 < len(made) <= MAX_VALUES
    assert len(answer["marks"]) == len(answer["rows"]) <= answer["count"]
    assert len(json.dumps(answer)) < 2_000_000
