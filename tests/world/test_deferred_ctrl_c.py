"""Signals in a context that defers them: they are delivered, and their handlers stay."""

import signal

import pytest

from ssduck.world import ctrl_c

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
