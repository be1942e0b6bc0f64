"""Signals that end a command: what an export has begun is removed."""

import os
import signal
import subprocess
import sys
import time

import pytest
import typer

import ssduck
from ssduck.cli import signals
from tests.support.cases import sampled

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
