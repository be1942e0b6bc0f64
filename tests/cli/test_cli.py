"""The command `ssduck`: what it writes where, and how it ends."""

from __future__ import annotations

import contextlib
import csv
import io
import json
import os
import re
import shlex
import signal
import subprocess
import sys
import time
import warnings
from importlib import metadata
from pathlib import Path

import pytest
import typer
from PIL import Image
from typer.testing import CliRunner

import ssduck
from ssduck.cli.app import app
from ssduck.demos.kitchen import KITCHEN
from ssduck.interpreter import opening
from tests.support.cases import sampled
from tests.support.timing import HANGS

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "reference" / "command-line.md").read_text(encoding="utf-8")
LINUX = pytest.mark.skipif(sys.platform != "linux", reason="signals and devices of Linux")

BOX = """\
<robot name="box"><link name="base">
  <inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
  <collision><geometry><box size="1 1 1"/></geometry></collision>
</link></robot>
"""
SCENE = """\
name = "two"
timestep = 0.01
[[body]]
name = "big"
urdf = "box.urdf"
fixed = true
[[body]]
name = "small"
urdf = "box.urdf"
position = [0.25, -0.0, 2.0]
"""


def write_scene(folder):
    """A scene of two boxes; quick to load."""
    (folder / "box.urdf").write_text(BOX)
    (folder / "two.toml").write_text(SCENE)
    return folder


@pytest.fixture
def here(tmp_path, monkeypatch):
    """The current folder, with a scene in it."""
    monkeypatch.chdir(tmp_path)
    return write_scene(tmp_path)


@pytest.fixture(scope="module")
def loaded(tmp_path_factory):
    """The scene, loaded once for the many tests that only look at how an answer is written."""
    with ssduck.load(write_scene(tmp_path_factory.mktemp("scene")) / "two.toml") as ss:
        yield ss


def ssduck_(*arguments, input=None, env=None):
    """Run the command in this process."""
    result = CliRunner().invoke(app, arguments, input=input, env=env, prog_name="ssduck")
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result


def answer(*arguments, **others):
    """What a command writes that succeeds; it writes nothing to standard error."""
    result = ssduck_(*arguments, **others)
    assert (result.exit_code, result.stderr) == (0, "")
    return result.stdout


def environment():
    """That of the process, without colours; the package is found if it is not installed."""
    names = ("PYTHONPATH", "FORCE_COLOR", "NO_COLOR", "COLUMNS")
    env = {name: value for name, value in os.environ.items() if name not in names}
    try:
        metadata.distribution("ssduck")
    except metadata.PackageNotFoundError:
        env["PYTHONPATH"] = str(ROOT)
    return env


def start(*arguments, module=("-m", "ssduck"), **others):
    """Start the command in a process of its own."""
    return subprocess.Popen(
        [sys.executable, *module, *arguments],
        stdin=subprocess.PIPE,
        stdout=others.pop("stdout", subprocess.PIPE),
        stderr=subprocess.PIPE,
        env=environment() | others.pop("env", {}),
        text=True,
        **others,
    )


def run(*arguments, **others):
    """Run it: its exit code, what it wrote, and what it complained of."""
    process = start(*arguments, **others)
    out, err = process.communicate(timeout=HANGS)
    return process.returncode, out, err


# -- query: answers -----------------------------------------------------------------------

# A question whose answer has more columns than a terminal has room for.
WIDE = (
    "SELECT id, x, y, z, mass, "
    + ", ".join(f"to(z * {n}, 'z{n}')" for n in range(35))
    + " FROM two;"
)

# (program, as a table, as JSON, as CSV)
ANSWERS = [
    ("1+2*3-4/5.;", "6.2\n", 6.2, "value\n6.2\n"),
    ("2 > 1;", "True\n", True, "value\ntrue\n"),
    ("0.1 + 0.2;", "0.3\n", 0.1 + 0.2, "value\n0.30000000000000004\n"),
    ("1234567.25;", "1234567.25\n", 1234567.25, "value\n1234567.25\n"),
    ("-0.0;", "0\n", 0.0, "value\n-0.0\n"),
    ("1e400;", "inf\n", None, 'value\n""\n'),
    (";", "", None, "value\n"),
    ("// nothing but a comment", "", None, "value\n"),
    ("x = 'kept'; x;", "kept\n", "kept", "value\nkept\n"),
    ("'[red]ü, \"😀\" :smile:';", '[red]ü, "😀" :smile:\n', '[red]ü, "😀" :smile:', None),
    ("'two\nlines';", "two\nlines\n", "two\nlines", 'value\n"two\nlines"\n'),
    ("two;", "two\n", "two", "value\ntwo\n"),
    ("[];", "(no rows)\n", [], "value\n"),
    ("[1, 'a', [2.5, True]];", "1\na\n[2.5, True]\n", [1, "a", [2.5, True]], None),
    ("[[1, 2], [3]];", "1  2\n3\n", [[1, 2], [3]], "1,2\n3\n"),
    (
        "SELECT id, z, isRobot FROM two;",
        "id     z  isRobot\n-----  -  -------\nbig    0  False\nsmall  2  False\n",
        [{"id": "big", "z": 0, "isRobot": False}, {"id": "small", "z": 2, "isRobot": False}],
        "id,z,isRobot\nbig,0.0,false\nsmall,2.0,false\n",
    ),
    (
        "SELECT obj, position FROM two WHERE id(this) == 'small' AS list;",
        "small\n[0.25, 0, 2]\n",
        ["small", [0.25, 0, 2]],
        'value\nsmall\n"[0.25, 0.0, 2.0]"\n',
    ),
    (
        "SELECT position FROM two AS list;",
        "   0  0  0\n0.25  0  2\n",
        [[0, 0, 0], [0.25, 0, 2]],
        "0.0,0.0,0.0\n0.25,0.0,2.0\n",
    ),
    (
        "SELECT to(z, id(this)) FROM two;",
        " big  small\n----  -----\n   0   NULL\nNULL      2\n",
        [{"big": 0}, {"small": 2}],
        "big,small\n0.0,\n,2.0\n",
    ),
    ("SELECT obj FROM two WHERE z(this) > 100;", "(no rows)\n", [], "value\n"),
]

# The same for SQL.
SQL_ANSWERS = [
    (
        "SELECT a.name, b.name, above(a, b) AS up FROM entities a, entities b WHERE a.id < b.id",
        "name  name_2  up\n----  ------  ----\nbig   small   True\n",
        [{"name": "big", "name_2": "small", "up": True}],
        "name,name_2,up\nbig,small,true\n",
    ),
    (
        "SELECT 'nan'::DOUBLE AS a, '-inf'::DOUBLE AS b, NULL AS c, 1.50::DECIMAL(5, 2) AS d",
        "  a     b     c    d\n---  ----  ----  ---\nnan  -inf  NULL  1.5\n",
        [{"a": None, "b": None, "c": None, "d": 1.5}],
        "a,b,c,d\n,,,1.5\n",
    ),
    (
        "SELECT DATE '2020-01-31' AS day, {'k': [1, NULL]} AS s, 'x'::BLOB AS b, 2::HUGEINT ** 0 n",
        None,
        [{"day": "2020-01-31", "s": {"k": [1, None]}, "b": "78", "n": 1}],
        'day,s,b,n\n2020-01-31,"{""k"": [1, null]}",78,1.0\n',
    ),
    (
        "SELECT 'a' || chr(10) || chr(27) || '[31m' AS odd",
        "odd\n-----------\na\\n\\x1b[31m\n",
        [{"odd": "a\n\x1b[31m"}],
        'odd\n"a\n\x1b[31m"\n',
    ),
    ("FROM entities SELECT name WHERE FALSE", "name\n----\n(no rows)\n", [], "name\n"),
    ("-- nothing but a comment", "", [], ""),
]

WRITTEN = [
    pytest.param([*flags, program], format, expected, id=f"{format} {program[:60]}")
    for flags, cases in (((), ANSWERS), (("--sql",), SQL_ANSWERS))
    for program, table, plain, values in cases
    for format, expected in (("table", table), ("json", plain), ("csv", values))
    if format == "json" or expected is not None
]


@pytest.mark.parametrize(("arguments", "format", "expected"), WRITTEN)
def test_answers(here, loaded, monkeypatch, arguments, format, expected):
    monkeypatch.setattr(opening, "load", lambda _: contextlib.nullcontext(loaded))
    *flags, program = arguments
    written = answer("query", "two.toml", "-F", format, *flags, "--", program)
    assert (json.loads(written) if format == "json" else written) == expected


def test_a_row_of_json_is_a_line(here):
    assert answer("query", "two.toml", "SELECT id FROM two;", "-F", "json") == (
        '[\n{"id": "big"},\n{"id": "small"}\n]\n'
    )


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


def test_a_table_is_folded_on_a_terminal_and_whole_elsewhere(here):
    sql = f"SELECT '{'long ' * 60}' AS text, name FROM entities"
    assert max(map(len, answer("query", "two.toml", "--sql", sql).splitlines())) > 300
    terminal = {"FORCE_COLOR": "1", "COLUMNS": "40", "TERM": "xterm"}
    folded = re.sub(r"\x1b\[[\d;]*m", "", answer("query", "two.toml", "--sql", sql, env=terminal))
    assert max(map(len, folded.splitlines())) <= 40
    assert folded.count("long") == 120
    assert "small" in folded


@sampled("width", [20, 80, 120], every=3)
@pytest.mark.parametrize("question", [["--sql", "SELECT * FROM entities"], [WIDE]])
def test_columns_that_do_not_fit_are_marked_and_counted(here, width, question):
    """Whatever is left out is told of on the terminal; elsewhere nothing is."""
    terminal = {"FORCE_COLOR": "1", "COLUMNS": str(width), "TERM": "xterm"}
    told = re.sub(r"\x1b\[[\d;]*m", "", answer("query", "two.toml", *question, env=terminal))
    lines = told.splitlines()
    assert max(map(len, lines)) <= width
    names = lines[0].split()
    assert "…" in names
    total, shown = map(int, re.search(r"(\d+) columns \((\d+) shown\)", lines[-1]).groups())
    whole = answer("query", "two.toml", *question).splitlines()
    assert (total, shown) == (len(whole[0].split()), len(names) - 1)
    assert "rows" in " ".join(lines[-2:])
    assert "…" not in "".join(whole)


# -- query: where the program comes from --------------------------------------------------

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


@pytest.mark.parametrize(("arguments", "input"), SOURCES)
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


def test_what_a_program_prints_is_not_its_answer(here):
    result = ssduck_("query", "two.toml", "print(1, 'a'); 2;", "-F", "json")
    assert (result.exit_code, result.stdout, result.stderr) == (0, "2\n", "1 a\n")


# -- errors -------------------------------------------------------------------------------

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
    (["query", "two.toml", "id(tow);"], 1, "did you mean 'to' or 'two'"),
    (
        ["query", "two.toml", LONG],
        1,
        f"    …{LONG[LONG.index('that') - 60 :]}\n    {' ' * 61}^^^^\n",
    ),
    (["query", "two.toml", "--sql", "SELCT 1"], 1, 'syntax error at or near "SELCT"'),
    (["query", "two.toml", "--sql", "FROM entitis"], 1, "entitis"),
    (["query", "kitchn", "1;"], 1, "did you mean 'kitchen'?"),
    (["query", "bad.toml", "1;"], 1, "bad.toml: nam: there is no such key; did you mean 'name'?"),
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
    (["query", "two.toml", "1;", "--steps", "-1"], 2, "--steps"),
    (["query", "two.toml", "1;", "--steps", "1.5"], 2, "--steps"),
    (["query", "two.toml", "1;", "--seconds", "-0.1"], 2, "--seconds"),
    (["query", "two.toml", "1;", "--seconds", "nan"], 2, "--seconds"),
    (["query", "two.toml", "1;", "--seconds", "inf"], 2, "--seconds"),
    (["query", "two.toml", "1;", "--seconds", "1e308"], 2, "--seconds: that is too long"),
    (["query", "two.toml", "1;", "--format", "xml"], 2, "xml"),
    (["query", "two.toml", "1;", "--nope"], 2, "--nope"),
    (["query", "two.toml", "-1;"], 2, "-1"),
    (["query"], 2, "SCENE"),
    (["nope"], 2, "nope"),
]


@pytest.mark.parametrize(
    ("arguments", "code", "told"), ERRORS, ids=[" ".join(a)[:60] for a, _, _ in ERRORS]
)
def test_errors(here, arguments, code, told):
    (here / "latin.ss").write_bytes("'ü';".encode("latin-1"))
    (here / "bad.toml").write_text('nam = "x"')
    result = ssduck_(*arguments)
    assert result.exit_code == code
    assert told in result.stderr
    assert "Traceback" not in result.stderr
    assert result.stdout == "" or arguments[0] == "demo"
    assert result.stderr.startswith("error: ") == (code == 1)


def test_the_mark_stands_under_what_it_marks(here):
    program = "two;\n\t[0] == [abov(two, two)]; '[red]not markup[/red]'"
    for env in ({}, {"FORCE_COLOR": "1", "COLUMNS": "30", "TERM": "xterm"}):
        result = ssduck_("query", "two.toml", program, env=env)
        assert re.sub(r"\x1b\[[\d;]*m", "", result.stderr) == MARKED


def test_a_mistake_of_ours_is_a_traceback(here, monkeypatch):
    monkeypatch.setattr(opening, "load", lambda _: 1 // 0)
    with pytest.raises(ZeroDivisionError):
        ssduck_("query", "two.toml", "1;")


@pytest.mark.filterwarnings("default")
def test_warnings_are_one_line_each_and_told_once(here, monkeypatch):
    load = opening.load

    def warn(scene):
        for text in ("a [shape]\n  is odd", "another", "a [shape]\n  is odd"):
            warnings.warn(text, stacklevel=2)
        return load(scene)

    monkeypatch.setattr(opening, "load", warn)
    result = ssduck_("query", "two.toml", "1;")
    assert (result.exit_code, result.stdout) == (0, "1\n")
    assert result.stderr == "warning: a [shape] is odd\nwarning: another\n"


# -- the other commands -------------------------------------------------------------------


def test_scenes():
    written = answer("scenes")
    assert "kitchen" in written
    assert "four robots" in written


def test_functions():
    written = answer("functions")
    with ssduck.Interpreter() as ss:
        for name in ss.help():
            assert re.search(rf"^{name}\(.*\)( -> \w+)?  +[A-Z].*\.$", written, re.MULTILINE), name
        assert answer("functions", "distance") == ss.help("distance") + "\n"


def test_help():
    assert answer() == answer("--help") == answer("-h")
    group = typer.main.get_command(app)
    for name, command in group.commands.items():
        assert command.help
        assert name in answer("--help")
        shown = answer(name, "--help")
        for parameter in command.params:
            assert parameter.help, f"{name}: {parameter.name}"
            assert all(option in shown for option in parameter.opts if option.startswith("-"))


def test_version():
    assert re.fullmatch(r"ssduck (\d+(\.\d+)+\S*|\(not installed.*\))\n", answer("--version"))


# -- records ------------------------------------------------------------------------------


@sampled("output", ["run", "run.duckdb"], every=2)
def test_a_scene_is_recorded_and_asked(here, output):
    written = answer("record", "two.toml", "--seconds", "0.5", "-o", output)
    assert written == f"51 ticks of 'two', from 0 s to 0.5 s: episode 0 in {output}\n"
    few = ["--tables", "entities", "--entities", "small", "--every", "5"]
    written = answer("record", "two.toml", "--seconds", "0.1", "--output", output, *few)
    assert written == f"3 ticks of 'two', from 0 s to 0.1 s: episode 1 in {output}\n"
    for episode, ids in ((0, ["big", "small"]), (1, ["small"])):
        asked = ["query", output, "SELECT id FROM two{0.0} AS list;", "-F", "json"]
        assert json.loads(answer(*asked, "--episode", str(episode))) == ids
    assert json.loads(answer(*asked)) == ["small"]
    assert json.loads(answer("query", output, "getTime();", "-F", "json")) == pytest.approx(0.1)
    sql = "SELECT count(*) AS n FROM entities_history"
    assert answer("query", output, "--sql", sql, "--episode", "0", "-F", "csv") == "n\n102\n"
    lines = answer("episodes", output).splitlines()
    assert lines[0].split() == ["world", "episode", "started", "ticks", "from", "to", "tables"]
    every = "contacts entities joints links sensings shapes"
    assert re.fullmatch(rf"two +0  \S+ +51 +0  0.5  {every}", lines[2])
    assert re.fullmatch(r"two +1  \S+ +3 +0  0.1  entities", lines[3])


def test_a_record_is_exported(here):
    answer("record", "two.toml", "--seconds", "0.5", "-o", "run.duckdb")
    written = answer("export", "run.duckdb", "-o", "all")
    assert written == "two: all/ticks/world=two/episode=0\n"
    some = ["--entities", "big", "--start", "0.1", "--end", "0.2"]
    answer("export", "all", "--output", "some", "--world", "two", "--episode", "0", *some)
    (episode,) = ssduck.episodes("some")
    assert (episode.ticks, episode.start, episode.entities) == (11, 0.1, ("big",))
    assert ssduck.episodes("all")[0].ticks == 51


RECORD_ERRORS = [
    (["query", "nothing.duckdb", "1;"], 1, "there is no scene 'nothing.duckdb'"),
    (["query", "empty", "1;"], 1, "empty is no record of ssduck: it has no ssduck.json"),
    (["query", "run", "SELECT z FROM tow;"], 1, "did you mean 'to' or 'two'"),
    (["query", "run", "1;", "--steps", "5"], 2, "a record cannot be simulated further"),
    (["query", "run", "1;", "--episode", "3"], 1, "no episode 3 has ticks"),
    (["query", "two.toml", "1;", "--episode", "3"], 2, "two.toml is no record"),
    (["episodes", "nothing"], 1, "there is no record nothing: neither a folder nor a DuckDB file"),
    (["episodes", "two.toml"], 1, "two.toml cannot be opened"),
    (["export", "run", "-o", "empty/../run/ssduck.json"], 1, "File exists"),
    (["export", "run", "-o", "out", "--entities", "bigg"], 1, "did you mean 'big'?"),
    (["export", "run", "-o", "out", "--world", "too"], 1, "did you mean 'two'?"),
    (["export", "run", "-o", "out", "--start", "9"], 1, "no tick of 'two' of that time"),
    (["record", "two.toml", "-o", "out"], 2, "--seconds"),
    (["record", "two.toml", "--seconds", "1"], 2, "--output"),
    (["record", "two.toml", "--seconds", "inf", "-o", "out"], 2, "that is too long"),
    (["record", "two.toml", "--seconds", "1", "-o", "out", "--every", "0"], 2, "--every"),
    (["record", "two.toml", "--seconds", "1", "-o", "out", "--tables", "entitis"], 1, "'entities'"),
    (["record", "two.toml", "--seconds", "1", "-o", "out", "--entities", "bg"], 1, "'big'?"),
    (["record", "two.toml", "--seconds", "1", "-o", "."], 1, "has something else in it"),
    (["record", "two.toml", "--seconds", "1", "-o", "box.urdf"], 1, "box.urdf cannot be written"),
]


@sampled(
    ("arguments", "code", "told"),
    RECORD_ERRORS,
    every=5,
    ids=[" ".join(a)[:60] for a, _, _ in RECORD_ERRORS],
)
def test_errors_of_records(here, arguments, code, told):
    (here / "empty").mkdir()
    answer("record", "two.toml", "--seconds", "0.02", "-o", "run")
    result = ssduck_(*arguments)
    assert result.exit_code == code
    assert told in result.stderr
    assert "Traceback" not in result.stderr
    assert result.stdout == ""
    assert not Path("out").exists()


def test_a_folder_of_the_name_of_a_scene_is_not_taken_for_it(here):
    answer("record", "two.toml", "--seconds", "0.02", "-o", "kitchen")
    assert answer("query", "kitchen", "count(SELECT this FROM kitchen AS list);") == "37\n"
    assert answer("query", "./kitchen", "count(SELECT this FROM two AS list);") == "2\n"


def written(folder, output):
    """How many bytes there are of a record: a batch of ticks has more than 200,000."""
    files = [
        path for path in folder.rglob("*") if path.relative_to(folder).parts[0].startswith(output)
    ]
    return sum(path.stat().st_size for path in files if path.is_file())


@LINUX
@sampled("output", ["run", "run.duckdb"], every=2)
def test_an_interrupted_recording_is_whole(here, output):
    with start("record", "two.toml", "--seconds", "100000", "-o", output) as process:
        began = time.monotonic()
        while time.monotonic() < began + HANGS and written(here, output) < 200_000:
            time.sleep(0.05)
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=HANGS)
    assert (process.returncode, err) == (
        130,
        "interrupted: the record is complete up to then\n",
    )
    (episode,) = ssduck.episodes(output)
    assert out.startswith(f"{episode.ticks} ticks of 'two', from 0 s to {episode.end:g} s")
    assert episode.ticks > 10


def test_a_bar_on_a_terminal(here):
    terminal = {"FORCE_COLOR": "1", "COLUMNS": "60", "TERM": "xterm"}
    result = ssduck_("record", "two.toml", "--seconds", "0.2", "-o", "run", env=terminal)
    assert "Recording two" in result.stderr
    assert "Recording" not in result.stdout


# -- the demonstration --------------------------------------------------------------------

# What the tutorial prints, as far as it fits a line here.
TUTORIAL = [
    "answer   6.2",
    "fridge         [-0.87, -2, 1.55]    robot",
    "cooker         [1.98, 1.72, 0.75]   robot",
    "barrett_4918   [0.42, 1.3, 0.892]   robot",
    "roomba_625x    [1.8, 0, 0.17]       robot",
    "[0.000118749, 0.000118749, 0.000118749, 0.00015724, 0.00015724, 0.00015724, 0.00015724]",
    "chair_6b56   0.0307263",
    "chair_083c   0.0255963",
    "[plate_b4e7, [-1.13, 2.01, 1.14]]",
    "Usage: onX(o1, o2) -> bool",
    "[cup_905a, cup_58a2, cup_b6af, cup_d441]",
    "left to Python: onX(table, this)",
    "table       plate_fa76",
    "microwave   pin_c671",
]


@pytest.mark.slow
def test_demo_in_an_empty_folder(tmp_path):
    code, out, err = run("demo", cwd=tmp_path)
    assert (code, err) == (0, "")
    for shown in (*TUTORIAL, *(question.asks for question in KITCHEN)):
        assert shown in out
    assert re.search(rf"^{len(KITCHEN)} questions in \d+\.\d\d s$", out, re.MULTILINE)
    assert "kitchen.png" in out
    assert "\x1b" not in out
    assert not re.search(r" $", out, re.MULTILINE)
    assert max(map(len, out.splitlines())) <= 100
    assert [path.name for path in tmp_path.iterdir()] == ["kitchen.png"]
    with Image.open(tmp_path / "kitchen.png") as picture:
        assert (picture.format, picture.mode, picture.size) == ("PNG", "RGB", (960, 720))
        assert len(picture.getcolors(maxcolors=960 * 720)) > 500


def test_demo_of_another_scene(here):
    written = answer("demo", "two.toml", "--output", "picture.jpg")
    assert "big     small" in written
    with Image.open("picture.jpg") as picture:
        assert picture.format == "JPEG"


def test_demo_without_sql_and_picture(here):
    before = sorted(here.iterdir())
    written = answer("demo", "two.toml", "--no-sql", "--no-picture")
    assert "as SQL" not in written
    assert sorted(here.iterdir()) == before


COLOURS = [
    ({}, False),
    ({"FORCE_COLOR": "1"}, True),
    ({"FORCE_COLOR": "1", "NO_COLOR": "1"}, False),
]


@pytest.mark.parametrize(("env", "coloured"), COLOURS)
def test_colours(here, env, coloured):
    env = {"NO_COLOR": None, "FORCE_COLOR": None, "TERM": "xterm", **env}
    written = answer("demo", "two.toml", "--no-picture", env=env)
    assert bool(re.search(r"\x1b\[3\d", written)) == coloured


# -- as a process -------------------------------------------------------------------------


@pytest.mark.slow
def test_the_kitchen_as_json(tmp_path):
    program = "SELECT id, position FROM kitchen WHERE isRobot(this);"
    code, out, err = run("query", "kitchen", program, "--format", "json", cwd=tmp_path)
    assert (code, err) == (0, "")
    assert [row["id"] for row in json.loads(out)] == [
        "fridge",
        "cooker",
        "barrett_4918",
        "roomba_625x",
    ]
    assert json.loads(out)[2]["position"] == pytest.approx([0.42, 1.3, 0.892])


@pytest.mark.slow
def test_an_error_is_no_traceback(here):
    code, out, err = run("query", "two.toml", "SELECT abov FROM two;")
    assert (code, out) == (1, "")
    assert err.startswith("error: ")
    assert "Traceback" not in err


@pytest.mark.slow
def test_integers_of_any_length_and_a_locale_that_has_no_umlauts(here):
    env = {"PYTHONIOENCODING": "ascii"}
    program = "[2 ^ 20000, 'ü😀'];"
    assert run("query", "two.toml", program, env=env) == (0, f"{_digits()}\n\\xfc\\U0001f600\n", "")
    code, out, err = run("query", "two.toml", "'ü😀';", "-F", "json", env=env)
    assert (code, json.loads(out), err) == (0, "ü😀", "")


def _digits():
    """2 to the power of 20000; Python prints that many digits only if it is asked to."""
    limit = sys.get_int_max_str_digits()
    sys.set_int_max_str_digits(0)
    try:
        return str(2**20000)
    finally:
        sys.set_int_max_str_digits(limit)


@pytest.mark.slow
def test_a_reader_that_goes_away(here):
    sql = "SELECT i FROM range(100000) r(i)"
    with start("query", "two.toml", "--sql", sql, "-F", "csv") as process:
        assert process.stdout.readline() == "i\n"
        process.stdout.close()
        assert process.stderr.read() == ""
    assert process.returncode == 1


@LINUX
@sampled("arguments", [["query", "two.toml", "1;"], ["--help"]], every=2)
def test_a_full_disk(here, arguments):
    with Path("/dev/full").open("w") as full:
        code, _, err = run(*arguments, stdout=full)
    assert (code, err) == (1, "error: [Errno 28] No space left on device\n")


SLOW = [
    ["query", "two.toml", "1;", "--steps", "1000000000"],
    ["query", "two.toml", "--sql", "SELECT count(*) FROM range(10000000) a, range(10000000) b"],
]


@LINUX
@sampled("arguments", SLOW, every=2)
def test_interrupted(here, arguments):
    main = "import ssduck.cli.app; print('begun', flush=True); ssduck.cli.app.main()"
    with start(*arguments, module=("-c", main)) as process:
        assert process.stdout.readline() == "begun\n"
        time.sleep(1.0)
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=HANGS)
    assert (process.returncode, out, err) == (130, "", "")


def test_help_waits_for_neither_simulator_nor_database(tmp_path):
    code = """
import sys
from ssduck.cli.app import main
sys.argv = ["ssduck", "--help"]
try:
    main()
finally:
    print(*[name for name in ("pybullet", "duckdb", "numpy", "scipy") if name in sys.modules])
"""
    returned, out, err = run(module=("-c", code), cwd=tmp_path)
    assert (returned, err) == (0, "")
    assert out.splitlines()[-1] == ""


# -- the manual ---------------------------------------------------------------------------

EXAMPLES = [
    tuple(example.split("\n", 1))
    for block in re.findall(r"^```console\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)
    for example in re.split(r"^\$ ", block, flags=re.MULTILINE)[1:]
]


@pytest.mark.parametrize(("line", "shown"), EXAMPLES, ids=[line for line, _ in EXAMPLES])
def test_examples_of_the_manual(tmp_path, monkeypatch, line, shown):
    monkeypatch.chdir(tmp_path)
    words = shlex.split(line)
    piped = words[1] if words[0] == "echo" else None
    result = ssduck_(*words[words.index("ssduck") + 1 :], input=piped)
    assert result.stdout + result.stderr == shown


def test_the_manual_names_every_command_and_option():
    assert len(EXAMPLES) >= 6
    for name, command in typer.main.get_command(app).commands.items():
        assert f"`ssduck {name}" in PAGE
        for parameter in command.params:
            options = [*parameter.opts, *parameter.secondary_opts]
            named = [o for o in options if o.startswith("--") and f"`{o}" in PAGE]
            named += [o for o in options if o.startswith("--") and f", `{o}" in PAGE]
            assert named or not options[0].startswith("-"), f"{name}: {options}"
