"""Entities and relations as graphs: AS graph, of networkx, and AS dot, for Graphviz."""

import sys

import networkx as nx
import pydot
import pytest
from hypothesis import given
from hypothesis import strategies as st

import ssduck
from ssduck.adapters.network import _quoted
from ssduck.errors import ArgumentError, UnsupportedError

NINE = {
    *(("table", f"cup_{name}") for name in ("58a2", "905a", "b6af", "d441")),
    *(("table", f"plate_{name}") for name in ("496f", "835a", "fa76")),
    ("microwave", "pin_a091"),
    ("microwave", "pin_c671"),
}
PAIRS = "FROM a=kitchen, b=kitchen WHERE NOT (isSensor(a.this) OR isSensor(b.this))"


def test_a_relation_that_is_false_is_no_edge(kitchen):
    graph = kitchen.eval(f"SELECT above(a.this, b.this) {PAIRS} AS graph;")
    assert isinstance(graph, nx.DiGraph)
    assert set(graph.edges) == NINE
    assert all(told == {"above": True} for _, _, told in graph.edges(data=True))
    assert len(graph) == 29


@pytest.mark.parametrize("columns", ["above(table, this), z", "table, obj, z"])
def test_row_by_row_is_the_same(kitchen, columns):
    with ssduck.Interpreter(row_by_row=True) as ss:
        for name in ("kitchen", "table"):
            ss.add_variable(name, kitchen.call_variable(name))
        query = f"SELECT {columns} FROM kitchen AS graph;"
        assert nx.utils.graphs_equal(ss.eval(query), kitchen.eval(query))
        assert ss.eval(query).number_of_edges() >= 7


def test_what_is_told_of_entities(kitchen):
    graph = kitchen.eval("SELECT volume, isRobot FROM kitchen AS graph;")
    table = kitchen.call_variable("kitchen")["table"]
    assert graph.nodes["table"] == {
        "name": "table",
        "kind": "kinbody",
        "id": table.id,
        "position": table.position,
        "orientation": table.orientation,
        "volume": pytest.approx(0.163113, abs=1e-5),
        "isRobot": False,
    }
    assert (len(graph), graph.number_of_edges()) == (37, 0)


def test_several_relations_of_two_entities(kitchen):
    columns = "above(a.this, b.this), to(distance(a.this, b.this), 'd'), isRobot(a.this)"
    query = f"SELECT {columns} {PAIRS} AND above(a.this, b.this) AS graph"
    graph = kitchen.eval(f"{query};")
    assert set(graph.edges) == NINE
    assert graph["microwave"]["pin_a091"] == {"above": True, "d": pytest.approx(0.8407, abs=1e-3)}
    assert graph.nodes["table"]["isRobot"] is False
    assert "isRobot" not in graph.nodes["pin_a091"]
    multi = kitchen.eval(f"{query}(multi=True);")
    assert isinstance(multi, nx.MultiDiGraph)
    assert set(multi["table"]["cup_58a2"]) == {"above", "d"}
    assert multi.number_of_edges() == 18


def test_entities_that_are_selected_are_the_ends(kitchen):
    graph = kitchen.eval(
        f"SELECT a.this, b.this, distance(a.this, b.this), id(a.this) {PAIRS} "
        "AND above(a.this, b.this) AS graph;"
    )
    assert set(graph.edges) == NINE
    assert graph["microwave"]["pin_a091"] == {
        "distance": pytest.approx(0.8407, abs=1e-3),
        "id": "microwave",
    }


def test_entities_alone(kitchen):
    graph = kitchen.eval("SELECT obj, z FROM kitchen WHERE isRobot(this) AS graph;")
    assert list(graph.nodes) == ["fridge", "cooker", "barrett_4918", "roomba_625x"]
    assert graph.nodes["fridge"]["z"] == 1.55
    assert set(kitchen.eval("SELECT robot FROM kitchen AS graph;")) == set(graph)
    assert len(kitchen.eval("SELECT * FROM kitchen AS graph;")) == 37
    assert len(kitchen.eval("SELECT obj FROM kitchen WHERE False AS graph;")) == 0


def test_columns_come_before_what_is_told_of_every_entity(kitchen):
    for query in ("SELECT obj, id FROM kitchen", "SELECT id, isRobot FROM kitchen"):
        graph = kitchen.eval(f"{query} AS graph;")
        assert graph.nodes["table"]["id"] == graph.nodes["table"]["name"] == "table"


def test_a_relation_that_gives_an_entity_is_an_edge_to_it(kitchen):
    kitchen.add_function("owner", lambda thing: kitchen.call_variable("kitchen")["table"])
    graph = kitchen.eval("SELECT owner FROM kitchen WHERE isRobot(this) AS graph;")
    assert set(graph.edges) == {
        (name, "table") for name in ("fridge", "cooker", "barrett_4918", "roomba_625x")
    }


REFUSED = [
    ("SELECT z * 2 FROM kitchen", "to\\(…, 'name'\\)"),
    ("SELECT getTime() FROM kitchen", "no column holds an entity"),
    (
        f"SELECT a.this, b.this, c.this {PAIRS.replace('WHERE', ', c=[1, 2] WHERE')} AND above(a.this, b.this)",
        "two values of 'c'.*multi=True",
    ),
    (f"SELECT a.this, to(id(b.this), 'b') {PAIRS}", "two values of 'b'.*; name the columns"),
    ("SELECT getTime(), isRobot FROM kitchen", "getTime has 0 entities"),
]


@pytest.mark.parametrize(("query", "message"), REFUSED)
def test_what_is_no_graph(kitchen, query, message):
    with pytest.raises(ssduck.SelectScriptError, match=message):
        kitchen.eval(f"{query} AS graph;")


@pytest.mark.slow
def test_entities_of_several_ticks_are_no_graph(kitchen):
    with ssduck.load("kitchen") as ss:
        ss.call_variable("kitchen").step()
        with pytest.raises(ArgumentError, match="several ticks of 'kitchen'"):
            ss.eval("SELECT obj FROM kitchen{} AS graph;")
        moved = ss.eval("SELECT obj FROM kitchen{0.0} AS graph;")
        assert moved.nodes["table"]["position"] == ss.call_variable("kitchen")["table"].position


@pytest.mark.slow
def test_entities_of_one_name_are_no_graph(kitchen):
    with ssduck.load("kitchen") as other:
        kitchen.add_variable("other", other.call_variable("kitchen"))
        with pytest.raises(ArgumentError, match="two worlds have an entity"):
            kitchen.eval("SELECT a.this, b.this FROM a=kitchen, b=other AS graph;")


def test_networkx_is_an_extra(kitchen, monkeypatch):
    monkeypatch.setitem(sys.modules, "networkx", None)
    with pytest.raises(UnsupportedError, match=r"AS graph: networkx .* 'ssduck\[graph\]'"):
        kitchen.eval("SELECT obj FROM kitchen AS graph;")
    assert kitchen.eval("SELECT obj FROM kitchen AS dot;").startswith("digraph {")


# pydot calls pyparsing's functions by names that are to go.
of_pydot = pytest.mark.filterwarnings("ignore:.* deprecated - use:DeprecationWarning")

# -- dot ---------------------------------------------------------------------------------------


def parsed(text):
    """A text for Graphviz as pydot reads it, quotes taken off."""
    (graph,) = pydot.graph_from_dot_data(text)
    nodes = {unquoted(n.get_name()): n.get_attributes() for n in graph.get_nodes()}
    edges = [
        (unquoted(e.get_source()), unquoted(e.get_destination()), e.get_attributes())
        for e in graph.get_edges()
    ]
    return nodes, edges


def unquoted(text):
    """What Graphviz shows of a quoted text."""
    assert text[0] == text[-1] == '"'
    letters, found = iter(text[1:-1]), []
    for letter in letters:
        escaped = next(letters) if letter == "\\" else None
        found.append(letter if escaped is None else {"n": "\n", "r": "\r"}.get(escaped, escaped))
    return "".join(found)


@pytest.mark.slow
@of_pydot
def test_dot_of_the_kitchen(kitchen):
    columns = "above(a.this, b.this), to(distance(a.this, b.this), 'd'), isRobot(a.this)"
    query = f"SELECT {columns} {PAIRS} AND above(a.this, b.this) AS dot;"
    nodes, edges = parsed(kitchen.eval(query))
    assert {(a, b) for a, b, _ in edges} == NINE
    assert len(edges) == 9
    labels = {(a, b): unquoted(told["label"]) for a, b, told in edges}
    assert labels["microwave", "pin_a091"] == "above\nd = 0.840657"
    assert unquoted(nodes["table"]["label"]) == "table\nisRobot = False"
    assert nodes["table"]["shape"] == "ellipse"


@pytest.mark.slow
@of_pydot
def test_dot_draws_an_edge_a_row(kitchen):
    several = PAIRS.replace("FROM", "FROM s=[1, 2],")
    text = kitchen.eval(
        f"SELECT a.this, b.this, to(s.this, 'side') {several} AND above(a.this, b.this) AS dot;"
    )
    _, edges = parsed(text)
    assert len(edges) == 18
    assert {unquoted(told["label"]) for _, _, told in edges} == {"side = 1", "side = 2"}
    plain = kitchen.eval(f"SELECT a.this, b.this {PAIRS} AND above(a.this, b.this) AS dot;")
    assert '"table" -> "cup_58a2";' in plain


@pytest.mark.slow
@of_pydot
@given(st.text(st.characters(codec="utf-8", exclude_characters="\0"), min_size=1))
def test_quoted_texts_are_shown_as_they_are(text):
    quoted = _quoted(text)
    assert unquoted(quoted) == text
    nodes, edges = parsed(f"digraph {{ {quoted} [label={quoted}]; {quoted} -> {quoted}; }}")
    assert [unquoted(node["label"]) for node in nodes.values()] == [text]
    assert list(nodes) == [text]
    assert [edge[:2] for edge in edges] == [(text, text)]
