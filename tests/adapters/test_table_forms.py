"""Rows as tables: AS table, arrow, df, polars, numpy, json, records, parquet; `Interpreter.show`."""

import json
import math
from decimal import Decimal

import numpy as np
import pandas as pd
import polars as pl
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st

import ssduck
from ssduck.adapters.columns import array_of
from ssduck.adapters.result import Result, TableView
from ssduck.errors import ArgumentError, LimitError
from tests.support.cases import sampled

ROBOTS = "SELECT id, position, z, isRobot, obj FROM kitchen WHERE isRobot(this) AS"
NAMES = ["fridge", "cooker", "barrett_4918", "roomba_625x"]
POSITIONS = [[-0.87, -2, 1.55], [1.98, 1.72, 0.75], [0.42, 1.3, 0.892], [1.8, 0, 0.17]]
COLUMNS = ["id", "position", "z", "isRobot", "obj"]
PLAIN = ssduck.Interpreter()  # for many examples
TABLES = ["table", "arrow", "df", "polars"]


@pytest.fixture
def values():
    """Evaluates a query of the rows of a variable."""
    with ssduck.Interpreter() as ss:

        def evaluated(query, rows):
            ss.add_variable("rows", rows)
            return ss.eval(query)

        yield evaluated


def as_arrow(value):
    """Any of the tables as Arrow's."""
    if isinstance(value, pd.DataFrame):
        return pa.Table.from_pandas(value, preserve_index=False)
    if isinstance(value, pa.Table):
        return value
    return value.arrow() if isinstance(value, Result) else value.to_arrow()


@pytest.mark.parametrize(
    ("form", "kind"),
    [
        ("table", Result),
        ("arrow", pa.Table),
        ("df", pd.DataFrame),
        ("pandas", pd.DataFrame),
        ("polars", pl.DataFrame),
        ("pl", pl.DataFrame),
    ],
)
def test_tables_of_the_kitchens_robots(kitchen, form, kind):
    found = kitchen.eval(f"{ROBOTS} {form};")
    assert type(found) is kind
    table = as_arrow(found)
    assert table.column_names == COLUMNS
    columns = table.to_pydict()
    assert columns["id"] == columns["obj"] == NAMES
    assert np.allclose(columns["position"], POSITIONS)
    assert columns["isRobot"] == [True] * 4
    assert pa.types.is_list(table.schema.field("position").type) or pa.types.is_large_list(
        table.schema.field("position").type
    )


@pytest.mark.parametrize("form", [*TABLES, "numpy"])
def test_tables_are_sources(kitchen, form):
    nested = f"SELECT to(r.this.z, 'z'), to(r.this.id, 'id') FROM r=({ROBOTS} {form}) WHERE r.this.z > 1;"
    assert kitchen.eval(nested) == [{"z": 1.55, "id": "fridge"}]
    kitchen.eval(f"robots = {ROBOTS} {form};")
    assert kitchen.eval("SELECT id FROM robots ORDER BY z AS list;") == [
        "roomba_625x",
        "cooker",
        "barrett_4918",
        "fridge",
    ]


@pytest.mark.parametrize("form", TABLES)
def test_empty_results_keep_the_columns(kitchen, form):
    table = as_arrow(kitchen.eval(f"SELECT id, position FROM kitchen WHERE False AS {form};"))
    assert table.column_names == ["id", "position"]
    assert table.num_rows == 0
    nested = f"(SELECT id FROM kitchen WHERE False AS {form})"
    assert kitchen.eval(f"SELECT id FROM {nested};") == []


def test_empty_results_elsewhere(kitchen):
    none = "SELECT id, z FROM kitchen WHERE False AS"
    assert kitchen.eval(f"{none} numpy;").shape == (0, 2)
    assert kitchen.eval(f"{none} json;") == "[]"
    assert kitchen.eval(f"{none} records;") == []


# Values, and the type of Arrow's that a column of them has.
INTEGERS = [2**63 - 1, -(2**63)]
TYPES = [
    ([True, None, False], pa.bool_()),
    (INTEGERS, pa.int64()),
    ([2**63, -(10**38) + 1], pa.decimal128(38, 0)),
    ([1, 2.5, None], pa.float64()),
    ([2**53, 0.5], pa.float64()),
    ([math.inf, -0.0], pa.float64()),
    (["a", None, ""], pa.string()),
    ([None, None], pa.null()),
    ([], pa.null()),
    ([[1.0, 2.0], [], None], pa.list_(pa.float64())),
    ([(1, 2), [3]], pa.list_(pa.int64())),
    ([[[1], [2.5]], [[]]], pa.list_(pa.list_(pa.float64()))),
    ([[], []], pa.list_(pa.null())),
    ([{"a": 1, "b": "x"}, {"a": 2}], pa.struct([("a", pa.int64()), ("b", pa.string())])),
    ([b"raw"], pa.binary()),
    ([np.float64(0.5), np.int64(3)], pa.float64()),
    ([np.array([1.0, 2.0])], pa.list_(pa.float64())),
]


@pytest.mark.parametrize(("column", "kind"), TYPES)
def test_types_of_columns(column, kind):
    assert array_of("n", column).type == kind


MIXED = [
    (["a", 1], "'n' holds a text \\('a'\\) and a number \\(1\\)"),
    ([True, 1], "'n' holds True or False"),
    ([[1], 1], "'n' holds a list"),
    ([["a", 1]], "'n' holds a text"),
    ([2**53 + 1, 0.5], "'n' holds fractions and 9007199254740993"),
    ([10**38], "an integer of more than 38 digits"),
    ([object()], "holds values that no table can hold: object"),
    ([{1: 2}], "must be a text, not 1"),
    ([{"a": 1}, {"a": "x"}], "'n.a' holds a number"),
]


@pytest.mark.parametrize(("column", "message"), MIXED)
def test_what_is_no_column(column, message):
    with pytest.raises(ArgumentError, match=message):
        array_of("n", column)


def test_a_mixed_column_is_told_with_the_place(kitchen):
    program = "SELECT n FROM [1, 'a'] AS table;"
    with ssduck.Interpreter() as ss:
        ss.add_function("n", lambda value: value)
        with pytest.raises(
            ArgumentError, match="AS table: the column 'n' holds a number"
        ) as caught:
            ss.eval(program)
    span = caught.value.span
    assert program[span.start : span.end] == "table"


@pytest.mark.parametrize("form", [*TABLES, "json"])
def test_columns_of_one_name(kitchen, form):
    with pytest.raises(ArgumentError, match="two columns have the name 'id'"):
        kitchen.eval(f"SELECT id(a.this), id(b.this) FROM a=kitchen, b=kitchen AS {form};")
    with pytest.raises(ArgumentError, match="two columns have the name 'fridge'"):
        kitchen.eval(
            f"SELECT to(z, 'fridge'), to(x, id) FROM kitchen WHERE id(this) == 'fridge' AS {form};"
        )


@pytest.mark.slow
@sampled("form", TABLES, every=2)
@given(
    st.lists(
        st.tuples(
            st.none() | st.integers(-(2**120), 2**120),
            st.floats(allow_nan=False),
            st.none() | st.text(st.characters(codec="utf-8", exclude_characters="\0")),
            st.none() | st.booleans(),
            st.lists(st.floats(allow_nan=False)),
        ),
        min_size=1,
        max_size=5,
    )
)
def test_values_come_back_from_tables(form, rows):
    """What is known; pandas has no word of its own for a missing number or text."""
    selected = [dict(zip("ifsbl", row, strict=True)) for row in rows]
    PLAIN.add_variable("rows", selected)
    PLAIN.add_variable("frame", PLAIN.eval(f"SELECT i, f, s, b, l FROM rows AS {form};"))
    assert PLAIN.eval("SELECT i, f, s, b, l FROM frame;") == selected


def test_pandas_keeps_integers_and_truths_among_which_some_are_missing(values):
    rows = [{"i": 2**60 + 1, "b": True}, {"i": None, "b": None}]
    frame = values("SELECT i, b FROM rows AS df;", rows)
    assert frame["i"][0] == 2**60 + 1
    assert frame["b"][0] is np.True_ or frame["b"][0] is True
    assert frame["i"].isna().tolist() == frame["b"].isna().tolist() == [False, True]


# -- numpy, json, records ----------------------------------------------------------------------

ARRAYS = [
    ("SELECT position FROM kitchen", (37, 3), np.float64),
    ("SELECT x, y, z FROM kitchen", (37, 3), np.float64),
    ("SELECT position, z FROM kitchen", (37, 4), np.float64),
    ("SELECT isRobot, isSensor FROM kitchen", (37, 2), np.bool_),
    ("SELECT count(position) FROM kitchen", (37, 1), np.int64),
    ("SELECT x(a.this), x(b.this) FROM a=kitchen, b=kitchen", (37 * 37, 2), np.float64),
]


@pytest.mark.parametrize(("query", "shape", "kind"), ARRAYS)
def test_arrays_of_numbers(kitchen, query, shape, kind):
    found = kitchen.eval(f"{query} AS numpy;")
    assert (found.shape, found.dtype) == (shape, kind)
    flat = kitchen.eval(f"{query} AS list;")
    expected = [n for value in flat for n in (value if isinstance(value, list) else [value])]
    assert found.ravel().tolist() == expected


def test_a_missing_number_is_nan(values):
    found = values("SELECT n FROM rows AS numpy;", [{"n": 1}, {"n": None}])
    assert found.dtype == float
    assert np.isnan(found[1, 0])


def test_structured_arrays(kitchen):
    found = kitchen.eval(f"{ROBOTS} numpy;")
    assert found.dtype.names == tuple(COLUMNS)
    assert found["position"].shape == (4, 3)
    assert found["id"].tolist() == NAMES
    assert found["isRobot"].dtype == bool
    mixed = [{"n": 2**70, "s": None, "l": [1]}, {"n": 1, "s": "a", "l": [1, 2]}]
    with ssduck.Interpreter() as ss:
        ss.add_variable("rows", mixed)
        array = ss.eval("SELECT n, s, l FROM rows AS numpy;")
    assert [array[name].dtype for name in "nsl"] == [object] * 3
    assert array.tolist() == [(2**70, None, [1]), (1, "a", [1, 2])]


def test_numbers_that_floats_are_not_stay_exact(values):
    rows = [{"n": 2**53, "f": 0.5}]
    assert values("SELECT n, f FROM rows AS numpy;", rows).tolist() == [[2**53, 0.5]]
    rows = [{"n": 2**53 + 1, "f": 0.5}]
    assert values("SELECT n, f FROM rows AS numpy;", rows).tolist() == [(2**53 + 1, 0.5)]
    assert values("SELECT n, n FROM rows AS numpy;", rows).tolist() == [[2**53 + 1] * 2]
    found = values("SELECT n FROM rows AS numpy;", [{"n": 2**53 + 1}, {"n": 0.5}])
    assert found["n"].tolist() == [2**53 + 1, 0.5]


def test_decimals_keep_their_digits(values):
    rows = [{"n": Decimal("1.5")}, {"n": Decimal(2)}]
    assert values("SELECT n FROM rows AS polars;", rows)["n"].to_list() == [1.5, 2]


def test_json_takes_a_number_of_spaces(kitchen):
    few = "SELECT id FROM kitchen WHERE id(this) == 'table' AS json"
    assert kitchen.eval(f"{few}(2);") == '[\n  {\n    "id": "table"\n  }\n]'
    for indent in ("'x'", "2.5", "-1", "True", "100000"):
        with pytest.raises(ArgumentError, match="indent is a whole number from 0 to 80"):
            kitchen.eval(f"{few}({indent});")


def test_json_is_a_text(kitchen):
    text = kitchen.eval(f"{ROBOTS} json;")
    rows = json.loads(text)
    assert [row["obj"] for row in rows] == NAMES
    assert np.allclose([row["position"] for row in rows], POSITIONS)
    assert list(rows[0]) == COLUMNS
    assert json.loads(kitchen.eval(f"{ROBOTS} json(indent=2);")) == rows


def test_json_of_odd_values(values):
    row = {"big": 2**100, "none": None, "inf": math.inf, "text": 'ä"\n', "flag": True}
    text = values("SELECT big, none, inf, text, flag FROM rows AS json;", [row])
    assert "Infinity" not in text
    assert json.loads(text) == [{**row, "inf": None}]


def test_records_are_named_tuples(kitchen):
    first = kitchen.eval(f"{ROBOTS} records;")[0]
    assert (first.id, first.z, first.obj) == (
        "fridge",
        1.55,
        kitchen.call_variable("kitchen")["fridge"],
    )
    assert kitchen.eval("SELECT z(this), to(1, 'two words') FROM [] AS records;") == []
    pairs = kitchen.eval(
        "SELECT id(a.this), id(b.this) FROM a=kitchen, b=kitchen LIMIT 1 AS records;"
    )
    assert pairs == [("fridge_webcam", "fridge_webcam")]
    assert pairs[0]._fields == ("id", "_1")


# -- groups, paths, files ----------------------------------------------------------------------


@pytest.mark.parametrize("form", ["numpy", "records", "list"])
def test_a_value_a_group(kitchen, form):
    groups = kitchen.eval(f"SELECT id FROM kitchen GROUP BY type AS {form};")
    assert {key: len(table) for key, table in groups.items()} == {
        "sensor": 8,
        "robot": 4,
        "kinbody": 25,
    }


OTHERS = ("numpy", "json", "records", "graph", "graph(multi=True)", "dot")


@pytest.mark.slow
def test_a_trigger_is_told_of_other_rows_and_graphs_only():
    """Of what stays where it is: nodes of graphs tell their positions."""
    with ssduck.load("kitchen") as ss:
        seen = {form: [] for form in (*TABLES, *OTHERS)}
        for form, results in seen.items():
            program = f"SELECT obj, isEnabled FROM kitchen WHERE id(this) == 'kitchen' AS {form};"
            ss.add_trigger(form, program, 0.1, results.append)
        world = ss.call_variable("kitchen")
        world.step(96)
        assert {form: len(results) for form, results in seen.items()} == dict.fromkeys(seen, 1)
        world["kitchen"].enabled = False
        world.step(48)
        assert {form: len(results) for form, results in seen.items()} == dict.fromkeys(seen, 2)


def test_a_table_a_path(kitchen):
    paths = kitchen.eval(
        "SELECT n FROM [0] START WITH n = 0 CONNECT BY n = n + 1 STOP WITH n == 3 AS arrow;"
    )
    assert [path.to_pydict() for path in paths] == [{"n": [0, 1, 2, 3]}]


def test_parquet_files(kitchen, tmp_path):
    file = tmp_path / "robots.parquet"
    for _ in range(2):  # the second takes the place of the first
        assert kitchen.eval(f"{ROBOTS} parquet('{file}');") == str(file)
    assert pq.read_table(file).equals(kitchen.eval(f"{ROBOTS} arrow;"))
    assert [path.name for path in tmp_path.iterdir()] == ["robots.parquet"]
    assert kitchen.sql(f"SELECT count(*) FROM '{file}'").fetchall() == [(4,)]


def test_parquet_that_cannot_be_written(kitchen, tmp_path):
    kept = tmp_path / "kept.parquet"
    kept.write_text("kept")
    for program, error, message in [
        (
            f"SELECT id FROM kitchen GROUP BY type AS parquet('{kept}');",
            ArgumentError,
            "each group",
        ),
        (f"SELECT id FROM kitchen AS parquet('{tmp_path}/no/x');", ArgumentError, "No such file"),
        (f"SELECT id FROM kitchen AS parquet('{tmp_path}');", ArgumentError, "directory"),
        ("SELECT id FROM kitchen AS parquet('');", ArgumentError, "a path in quotes"),
        ("SELECT id FROM kitchen AS parquet('/');", ArgumentError, "a path in quotes"),
        ("SELECT id FROM kitchen AS parquet(3);", ArgumentError, "a path in quotes"),
        (f"SELECT to([obj, 1], 'x') FROM kitchen AS parquet('{kept}');", ArgumentError, "holds"),
    ]:
        with pytest.raises(error, match=message):
            kitchen.eval(program)
    assert kept.read_text() == "kept"
    assert list(tmp_path.iterdir()) == [kept]


def test_files_that_limits_forbid(tmp_path):
    file = tmp_path / "x.parquet"
    calls = []
    program = f"SELECT seen(this) FROM [1] AS parquet('{file}');"
    with ssduck.Interpreter(limits=ssduck.Limits(files=False)) as ss:
        ss.add_function("seen", calls.append)
        with pytest.raises(LimitError, match="AS parquet: files are switched off") as caught:
            ss.eval(program)
        span = caught.value.span
        assert program[span.start : span.end] == f"parquet('{file}')"
        with pytest.raises(LimitError):
            ss.eval(f"SELECT this FROM (SELECT this FROM [1] AS parquet('{file}'));")
        assert ss.eval("SELECT to(this, 'n') FROM [1] AS arrow;").num_rows == 1
    assert calls == []
    assert not file.exists()


# -- shown -------------------------------------------------------------------------------------


def test_shown_in_a_terminal(kitchen):
    assert repr(kitchen.show("SELECT id, z FROM kitchen;", 2)).splitlines() == [
        "id                 z",
        "-------------  -----",
        "fridge_webcam  1.499",
        "·                  ·",
        "shaker          0.98",
        "37 rows (2 shown)",
    ]
    assert repr(kitchen.show("SELECT id, z FROM kitchen WHERE isRobot(this);")).count("\n") == 5
    assert str(kitchen.eval(f"{ROBOTS} table;")).startswith("id            position ")


SHOWN = [
    (3, "3"),
    ([], "(no rows)"),
    (["a", "b"], "a\nb"),
    ([[1, 2], [3]], "1  2\n3"),
    ({"a": 1}, "key  value\n---  -----\na        1"),
    (None, "(no rows)"),
]


@pytest.mark.parametrize(("value", "text"), SHOWN)
def test_shown_values(value, text):
    assert repr(TableView(value)) == text


def test_shown_in_a_notebook():
    page = TableView([{"<b>": f"<i>{n}"} for n in range(143)])._repr_html_()
    assert "<th>&lt;b&gt;<br><small>varchar</small></th>" in page
    assert "<td>&lt;i&gt;9</td>" in page
    assert "<td>·</td>" in page
    assert "<td>&lt;i&gt;142</td>" in page
    assert "&lt;i&gt;10<" not in page
    assert page.endswith("<p>143 rows (20 shown), 1 column</p>")
    assert "shown" not in TableView([{"n": n} for n in range(20)])._repr_html_()


def test_showing_a_result_leaves_its_rows_to_be_fetched(kitchen):
    result = kitchen.eval(f"{ROBOTS} table;")
    result.fetchone()
    str(result)
    assert len(result.fetchall()) == 3


@pytest.mark.parametrize("form", TABLES)
@pytest.mark.parametrize("row_by_row", [False, True])
def test_groups_are_one_frame(form, row_by_row):
    """As GROUP BY of SQL and of pandas gives it; a plain list has a part for each group."""
    numbers = "FROM [1, 2, 3, 4, 5] GROUP BY this % 2"
    with ssduck.Interpreter(row_by_row=row_by_row) as ss:
        for select, expected in [
            ("this % 2 AS odd, count(*) AS n, max(this) AS most", [(1, 3, 5), (0, 2, 4)]),
            ("this % 2 AS odd, this AS number", [(1, 1), (1, 3), (1, 5), (0, 2), (0, 4)]),
        ]:
            frame = ss.eval(f"SELECT {select} {numbers} AS {form};")
            names = [part.rpartition(" ")[2] for part in select.split(", ")]
            assert contents(frame) == (names, expected)
            empty = ss.eval(f"SELECT {select} {numbers} HAVING count(*) > 9 AS {form};")
            assert contents(empty) == (names, [])
        assert ss.eval(f"SELECT this {numbers} AS list;") == {"1": [1, 3, 5], "0": [2, 4]}


def contents(frame):
    """Returns the names of the columns of a table of any kind, and its rows."""
    if isinstance(frame, pd.DataFrame):
        return list(frame.columns), list(frame.itertuples(index=False, name=None))
    if isinstance(frame, pl.DataFrame):
        return frame.columns, frame.rows()
    result = Result(frame) if isinstance(frame, pa.Table) else frame
    return result.columns, result.fetchall()
