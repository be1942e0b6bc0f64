"""Signals at any place of a context that defers them: they are delivered, and their handlers stay."""

from __future__ import annotations

import gc
import signal
import sys

import pytest

import ssduck
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


class TimeIsUpError(Exception):
    """What a handler of SIGALRM may raise."""


def time_is_up(*_):
    raise TimeIsUpError


UNIX = pytest.mark.skipif(not hasattr(signal, "SIGALRM"), reason="Windows has no such signal")


def with_an_alarm(presser):
    """Has an alarm come in a context that defers it."""
    sys.settrace(presser.trace)
    try:
        with ctrl_c.deferred():
            signal.raise_signal(signal.SIGALRM)
            with ctrl_c.allowed():
                pass
    finally:
        sys.settrace(None)


@pytest.mark.slow
@UNIX
def test_the_handlers_are_back_whichever_of_two_signals_raises():
    """An alarm comes, and Ctrl-C at any place: one error follows from the other, or is the only."""
    kept = signal.signal(signal.SIGALRM, time_is_up)
    try:
        for event in (None, *range(2, with_ctrl_c_at(None)[1])):
            with pytest.raises((KeyboardInterrupt, TimeIsUpError)) as caught:
                with_an_alarm(Presser(event))
            assert event is not None or caught.type is TimeIsUpError
            del caught
            gc.collect()
            assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
            assert signal.getsignal(signal.SIGALRM) is time_is_up
            assert not ctrl_c._replaced
            assert not ctrl_c._noted
    finally:
        signal.signal(signal.SIGALRM, kept)


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


def raise_in_a_context(*names):
    """Raises signals in a context that defers them."""
    with ctrl_c.deferred():
        for name in names:
            signal.raise_signal(getattr(signal, name))


@UNIX
@pytest.mark.parametrize("names", [("SIGINT", "SIGALRM"), ("SIGALRM", "SIGINT")])
def test_the_signal_that_ends_the_program_wins(names):
    """Who catches the error of an alarm goes on, and would have missed Ctrl-C."""
    kept = signal.signal(signal.SIGALRM, time_is_up)
    try:
        with pytest.raises(KeyboardInterrupt):
            raise_in_a_context(*names)
        assert not ctrl_c._noted
    finally:
        signal.signal(signal.SIGALRM, kept)


@pytest.mark.slow
@UNIX
def test_the_tables_are_those_of_the_simulator_whatever_a_handler_raises():
    """An alarm that ends a long `step` comes between two steps of the simulator."""
    kept = signal.signal(signal.SIGALRM, time_is_up)
    try:
        with ssduck.load("kitchen") as ss:
            world = ss.call_variable("kitchen")
            for place in range(8):
                signal.setitimer(signal.ITIMER_REAL, 0.02 + 0.0007 * place)
                with pytest.raises(TimeIsUpError):
                    world.step(100_000, every=100_000)
                assert world.snapshot.time == world._simulator.time
                (time,) = {row[0] for row in ss.sql("SELECT time FROM entities").fetchall()}
                assert time == world._simulator.time
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, kept)
