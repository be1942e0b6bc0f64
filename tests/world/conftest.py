"""A kitchen of a test's own."""

import pytest

import ssduck


@pytest.fixture
def kitchen():
    with ssduck.load("kitchen") as ss:
        yield ss.call_variable("kitchen")
