"""Fixtures of the tests in this folder."""

import pytest

from tests.support.stage import Stage


@pytest.fixture(scope="module")
def stage():
    """A PyBullet client of a module, for the worlds that it asks and never changes."""
    with Stage() as stage:
        yield stage
