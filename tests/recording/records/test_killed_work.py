"""Processes that are killed while they work on a record leave no half that looks whole."""

import os

import pytest

from tools import kill_work

POSIX = pytest.mark.skipif(os.name != "posix", reason="SIGKILL")


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    return kill_work.Run(tuple(kill_work.WORK), tmp_path_factory.mktemp("records"))


@pytest.mark.long
@POSIX
# Exports, closing and so on in turn; folders below the number of works, files from it on.
@pytest.mark.parametrize("seed", [0, 7, 2, 9, 4, 11])
def test_killed_work_leaves_whole_records(run, seed):
    """The short form of `python -m tools.kill_work`."""
    run.add(seed)
    assert run.faults == {}
