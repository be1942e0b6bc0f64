"""Strict programs of the command line, and of agents, run in a process of their own."""

import re
import subprocess
import sys

import pytest

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
