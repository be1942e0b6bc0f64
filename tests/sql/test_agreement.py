"""SQL and row by row give the same: programs made at random, in both evaluators."""

from functools import cache

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.support.cases import generated
from tests.support.choices import Choices, seeded
from tests.support.evaluators import evaluators, shrunk
from tests.support.grammar import program

pytestmark = pytest.mark.slow

SEEDS = range(generated(250))
BUNCH = 25


@cache
def below(bound):
    return st.integers(0, bound - 1)


@st.composite
def programs(draw):
    return program(Choices(lambda bound: draw(below(bound))))


@pytest.fixture(scope="module")
def both():
    with evaluators() as found:
        yield found


@pytest.mark.parametrize("first", range(0, len(SEEDS), BUNCH))
def test_they_agree(both, first):
    for seed in range(first, first + BUNCH):
        choices = seeded(seed)
        if both.disagreement(program(choices)) is not None:
            small = shrunk(choices.taken, lambda text: both.disagreement(text) is not None)
            pytest.fail(f"seed {seed}: {both.disagreement(small)}")


@settings(suppress_health_check=list(HealthCheck))
@given(text=programs())
def test_they_agree_on_what_hypothesis_finds(both, text):
    assert both.disagreement(text) is None
