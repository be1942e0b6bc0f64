"""Defines the graph result forms: networkx graphs and Graphviz texts of related entities."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, TypeAlias

from ssduck.adapters.base import Selection, form
from ssduck.adapters.columns import checked_names, plain_value
from ssduck.adapters.display import readable
from ssduck.adapters.logic import Clause, clauses, with_arguments
from ssduck.adapters.optional import library
from ssduck.errors import ArgumentError
from ssduck.formatting import short_repr
from ssduck.language.tree import Call, ListLiteral, Name, Node, Query, This
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
        known = self.entities.setdefault(entity.full_name, entity)
        if known is not entity and known != entity:
            raise ArgumentError(
                f"two worlds have an entity {entity.full_name!r}; a graph needs entities "
                "of one world"
            )
        self.nodes.setdefault(entity.full_name, {})
        return entity.full_name

    def describe(self, entity: Handle, attributes: Mapping[str, Any]) -> None:
        """Adds attributes to the node of an entity."""
        name = self.node(entity)
        _set_attributes(self.nodes[name], attributes, name, "name the columns by to(…, 'name')")

    def connect(self, a: Handle, b: Handle, key: Key, attributes: Mapping[str, Any]) -> None:
        """Adds an edge, or adds attributes to an existing one."""
        start, end = self.node(a), self.node(b)
        edge = self.edges.setdefault((start, end, key), {})
        remedy = "AS graph(multi=True) makes an edge a row"
        _set_attributes(edge, attributes, f"the edge from {start} to {end}", remedy)


def _set_attributes(
    attributes: dict[str, Any], new: Mapping[str, Any], owner: str, remedy: str
) -> None:
    for key, value in new.items():
        if attributes.setdefault(key, value) != value:
            raise ArgumentError(
                f"{owner} would have two values of {key!r}: {short_repr(attributes[key])} and "
                f"{short_repr(value)}; {remedy}"
            )


# -- the network of a query -------------------------------------------------------------------


def _graph_query(query: Query) -> Query:
    """Returns the query itself if it selects entities; else also selects the arguments."""
    if not query.items or any(map(_is_entity, query.items)):
        return query
    return with_arguments(query)


def _is_entity(item: Node) -> bool:
    match item:
        case Call(name="to", arguments=(value, *_)):
            return _is_entity(value)
        case Name(name=name) | Call(name=name):
            return name in _ENTITIES
    return isinstance(item, This)


# Functions that return the entity itself.
_ENTITIES = frozenset(("obj", "robot", "kinbody", "sensor"))


def _selects_relations(query: Query) -> bool:
    match query.items:
        case (Call(name="to", arguments=(ListLiteral(), _)), *_):
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
    entities = [value for value in clause.arguments if isinstance(value, Handle)]
    relation, result = clause.relation, clause.result
    if isinstance(result, Handle):
        entities, result = [*entities, result], True
    for entity in entities:
        network.node(entity)
    match entities:
        case (a, b):
            if result is not False and result is not None:
                network.connect(a, b, key, {relation: plain_value(result)})
        case (only,):
            network.describe(only, {relation: plain_value(result)})
        case _:
            raise ArgumentError(
                f"{relation} has {len(entities)} entities; an edge has two, and a node one"
            )


def _add_row(network: _Network, names: tuple[str, ...], row: tuple[Any, ...], key: Key) -> None:
    """Adds a row: an edge between its first two entities, with the other columns as attributes."""
    entity_columns = [column for column, value in enumerate(row) if isinstance(value, Handle)][:2]
    other_columns = [column for column in range(len(row)) if column not in entity_columns]
    attributes = {
        name: plain_value(row[column])
        for name, column in zip(
            checked_names([names[p] for p in other_columns]), other_columns, strict=True
        )
    }
    match [row[column] for column in entity_columns]:
        case (a, b):
            network.connect(a, b, key, attributes)
        case (only,):
            network.describe(only, attributes)
        case _ if None not in row:  # None stands for a missing entity
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
        # Selected values take precedence: the query's id is a name.
        graph.add_nodes_from([(name, _entity_attributes(network.entities[name]) | attributes)])
    for (a, b, key), attributes in network.edges.items():
        graph.add_edges_from([(a, b, key, attributes) if multi else (a, b, attributes)])
    return graph


def _entity_attributes(entity: Handle) -> dict[str, Any]:
    """Returns the attributes of every node: metres, and quaternions w, x, y, z."""
    return {
        "name": entity.full_name,
        "kind": entity.kind,
        "id": entity.id,
        "position": entity.position,
        "orientation": entity.orientation,
    }


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


_ESCAPES = {"\\": "\\\\", '"': '\\"', "\n": "\\n", "\r": "\\r"}


def _quoted(text: str) -> str:
    r"""Returns a text in quotes for Graphviz, with backslashes, quotes and line ends escaped."""
    return '"' + "".join(_ESCAPES.get(letter, letter) for letter in text) + '"'


NETWORK = (_graph, _dot)
