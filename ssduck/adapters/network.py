"""Defines the graph result forms: networkx graphs and Graphviz texts of related entities."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeAlias

from ssduck.adapters.base import Selection, form
from ssduck.adapters.columns import checked_names, plain_value
from ssduck.adapters.display import readable
from ssduck.adapters.logic import Clause, clauses, with_arguments
from ssduck.adapters.optional import library
from ssduck.errors import ArgumentError
from ssduck.formatting import short_repr
from ssduck.language import ast
from ssduck.world.handles import Handle

# Distinguishes edges between the same nodes: the relation or the row number, None if single.
Key: TypeAlias = str | int | None


@dataclass
class _Network:
    """Nodes and directed edges with attributes."""

    entities: dict[str, Handle] = field(default_factory=dict)
    nodes: dict[str, dict[str, Any]] = field(default_factory=dict)
    edges: dict[tuple[str, str, Key], dict[str, Any]] = field(default_factory=dict)

    def node(self, entity: Handle) -> str:
        """Returns the name of the node of an entity, which it adds if necessary."""
        name = entity.full_name
        if self.entities.setdefault(name, entity) != entity:
            raise ArgumentError(
                f"two worlds have an entity {name!r}; a graph needs entities of one world"
            )
        self.nodes.setdefault(name, {})
        return name

    def add(self, entities: Sequence[Handle], key: Key, attributes: Mapping[str, Any]) -> None:
        """Adds attributes to the edge between two entities, or to the node of a single one."""
        names = [self.node(entity) for entity in entities]
        if len(names) == 1:
            known, owner = self.nodes[names[0]], names[0]
            remedy = "name the columns by to(…, 'name')"
        else:
            start, end = names
            known = self.edges.setdefault((start, end, key), {})
            owner = f"the edge from {start} to {end}"
            remedy = "AS graph(multi=True) makes an edge a row"
        for name, value in attributes.items():
            if known.setdefault(name, value) != value:
                raise ArgumentError(
                    f"{owner} would have two values of {name!r}: {short_repr(known[name])} and "
                    f"{short_repr(value)}; {remedy}"
                )


# -- the network of a query -------------------------------------------------------------------


def _graph_query(query: ast.Query) -> ast.Query:
    """Returns the query itself if it selects entities; else also selects the arguments."""
    if not query.items or any(map(_is_entity, query.items)):
        return query
    return with_arguments(query)


def _is_entity(item: ast.Node) -> bool:
    match item:
        case ast.Call(name="to", arguments=(value, *_)):
            return _is_entity(value)
        case ast.Name(name=name) | ast.Call(name=name):
            return name in _ENTITIES
    return isinstance(item, ast.This)


# Functions that return the entity itself.
_ENTITIES = frozenset(("obj", "robot", "kinbody", "sensor"))


def _selects_relations(query: ast.Query) -> bool:
    match query.items:
        case (ast.Call(name="to", arguments=(ast.ListLiteral(), _)), *_):
            return not any(map(_is_entity, query.items))
    return False


def _network(selection: Selection, *, multi: bool) -> _Network:
    network = _Network()
    selection.worlds  # noqa: B018  # raises an error for entities of several ticks
    if _selects_relations(selection.query):
        for clause in clauses(selection):
            _add_clause(network, clause, clause.relation if multi else None)
        return network
    names = selection.columns
    for index, row in enumerate(selection.timed_rows):
        _add_row(network, names, row, index if multi else None)
    return network


def _add_clause(network: _Network, clause: Clause, key: Key) -> None:
    """Adds a clause: an edge between two entities, or an attribute of a single one."""
    values = (*clause.arguments, clause.result)
    entities = [value for value in values if isinstance(value, Handle)]
    result = True if isinstance(clause.result, Handle) else plain_value(clause.result)
    for entity in entities:
        network.node(entity)
    if len(entities) not in (1, 2):
        raise ArgumentError(
            f"{clause.relation} has {len(entities)} entities; an edge has two, and a node one"
        )
    if len(entities) == 1 or (result is not False and result is not None):
        network.add(entities, key, {clause.relation: result})


def _add_row(network: _Network, names: tuple[str, ...], row: tuple[Any, ...], key: Key) -> None:
    """Adds a row: an edge between its first two entities, with the other columns as attributes."""
    ends = [column for column, value in enumerate(row) if isinstance(value, Handle)][:2]
    others = [column for column in range(len(row)) if column not in ends]
    checked = checked_names([names[column] for column in others])
    if ends:
        values = (plain_value(row[column]) for column in others)
        attributes = dict(zip(checked, values, strict=True))
        network.add([row[column] for column in ends], key, attributes)
    elif None not in row:  # None stands for a missing entity
        raise ArgumentError(f"a row has no entity: {short_repr(row)}")


# -- forms ------------------------------------------------------------------------------------


@form(
    "graph",
    help="A networkx graph: entities are nodes, relations of two entities are directed edges. "
    "Extra: graph.",
    needs="entities",
    select=_graph_query,
)
def _graph(selection: Selection, multi: bool = False) -> Any:
    library("networkx", "graph")
    from ssduck.adapters.entity_graphs import EntityGraph, EntityMultiGraph

    network = _network(selection, multi=multi)
    graph: Any = EntityMultiGraph() if multi else EntityGraph()
    for name, attributes in network.nodes.items():
        entity = network.entities[name]
        described = {key: getattr(entity, key) for key in _OF_NODES}
        # Selected values take precedence: the query's id is a name.
        graph.add_nodes_from([(name, {"name": name} | described | attributes)])
    for (a, b, key), attributes in network.edges.items():
        graph.add_edges_from([(a, b, key, attributes) if multi else (a, b, attributes)])
    return graph


# The attributes of every node, beside its name: metres, and quaternions w, x, y, z.
_OF_NODES = ("kind", "id", "position", "orientation")
_SHAPES = {"robot": "box", "kinbody": "ellipse", "sensor": "diamond", "link": "ellipse"}


@form("dot", needs="entities", select=_graph_query)
def _dot(selection: Selection) -> str:
    """The graph of AS graph as a text for Graphviz, each edge with its relations."""
    network = _network(selection, multi=not _selects_relations(selection.query))
    lines = ["digraph {"]
    for name, attributes in network.nodes.items():
        label = _quoted("\n".join([name, *_labels(attributes)]))
        shape = _SHAPES[network.entities[name].kind]
        lines.append(f"    {_quoted(name)} [label={label}, shape={shape}];")
    for (a, b, _), attributes in network.edges.items():
        label = f" [label={_quoted(chr(10).join(_labels(attributes)))}]" if attributes else ""
        lines.append(f"    {_quoted(a)} -> {_quoted(b)}{label};")
    return "\n".join([*lines, "}"]) + "\n"


def _labels(attributes: Mapping[str, Any]) -> list[str]:
    """Returns a line for each attribute; for True, the name alone."""
    return [
        key if value is True else f"{key} = {readable(value)}" for key, value in attributes.items()
    ]


_ESCAPES = str.maketrans({"\\": "\\\\", '"': '\\"', "\n": "\\n", "\r": "\\r"})


def _quoted(text: str) -> str:
    r"""Returns a text in quotes for Graphviz, with backslashes, quotes and line ends escaped."""
    return f'"{text.translate(_ESCAPES)}"'


NETWORK = (_graph, _dot)
