"""What of the tests is run each time, and what takes too long for it."""

import json
import os
import subprocess
import sys
import time
from itertools import combinations, product
from types import SimpleNamespace

import pytest

from tests.support.archive import UNUSED, Archive
from tests.support.cases import covering, mark_all_but_pairs, sampled
from tools import times


def pairs(case):
    return set(combinations(enumerate(case), 2))


@pytest.mark.parametrize("sizes", [(2, 3), (3, 3, 3), (4, 3, 2, 2), (2,) * 6])
def test_few_cases_have_each_pair_of_values(sizes):
    every = set(product(*map(range, sizes)))
    chosen = covering(every)
    assert chosen <= every
    assert set().union(*map(pairs, chosen)) == set().union(*map(pairs, every))
    assert len(chosen) < len(every) or len(sizes) == 2


def test_all_cases_of_a_single_parameter_are_needed():
    assert covering({(0,), (1,), (2,)}) == {(0,), (1,), (2,)}


def test_the_other_cases_are_long():
    class Item:
        def __init__(self, indices):
            self.nodeid, self.marks = f"test_it[{indices}]", []
            self.callspec = SimpleNamespace(indices=dict(enumerate(indices)))
            self.get_closest_marker = {"pairwise": True}.get
            self.add_marker = self.marks.append

    items = [Item(indices) for indices in product(range(3), repeat=3)]
    mark_all_but_pairs(items)
    left = [item for item in items if not item.marks]
    assert 9 <= len(left) < 14
    assert {mark.name for item in items for mark in item.marks} == {"long"}


def test_a_sample_is_not_long():
    cases = sampled("n", [1, 2, pytest.param(3, id="three"), 4, 5], every=3).args[1]
    long = [[mark.name for mark in getattr(case, "marks", ())] for case in cases]
    assert long == [[], ["long"], ["long"], [], ["long"]]
    assert cases[2].id == "three"


def write_number(folder, number):
    (folder / "number").write_text(str(number))
    with (folder.parent / "calls").open("a") as calls:
        calls.write(f"{number} ")


def test_what_is_archived_is_written_once_for_each_argument(tmp_path):
    for name, age in (("of old code", UNUSED + 60), ("of another run", UNUSED - 60)):
        (tmp_path / "records" / name).mkdir(parents=True)
        os.utime(tmp_path / "records" / name, (time.time() - age,) * 2)
    for run in range(2):  # two processes of a run
        archive = Archive(tmp_path / "records")
        for number in (1, 2):
            copy = archive.copy(write_number, tmp_path / f"{run} {number}", number)
            assert (copy / "number").read_text() == str(number)
            (copy / "number").write_text("changed")
    other, place = sorted((tmp_path / "records").iterdir(), key=lambda one: one.stat().st_mtime)
    assert other.name == "of another run"
    assert (place / "calls").read_text() == "1 2 "


def test_a_record_whose_writing_fails_is_not_kept(tmp_path):
    def fail(folder):
        (folder / "half").touch()
        raise EOFError

    archive = Archive(tmp_path / "records")
    for _ in range(2):
        with pytest.raises(EOFError):
            archive.copy(fail, tmp_path / "copy")
    assert not (tmp_path / "copy").exists()


CASE = "tests/sql/test_it.py::test_it[1]"


@pytest.mark.parametrize(("alone", "status"), [(3.5, 1), (0.5, 0)])
def test_a_case_that_takes_too_long_alone_too_is_named(
    tmp_path, monkeypatch, capsys, alone, status
):
    cache = tmp_path / "times"
    fixtures = {"tests::client": [0.1, 0.2], "tests/sql/test_it.py::ss": [1.0]}
    cache.write_text(
        json.dumps({"calls": {CASE: 4.0, "tests/test_b.py::b": 1}, "fixtures": fixtures})
    )
    monkeypatch.setattr(times, "CACHE", cache)
    monkeypatch.setattr(times, "seconds_alone", lambda case: alone)
    assert times.main() == status
    told = capsys.readouterr().out
    assert (f"{CASE} takes 3.5 s, more than 3: " in told) == bool(status)
    assert "sql                 1    4.0 s    1.0 s" in told
    assert "   0.3 s  tests::client, 2 times" in told


@pytest.mark.slow
def test_pytest_tells_what_its_cases_and_fixtures_took(tmp_path):
    (tmp_path / "test_it.py").write_text(
        "import time, pytest\n"
        "@pytest.fixture\ndef late(): time.sleep(0.05)\n"
        "def test_it(late): time.sleep(0.02)\n"
    )
    (tmp_path / "conftest.py").write_text(
        "from tests.support.times import Times\n"
        "def pytest_configure(config): config.pluginmanager.register(Times(config))\n"
    )
    command = [sys.executable, "-m", "pytest", "-p", "no:xdist", "--rootdir", tmp_path]
    subprocess.run(
        [*command, "-c", os.devnull, tmp_path / "test_it.py"],
        cwd=times.ROOT,
        check=True,
        stdout=subprocess.DEVNULL,
    )
    told = json.loads((tmp_path / ".pytest_cache" / "v" / times.TIMES).read_text())
    assert told["calls"]["test_it.py::test_it"] >= 0.02
    assert told["fixtures"]["test_it.py::late"][0] >= 0.05
