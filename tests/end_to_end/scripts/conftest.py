"""Fixtures of the tests in this folder."""

import pytest

import ssduck

EVALUATORS = {"compiled": {}, "row by row": {"row_by_row": True}}


@pytest.fixture(params=EVALUATORS)
def ss(request):
    with ssduck.Interpreter(**EVALUATORS[request.param]) as found:
        yield found
