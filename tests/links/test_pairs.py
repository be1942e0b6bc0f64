"""Pairs of links, and of links and entities, are found at once, as those of entities are."""

from collections import Counter
from itertools import pairwise

import pytest

import ssduck
from ssduck.geometry import queries
from ssduck.geometry.narrow_phase import NarrowPhase
from ssduck.schema import LINK_FACTOR
from tests.support.cases import sampled

SOURCES = [("links(sim)", "links(sim)"), ("links(sim)", "sim"), ("sim", "links(sim)")]
EXACT = [
    ("near(a.this, b.this, 0.01)", "all_within"),
    ("touching(a.this, b.this)", "all_touching"),
    ("collides(a.this, b.this)", "all_colliding"),
    ("collides(b.this, a.this, 0.001)", "all_colliding"),
]
CANDIDATES = [f"{name}(a.this, b.this)" for name in ("on", "supports", "contains", "enclosed")]


def pairs_of(condition, sources):
    return (
        f"SELECT a.this, b.this FROM a = {sources[0]}, b = {sources[1]} WHERE {condition} AS list;"
    )


def rows_of(ss, program):
    values = iter(ss.eval(program))
    return list(zip(values, values, strict=True))


def names_in(ss, program):
    return [(a.full_name, b.full_name) for a, b in rows_of(ss, program)]


@pytest.fixture
def calls(monkeypatch):
    """The calls of the narrow phase by method: for one pair, or for all pairs."""
    counts = Counter()

    def counting(name, method):
        def counted(self, *arguments):
            counts[name] += 1
            return method(self, *arguments)

        return counted

    for name in ("clearance", "touches", "collides", "all_pairs"):
        monkeypatch.setattr(NarrowPhase, name, counting(name, getattr(NarrowPhase, name)))
    return counts


@pytest.mark.slow
@pytest.mark.parametrize("sources", SOURCES, ids=" ".join)
@sampled(("condition", "search"), EXACT, ids=[row[0] for row in EXACT], every=2)
def test_pairs_are_those_of_each_pair(cell, condition, search, sources):
    by_sql, row_by_row = (names_in(ss, pairs_of(condition, sources)) for ss in cell.interpreters)
    assert by_sql == row_by_row
    assert len(by_sql) > 2
    assert search in cell.ss.explain(pairs_of(condition, sources)).lower()


@pytest.mark.slow
@pytest.mark.parametrize("sources", SOURCES, ids=" ".join)
@sampled("condition", [*CANDIDATES, "restsOn(a.this, b.this)"], every=2)
def test_candidate_pairs_are_those_of_each_pair(cell, condition, sources):
    by_sql, row_by_row = (names_in(ss, pairs_of(condition, sources)) for ss in cell.interpreters)
    assert by_sql == row_by_row
    assert by_sql or condition.startswith(("contains", "enclosed", "restsOn"))


@pytest.mark.parametrize("sources", SOURCES, ids=" ".join)
def test_one_search_finds_all_pairs(cell, calls, sources):
    """A tick of its own has no results yet."""
    program = pairs_of("near(a.this, b.this, 0.02)", sources)
    expected = names_in(cell.ss, program)
    calls.clear()
    with ssduck.Interpreter(recording=None) as ss:
        ss.add_variable("maybe", cell.world.what_if({}))
        assert names_in(ss, program.replace("sim", "maybe")) == expected
    assert calls == {"all_pairs": 1}


def test_single_pairs_turn_into_one_search(cell):
    """Many pairs, asked about one by one, are compared at once: links with links alone."""
    program = (
        "SELECT a.this, b.this FROM links(sim) a, links(sim) b WHERE near(a, b, 0.011) AS list;"
    )
    shapes = cell.world.snapshot.shapes().links
    ids = [link.id for entity in cell.world for link in entity.links]
    found = {(a, b) for a in ids for b in ids if a != b and shapes.near(a, b, 0.011)}
    assert found == {(a.id, b.id) for a, b in rows_of(cell.ss, program)}
    entities = [entity.id for entity in cell.world]
    both = cell.world.snapshot.shapes().links_and_entities
    mixed = {
        (a, b) for a in ids for b in entities if a % LINK_FACTOR != b and both.near(a, b, 0.011)
    }
    owners = {(a, b % LINK_FACTOR) for a, b in found if (a - b) % LINK_FACTOR}
    assert mixed == owners


@pytest.mark.slow
@pytest.mark.parametrize("relation", ["clearance(a.this, b.this)", "near(a.this, b.this, 0.0)"])
def test_links_that_overlap_are_found_at_once(cell, calls, monkeypatch, relation):
    """Neighbours overlap; one by one, each of them takes long."""
    program = (
        f"SELECT {relation} FROM a = links(sim.panda), b = links(sim.panda) "
        "WHERE a.this != b.this AS list;"
    )
    results = []
    for single_pairs in (10_000, queries.MAX_SINGLE_OWN_PAIRS):
        monkeypatch.setattr(queries, "MAX_SINGLE_OWN_PAIRS", single_pairs)
        with ssduck.Interpreter(recording=None) as ss:
            ss.add_variable("sim", cell.world.what_if({}))
            calls.clear()
            results.append((ss.eval(program), calls["clearance"], calls["all_pairs"]))
    (one_by_one, single_calls, _), (at_once, fewer_calls, searches) = results
    assert at_once == one_by_one
    assert 0.0 in at_once or True in at_once
    assert fewer_calls < single_calls
    assert searches == 1


def test_results_are_in_the_order_of_links(cell):
    order = [link.full_name for entity in cell.world for link in entity.links]
    found = names_in(cell.ss, pairs_of("near(a.this, b.this, 0.01)", SOURCES[0]))
    places = [(order.index(a), order.index(b)) for a, b in found]
    assert all(one < other for one, other in pairwise(places))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("table", "condition"),
    [
        ("link_pairs_within(0.01)", "near(a.this, b.this, 0.01)"),
        ("link_pairs_within(-1)", "near(a.this, b.this, -1)"),
        ("colliding_link_pairs()", "collides(a.this, b.this)"),
        ("colliding_link_pairs(depth := 0.001)", "collides(a.this, b.this, 0.001)"),
    ],
)
@pytest.mark.parametrize("place", ["", "sim."])
def test_pairs_of_links_are_tables(cell, table, condition, place):
    with ssduck.Interpreter(recording=None) as ss:
        ss.add_variable("sim", cell.world)
        rows = ss.sql(
            f"SELECT a.full_name, b.full_name FROM {place}{table} p JOIN links a ON a.id = p.a "
            "JOIN links b ON b.id = p.b"
        ).fetchall()
        expected = names_in(ss, pairs_of(condition, SOURCES[0]))
    assert sorted(rows) == sorted(expected)
    assert bool(rows) is ("-1" not in table)


BESIDE = (("links(kitchen)", "links(kitchen)"), ("kitchen", "links(kitchen)"))


@pytest.fixture(scope="module")
def ss():
    with ssduck.load("kitchen") as interpreter:
        assert len(interpreter.eval("SELECT id(this) FROM kitchen WHERE isSensor(this);")) > 1
        yield interpreter


@pytest.mark.slow
@pytest.mark.parametrize("condition", ["touching(a.this, b.this)", "on(a.this, b.this)"])
@pytest.mark.parametrize(("first", "second"), BESIDE)
def test_at_once_is_one_by_one(ss, first, second, condition):
    selected = f"SELECT str(a.this), str(b.this) FROM a={first}, b={second} WHERE {condition}"
    at_once, one_by_one = (
        ss.eval(f"{selected}{more} AS list;") for more in ("", " AND z(a.this) > -1e9")
    )
    pairs = [sorted(zip(found[::2], found[1::2], strict=True)) for found in (at_once, one_by_one)]
    assert pairs[0]
    assert pairs[0] == pairs[1]
