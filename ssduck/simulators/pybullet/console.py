"""Imports PyBullet silently, and captures the output of its C code."""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress


@contextmanager
def captured() -> Iterator[list[str]]:
    """Captures the output of C code; at the end the list holds the lines."""
    lines: list[str] = []
    saved: dict[int, int] = {}
    with tempfile.TemporaryFile() as sink:
        try:
            for stream, number in ((sys.stdout, 1), (sys.stderr, 2)):
                if stream is not None:
                    stream.flush()
                with suppress(OSError):  # a daemon may have closed it
                    saved[number] = os.dup(number)
                    os.dup2(sink.fileno(), number)
            yield lines
        finally:
            for number, copy in saved.items():
                os.dup2(copy, number)
                os.close(copy)
            sink.seek(0)
            lines += sink.read().decode(errors="replace").splitlines()


with captured():  # PyBullet prints its build time
    import pybullet

__all__ = ["captured", "pybullet"]
