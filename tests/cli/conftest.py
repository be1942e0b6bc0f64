"""Fixtures of the tests in this folder."""

import pytest

from tests.support.command_line import write_scene


@pytest.fixture
def here(tmp_path, monkeypatch):
    """The current folder, with a scene in it."""
    monkeypatch.chdir(tmp_path)
    return write_scene(tmp_path)
