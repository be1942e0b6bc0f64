"""Tables that fit a terminal: what does not fit is folded or marked, never lost without a word."""

import io
import re
from collections import Counter

import pytest
import rich.console
from rich.cells import cell_len

import ssduck
from ssduck.adapters.display import DisplayTable, display_table, fitted_table
from ssduck.adapters.result import TableView
from ssduck.adapters.text_table import elided

WIDE = [{f"column_{n}": n * 1.5 for n in range(31)} for _ in range(4)]
PROSE = "One sentence of some words, and another one that is about as long as this."
TABLES = {
    "numbers": WIDE,
    "mixed": [{"id": n, "text": PROSE, "place": [n, 0.5, 2], "是名字": "字" * n} for n in range(9)],
    "one long text": [{"text": PROSE}, {"text": "short"}],
    "one long word": [{"name": "x" * 300}],
    "a long number": [{"n": 10**60}, {"n": 1}],
    "wide letters": [{"名": "机器人" * 20, "z": 1.25}, {"名": "é̄" * 30, "z": None}],
    "long names": [{"name_of_a_column_" * 3 + str(n): n for n in range(5)}],
    "without names": [[n, PROSE] for n in range(3)] + [[1]],
    "no rows": {},
    "a row of nothing": [{"a": None}],
    "control letters": [{"t": "a\tb\n\x1b[31mc"}],
}


def words(text):
    return Counter(text.split())


@pytest.mark.parametrize("width", [1, 2, 5, 6, 7, 20, 40, 80, 120, 1000])
@pytest.mark.parametrize("name", TABLES)
def test_no_line_is_wider_and_nothing_goes_without_a_mark(name, width):
    answer = display_table(TABLES[name])
    lines = fitted_table(answer).lines(width)
    assert max(map(cell_len, lines), default=0) <= width
    whole = fitted_table(answer).lines(100_000)
    assert "…" not in "".join(whole)
    shown = "\n".join(lines)
    if "…" not in shown:
        assert words(shown.replace("─", "")) == words("\n".join(whole).replace("─", ""))
    if width == 1000:
        assert lines == whole
    if told := re.search(r"(\d+) columns \((\d+) shown\)", " ".join(lines[-3:])):
        total, left = map(int, told.groups())
        assert total == max(len(row) for row in (answer.columns, *answer.rows)) > left
        assert width < 6 or "…" in lines[0]


@pytest.mark.parametrize(
    ("width", "count"), [(400, 31), (368, 31), (120, 10), (80, 6), (20, 1), (13, 1)]
)
def test_columns_are_left_out_in_the_middle(width, count):
    """As many as there is room for, from both sides; the note counts them."""
    head, types, rule, first, *rest = fitted_table(display_table(WIDE)).lines(width)
    names = head.split()
    assert set(types.split()) <= {"double", "…"}
    assert rule == "─" * len(rule)
    assert len(rule) <= width
    if count == 31:
        assert (names, len(rest)) == (list(WIDE[0]), 3)
        return
    assert len(names) == count + 1
    left = names.index("…")
    assert names[:left] == list(WIDE[0])[:left] or left == 1
    assert 0 <= left - (count - left) <= 1
    assert first.split()[left] == "…"
    assert f"31 columns ({count} shown)" in " ".join(rest[3:])


def test_numbers_are_not_cut_before_texts():
    rows = [{"number": 123456.5, "text": "t" * 50, "other": 654321.25}]
    *_, line = fitted_table(display_table(rows)).lines(50)
    assert re.fullmatch(r"123456\.?5?   t+…   +654321", line.replace("654321.25", "654321"))
    assert cell_len(line) <= 50


def test_texts_are_folded_at_spaces():
    lines = fitted_table(
        display_table([{"a": "one two three four five six", "b": "x" * 25}])
    ).lines(50)
    assert lines[3:] == ["one two three four       xxxxxxxxxxxxxxxxxxxxxxxxx", "five six"]


@pytest.mark.parametrize(
    ("text", "width", "expected"),
    [
        ("abc", 3, "abc"),
        ("abcd", 3, "ab…"),
        ("abcd", 1, "…"),
        ("机器人", 6, "机器人"),
        ("机器人", 5, "机器…"),
        ("机器人", 4, "机…"),
        ("", 1, ""),
    ],
)
def test_elided(text, width, expected):
    assert elided(text, width) == expected


def test_rows_beyond_are_counted_with_the_columns():
    rows = [dict.fromkeys(range(40), n) for n in range(30)]
    text = rich.console.Console(file=io.StringIO(), width=60)
    text.print(TableView(rows))
    lines = text.file.getvalue().splitlines()
    assert lines[-1].startswith("30 rows (20 shown), 40 columns (")
    assert set(lines[13].split()) == {"·", "…"}
    assert [line.split()[0] for line in lines[3:13]] == [str(n) for n in range(10)]
    assert [line.split()[0] for line in lines[14:-1]] == [str(n) for n in range(20, 30)]
    assert len(repr(TableView(rows)).splitlines()[0].split()) == 40  # no terminal: whole


@pytest.mark.parametrize(
    ("rows", "shown"),
    [(0, "·"), (1, "0 ·"), (2, "0 · 4"), (3, "0 1 · 4"), (4, "0 1 · 3 4"), (5, "0 1 2 3 4")],
)
def test_the_first_and_the_last_rows_are_shown(rows, shown):
    """Also of lists of plain values, and in HTML."""
    note = [f"5 rows ({rows} shown)"] if rows < 5 else []
    for value in ([{"n": n} for n in range(5)], [[n] for n in range(5)], list(range(5))):
        view = TableView(value, rows)
        lines = repr(view).splitlines()[2 if isinstance(value[0], dict) else 0 :]
        if not rows and isinstance(value[0], list):
            assert lines[-1:] == note  # there are no columns to mark
            continue
        assert lines == [*shown.split(), *note]
        cells = re.findall("<td>(.*?)</td>", view._repr_html_())
        assert cells == shown.split()
        assert ("".join(note) in view._repr_html_()) or not note


def test_a_column_of_the_other_side_takes_room_that_is_left():
    rows = [{"a": "x" * 9, "b": "y" * 9, "c": "z" * 9, "d": "w" * 80, "e": 10**40}]
    head = fitted_table(display_table(rows)).lines(75)[0].split()
    assert head == ["a", "b", "…", "e"]


TYPES = [
    ([{"a": 1}, {"a": None}], "bigint"),
    ([{"a": 1}, {"a": 0.5}], "double"),
    ([{"a": True}], "boolean"),
    ([{"a": "x"}], "varchar"),
    ([{"a": [[1], [0.5]]}], "double[][]"),
    ([{"a": []}], "list"),
    ([{"a": {"b": 1}}], "struct"),
    ([{"a": 1}, {"a": "x"}], ""),
    ([{"a": None}], ""),
]


@pytest.mark.parametrize(("value", "type"), TYPES)
def test_types_of_values(value, type):
    assert list(display_table(value).types) == [type]


@pytest.mark.slow
def test_shown_on_a_terminal_fits(monkeypatch):
    """`print(ss.sql(…))` and `ss.show(…)`; the types of columns that SQL gives are told."""
    with ssduck.load("chaos", recording=None) as ss:
        result = ss.sql("SELECT * FROM entities LIMIT 3")
        whole = str(result).splitlines()
        monkeypatch.setenv("FORCE_COLOR", "1")
        monkeypatch.setenv("COLUMNS", "70")
        lines = str(result).splitlines()
        shown = repr(ss.show("SELECT id, position, velocity, pose FROM chaos;", 2)).splitlines()
    assert len(whole[0].split()) == len(result.columns) == len(result.types)
    assert max(map(len, lines)) <= 70
    assert lines[1].split()[:3] == ["bigint", "double", "bigint"]
    assert re.fullmatch(rf"3 rows, {len(result.columns)} columns \(\d+ shown\)", lines[-1])
    assert max(map(len, shown)) <= 70
    assert repr(result).startswith(f"<Result: 3 rows of {len(result.columns)} columns: tick, ")
    assert len(repr(result)) < 150


def test_types_are_called_as_duckdb_calls_them():
    asked = {
        "1": "integer", "1::BIGINT": "bigint", "1::UTINYINT": "utinyint", "1.5": "decimal(2,1)",
        "1.5::DOUBLE": "double", "1::HUGEINT": "hugeint", "'a'": "varchar", "true": "boolean",
        "[1]": "integer[]", "{'a': 1}": "struct", "MAP {'a': 1}": "map", "'a'::BLOB": "blob",
        "DATE '2020-01-01'": "date", "TIME '12:00'": "time", "INTERVAL 1 DAY": "interval",
        "TIMESTAMP '2020-01-01'": "timestamp", "'a'::ENUM ('a')": "varchar",
    }  # fmt: skip
    with ssduck.Interpreter() as ss:
        result = ss.sql(f"SELECT {', '.join(asked)}")
    assert result.types == list(asked.values())


def test_a_notebook_scrolls_a_wide_table():
    page = TableView(WIDE)._repr_html_()
    assert page.startswith('<div style="overflow-x: auto"><table>')
    assert page.count("<th>") == 31


def test_long_lists_of_words_are_folded_before_columns_are_left_out():
    columns = ["world", "episode", "started", "ticks", "from", "to", "tables"]
    tables = "contacts entities joints links sensings shapes"
    row = ["kitchen", 0, "2026-11-23T07:00:42+00:00", 13, 0.0, 0.05, tables]
    lines = fitted_table(DisplayTable(columns, [row])).lines(80)
    assert max(map(len, lines)) <= 80
    assert lines[0].split() == columns
    assert [line.split()[-1] for line in lines[2:]] == tables.split()
    assert "…" not in "".join(lines)
