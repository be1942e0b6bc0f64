"""A record of a few short episodes of an environment, made once a process."""

import shutil

import pytest

from ssduck.lakes.workers import forget_readers
from tests.support.lake_episodes import record_episodes

EPISODES = 5
STEPS = 8


@pytest.fixture(scope="session")
def recorded(tmp_path_factory, archive):
    place = tmp_path_factory.mktemp("lake") / "record"
    return archive.copy(record_episodes, place, EPISODES, 0, STEPS)


@pytest.fixture
def folder(recorded, tmp_path):
    """A copy of the record that a test may change."""
    return shutil.copytree(recorded, tmp_path / "record")


@pytest.fixture(autouse=True, scope="module")
def _readers():
    yield
    forget_readers()
