"""Fixtures of the tests in this folder."""

import pytest

import ssduck


@pytest.fixture(scope="module")
def kitchen(shared_kitchen):
    """An interpreter with the kitchen that modules share, and its table."""
    with ssduck.Interpreter() as ss:
        ss.add_variable("kitchen", shared_kitchen)
        ss.add_variable("table", shared_kitchen["table"])
        yield ss
