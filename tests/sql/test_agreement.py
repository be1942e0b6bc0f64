"""SQL and row by row give the same: programs made at random, and square roots, in both evaluators."""

from functools import cache

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import ssduck
from ssduck.errors import UnsupportedError
from tests.support.cases import generated
from tests.support.choices import Choices, seeded
from tests.support.evaluators import evaluators, shrunk
from tests.support.grammar import program

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


@pytest.mark.slow
@pytest.mark.parametrize("first", range(0, len(SEEDS), BUNCH))
def test_they_agree(both, first):
    for seed in range(first, first + BUNCH):
        choices = seeded(seed)
        if both.disagreement(program(choices)) is not None:
            small = shrunk(choices.taken, lambda text: both.disagreement(text) is not None)
            pytest.fail(f"seed {seed}: {both.disagreement(small)}")


@pytest.mark.slow
@settings(suppress_health_check=list(HealthCheck))
@given(text=programs())
def test_they_agree_on_what_hypothesis_finds(both, text):
    assert both.disagreement(text) is None


# -- square roots: to the last bit, and in errors ---------------------------------------------

LISTS = ("[0.0, -0.0, 1.0, 2.0, 1e308, 5e-324]", "[-4.0, 9.0]", "[3, 0, -2]", "[1e200, -1e200]")
ROOTS = (
    "sqrt(this)", "sqrt(this ^ 2)", "sqrt(this ^ 3)", "sqrt(abs(this))", "sqrt(this * this)",
    "sqrt(abs(this) + this ^ 2)", "sqrt(this ^ 2 - 1)", "sqrt(sqrt(abs(this)) * abs(this))",
    "sqrt(-this)", "sqrt(this + abs(this))", "1.0 / sqrt(abs(this))", "sqrt(this) < 2",
)  # fmt: skip
# Of entities; those of a sum of squares cannot fail.
OF_ENTITIES = (
    "sqrt(x(this)^2 + y(this)^2 + z(this)^2)",
    "sqrt(abs(x(this)))",
    "-sqrt((x(this) - 0.1)^2 + 4)",
    "sqrt(x(this))",
    "sqrt(z(this) - 0.3)",
)


@pytest.mark.parametrize("root", ROOTS)
@pytest.mark.parametrize("numbers", LISTS)
def test_square_roots_are_python_s(both, root, numbers):
    assert both.disagreement(f"SELECT {root} FROM {numbers} AS list;") is None
    condition = f"SELECT this FROM {numbers} WHERE this > 0 AND {root} >= 1 AS list;"
    assert both.disagreement(condition) is None


def test_a_root_of_a_negative_number_is_an_error_of_the_language(both):
    with pytest.raises(ssduck.SelectScriptError, match="sqrt does not take -"):
        both.sql.eval("SELECT sqrt(x(this)) FROM w AS list;")


def test_an_engine_that_gives_nan_gets_no_root_that_may_fail(both):
    both.refresh(both.sql)
    portable = both.sql.compile(f"SELECT {OF_ENTITIES[1]} AS r FROM w;")
    assert "SQRT(" in portable.sql(dialect="spark")
    with pytest.raises(UnsupportedError, match="ERROR"):
        both.sql.compile("SELECT sqrt(x(this)) AS r FROM w;").sql(dialect="spark")
