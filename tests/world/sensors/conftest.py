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


@pytest.fixture
def walled(mast):
    """The world of the mast, with a wall 1.5 m ahead of it."""
    mast.box("wall", [0.5, 9, 9], [2, 0, 0])
    return mast.open()
