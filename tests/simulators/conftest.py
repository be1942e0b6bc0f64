"""Scenes of the tests of simulators."""

import pytest

import ssduck


@pytest.fixture
def load(write):
    """Loads a scene of one text with files beside it; returns the interpreter and the world.

    The name of a file is that of its argument, with `.` for `_`.
    """
    opened = []

    def loaded(text, **files):
        for name, content in files.items():
            write(name.replace("_", "."), content)
        ss = ssduck.load(write("room.toml", text))
        opened.append(ss)
        return ss, ss.call_variable("room")

    yield loaded
    for ss in opened:
        ss.close()
