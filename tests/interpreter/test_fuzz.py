"""Mutated programs end in a value or in an error of ours; the long form is `tools/fuzz.py`."""

from pathlib import Path

import pytest

from tests.support.cases import generated
from tools.fuzzing.bench import Bench
from tools.fuzzing.mutation import SQL, Input, input_of, programs
from tools.fuzzing.workers import Worker, fuzz

pytestmark = pytest.mark.filterwarnings("ignore::ssduck.ProgramWarning")


@pytest.fixture(scope="module")
def bench():
    return Bench()


@pytest.mark.parametrize("text", programs())
def test_the_programs_that_are_mutated_are_right(bench, text, capsys):
    assert isinstance(text, str)
    assert bench.error_of(Input(text)) is None


@pytest.mark.parametrize("text", SQL)
def test_the_sql_that_is_mutated_is_right(bench, text):
    assert bench.error_of(Input(text, is_sql=True)) is None


def test_inputs_are_made_of_their_numbers():
    assert input_of(1, 2) == input_of(1, 2)
    assert len({input_of(1, number).text for number in range(100)}) > 90


@pytest.mark.slow
def test_mutated_programs_end_in_a_value_or_an_error_of_ours():
    findings = fuzz(generated(10), seed=1)
    assert not findings, "\n".join(f"{finding}\n{finding.trace}" for finding in findings)


def test_a_crash_and_a_hang_are_found(monkeypatch, tmp_path):
    """The parent names the input that a worker was at."""
    worker = Worker(0, range(0, 8, 2), str(tmp_path / "log.txt"))
    worker.log = str(tmp_path / "log.txt")
    Path(worker.log).write_text('  File "/x/ssduck/tree.py", line 3 in f\n')
    worker.progress = [2.0, 0.0]
    monkeypatch.setattr(worker, "begin", lambda: None)
    finding = worker._lost("crash, exit status -11")
    assert (finding.number, finding.cause) == (2, 'tree.py", line 3 in f')
    assert finding.input == input_of(0, 2)
    assert list(worker.numbers) == [4, 6]
