"""`ssduck` as a process: signals, pipes, full disks."""

import json
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.support.cases import sampled
from tests.support.command_line import LINUX, run, start
from tests.support.timing import HANGS


@pytest.mark.slow
def test_an_error_is_no_traceback(here):
    code, out, err = run("query", "two.toml", "SELECT abov FROM two;")
    assert (code, out) == (1, "")
    assert err.startswith("error: ")
    assert "Traceback" not in err


@pytest.mark.long
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


@pytest.mark.long
def test_a_reader_that_goes_away(here):
    sql = "SELECT i FROM range(100000) r(i)"
    with start("query", "two.toml", "--sql", sql, "-F", "csv") as process:
        assert process.stdout.readline() == "i\n"
        process.stdout.close()
        assert process.stderr.read() == ""
    assert process.returncode == 1


@pytest.mark.slow
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


@pytest.mark.slow
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


@pytest.mark.slow
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


# Each level makes a text a hundred times as long, in one step that DuckDB does not count.
CONCAT = f"concat({', '.join(['s'] * 100)})"
LARGE = f"(SELECT '{'a' * 1000}' || range AS s FROM range(100))"
for _ in range(4):
    LARGE = f"(SELECT {CONCAT} AS s FROM {LARGE})"
LARGE = f"SELECT max(length(s)) AS n FROM {LARGE}"
# It is measured before it runs, or it takes too much.
REFUSED = r"memory|took more than|would be too large"


# -- ssduck query --strict --------------------------------------------------------------------


def query(*arguments, **options):
    return subprocess.Popen(
        [sys.executable, "-m", "ssduck", "query", "hall", "--strict", *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        **options,
    )


@pytest.mark.slow
@LINUX
def test_a_strict_query_has_its_result_and_its_errors():
    process = query("-F", "json", "[1, 2];")
    assert (*process.communicate(timeout=HANGS), process.returncode) == ("[1, 2]\n", "", 0)
    process = query("nobody;")
    out, err = process.communicate(timeout=HANGS)
    assert (out, process.returncode) == ("", 1)
    assert "there is no variable 'nobody'" in err


@LINUX
@pytest.mark.long
def test_a_strict_query_takes_no_more_memory_than_it_may():
    process = query("--sql", LARGE)
    out, err = process.communicate(timeout=HANGS)
    assert (out, process.returncode) == ("", 1)
    assert re.search(REFUSED, err)
