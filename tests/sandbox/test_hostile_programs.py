"""Programs and SQL of strangers: each is answered, refused or ended, and the next is answered."""

import resource
from pathlib import Path

import pytest

from ssduck.errors import LimitError, ParseError, SelectScriptError, SqlError
from ssduck.limits import Limits
from ssduck.sandbox import opening


def grouped(*counts, word="ROLLUP"):
    sets = (f"{word}({', '.join(f'n + {i}' for i in range(count))})" for count in counts)
    return f"SELECT count(*) FROM range(3) t(n) GROUP BY {', '.join(sets)}"


def nested(form, times, start):
    for _ in range(times):
        start = form.replace("§", start)
    return start


INLINED = ", ".join(
    f"q{i} AS NOT MATERIALIZED (SELECT p.s FROM q{i - 1} p, q{i - 1} q)" for i in range(1, 41)
)
ENDED = r"too long|took more than|more memory|process of the program ended"
REFUSED = r"Permission|disabled|not exist|locked|Cannot|cannot"

# What stops each: the language's own bounds, which are always on, or its time in the sandbox.
PROGRAMS = {
    "a text doubled 60 times": ("x = 'a'; " + "x = x + x; " * 60 + "1;", "too large"),
    "a list of lists, written": ("x = [1]; " + "x = [x, x]; " * 60 + "str(x);", "too large"),
    "a power of a power": ("10 ^ (10 ^ 10);", "too large"),
    "a text repeated": ("'a' * 100000000000;", "too large"),
    "a path without end": (
        "SELECT this, s FROM n START WITH s=0 CONNECT BY UNIQUE s = s+1 STOP WITH False AS list;",
        "more than 1000 rows",
    ),
    "brackets in brackets": ("(" * 100_000 + "1" + ")" * 100_000 + ";", "nested"),
    "not not not": ("NOT " * 30_000 + "1;", "nested deeper"),
    "many small cells": (
        "SELECT obj, mass FROM kitchen WHERE NOT isPlane(this) AS voxelgrid(0.001);",
        "cells are more than",
    ),
    "a file of a mesh": ("SELECT obj FROM kitchen AS glb('{outside}');", "switched off"),
    "a file of rows": ("SELECT id FROM kitchen AS parquet('{outside}');", "switched off"),
    "eval": ("eval('1 + 1');", "eval"),
    "eval of eval": ("eval(\"eval('1')\");", "eval"),
    "more than an answer holds": ("m * 20;", "answer takes"),
}
ENDLESS_PROGRAMS = {
    "many long texts": (
        "SELECT IF(round(this) >= 0; text + str(this)) FROM m AS list;",
        f"{ENDED}|answer takes",
    ),
    "all pairs": ("SELECT a.this FROM a=m, b=m AS list;", ENDED),
    "an endless sum": ("sum(SELECT a.this * b.this FROM a=m, b=m AS list);", ENDED),
    "sorted pairs": (
        "SELECT a.this FROM a=m, b=n ORDER BY b.this DESC AS list;",
        f"answer|{ENDED}",
    ),
}
STATEMENTS = {
    "a file is read": ("SELECT * FROM read_text('/etc/passwd')", REFUSED),
    "a table is read": ("SELECT * FROM read_csv('/etc/passwd')", REFUSED),
    "a file by its name": ("SELECT * FROM '/etc/passwd.csv'", REFUSED),
    "names of files": ("SELECT * FROM glob('/etc/*')", REFUSED),
    "a file is written": ("COPY (SELECT 1) TO '{outside}'", REFUSED),
    "a folder is written": ("EXPORT DATABASE '{outside}'", REFUSED),
    "a database is attached": ("ATTACH '{outside}' AS other", REFUSED),
    "a page of the web": ("SELECT * FROM read_text('http://127.0.0.1:9/x')", f"{REFUSED}|httpfs"),
    "an object": ("SELECT * FROM read_parquet('s3://bucket/x.parquet')", f"{REFUSED}|httpfs"),
    "an extension is installed": ("INSTALL httpfs", REFUSED),
    "an extension is loaded": ("LOAD '/tmp/evil.duckdb_extension'", REFUSED),
    "more threads": ("SET threads = 8", REFUSED),
    "more memory": ("SET memory_limit = '100GB'", REFUSED),
    "files again": ("SET enable_external_access = true", REFUSED),
    "another folder": ("SET allowed_directories = ['/']", REFUSED),
    "unlocked": ("SET lock_configuration = false", REFUSED),
    "a variable of the shell": ("SELECT getenv('HOME')", REFUSED),
    "a secret": ("CREATE SECRET s (TYPE s3)", f"{REFUSED}|not found|extension"),
    "a variable of Python": ("SELECT * FROM worker", "worker"),
    "a huge list": ("SELECT len(range(100000000000))", "not supported"),
    "a file of rows as Parquet": ("COPY (SELECT 1) TO '{outside}' (FORMAT parquet)", REFUSED),
    "more than an answer holds": (
        f"SELECT {', '.join(['range'] * 6)} FROM range(900000)",
        "answer takes",
    ),
}
# They end after half a second, or before.
ENDLESS = {
    "a huge text": ("SELECT length(repeat(name, 1000000000)) FROM entities", "Out of|memory|Range"),
    "hex of hex": (
        f"SELECT length({nested('hex(§)', 40, 'name')}) FROM entities",
        f"{ENDED}|Out of",
    ),
    "a slow pattern": (
        "SELECT count(*) FROM range(200000) t(i) WHERE "
        "regexp_matches(repeat('a', 5000) || i, '((a{1,10}){1,10}){1,10}b')",
        f"{ENDED}|Invalid",
    ),
    "sleep": ("SELECT sleep_ms(100000)", f"{ENDED}|{REFUSED}"),
    "inlined twice each": (
        f"WITH q0 AS NOT MATERIALIZED (SELECT 1 AS s), {INLINED} SELECT count(*) FROM q40",
        f"{ENDED}|Out of|expression",
    ),
    "a huge range": (
        "SELECT sum(a.range * b.range) FROM range(1000000000) a, range(1000000) b",
        ENDED,
    ),
    "an endless recursion": (
        "WITH RECURSIVE t(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM t) SELECT sum(i) FROM t",
        ENDED,
    ),
    "sorted on the disk": (
        "SELECT i, hash(i) FROM range(100000000) t(i) ORDER BY 2",
        f"{ENDED}|memory|answer",
    ),
}
# Harmless: what they do to their own database, they do to themselves.
ANSWERED = {
    "rolled up": grouped(17, 17),
    "a schema is dropped": "DROP SCHEMA IF EXISTS other CASCADE",
    "a table is made": "CREATE OR REPLACE TABLE mine AS SELECT 1 AS a",
    "settings are read": "SELECT count(*) FROM duckdb_settings()",
}


@pytest.fixture(scope="module")
def outside(tmp_path_factory):
    """A path outside the sandbox, which programs try to write."""
    return tmp_path_factory.mktemp("outside") / "stolen"


@pytest.fixture(scope="module")
def hostile(request, zygote):
    """A sandbox with variables, whose programs have so many seconds."""
    limits = Limits.strict(seconds=request.param)
    with opening.load("kitchen", limits=limits, zygote=zygote) as ss:
        for name, value in {
            "n": list(range(100)),
            "m": list(range(100_000)),
            "text": "a" * 100_000,
        }.items():
            ss.add_variable(name, value)
        yield ss


def check_contained(ss, outside, ask, pattern):
    """The program is an error, nothing was written, and the next questions are answered."""
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(SelectScriptError, match=pattern):
        ask()
    assert list(outside.parent.iterdir()) == []
    assert ss.eval("SELECT count(*) FROM kitchen AS value;") == 37
    assert ss.eval("n[99];") == 99
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 50_000


CASES = [
    pytest.param(seconds, method, text, pattern, id=name)
    for seconds, method, cases in (
        (0.5, "eval", ENDLESS_PROGRAMS),
        (0.5, "sql", ENDLESS),
        (20.0, "eval", PROGRAMS),
        (20.0, "sql", STATEMENTS),
    )
    for name, (text, pattern) in cases.items()
]


@pytest.mark.slow
@pytest.mark.parametrize(("hostile", "method", "text", "pattern"), CASES, indirect=["hostile"])
def test_programs_and_statements_are_refused_or_ended(hostile, outside, method, text, pattern):
    text = text.replace("{outside}", str(outside))
    check_contained(hostile, outside, lambda: getattr(hostile, method)(text), pattern)


@pytest.mark.parametrize("hostile", [20.0], indirect=True)
@pytest.mark.slow
@pytest.mark.parametrize("name", ANSWERED)
def test_what_harms_nobody_is_answered(hostile, name):
    ss = hostile
    ss.sql(ANSWERED[name])
    assert ss.sql("SELECT count(*) FROM kitchen.entities").fetchall() == [(37,)]


@pytest.mark.slow
def test_what_a_program_breaks_is_its_own(zygote):
    """A dropped schema, and a table in place of ssduck's, end with the process."""
    with opening.load("kitchen", zygote=zygote) as ss:
        ss.sql("CREATE TABLE mine AS SELECT 1 AS a")
        with pytest.raises(LimitError, match="the process of the program ended"):
            ss.ask("worker.python", "__import__('os')._exit(0)")
        with pytest.raises(SqlError, match="mine"):
            ss.sql("SELECT * FROM mine")


def test_errors_of_programs_have_their_place(kitchen):
    with pytest.raises(ParseError) as caught:
        kitchen.eval("1 +;")
    assert (caught.value.line, caught.value.column) == (1, 4)
    assert not Path("stolen").exists()
