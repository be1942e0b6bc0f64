"""Fixtures of the tests in this folder."""

import pytest

from tests.support.sensing import Stage


@pytest.fixture
def stage():
    with Stage() as stage:
        yield stage


@pytest.fixture
def mast(stage):
    """A stage with a small body at its origin to put sensors on."""
    stage.sphere("mast", 0.01, [0, 0, 0])
    return stage
