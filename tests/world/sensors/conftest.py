"""Fixtures of the tests in this folder."""

from __future__ import annotations

import pytest

from tests.support.sensing import Stage

pybullet = pytest.importorskip("pybullet")


@pytest.fixture
def stage():
    made = Stage()
    yield made
    if pybullet.isConnected(made.client):
        pybullet.disconnect(made.client)


@pytest.fixture
def mast(stage):
    """A stage with a small body at its origin to put sensors on."""
    stage.sphere("mast", 0.01, [0, 0, 0])
    return stage
