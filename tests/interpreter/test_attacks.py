"""Programs of strangers that try to take time, memory, files or Python's objects."""

import gc
import time
from pathlib import Path

import pytest

import ssduck
from ssduck.errors import (
    ArgumentError,
    EvaluationError,
    LimitError,
    ParseError,
    SelectScriptError,
    UnknownNameError,
)
from tests.support.cases import sampled
from tests.support.timing import HANGS

MEMORY = 50_000_000
# What a program may take beside what is counted, bytes.
SPARE = 150_000_000
STATUS, RESET = Path("/proc/self/status"), Path("/proc/self/clear_refs")


def _strict(seconds):
    limits = ssduck.Limits.strict(seconds=seconds, memory=MEMORY, progress=False, require=())
    with ssduck.load("kitchen", limits=limits) as ss:
        ss.call_variable("kitchen").step(10)
        ss.add_variable("n", list(range(100)))
        ss.add_variable("m", list(range(100_000)))
        ss.add_variable("text", "a" * 100_000)
        ss.add_variable("numbers", [0] * 100_000)
        yield ss


@pytest.fixture(autouse=True)
def pythons_collections():
    """Garbage is collected as often as it is for users: until then it counts as memory."""
    threshold = gc.get_threshold()
    gc.set_threshold(700, 10, 10)
    yield
    gc.set_threshold(*threshold)


@pytest.fixture(scope="module")
def patient():
    """One whose time does not run out before the other limits, however busy the machine is."""
    yield from _strict(HANGS)


@pytest.fixture(scope="module")
def hasty():
    yield from _strict(0.2)


def fails(ss, program, kind, words):
    """The program ends in time, takes no more memory than it may, and the session goes on."""
    if RESET.exists():
        RESET.write_text("5")
    before, started = _memory("VmRSS"), time.process_time()
    with pytest.raises(kind, match=words) as caught:
        ss.eval(program)
    assert type(caught.value) is kind
    caught = None
    assert time.process_time() - started < HANGS
    assert _memory("VmHWM") - before < MEMORY + SPARE
    assert ss.eval("SELECT id(this) FROM kitchen WHERE isRobot(this) LIMIT 1 AS list;") == [
        "fridge"
    ]


def _memory(name):
    if not STATUS.exists():
        return 0
    (line,) = [line for line in STATUS.read_text().splitlines() if line.startswith(name)]
    return int(line.split()[1]) * 1024


TOO_LARGE, TOO_MUCH = "too large", "values of more than 50,000,000 bytes"
DEEP = "nested deeper than 60 levels"
DUCKDB = "more memory than available|values of more than"


def _repeated(start, step, times):
    return f"{start} {step * times} 1;"


def _many(count, text, between=","):
    return between.join(text.format(number) for number in range(count))


LARGE_VALUES = [
    # Texts, lists and numbers that grow.
    (_repeated("x = 'a';", "x = x + x;", 60), EvaluationError, TOO_LARGE),
    (_repeated("x = [1];", "x = [x, x];", 60), EvaluationError, TOO_LARGE),
    (_repeated("x = [1];", "x = x + x;", 60), LimitError, TOO_MUCH),
    (_repeated("x = ['a'];", "x = x * 9;", 20), EvaluationError, TOO_LARGE),
    (_repeated("x = text;", "x = x + text;", 90) * 6, LimitError, TOO_MUCH),
    (_repeated("x = text;", "x = add(x, text);", 90) * 6, LimitError, TOO_MUCH),
    (_repeated("x = 3;", "x = x * x;", 60), EvaluationError, TOO_LARGE),
    (_repeated("x = 3;", "x = mul(x, x);", 60), EvaluationError, TOO_LARGE),
    (f"[{_many(600, 'text + str({})')}];", LimitError, TOO_MUCH),
    (f"x = text * 90; y = [{_many(20, 'x + str({})')}];", LimitError, TOO_MUCH),
    (f"[{_many(80, 'numbers + [{}]')}];", LimitError, TOO_MUCH),
    (" ".join(f"y{i} = numbers * 9 + [{i}];" for i in range(20)), LimitError, TOO_MUCH),
    ("10 ^ (10 ^ 10);", EvaluationError, TOO_LARGE),
    ("pow(10, 10000000000);", EvaluationError, TOO_LARGE),
    ("2.0 ^ 100000;", EvaluationError, TOO_LARGE),
    ("(-2) ^ 99999999999;", EvaluationError, TOO_LARGE),
    ("round(123, -10000000000);", ArgumentError, "round"),
    ("'a' * 100000000000;", EvaluationError, TOO_LARGE),
    ("100000000000 * [1];", EvaluationError, TOO_LARGE),
    ("mul('a', 100000000000);", EvaluationError, TOO_LARGE),
    ("[[1] * 9000000, [1] * 9000000];", LimitError, TOO_MUCH),
    # Texts of lists whose elements are large, and not copied.
    ("str([text] * 1000000);", EvaluationError, TOO_LARGE),
    ("x = [text] * 90; y = [x, x, x, x]; z = [y, y, y, y]; str(z);", EvaluationError, TOO_LARGE),
    ("print([text] * 1000000);", EvaluationError, TOO_LARGE),
    ("str([2 ^ 400000] * 10000);", EvaluationError, TOO_LARGE),
    ("int('9' * 9000000);", ArgumentError, "int does not take"),
    # The same for each row.
    ("SELECT text + str(this) FROM m AS list;", LimitError, DUCKDB),
    ("SELECT IF(round(this) >= 0; text + str(this)) FROM m AS list;", LimitError, DUCKDB),
    ("SELECT IF(round(this) >= 0; numbers + [this]) FROM m AS list;", LimitError, DUCKDB),
    ("SELECT numbers + [this] FROM m AS list;", LimitError, DUCKDB),
    ("SELECT this FROM m GROUP BY text + str(this) AS list;", LimitError, DUCKDB),
    ("SELECT this FROM m ORDER BY IF(round(this) >= 0; text + str(this)) AS list;", LimitError, DUCKDB),
    ("SELECT DISTINCT IF(round(this) >= 0; text + str(this)) FROM m AS list;", LimitError, DUCKDB),
    ("x = ''; SELECT x = x + 'aaaaaaaaaaaaaaaa' FROM m AS list;", LimitError, TOO_MUCH),
    ("x = []; SELECT x = x + [this] FROM m AS list;", LimitError, TOO_MUCH),
    ("x = [0]; SELECT x = [x, x] FROM m AS list;", EvaluationError, TOO_LARGE),
    ("SELECT (2 ^ 400000) + this FROM m AS list;", LimitError, TOO_MUCH),
    ("SELECT s FROM [1] START WITH s='a' CONNECT BY s = s+s STOP WITH False AS list;",
     EvaluationError, TOO_LARGE),
    ("SELECT s FROM [1] START WITH s=[1] CONNECT BY s = s+s STOP WITH False AS list;",
     LimitError, TOO_MUCH),
    ("SELECT s FROM [1] START WITH s=3 CONNECT BY s = s*s STOP WITH False AS list;",
     EvaluationError, TOO_LARGE),
    ("SELECT str(this) FROM [[text] * 1000000, 1] AS list;", EvaluationError, TOO_LARGE),
    ("y = ''; SELECT y = text + str(this) FROM m AS list;", LimitError, DUCKDB),
    ("y = []; SELECT y = numbers + [this] FROM m AS list;", LimitError, DUCKDB),
    ("y = 0; SELECT y = this, 'x' * 100000 + str(y) FROM m;", LimitError, TOO_MUCH),
    # Variables.
    ("x{} = text * 90; x{} = text * 91; x{} = text * 92; x{} = text * 93; x{} = text * 94; "
     "x{} = text * 95;", LimitError, TOO_MUCH),
]  # fmt: skip

LONG_TEXTS = [
    ("(" * 100 + "1" + ")" * 100 + ";", ParseError, DEEP),
    ("(" * 100_000 + "1" + ")" * 100_000 + ";", ParseError, DEEP),
    ("[" * 20_000 + "]" * 20_000 + ";", ParseError, DEEP),
    ("NOT " * 30_000 + "1;", ParseError, DEEP),
    ("-" * 30_000 + "1;", ParseError, DEEP),
    ("IF(1; " * 100 + "1" + ")" * 100 + ";", ParseError, DEEP),
    ("SELECT this FROM (" * 100 + "n" + " AS list)" * 100 + ";", ParseError, DEEP),
]

COMBINATIONS = [
    ("c = 0; SELECT a.this FROM a=m, b=m WHERE IF(a.this < 0; c = 1, True) AS list;", LimitError, "more than 1000000"),
    ("SELECT a.this FROM a=m, b=m AS list;", LimitError, "more than 1000000 rows|" + DUCKDB),
    ("SELECT IF(True; 1) FROM a=n, b=n, c=n, d=n, e=n, f=n AS list;", LimitError,
     "more than 1000000|" + DUCKDB),
    ("SELECT this FROM n START WITH s=0 CONNECT BY s = round(s+1) STOP WITH False AS list;",
     LimitError, "a path has more than 1000 rows"),
    ("SELECT this FROM n START WITH s=0 CONNECT BY s = s+1 STOP WITH False AS list;", LimitError,
     "more than 1000 rows|" + DUCKDB),
    ("SELECT this, s FROM n START WITH s=0 CONNECT BY UNIQUE s = s+1 STOP WITH False AS list;",
     LimitError, "a path has more than 1000 rows"),
    ("SELECT this FROM n START WITH s=0 CONNECT BY NO CYCLE s = s+1 STOP WITH s > 50 AS list;",
     LimitError, DUCKDB),
]  # fmt: skip

BOUNDS = "which the limits of time and memory allow"
CELLS = "cells are more than"
FORMS = [
    ("image(8192, 8192)", LimitError, BOUNDS),
    ("image(100000, 10)", ArgumentError, "from 1 to 8192"),
    ("image(0, 10)", ArgumentError, "from 1 to 8192"),
    ("voxelgrid(0.0001)", ArgumentError, CELLS),
    ("voxelgrid(0.01)", LimitError, BOUNDS),
    ("voxelgrid(1e-300)", ArgumentError, CELLS),
    ("voxelgrid(0)", ArgumentError, "size of a cell"),
    ("occupancygrid(0.5, 0.0001)", ArgumentError, CELLS),
    ("occupancygrid([0, 3], 0.001)", LimitError, BOUNDS),
    ("occupancygrid(0.5, 1, [[-10000, -10000], [10000, 10000]])", ArgumentError, CELLS),
    ("roombaGrid(0.22, 0.001)", LimitError, BOUNDS),
    ("points(0.001)", ArgumentError, "points are more than"),
    ("points(0.005)", LimitError, BOUNDS),
    ("points(0)", ArgumentError, "spacing"),
    ("plane('XY', [0, 0], [9000, 9000, 0.001])", LimitError, BOUNDS),
    ("plane('XY', [0, 0], [1e12, 1e12, 1])", ArgumentError, CELLS),
    ("json(100000000)", ArgumentError, "indent"),
    ("parquet('stolen.parquet')", LimitError, "files are switched off"),
    ("glb('stolen.glb')", LimitError, "files are switched off"),
    ("nosuchform", UnknownNameError, "no result form"),
]
ON_BODIES = [
    (f"SELECT obj, mass FROM kitchen WHERE NOT isPlane(this) AS {form};", kind, words)
    for form, kind, words in FORMS
]
ON_SENSORS = [
    (f"SELECT obj FROM kitchen WHERE isSensor(this) AS sensorgrid({arguments});", kind, words)
    for arguments, kind, words in (
        ("0.5, 0.0001", ArgumentError, CELLS),
        ("0.5, 0.001", LimitError, BOUNDS),
        ("0.5, 1, [[-1e9, -1e9], [1e9, 1e9]]", ArgumentError, CELLS),
    )
]

NO_ELEMENT, NO_ENTITY = "has no element", "has no entity"
PYTHON = [
    ("kitchen.__class__;", UnknownNameError, NO_ENTITY),
    ("kitchen['__class__'];", UnknownNameError, NO_ENTITY),
    ("kitchen.step;", UnknownNameError, NO_ENTITY),
    ("kitchen.client;", UnknownNameError, NO_ENTITY),
    ("kitchen.fridge.__class__;", ArgumentError, NO_ELEMENT),
    ("kitchen.fridge['__dict__'];", ArgumentError, NO_ELEMENT),
    ("kitchen.fridge.world;", ArgumentError, NO_ELEMENT),
    ("kitchen.fridge.move;", ArgumentError, NO_ELEMENT),
    ("(1).__class__;", ArgumentError, NO_ELEMENT),
    ("'a'.__class__;", ArgumentError, NO_ELEMENT),
    ("[].append;", ArgumentError, NO_ELEMENT),
    ("''.format;", ArgumentError, NO_ELEMENT),
    ("'{0.__class__}'.format(1);", ParseError, "expected"),
    ("'%1000000000d' % 5;", ArgumentError, "% does not take"),
    ("mod('%s', 5);", ArgumentError, "% does not take"),
    ("__import__('os');", UnknownNameError, "no function"),
    ("open('/etc/passwd');", UnknownNameError, "no function"),
    ("getattr(kitchen, 'step');", UnknownNameError, "no function"),
    ("exec('1');", UnknownNameError, "no function"),
    ("var('__builtins__');", UnknownNameError, "no variable"),
    ("var(kitchen);", ArgumentError, "name of a variable"),
    ("str.__subclasses__;", UnknownNameError, "no variable"),
    ("print.__globals__;", UnknownNameError, "no variable"),
    ("eval('1');", LimitError, "eval is switched off"),
    ("SELECT eval('1') FROM kitchen AS list;", LimitError, "eval is switched off"),
    ("help('__class__');", UnknownNameError, "no function"),
    ("SELECT this['__class__'] FROM kitchen AS list;", ArgumentError, NO_ELEMENT),
    ("SELECT this.__dict__ FROM kitchen AS list;", SelectScriptError, "."),
    ("SELECT obj.world FROM kitchen AS list;", SelectScriptError, "."),
    ("r = SELECT id FROM kitchen; r[0].__class__;", EvaluationError, "no element"),
    ("kitchen = 1;", LimitError, "kitchen is a world"),
    ("kitchen{} = 1;", LimitError, "kitchen is a world"),
    ("clear('kitchen');", LimitError, "kitchen is a world"),
    ("SELECT kitchen = 1 FROM n AS list;", LimitError, "kitchen is a world"),
]

# Forms that copy the texts of each row, and names of columns.
TEXT_FORMS = [
    (f"x = text * 90; SELECT {columns} FROM n AS {form};", LimitError, TOO_MUCH + "|" + DUCKDB)
    for columns, form in (
        *(
            ("x, this", form)
            for form in ("csv", "json", "markdown", "arrow", "table", "df", "polars", "numpy")
        ),
        *(("to(this, x)", form) for form in ("json", "prolog")),
        ("to(x, 'a')", "prolog"),
        ("to(this, 'p' + x)", "prolog"),
        ("to(this, x)", "asp"),
        ("to(x, 'a')", "asp"),
    )
]
MANY = _many(3000, "to(this, 'c{}')")
BODIES = "SELECT obj, mass FROM kitchen WHERE NOT isPlane(this) AS"
# Rows of many columns, worlds, and grids that variables keep.
MADE = [
    (f"SELECT {MANY} FROM m AS dict;", LimitError, TOO_MUCH),
    (f"SELECT {MANY} FROM m AS list;", LimitError, TOO_MUCH),
    (f"SELECT {MANY} FROM m AS df;", LimitError, TOO_MUCH),
    (f"SELECT IF(round(this) >= 0; 1), {MANY} FROM m AS list;", LimitError, TOO_MUCH),
    (_many(9, "w{} = SELECT obj FROM kitchen WHERE isRobot(this) AS environment", "; ") + ";",
     LimitError, TOO_MUCH),
    ("SELECT obj FROM kitchen WHERE NOT isSensor(this) GROUP BY id AS environment;", LimitError,
     TOO_MUCH),
    (_many(40, f"p{{}} = {BODIES} plane('XY', [0, 0], [500, 500, 0.01])", "; ") + ";", LimitError,
     TOO_MUCH),
    ("SELECT this, s FROM m START WITH s='' CONNECT BY UNIQUE s = s+'aaaaaaaaaaaaaaaaaaaa' "
     "STOP WITH False AS list;", LimitError, "a path has more than 1000 rows|" + TOO_MUCH),
    ("SELECT a.this, s FROM a=m, b=[1] START WITH s='' CONNECT BY UNIQUE s = s+'aaaaaaaaaaaaaaaa' "
     "STOP WITH False AS list;", LimitError, "a path has more than 1000 rows|" + TOO_MUCH),
]  # fmt: skip

REFUSED = [
    *LARGE_VALUES,
    *TEXT_FORMS,
    *MADE,
    *LONG_TEXTS,
    *COMBINATIONS,
    *ON_BODIES,
    *ON_SENSORS,
    *(case for case in PYTHON if case[1] is not SelectScriptError),
]


@pytest.mark.slow
@sampled(("program", "kind", "words"), REFUSED, every=12)
def test_a_program_is_refused_in_time(patient, program, kind, words):
    fails(patient, program, kind, words)


ENDLESS = [
    "SELECT a.this FROM a=n, b=n, c=n, d=n, e=n WHERE round(a.this + b.this) == -1 AS list;",
    "SELECT a.this FROM a=m, b=m WHERE a.this * b.this == -1 AS list;",
    "SELECT count(*) FROM a=m, b=m, c=m AS list;",
    "SELECT count(SELECT b.this FROM b=m WHERE round(b.this) == a.this AS list) FROM a=m AS list;",
    "SELECT a.this FROM a=n, b=n, c=n GROUP BY a.this + b.this AS list;",
    "SELECT this, s FROM n START WITH s=0 CONNECT BY MEMORIZE s=s+1 STOP WITH False AS list;",
    "SELECT this, s FROM n START WITH s=0 CONNECT BY MEMORIZE 900 s=s+1 STOP WITH False AS list;",
    "SELECT (2 ^ 400000) % (this + 3 ^ 100000) FROM m AS list;",
    "SELECT sum(numbers) FROM m AS list;",
    "SELECT uniq(numbers) FROM m AS list;",
    "SELECT IF(5 IN numbers; 1) FROM m AS list;",
    "SELECT IF(text LIKE '%a_b'; 1) FROM m AS list;",
    "SELECT IF(True; this) FROM m ORDER BY IF(True; this * 7919 % 1000) AS list;",
    "SELECT clearance(a.this, b.this) FROM a=kitchen{}, b=kitchen{} AS list;",
    "SELECT a.this, b.this FROM a=m, b=[1, 2, 3, 4, 5] AS csv;",
    "SELECT a.this, b.this FROM a=m, b=[1, 2, 3, 4, 5] AS markdown;",
    "SELECT a.this, b.this FROM a=m, b=[1, 2, 3, 4, 5] AS json;",
    "SELECT obj FROM kitchen WHERE isSensor(this) AS sensorgrid(0.5, 0.005);",
    _many(
        8,
        "p{0} = SELECT a.obj, b.mass FROM a=kitchen, b=kitchen "
        "AS plane('XY', [0,0], [800,800,0.01], 290)",
        ";",
    )
    + ";",
    _many(10_000, "v{0}={0}", ";") + ";",
]
# What ended long after its time once.
LATE = [
    "l = [1] * 200000; SELECT a.this FROM a=n, b=n GROUP BY l AS list;",
    "l = [1] * 200000; SELECT a.this FROM a=n, b=n GROUP BY [l, a.this] AS list;",
    f"SELECT a0.this FROM {_many(60, 'a{}=kitchen')} WHERE "
    + " AND ".join(f"near(a{i}.this, a{j}.this, 1)" for i in range(60) for j in range(i))
    + " AS list;",
]


@pytest.mark.slow
@sampled("program", LATE, every=3)
def test_a_program_that_python_prepares_is_ended_in_time(hasty, program):
    fails(hasty, program, LimitError, "took more than|memory|values of more than")


@pytest.mark.slow
@sampled("program", ENDLESS, every=3)
def test_a_program_is_ended_in_time(hasty, program):
    fails(hasty, program, LimitError, "took more than|memory|values of more than|more than 1000000")


HARMLESS = [
    ("'aaaaaaaaaaaaaaaaaaaaaaaaaaaaaaab' LIKE '%a%a%a%a%a%a%a%a%a%a%a%a%a%a%a%ac';", False),
    ("'a\nb_c' LIKE '_%b__';", True),
    ("(text + 'b') LIKE '%aaa%aaa_b';", True),
    ("text LIKE '%a%a%a%a%a%a%a%a%a%a%ab';", False),
    ("w = 1; w = 2; clear('w');", True),
    ("2 ^ -999999999;", 0.0),
    ("count(text + text);", 200_000),
]


@pytest.mark.parametrize(("program", "value"), HARMLESS)
def test_a_harmless_program_has_its_value(patient, program, value):
    assert patient.eval(program) == value


@pytest.mark.parametrize("program", [text for text, kind, _ in PYTHON if kind is SelectScriptError])
def test_python_attributes_of_rows_are_not_there(patient, program):
    with pytest.raises(SelectScriptError):
        patient.eval(program)


@pytest.mark.slow
def test_without_limits_worlds_are_replaced():
    with ssduck.load("kitchen") as ss:
        assert ss.eval("kitchen = 1; kitchen;") == 1
