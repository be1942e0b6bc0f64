"""Entities and what is between them as graphs: networkx's, and Graphviz' text."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, TypeAlias

from ssduck.adapters.base import Adapter, Selection
from ssduck.adapters.clauses import Clause, clauses, with_arguments
from ssduck.adapters.columns import distinct, plain_value
from ssduck.adapters.display import readable
from ssduck.adapters.optional import library
from ssduck.errors import ArgumentError
from ssduck.formatting import short_repr
from ssduck.language.tree import Call, ListLiteral, Name, Node, Query, This
from ssduck.world.entities import Entity

# None, or of several edges between two nodes the relation or the number of the row.
Key: TypeAlias = str | int | None


@dataclass
class _Network:
    """Nodes and directed edges with attributes.

    Attributes:
        entities: by name.
        nodes: what is told of each, beside what it is.
        edges: what is told of each, by from, to, and what tells it from others between these.
    """

    entities: dict[str, Entity] = field(default_factory=dict)
    nodes: dict[str, dict[str, Any]] = field(default_factory=dict)
    edges: dict[tuple[str, str, Key], dict[str, Any]] = field(default_factory=dict)

    def node(self, entity: Entity) -> str:
        """The name of an entity's node, which is made if it is not there."""
        known = self.entities.setdefault(entity.name, entity)
        if known is not entity and known != entity:
            raise ArgumentError(
                f"two worlds have an entity that is called {entity.name!r}; a graph is of one"
            )
        self.nodes.setdefault(entity.name, {})
        return entity.name

    def tell(self, entity: Entity, told: Mapping[str, Any]) -> None:
        """Tell something of an entity."""
        name = self.node(entity)
        _put(self.nodes[name], told, name, "name the columns by to(…, 'name')")

    def connect(self, a: Entity, b: Entity, key: Key, told: Mapping[str, Any]) -> None:
        """Add an edge, or tell more of the one that is there."""
        start, end = self.node(a), self.node(b)
        attributes = self.edges.setdefault((start, end, key), {})
        remedy = "AS graph(multi=True) makes an edge a row"
        _put(attributes, told, f"the edge from {start} to {end}", remedy)


def _put(attributes: dict[str, Any], told: Mapping[str, Any], what: str, remedy: str) -> None:
    for key, value in told.items():
        if attributes.setdefault(key, value) != value:
            raise ArgumentError(
                f"{what} would be given two values of {key!r}: {short_repr(attributes[key])} and "
                f"{short_repr(value)}; {remedy}"
            )


# -- what is asked ----------------------------------------------------------------------------


def _asked(query: Query) -> Query:
    """The query itself if it selects entities; else its relations with their arguments."""
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


# Functions that give the entity itself.
_ENTITIES = frozenset(("obj", "robot", "kinbody", "sensor"))


def _is_of_relations(query: Query) -> bool:
    match query.items:
        case (Call(name="to", arguments=(ListLiteral(), _)), *_):
            return not any(map(_is_entity, query.items))
    return False


def _network(selection: Selection, *, multi: bool) -> _Network:
    network = _Network()
    selection.worlds  # noqa: B018  # is an error if the entities are of several ticks
    if _is_of_relations(selection.query):
        for clause in clauses(selection):
            _add_clause(network, clause, clause.relation if multi else None)
        return network
    names = selection.columns
    for index, row in enumerate(selection.rows):
        _add_row(network, names, row, index if multi else None)
    return network


def _add_clause(network: _Network, clause: Clause, key: Key) -> None:
    """Of two entities an edge, of one something that is told of it."""
    entities = [value for value in clause.arguments if isinstance(value, Entity)]
    relation, result = clause.relation, clause.result
    if isinstance(result, Entity):
        entities, result = [*entities, result], True
    for entity in entities:
        network.node(entity)
    match entities:
        case (a, b):
            if result is not False and result is not None:
                network.connect(a, b, key, {relation: plain_value(result)})
        case (only,):
            network.tell(only, {relation: plain_value(result)})
        case _:
            raise ArgumentError(
                f"{relation} is of {len(entities)} entities; an edge is of two, and a node one"
            )


def _add_row(network: _Network, names: tuple[str, ...], row: tuple[Any, ...], key: Key) -> None:
    """The first two entities are an edge, the other columns what is told of it."""
    places = [place for place, value in enumerate(row) if isinstance(value, Entity)][:2]
    others = [place for place in range(len(row)) if place not in places]
    told = {
        name: plain_value(row[place])
        for name, place in zip(distinct([names[p] for p in others]), others, strict=True)
    }
    match [row[place] for place in places]:
        case (a, b):
            network.connect(a, b, key, told)
        case (only,):
            network.tell(only, told)
        case _ if None not in row:  # which stands for an entity that there is not
            raise ArgumentError(f"a row has no entity: {short_repr(row)}")


# -- forms ------------------------------------------------------------------------------------


def _graph(selection: Selection, multi: bool = False) -> Any:
    networkx = library("networkx", "graph")
    network = _network(selection, multi=multi)
    graph = networkx.MultiDiGraph() if multi else networkx.DiGraph()
    for name, told in network.nodes.items():
        # What the query tells comes first: its id is a name.
        graph.add_nodes_from([(name, _facts(network.entities[name]) | told)])
    for (a, b, key), told in network.edges.items():
        graph.add_edges_from([(a, b, key, told) if multi else (a, b, told)])
    return graph


def _facts(entity: Entity) -> dict[str, Any]:
    """What is told of every entity: metres, and quaternions w, x, y, z."""
    return {
        "name": entity.name,
        "kind": entity.kind,
        "id": entity.id,
        "position": entity.position,
        "orientation": entity.orientation,
    }


_SHAPES = {"robot": "box", "kinbody": "ellipse", "sensor": "diamond"}


def _dot(selection: Selection) -> str:
    network = _network(selection, multi=not _is_of_relations(selection.query))
    lines = ["digraph {"]
    for name, told in network.nodes.items():
        label = _quoted("\n".join([name, *_labels(told)]))
        shape = _SHAPES[network.entities[name].kind]
        lines.append(f"    {_quoted(name)} [label={label}, shape={shape}];")
    for (a, b, _), told in network.edges.items():
        label = f" [label={_quoted(chr(10).join(_labels(told)))}]" if told else ""
        lines.append(f"    {_quoted(a)} -> {_quoted(b)}{label};")
    return "\n".join([*lines, "}"]) + "\n"


def _labels(told: Mapping[str, Any]) -> list[str]:
    """A line each: the name alone of what is True."""
    return [key if value is True else f"{key} = {readable(value)}" for key, value in told.items()]


_ESCAPES = {"\\": "\\\\", '"': '\\"', "\n": "\\n", "\r": "\\r"}


def _quoted(text: str) -> str:
    r"""A text as Graphviz shows it: in a label \\ is a backslash and \n ends a line."""
    return '"' + "".join(_ESCAPES.get(letter, letter) for letter in text) + '"'


NETWORK = (
    Adapter(
        ("graph",),
        "A networkx graph: entities are nodes, relations of two directed edges. Extra: graph.",
        _graph,
        needs="entities",
        select=_asked,
    ),
    Adapter(
        ("dot",),
        "The same graph as a text for Graphviz, each edge with its relations.",
        _dot,
        needs="entities",
        select=_asked,
    ),
)
