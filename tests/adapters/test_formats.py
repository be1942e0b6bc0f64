"""The formats of results: files by their suffix, result forms, and the command line's output."""

import csv
import io
import json
import math

import duckdb
import pandas as pd
import pyarrow.parquet as pq
import pytest

import ssduck
from ssduck.adapters.formats import FORMATS, save, text_of
from ssduck.errors import ArgumentError, UnknownNameError
from ssduck.logic.why import Why

SQL = "SELECT name, z, [x, y] AS place FROM entities ORDER BY id"
PROGRAM = "SELECT id, z, position FROM chaos"


@pytest.fixture(scope="module")
def chaos():
    with ssduck.load("chaos", recording=None) as ss:
        yield ss


def plain_rows(ss):
    """The rows of `SQL`, from the world's own entities."""
    return [[e.name, e.position[2], e.position[:2]] for e in ss.call_variable("chaos")]


def test_a_result_is_saved_by_its_suffix(chaos, tmp_path):
    result, expected = chaos.sql(SQL), plain_rows(chaos)
    for suffix in (".csv", ".json", ".parquet", ".md", ".txt", ".markdown", ".CSV"):
        path = tmp_path / f"result{suffix}"
        path.write_text("old")
        assert result.save(path) == path
        assert result.save(str(path)) == path
    (head, *rows) = list(csv.reader((tmp_path / "result.csv").read_text().splitlines()))
    assert head == ["name", "z", "place"]
    assert [[n, float(z), json.loads(p)] for n, z, p in rows] == expected
    written = json.loads((tmp_path / "result.json").read_text())
    assert [list(row.values()) for row in written] == expected
    assert pq.read_table(tmp_path / "result.parquet").to_pylist() == written
    assert duckdb.read_parquet(str(tmp_path / "result.parquet")).fetchall() == [
        tuple(row) for row in expected
    ]
    lines = (tmp_path / "result.md").read_text().splitlines()
    assert lines[:2] == ["| name | z | place |", "| --- | ---: | --- |"]
    assert len(lines) == len(expected) + 2
    assert len((tmp_path / "result.txt").read_text().splitlines()) == len(expected) + 2
    assert sorted(p.suffix for p in tmp_path.iterdir()) == sorted(
        (".csv", ".json", ".parquet", ".md", ".txt", ".markdown", ".CSV")
    )
    assert len(result.fetchall()) == len(expected)  # saving leaves the rows to be fetched


def test_what_cannot_be_saved_is_told(chaos, tmp_path):
    result = chaos.sql(SQL)
    with pytest.raises(UnknownNameError, match=r"'\.xls' is of no format; known are \.txt, \.csv"):
        result.save(tmp_path / "a.xls")
    with pytest.raises(UnknownNameError, match=r"did you mean '\.parquet'"):
        result.save(tmp_path / "a.parqet")
    with pytest.raises(ArgumentError, match="No such file"):
        result.save(tmp_path / "no" / "a.csv")
    with pytest.raises(ArgumentError, match="Parquet needs named columns"):
        save([[1, 2]], tmp_path / "a.parquet")
    with pytest.raises(ArgumentError, match="'a' holds a number"):
        save([{"a": 1}, {"a": "x"}], tmp_path / "a.parquet")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("value", "rows"),
    [
        ([1, 2], [{"value": 1}, {"value": 2}]),
        (0.5, [{"value": 0.5}]),
        ({"a": 1}, [{"key": "a", "value": 1}]),
        ([], []),
        (None, []),
        ([{"a": 1}, {"b": None}], [{"a": 1, "b": None}, {"a": None, "b": None}]),
    ],
)
def test_values_as_parquet(tmp_path, value, rows):
    path = save(value, tmp_path / "a.parquet")
    assert pq.read_table(path).to_pylist() == rows


MARKDOWN = [
    ([{"a|b": "x|y", "n": 1 / 3}], "| a\\|b | n |\n| --- | ---: |\n| x\\|y | 0.333333 |\n"),
    (["<b>&", "roomba_625x", "_it_ *b* `c` ~d~"], "| value |\n| --- |\n| &lt;b>&amp; |\n"
     "| roomba_625x |\n| \\_it\\_ \\*b\\* \\`c\\` \\~d\\~ |\n"),
    (["[a](b)", [0, 1], "two\nlines", "\\"], "| value |\n| --- |\n| \\[a](b) |\n| [0, 1] |\n"
     "| two\\\\nlines |\n| \\\\ |\n"),
    ([[1, 2], [3]], "|  |  |\n| ---: | ---: |\n| 1 | 2 |\n| 3 |  |\n"),
    ([], "| value |\n| --- |\n"),
]  # fmt: skip


@pytest.mark.parametrize(("value", "text"), MARKDOWN)
def test_markdown(value, text):
    assert text_of(value, FORMATS["markdown"]) == text


def test_why_is_a_tree_for_people_and_rows_for_programs():
    part = Why("z > 1", False, -0.5, 2.0, points=((0.0, 0.0, 0.5), (0.0, 0.0, 1.0)))
    why = Why("historically(z > 1)", False, -0.5, parts=(part,))
    tree = "✗ historically(z > 1)  (margin -0.5)\n  ✗ z > 1  (margin -0.5; at 2 s)"
    assert text_of(why, FORMATS["table"]) == f"{tree}\n"
    assert json.loads(text_of(why, FORMATS["json"])) == why.rows()
    head, *rows = csv.reader(io.StringIO(text_of(why, FORMATS["csv"])))
    assert [dict(zip(head, row, strict=True))["margin"] for row in rows] == ["-0.5", "-0.5"]


def test_forms_of_the_same_names(chaos):
    """AS csv and AS markdown; AS json and AS parquet have tests of their own."""
    rows = list(csv.reader(io.StringIO(chaos.eval(f"{PROGRAM} AS csv;"))))
    assert rows[0] == ["id", "z", "position"]
    expected = [[e.name, e.position[2], e.position] for e in chaos.call_variable("chaos")]
    assert [[n, float(z), json.loads(p)] for n, z, p in rows[1:]] == expected
    lines = chaos.eval(f"{PROGRAM} AS markdown;").splitlines()
    assert lines[0] == "| id | z | position |"
    assert len(lines) == len(expected) + 2
    assert chaos.eval(f"{PROGRAM} WHERE FALSE AS csv;") == "id,z,position\n"
    with pytest.raises(ArgumentError, match="two columns have the name 'id'"):
        chaos.eval("SELECT id, to(z, 'id') FROM chaos AS csv;")


def test_infinities_in_csv_are_numbers_for_readers(chaos, tmp_path):
    """An infinity is no missing number: nothing is infinitely far from everything."""
    path = tmp_path / "distances.csv"
    chaos.sql("SELECT * FROM (VALUES ('inf'::DOUBLE), ('-inf'), ('nan'), (NULL)) t(d)").save(path)
    read = pd.read_csv(path, skip_blank_lines=False).d
    assert read.tolist()[:2] == [math.inf, -math.inf]
    assert read[2:].isna().all()
    text = text_of([{"box": [-math.inf, 1.0, math.inf]}], FORMATS["csv"])
    assert text == 'box\n"[""-Infinity"", 1.0, ""Infinity""]"\n'


def test_show_prints(chaos, capsys, monkeypatch):
    result = chaos.sql(SQL)
    count = len(result)
    result.show()
    assert capsys.readouterr().out == f"{result}\n"
    result.show(rows=2, width=20)
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= 20
    assert f"{count} rows (2" in " ".join(lines)
    result.show(rows=count)
    assert len(capsys.readouterr().out.splitlines()) == count + 2
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("COLUMNS", "30")
    result.show()
    assert max(map(len, capsys.readouterr().out.splitlines())) <= 30
