"""Square roots are SQL, and give what Python gives, to the last bit and in errors."""

import pytest

import ssduck
from ssduck.errors import UnsupportedError
from tests.support.evaluators import evaluators

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


@pytest.fixture(scope="module")
def both():
    with evaluators() as found:
        yield found


@pytest.mark.parametrize("root", ROOTS)
@pytest.mark.parametrize("numbers", LISTS)
def test_they_are_python_s(both, root, numbers):
    assert both.disagreement(f"SELECT {root} FROM {numbers} AS list;") is None
    condition = f"SELECT this FROM {numbers} WHERE this > 0 AND {root} >= 1 AS list;"
    assert both.disagreement(condition) is None


def test_a_negative_number_is_an_error_of_the_language(both):
    with pytest.raises(ssduck.SelectScriptError, match="sqrt does not take -"):
        both.sql.eval("SELECT sqrt(x(this)) FROM w AS list;")


def test_an_engine_that_gives_nan_gets_no_root_that_may_fail(both):
    both.refresh(both.sql)
    portable = both.sql.compile(f"SELECT {OF_ENTITIES[1]} AS r FROM w;")
    assert "SQRT(" in portable.sql(dialect="spark")
    with pytest.raises(UnsupportedError, match="ERROR"):
        both.sql.compile("SELECT sqrt(x(this)) AS r FROM w;").sql(dialect="spark")
