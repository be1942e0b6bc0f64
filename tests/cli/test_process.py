"""`ssduck` as a process: signals, pipes, full disks."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import typer

import ssduck
from ssduck.cli import signals
from tests.support.cases import sampled
from tests.support.command_line import LINUX, run, start
from tests.support.timing import HANGS


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


# -- the handlers of signals: what an export has begun is removed -----------------------------

ENDING = (signal.SIGINT, signal.SIGTERM)


@pytest.fixture
def handlers():
    """The handlers before a test, which are there again after it."""
    before = {number: signal.getsignal(number) for number in ENDING}
    yield before
    for number, handler in before.items():
        signal.signal(number, handler)


def interrupted(number, cleaned):
    """Gets a signal, and makes another error of the interrupt, as libraries do."""
    try:
        os.kill(os.getpid(), number)
        time.sleep(10)
    except KeyboardInterrupt:
        raise RuntimeError("Query interrupted") from None
    finally:
        cleaned.append(number)


@pytest.mark.parametrize("number", ENDING)
def test_the_first_signal_is_an_interrupt_and_an_exit_status(handlers, number):
    cleaned = []
    with pytest.raises(typer.Exit) as ended, signals.raised():
        interrupted(number, cleaned)
    assert cleaned == [number]
    assert ended.value.exit_code == 128 + number
    assert {number: signal.getsignal(number) for number in ENDING} == handlers


def test_other_errors_stay_as_they_are(handlers):
    with pytest.raises(ValueError, match="wrong"), signals.raised():
        raise ValueError("wrong")


@pytest.mark.parametrize("number", ENDING)
def test_signals_that_are_ignored_stay_so(handlers, number):
    signal.signal(number, signal.SIG_IGN)  # as of nohup, and of a shell that does not wait
    with signals.raised():
        os.kill(os.getpid(), number)
    with signals.deferred() as received:
        os.kill(os.getpid(), number)
    assert received == []


COMMANDS = {
    "a record": ["export", "run", "-o", "out"],
    "another format": ["export", "run", "-o", "out", "--format", "mcap"],
}


@pytest.mark.slow
@sampled("number", ENDING, every=2)
@sampled("name", COMMANDS, every=2)
def test_an_export_that_a_signal_ends_leaves_nothing(tmp_path, name, number):
    count = 20_000
    poses = {f"cup {i}": [[i, 0, t / count] for t in range(count)] for i in range(4)}
    times = [t / 240 for t in range(count)]
    ssduck.write_record(tmp_path / "run", list(poses), poses, times, world="lab")
    (tmp_path / "tmp").mkdir()
    process = subprocess.Popen(
        [sys.executable, "-P", "-m", "ssduck", *COMMANDS[name]],
        cwd=tmp_path,
        env={**os.environ, "TMPDIR": str(tmp_path / "tmp")},
        stderr=subprocess.PIPE,
        stdout=subprocess.PIPE,
    )
    while process.poll() is None and not (
        any((tmp_path / "tmp").iterdir())
        or any(p.name not in ("run", "tmp") for p in tmp_path.iterdir())
    ):
        time.sleep(0.002)
    process.send_signal(number)
    output, errors = process.communicate(timeout=60)
    left = [p for p in tmp_path.rglob("*") if "run" not in p.relative_to(tmp_path).parts]
    if process.returncode == 0:  # it had ended before
        assert output
        return
    assert process.returncode == 128 + number, errors
    assert left == [tmp_path / "tmp"]
