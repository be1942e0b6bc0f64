"""Signals at any place of a context that defers them: they are delivered, and their handlers stay."""

from __future__ import annotations

import gc
import signal
import sys

import pytest

from ssduck.world import ctrl_c


@pytest.fixture(autouse=True)
def handler():
    kept = signal.signal(signal.SIGINT, signal.default_int_handler)
    gc.collect()
    gc.freeze()  # what other tests have left is not gone through after each signal
    yield
    signal.signal(signal.SIGINT, kept)


class Presser:
    """Presses Ctrl-C at an event of the trace that comes after so many others."""

    def __init__(self, at):
        self.at, self.count = at, 0

    def trace(self, *_):
        self.count += 1
        if self.count == self.at:
            signal.raise_signal(signal.SIGINT)
        return self.trace


def with_ctrl_c_at(event):
    """Presses Ctrl-C at an event of a wait; returns the error, and the number of events."""
    presser, caught = Presser(event), None
    try:
        sys.settrace(presser.trace)
        try:
            with ctrl_c.deferred(), ctrl_c.allowed():
                pass
        finally:
            sys.settrace(None)
    except KeyboardInterrupt as error:
        caught = error
    return caught, presser.count


@pytest.mark.slow
def test_the_handler_is_back_wherever_ctrl_c_comes():
    caught, count = with_ctrl_c_at(None)
    assert caught is None
    assert count > 10
    for event in range(1, count):  # the last one is that of `settrace`
        caught, _ = with_ctrl_c_at(event)
        assert isinstance(caught, KeyboardInterrupt)
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
        del caught  # with the frames that it went through
        gc.collect()
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
        assert not ctrl_c._replaced
        assert not ctrl_c._noted


UNIX = pytest.mark.skipif(not hasattr(signal, "SIGALRM"), reason="Windows has no such signal")


@UNIX
def test_a_handler_is_called_as_often_as_its_signal_came():
    """`ssduck record` ends after one, and at once after two."""
    calls = []

    def first(number, _):
        calls.append("first")
        signal.signal(number, second)

    def second(*_):
        calls.append("second")

    kept = signal.signal(signal.SIGTERM, first)
    try:
        with ctrl_c.deferred():
            with ctrl_c.deferred():
                signal.raise_signal(signal.SIGTERM)
                signal.raise_signal(signal.SIGTERM)
            assert not calls
        assert calls == ["first", "second"]
        with ctrl_c.deferred():
            signal.raise_signal(signal.SIGTERM)
            with ctrl_c.allowed():
                assert calls[2:] == ["second"]
                signal.signal(signal.SIGTERM, first)
            signal.raise_signal(signal.SIGTERM)
        assert calls[3:] == ["first"]
        assert signal.getsignal(signal.SIGTERM) is second
    finally:
        signal.signal(signal.SIGTERM, kept)
