"""`ssduck query`: answers, the source of the program, errors."""

import contextlib
import csv
import io
import json
import re
import sys
import warnings

import anyio
import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from mcp import Client, StdioServerParameters
from PIL import Image

import ssduck
from ssduck.adapters.tabular import tabulated
from ssduck.interpreter import opening
from tests.support.cases import sampled
from tests.support.command_line import NO_ROWS, WRITTEN, answer, fails, ssduck_, write_scene


@pytest.fixture(scope="module")
def loaded(tmp_path_factory):
    """The scene, loaded once for the many tests that only look at how an answer is written."""
    with ssduck.load(write_scene(tmp_path_factory.mktemp("scene")) / "two.toml") as ss:
        yield ss


# -- query: answers ------------------------------------------------------------------------------


@pytest.mark.parametrize(("arguments", "format", "expected"), WRITTEN)
def test_answers(here, loaded, monkeypatch, arguments, format, expected):
    monkeypatch.setattr(opening, "load", lambda *_, **__: contextlib.nullcontext(loaded))
    *flags, program = arguments
    written = answer("query", "two.toml", "-F", format, *flags, "--", program)
    assert (json.loads(written) if format == "json" else written) == expected


@pytest.mark.slow
def test_a_row_of_json_is_a_line(here):
    assert answer("query", "two.toml", "SELECT id FROM two;", "-F", "json") == (
        '[\n{"id": "big"},\n{"id": "small"}\n]\n'
    )


@pytest.mark.parametrize("form", ["df", "polars", "arrow", "numpy"])
def test_a_frame_is_its_rows(here, loaded, monkeypatch, form):
    monkeypatch.setattr(opening, "load", lambda *_, **__: contextlib.nullcontext(loaded))
    program = f"SELECT two.id AS id, two.position AS position, n.this AS n FROM two, n={[*range(60)]} ORDER BY id, n AS {{}};"
    arguments = ["query", "two.toml", program.format(form)]
    rows = loaded.eval(program.replace(" AS {}", ""))
    assert json.loads(answer(*arguments, "-F", "json")) == rows
    written = list(csv.DictReader(io.StringIO(answer(*arguments, "-F", "csv"))))
    assert [(row["id"], int(row["n"])) for row in written] == [(r["id"], r["n"]) for r in rows]
    answer(*arguments, "-o", "o.parquet")
    assert pq.read_table("o.parquet").to_pylist() == rows


WIDE = pd.DataFrame({"z": [1, 2]})


@pytest.mark.parametrize(
    "value",
    [
        WIDE["z"],
        WIDE.index,
        pd.Timestamp(0),
        pd.DataFrame([[1, 2]], columns=["a", "a"]),
        pd.DataFrame({"a": [2**70]}),
        pd.DataFrame({"a": [1, "a"]}),
        pa.chunked_array([[1, 2]]),
        np.array([(1j,)], [("a", complex)]),
    ],
    ids=lambda value: type(value).__name__,
)
def test_what_is_no_table_is_shown_as_it_is(value):
    assert tabulated(value) is value


def test_a_named_index_is_a_column():
    frame = WIDE.set_index(pd.Index(["a", "b"], name="k"))
    assert tabulated(frame).fetchall() == [("a", 1), ("b", 2)]
    assert tabulated(frame.reset_index(drop=True)).fetchall() == [(1,), (2,)]
    assert tabulated(WIDE[:0]).columns == ["z"]


def test_an_array_is_its_rows(here, loaded, monkeypatch):
    monkeypatch.setattr(opening, "load", lambda *_, **__: contextlib.nullcontext(loaded))
    program = f"SELECT two.z, n.this FROM two, n={[*range(2000)]} AS numpy;"
    written = list(csv.reader(io.StringIO(answer("query", "two.toml", "-F", "csv", program))))
    assert [[*map(float, row)] for row in written] == loaded.eval(program).tolist()


@pytest.mark.slow
@sampled("format", ["table", "json", "csv"], every=3)
def test_many_rows(here, format):
    sql = "SELECT i, i / 2 AS half, [i, i] AS pair FROM range(20000) r(i)"
    written = answer("query", "two.toml", "--sql", sql, "-F", format)
    if format == "json":
        rows = json.loads(written)
        assert (len(rows), rows[-1]) == (20000, {"i": 19999, "half": 9999.5, "pair": [19999] * 2})
    elif format == "csv":
        rows = list(csv.reader(io.StringIO(written)))
        assert (len(rows), rows[-1]) == (20001, ["19999", "9999.5", "[19999, 19999]"])
    else:
        lines = written.splitlines()
        assert (len(lines), lines[-1]) == (20002, "19999  9999.5  [19999, 19999]")


@pytest.mark.slow
def test_a_table_is_folded_on_a_terminal_and_whole_elsewhere(here):
    sql = f"SELECT '{'long ' * 60}' AS text, name FROM entities"
    assert max(map(len, answer("query", "two.toml", "--sql", sql).splitlines())) > 300
    terminal = {"FORCE_COLOR": "1", "COLUMNS": "40", "TERM": "xterm"}
    folded = re.sub(r"\x1b\[[\d;]*m", "", answer("query", "two.toml", "--sql", sql, env=terminal))
    assert max(map(len, folded.splitlines())) <= 40
    assert folded.count("long") == 120
    assert "small" in folded


# -- query: where the program comes from ---------------------------------------------------------


SOURCES = [
    (["1 + 1;"], None),
    (["-"], "1 + 1;"),
    ([], "1 + 1;"),
    (["-f", "-"], "1 + 1;"),
    (["-f", "plain.ss"], None),
    (["--file", "mark.ss"], None),
    (["--", "-1 + 3;"], None),
    ([], "\ufeff1\r\n+ 1;\r\n"),
]


@sampled(("arguments", "input"), SOURCES, every=3)
def test_sources_of_the_program(here, arguments, input):
    (here / "plain.ss").write_text("1 +\n\t1;\n")
    (here / "mark.ss").write_text("1 + 1;", encoding="utf-8-sig")
    assert answer("query", "two.toml", *arguments, input=input) == "2\n"


TIMES = [
    ([], 0),
    (["--steps", "0"], 0),
    (["--steps", "24"], 0.24),
    (["--seconds", "0.5"], 0.5),
    (["--seconds", "0.126"], 0.13),
    (["--seconds", "0.004"], 0),
]


@pytest.mark.parametrize(("arguments", "expected"), TIMES)
def test_simulated_time(here, arguments, expected):
    written = answer("query", "two.toml", "getTime();", "-F", "json", *arguments)
    assert json.loads(written) == pytest.approx(expected)


BALL = """<mujoco><option timestep="0.01"/><worldbody><body name="ball" pos="0 0 9"><freejoint/>
<geom size="0.1"/></body></worldbody></mujoco>"""


@pytest.fixture(params=["model", "scene"])
def model(request, here):
    """A model whose step is 0.01 s, by itself and in a scene."""
    pytest.importorskip("mujoco")
    (here / "drop.xml").write_text(BALL)
    (here / "dropped.toml").write_text('simulator = "mujoco"\n[[body]]\nmjcf = "drop.xml"\n')
    return "drop.xml" if request.param == "model" else "dropped.toml"


@pytest.mark.slow
def test_seconds_are_in_steps_of_the_model(model):
    """Of each command, by the clock of the simulator, not by 1/240 s."""
    written = answer("query", model, "getTime();", "-F", "json", "--seconds", "0.5")
    assert json.loads(written) == pytest.approx(0.5)
    told = answer("record", model, "--seconds", "0.2", "-o", "run")
    assert told.startswith("21 ticks of ")
    assert ssduck.episodes("run")[0].end == pytest.approx(0.2)


@pytest.mark.slow
def test_agents_get_seconds_in_steps_of_the_model(model):
    parameters = StdioServerParameters(
        command=sys.executable, args=["-m", "ssduck", "mcp", model, "--seconds", "0.5"]
    )

    async def ask():
        async with Client(parameters) as client:
            return await client.call_tool("query", {"program": "getTime();"})

    assert json.loads(anyio.run(ask).content[0].text) == pytest.approx(0.5)


@pytest.mark.slow
def test_what_a_program_prints_is_not_its_answer(here):
    result = ssduck_("query", "two.toml", "print(1, 'a'); 2;", "-F", "json")
    assert (result.exit_code, result.stdout, result.stderr) == (0, "2\n", "1 a\n")


# -- errors --------------------------------------------------------------------------------------


MARKED = """\
error: there is no function 'abov'; did you mean 'above'?
  line 2, column 10
    \t[0] == [abov(two, two)]; '[red]not markup[/red]'
    \t        ^^^^
"""

LONG = "SELECT id FROM two WHERE " + "isRobot(this) OR " * 30 + "z(that) > 1;"

# (arguments, exit code, what standard error says)
ERRORS = [
    (["query", "two.toml", "1 +;"], 1, "expected an expression, found ';'"),
    (["query", "two.toml", "1 / 0;"], 1, "division by zero"),
    (["query", "two.toml", "sqrt(1, 2, 3);"], 1, "sqrt takes 1 argument, not 3"),
    (["query", "two.toml", "SELECT id FROM two AS lst;"], 1, "did you mean 'list'?"),
    (["query", "two.toml", "id(tow);"], 1, "did you mean 'two'"),
    (
        ["query", "two.toml", LONG],
        1,
        f"    …{LONG[LONG.index('that') - 60 :]}\n    {' ' * 61}^^^^\n",
    ),
    (["query", "two.toml", "--sql", "SELCT 1"], 1, 'syntax error at or near "SELCT"'),
    (["query", "two.toml", "--sql", "FROM entitis"], 1, "entitis"),
    (["query", "kitchn", "1;"], 1, "did you mean 'kitchen'?"),
    (["query", "bad.toml", "1;"], 1, "bad.toml: nam: there is no such key; did you mean 'name'?"),
    (["query", "task.toml", "1;"], 1, "scene: this is the file of a task, no scene: its scene is"),
    (["render", "task.toml", "-o", "a.png"], 1, "'push.xml'; ssduck.gym.make_task makes its"),
    (["check", "task.toml"], 1, "scenes and models are opened by ssduck.load, not as records"),
    (["query", "two.toml", "-f", "nofile.ss"], 1, "nofile.ss cannot be read: No such file"),
    (["query", "two.toml", "-f", "."], 1, "cannot be read: Is a directory"),
    (["query", "two.toml", "-f", "latin.ss"], 1, "latin.ss is not UTF-8: byte 1 is 0xfc"),
    (["query", "two.toml", "'\udcff';"], 1, "the program is not UTF-8: byte 1 is 0xff"),
    (["functions", "abov"], 1, "there is no function 'abov'; did you mean 'above'?"),
    (["demo", "nowhere.toml"], 1, "there is no scene 'nowhere.toml'"),
    (["demo", "two.toml", "-o", "no/such/folder.png"], 1, "cannot be written: No such file"),
    (["demo", "two.toml", "-o", "picture.nope"], 1, "picture.nope cannot be written: unknown file"),
    (["demo", "two.toml", "-o", "a.png", "--no-picture"], 2, "exclude each other"),
    (["query", "two.toml"], 2, "the program is empty"),
    (["query", "two.toml", " \n"], 2, "the program is empty"),
    (["query", "two.toml", "1;", "-f", "latin.ss"], 2, "given twice"),
    (["query", "two.toml", "1;", "--steps", "1", "--seconds", "1"], 2, "exclude each other"),
    (["query", "two.toml", "1;", "--seconds", "inf"], 1, "--seconds: inf s are more than"),
    (["query", "two.toml", "1;", "--seconds", "1e308"], 1, "--seconds: 1e+308 s are more than"),
    (["query", "two.toml", "1;", "--format", "xml"], 2, "xml"),
    (["query", "two.toml", "1;", "--nope"], 2, "--nope"),
    (["query", "two.toml", "-1;"], 2, "-1"),
    (["query"], 2, "SCENE"),
    (["nope"], 2, "nope"),
]


@sampled(
    ("arguments", "code", "told"), ERRORS, every=3, ids=[" ".join(a)[:60] for a, _, _ in ERRORS]
)
def test_errors(here, arguments, code, told):
    (here / "latin.ss").write_bytes("'ü';".encode("latin-1"))
    (here / "bad.toml").write_text('nam = "x"')
    (here / "task.toml").write_text('scene = "push.xml"\nsuccess = "z(sim.ball) > 1"')
    result = fails(arguments, code, told)
    assert result.stdout == "" or arguments[0] == "demo"


@pytest.mark.slow
def test_the_mark_stands_under_what_it_marks(here):
    program = "two;\n\t[0] == [abov(two, two)]; '[red]not markup[/red]'"
    for env in ({}, {"FORCE_COLOR": "1", "COLUMNS": "30", "TERM": "xterm"}):
        result = ssduck_("query", "two.toml", program, env=env)
        assert re.sub(r"\x1b\[[\d;]*m", "", result.stderr) == MARKED


def test_a_mistake_of_ours_is_a_traceback(here, monkeypatch):
    monkeypatch.setattr(opening, "load", lambda *_, **__: 1 // 0)
    with pytest.raises(ZeroDivisionError):
        ssduck_("query", "two.toml", "1;")


@pytest.mark.slow
@pytest.mark.filterwarnings("default")
def test_each_warning_is_written_once(here, monkeypatch):
    load = opening.load

    def warn(scene, **options):
        for text in ("a [shape] is odd", "another", "a [shape] is odd"):
            warnings.warn(text, stacklevel=2)
        return load(scene, **options)

    monkeypatch.setattr(opening, "load", warn)
    result = ssduck_("query", "two.toml", "1;")
    assert (result.exit_code, result.stdout) == (0, "1\n")
    assert result.stderr == "warning: a [shape] is odd\nwarning: another\n"


PROBABLE_MISTAKE = """\
no entity of two has the name 'bigg'; did you mean 'big'?
  line 1, column 29
    SELECT id FROM two WHERE id='bigg';
                                ^^^^^^
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("flags", "filter", "code", "prefix"),
    [
        ([], "default", 0, "warning: "),
        ([], "error", 1, "error: "),
        (["--strict"], "default", 1, "error: "),
    ],
)
def test_a_warning_underlines_its_place(here, flags, filter, code, prefix):
    """Also as an error, as `python -W error` makes it: no traceback."""
    with warnings.catch_warnings():
        warnings.simplefilter(filter)
        result = ssduck_("query", "two.toml", "SELECT id FROM two WHERE id='bigg';", *flags)
    assert (result.exit_code, result.stderr) == (code, prefix + PROBABLE_MISTAKE)


# -- query: formats and files ---------------------------------------------------------------------


MANY = ["--sql", "SELECT i, -i AS j FROM range(100) r(i)"]


@pytest.mark.slow
def test_many_rows_are_elided_on_a_terminal_only(here):
    terminal = {"FORCE_COLOR": "1", "COLUMNS": "80", "TERM": "xterm"}
    written = answer("query", "two.toml", *MANY, env=terminal)
    lines = re.sub(r"\x1b\[[\d;]*m", "", written).splitlines()
    assert lines[-1] == "100 rows (40 shown)"
    assert [line.split()[0] for line in lines[3:-1]] == [*map(str, range(20)), "·"] + [
        *map(str, range(80, 100))
    ]
    assert answer("query", "two.toml", *MANY, "--rows", "100", env=terminal).count("\n") == 103
    assert answer("query", "two.toml", *MANY).count("\n") == 102
    assert answer("query", "two.toml", *MANY, "--rows", "3").splitlines()[2:] == [
        " 0    0",
        " 1   -1",
        " ·    ·",
        "99  -99",
        "100 rows (3 shown)",
    ]
    for format in ("csv", "json", "markdown"):
        assert "·" not in answer("query", "two.toml", *MANY, "-F", format, env=terminal)


@pytest.mark.slow
@pytest.mark.parametrize("flags", [["-F", "csv", "-o", "a"], ["-o", "a.csv"]])
def test_a_result_goes_to_a_file(here, flags):
    assert answer("query", "two.toml", *MANY, *flags) == ""
    rows = list(csv.reader((here / flags[-1]).read_text().splitlines()))
    assert rows == [["i", "j"], *([str(i), str(-i)] for i in range(100))]
    assert sorted(path.name for path in here.iterdir()) == sorted(
        [flags[-1], "box.urdf", "two.toml"]
    )


WRONG_FORMATS = [
    (["-F", "parquet"], 2, "name a file, as in -o result.parquet"),
    (["-F", "csv", "--rows", "3"], 2, "--rows is for tables on standard output"),
    (["-o", "a.txt", "--rows", "3"], 2, "--rows is for tables on standard output"),
    (["--rows", "-1"], 2, "--rows"),
    (["-o", "a.xls"], 1, "a.xls: the suffix '.xls' is of no format"),
    (["-o", "no/a.csv"], 1, "no/a.csv: No such file"),
]


@pytest.mark.parametrize(("flags", "code", "told"), WRONG_FORMATS)
def test_wrong_formats(here, flags, code, told):
    result = ssduck_("query", "two.toml", "[1, 2];", *flags)
    assert (result.exit_code, result.stdout) == (code, "")
    assert told in result.stderr


def test_a_table_of_markdown_without_rows_has_its_columns(here):
    written = answer("query", "two.toml", NO_ROWS, "-F", "markdown")
    assert written == "| id | top |\n| --- | --- |\n"


def test_a_file_without_rows_has_its_columns(here):
    answer("query", "two.toml", NO_ROWS, "-o", "none.parquet")
    assert pq.read_table("none.parquet").column_names == ["id", "top"]
    assert pq.read_table("none.parquet").num_rows == 0


@pytest.mark.slow
def test_a_plan_of_duckdb_is_readable(here):
    plan = answer("query", "two.toml", "--sql", "EXPLAIN SELECT id FROM entities")
    first, *_, last = plan.splitlines()
    assert (first[0], last[0]) == ("╭", "╰")
    assert "│ Projections: id" in plan
    rows = answer("query", "two.toml", "--sql", "EXPLAIN SELECT 1", "-F", "csv")
    assert rows.startswith("explain_key,explain_value\n")


PICTURES = ["occupancygrid(0.5, 0.1)", "voxelgrid(0.5)", "points(0.2)", "mesh", "graph", "image"]


@pytest.mark.slow
@sampled("form", PICTURES, every=2)
def test_a_picture_goes_to_a_file(here, form):
    program = f"SELECT {'touching(a.this, b.this)' if form == 'graph' else 'a.obj'} FROM a=two"
    program += ", b=two" if form == "graph" else ""
    answer("query", "two.toml", f"{program} AS {form};", "-o", "picture.png")
    with Image.open("picture.png") as picture:
        assert picture.format == "PNG"
        assert len(picture.convert("RGB").getcolors(2**24)) > 1


def test_a_table_is_no_picture(here):
    result = ssduck_("query", "two.toml", "SELECT id FROM two;", "-o", "picture.png")
    assert (result.exit_code, result.stdout) == (1, "")
    assert "this is no picture; AS image, mesh, points, graph" in result.stderr
    assert not (here / "picture.png").exists()


@pytest.mark.slow
def test_strict_queries_are_confined(here):
    (here / "other.csv").write_text("a\n7\n")
    text = "FROM read_csv('other.csv')"
    assert "7" in ssduck_("query", "two.toml", "--sql", text).stdout
    refused = ssduck_("query", "two.toml", "--strict", "--sql", text)
    assert (refused.exit_code, refused.stdout) == (1, "")
    assert "other.csv" in refused.stderr
