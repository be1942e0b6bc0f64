"""Ctrl-C at any place of a context that defers it: it is delivered, and its handler is back."""

from __future__ import annotations

import gc
import signal
import sys

import pytest

from ssduck.world import ctrl_c


@pytest.fixture(autouse=True)
def handler():
    kept = signal.signal(signal.SIGINT, signal.default_int_handler)
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
        assert not ctrl_c._is_pressed
