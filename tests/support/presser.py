"""Presses Ctrl-C at a line of ssduck's."""

from __future__ import annotations

import signal
import sys
from pathlib import Path

import ssduck


class Presser:
    """Presses Ctrl-C before a line of ssduck's that comes after so many others.

    Args:
        line: the number of the line.
        number: another signal that comes there.
        places: what the paths of files begin with whose lines count; by default all of ssduck's.

    Attributes:
        count: the number of lines so far.
    """

    def __init__(
        self,
        line: float,
        number: int = signal.SIGINT,
        places: tuple[str, ...] = (f"{Path(ssduck.__file__).parent}/",),
    ) -> None:
        self._line, self._number, self._places = line, number, places
        self.count = 0

    def __enter__(self):
        sys.settrace(self._trace)
        return self

    def __exit__(self, *_):
        sys.settrace(None)

    def _trace(self, frame, event, _):
        if not frame.f_code.co_filename.startswith(self._places):
            return None
        if event == "line":
            self.count += 1
            if self.count == self._line:
                signal.raise_signal(self._number)
        return self._trace
