"""Strict programs of the command line, and of agents, run in a process of their own."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time

import pytest

from ssduck.cli.worker import Source, WorkerAnswers
from ssduck.errors import LimitError
from ssduck.limits import Limits
from ssduck.mcp.answers import WorkerError
from tests.support.cases import sampled
from tests.support.command_line import LINUX
from tests.support.timing import HANGS

# Each level makes a text a hundred times as long, in one step that DuckDB does not count.
CONCAT = f"concat({', '.join(['s'] * 100)})"
LARGE = f"(SELECT '{'a' * 1000}' || range AS s FROM range(100))"
for _ in range(4):
    LARGE = f"(SELECT {CONCAT} AS s FROM {LARGE})"
LARGE = f"SELECT max(length(s)) AS n FROM {LARGE}"
# It is measured before it runs, or it takes too much.
REFUSED = r"memory|took more than|would be too large"


@pytest.fixture(scope="module")
def worker():
    answers = WorkerAnswers(Source("hall", None, None, Limits.strict(seconds=1)))
    yield answers
    answers.close()


def rows(worker, program, language="selectscript"):
    return json.loads(worker.query(program, language, 100))


def test_a_worker_answers(worker):
    assert rows(worker, "1 + 1;") == 2
    assert rows(worker, "SELECT count(*) AS n FROM entities", "sql")[0]["n"] > 1
    assert "# Tables of each world" in worker.schema()
    assert "Usage: " in worker.help("above")
    with pytest.raises(WorkerError, match="UnknownNameError: there is no variable 'nobody'"):
        rows(worker, "nobody;")


@pytest.mark.slow
def test_a_picture_comes_from_the_worker(worker):
    name = rows(worker, "SELECT name FROM entities LIMIT 1", "sql")[0]["name"]
    picture = worker.picture(
        f"SELECT obj FROM hall WHERE id(this) == '{name}';", "selectscript", 64, 48
    )
    assert picture.startswith(b"\x89PNG")


@pytest.mark.long
@LINUX
def test_a_worker_that_is_stuck_is_ended_and_started_again(worker):
    rows(worker, "kept = 1;")
    worker._process.send_signal(signal.SIGSTOP)  # as a call in C that does not return
    started = time.monotonic()
    with pytest.raises(LimitError, match=r"took more than 1 s, and its process was ended; variab"):
        rows(worker, "1;")
    assert time.monotonic() - started >= 1
    assert rows(worker, "2;") == 2
    with pytest.raises(WorkerError, match="no variable 'kept'"):
        rows(worker, "kept;")


@pytest.mark.slow
@LINUX
def test_a_worker_that_is_gone_is_started_again(worker):
    worker._process.kill()
    worker._process.wait()
    assert rows(worker, "3;") == 3


@LINUX
def test_a_worker_takes_no_more_memory_than_it_may(worker):
    with pytest.raises((LimitError, WorkerError), match=REFUSED):
        rows(worker, LARGE, "sql")
    assert rows(worker, "4;") == 4


@pytest.mark.slow
def test_a_worker_tells_why_it_does_not_start():
    with pytest.raises(WorkerError, match="did you mean 'kitchen'"):
        WorkerAnswers(Source("kitchn", None, None, Limits.strict()))


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


PROGRAM = """
import os, signal, sys, time
from ssduck.cli.child_process import supervised
from ssduck.errors import LimitError
from ssduck.limits import Limits
try:
    with supervised(Limits.strict(seconds=0.3)):
        {}
    print("result")
    sys.exit(3)
except LimitError as error:
    print("error:", error)
"""


@pytest.mark.slow
@LINUX
@sampled(
    ("code", "output", "status"),
    [
        ("pass", "result\n", 3),
        ("signal.pthread_sigmask(signal.SIG_BLOCK, [2, 15]); time.sleep(1000)",
         "error: the program took more than 0.3 s, and its process was ended\n", 0),
        ("os.kill(os.getpid(), signal.SIGSEGV)",
         "error: the process of the program ended by SIGSEGV; it may have needed more memory than "
         "available\n", 0),
        ("bytearray(10**11)", "error: the program needs too much memory\n", 0),
        ("raise LimitError('a limit')", "error: a limit\n", 0),
    ],
every=4)  # fmt: skip
def test_the_parent_ends_as_its_child(code, output, status):
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM.format(code)],
        capture_output=True,
        text=True,
        timeout=HANGS,
        check=False,
    )
    assert (done.stdout, done.returncode, done.stderr) == (output, status, "")


@pytest.mark.slow
@LINUX
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_both(number):
    code = "print(os.getpid(), flush=True); signal.signal(2, signal.SIG_IGN); time.sleep(1000)"
    text = PROGRAM.replace("seconds=0.3", f"seconds={HANGS}").format(code)
    process = subprocess.Popen(
        [sys.executable, "-c", text], stdout=subprocess.PIPE, text=True, start_new_session=True
    )
    child = int(process.stdout.readline())
    process.send_signal(number)
    assert process.wait(HANGS) == 128 + number
    process.stdout.close()
    deadline = time.monotonic() + HANGS
    while time.monotonic() < deadline and _is_there(child):
        time.sleep(0.01)
    assert not _is_there(child)


def _is_there(process):
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    with open(f"/proc/{process}/stat") as file:  # noqa: PTH123
        return file.read().rpartition(")")[2].split()[0] != "Z"
