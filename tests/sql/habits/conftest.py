"""Fixtures of the tests in this folder."""

import pytest

from ssduck.interpreter import query_runner as queries
from tests.support.habits import _interpreter


@pytest.fixture(scope="module")
def world(shared_kitchen):
    return shared_kitchen


@pytest.fixture(scope="module")
def as_sql(world):
    few, queries.FEW_ROWS = queries.FEW_ROWS, 0
    with _interpreter(world) as made:
        yield made
    queries.FEW_ROWS = few


@pytest.fixture(scope="module")
def by_rows(world):
    with _interpreter(world, row_by_row=True) as made:
        yield made


@pytest.fixture(params=["as_sql", "by_rows"])
def ss(request):
    return request.getfixturevalue(request.param)
