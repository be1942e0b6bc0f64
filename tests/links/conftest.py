"""The arm and the cube of all tests of links."""

import pytest

from tests.support.cell import Cell


@pytest.fixture(scope="package")
def cell():
    """The arm, the cube and their records."""
    found = Cell()
    yield found
    found.close()
