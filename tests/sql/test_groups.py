"""Groups, aggregates and DISTINCT run in SQL, and give what the evaluator of the language gives."""

from fractions import Fraction

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import ssduck
from tests.support.evaluators import evaluators, is_same

# What SQL has, and what is left to Python.
ITEMS = (
    *("count(*)", "count(z)", "count(DISTINCT kind)", "count(DISTINCT this)", "sum(z)", "avg(x)"),
    *("avg(mass * 2 - z)", "min(id)", "max(z) - min(z)", "median(z)", "sum(isRobot)", "sum(tick)"),
    *("avg(tick)", "max(isRobot)", "kind", "this", "z", "5", "n", "-max(z) + n", "count(*) * 2"),
    *("avg(distance(this, [0, 0, 1]))", "sum(CASE WHEN z > 0.5 THEN 1 ELSE 0 END)"),
    *("max(above(w.table, this))", "CASE WHEN count(*) > 2 THEN 'many' ELSE kind END"),
)
OTHERS = ("stddev(z)", "uniq(kind)", "sum(position)", "median(tick)")
KEYS = ("kind", "id", "this", "z > 0.5", "tick", "mass", "kind, id", "isRobot, z", "5, kind")
CLAUSES = {
    "where": ("", "WHERE z > 0.4", "WHERE z > 100", "WHERE NOT isSensor"),
    "having": ("", "", "HAVING count(*) > 1", "HAVING max(z) > 0.3 AND min(id) != 'cup'"),
    "order": ("", "ORDER BY z DESC", "ORDER BY count(*) DESC, kind", "ORDER BY avg(z), id"),
    "limit": ("", "", "LIMIT 2", "LIMIT 1 OFFSET 1", "LIMIT 0"),
    "form": ("", "AS list", "AS value"),
}
SOURCES = ("w", "w{-0.02}")


@pytest.fixture(scope="module")
def both():
    """Both evaluators, on a world whose box and cup have moved."""
    with evaluators() as found:
        for tick in range(6):
            found.world["box"].move([0.1 * tick, 0.0, 0.75])
            found.world["cup"].move([0.2, 0.3 / (1 + tick), 0.7])
            found.world.step()
        yield found


@st.composite
def programs(draw, others):
    """A query with groups, or with one group of all rows, or the distinct rows."""
    clauses = {name: draw(st.sampled_from(texts)) for name, texts in CLAUSES.items()}
    source = draw(st.sampled_from(SOURCES))
    rest = f"FROM {source} {clauses['where']}"
    end = f"{clauses['limit']} {clauses['form']};"
    kind = draw(st.sampled_from(("groups", "groups", "all", "distinct")))
    if kind == "distinct":
        columns = draw(
            st.sampled_from(("kind", "kind, this", "kind, z > 0.5 AS high", "kind, position"))
        )
        order = draw(st.sampled_from(("", "ORDER BY z DESC", "ORDER BY kind, id DESC")))
        return f"SELECT DISTINCT {columns} {rest} {order} {end}"
    chosen = draw(st.lists(st.sampled_from(ITEMS + others), min_size=1, max_size=3))
    items = ", ".join(f"{item} AS c{place}" for place, item in enumerate(chosen))
    if kind == "all":
        return f"SELECT {items} {rest} {clauses['having']} {end}"
    key = draw(st.sampled_from(KEYS))
    return f"SELECT {items} {rest} GROUP BY {key} {clauses['having']} {clauses['order']} {end}"


@settings(suppress_health_check=list(HealthCheck))
@given(text=programs(OTHERS))
def test_groups_are_those_of_the_evaluator(both, text):
    assert both.disagreement(text) is None


@pytest.mark.parametrize("source", SOURCES)
def test_pairs_of_rows_are_grouped(both, source):
    text = (
        f"SELECT a.id, count(*) AS n, min(distance(a.this, b.this)) AS least "
        f"FROM {source} a, {source} b WHERE a.z > b.z GROUP BY a.this, b.kind ORDER BY n;"
    )
    assert both.disagreement(text) is None


def test_what_is_left_to_python_says_for_what(both):
    text = "SELECT kind, stddev(z) AS s FROM w{-0.02} GROUP BY kind;"
    assert "-- left to Python: GROUP BY, for stddev(z)" in both.sql.explain(text)
    assert both.disagreement(text) is None


NUMBERS = st.floats(-1e6, 1e6) | st.floats(allow_nan=False, allow_infinity=False)
LISTS = st.lists(NUMBERS | st.sampled_from((0.1, -0.1, 1e16, -1e16, -0.0)), min_size=1, max_size=9)


@settings(suppress_health_check=list(HealthCheck))
@given(values=LISTS)
def test_sums_are_rounded_once(both, values):
    exact = sum(map(Fraction, values))
    for interpreter in (both.sql, both.rows):
        interpreter.add_variable("values", values)
        (row,) = interpreter.eval(
            "SELECT sum(this + 0.0) AS s, avg(this) AS a, median(this) AS m, max(this) AS top "
            "FROM values HAVING True;"
        )
        try:
            total = float(exact)
        except OverflowError:
            continue
        assert is_same(row["s"], total)
        assert row["a"] == total / len(values)
        ordered = sorted(values)
        assert row["m"] == (ordered[len(values) // 2] + ordered[~(len(values) // 2)]) / 2
        assert row["top"] == max(values)


def test_the_sum_of_many_numbers_has_one_value(both):
    """However DuckDB shares the rows among its threads."""
    values = [(-1.0) ** n * 0.1 * n for n in range(300_000)]
    both.sql.add_variable("values", values)
    text = "SELECT sum(this + 0.0) AS s FROM values HAVING True AS value;"
    assert both.sql.eval(text) == float(sum(map(Fraction, values)))


@pytest.mark.parametrize(
    ("first", "second"),
    [(["x", "x, y"], ["y, z", "z"]), (["None", "x"], [None]), ([0.0, -0.0], [1, 2])],
)
def test_groups_whose_keys_are_printed_alike_are_one(both, first, second):
    for interpreter in (both.sql, both.rows):
        interpreter.add_variable("p", first)
        interpreter.add_variable("q", second)
    text = "SELECT a.this AS k, count(*) AS n FROM a=p, b=q GROUP BY a.this, b.this LIMIT 1;"
    assert both.sql.eval(text) == both.rows.eval(text)


def test_no_rows_have_one_group_without_keys(both):
    for items in ("count(*) AS n, max(z) AS m", "sum(z) AS s, avg(z) AS a", "sum(tick) AS s"):
        assert both.disagreement(f"SELECT {items} FROM w{{-0.02}} WHERE z > 100;") is None
        assert (
            both.disagreement(f"SELECT {items} FROM w{{-0.02}} WHERE z > 100 GROUP BY kind;")
            is None
        )


def test_variables_beside_aggregates_change_between_runs(both):
    text = "SELECT kind, v AS v, max(z) > v AS high FROM w GROUP BY kind HAVING count(*) > v;"
    for number in (0.5, 1.5, 2.5, 0.5, 3, 0, 1, 2):
        for interpreter in (both.sql, both.rows):
            interpreter.add_variable("v", number)
        assert is_same(both.sql.eval(text), both.rows.eval(text))
    assert both.sql.eval("SELECT v AS v, count(*) AS n FROM w WHERE z > 9;") == [{"v": 2, "n": 0}]


def test_an_error_of_a_group_has_its_place(both):
    text = "SELECT 1 / (max(z) - max(z)) AS x FROM w{-0.02} GROUP BY kind;"
    for interpreter in (both.sql, both.rows):
        with pytest.raises(ssduck.SelectScriptError, match="division by zero") as caught:
            interpreter.eval(text)
        assert caught.value.span is not None
        assert text[caught.value.span.start : caught.value.span.end].startswith("1 / (")
