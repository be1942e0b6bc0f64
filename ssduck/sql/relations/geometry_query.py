"""Relations of shapes: the function that computes one, and the pairs for which it is called.

Such a relation is one entry with a `GeometryQuery`, which names a method of `ShapeQueries`
(`ssduck.geometry.queries`). The formula of the relation and the function that DuckDB calls follow
from it. The formula calls the function only for pairs whose boxes are near enough. It states that
condition twice: once for a join to go by, and once for wherever a condition is not a join's.

A `PairSearch` is a method of `ShapeQueries` that finds all pairs of a tick at once, instead of a
condition on each pair; `CandidatePairs` name the search that a relation uses. For relations of a
box and a position, it is a method of `BoxQueries`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

from ssduck.geometry.box_relations import BoxQueries
from ssduck.geometry.pair_batch import QuestionKind
from ssduck.geometry.queries import ShapeQueries

# The largest distance of two shapes of a world that touch by their margins alone, metres.
MARGINS_UDF = "narrow margins"
MARGINS = f'"{MARGINS_UDF}"($world)'
ZERO = "0.0::DOUBLE"

# What the two sides of a pair are, in either order.
PairKind: TypeAlias = Literal["entities", "links", "links and entities"]

# The pairs that the narrow phase compares, as the manual and EXPLAIN state them.
MEETING_BOXES = "on pairs whose boxes meet"
EVERY_PAIR = "on every pair"


def boxes_within(distance: str) -> str:
    """Returns a condition: the boxes of a and b are at most that far apart along each axis.

    A nanometre is allowed for rounding.

    >>> boxes_within("d").partition(" AND ")[0]
    'a.xmin <= b.xmax + (d) + 1e-9'
    """
    far = f"({distance}) + 1e-9"
    sides = [
        f"a.{axis}min <= b.{axis}max + {far} AND b.{axis}min <= a.{axis}max + {far}"
        for axis in "xyz"
    ]
    return " AND ".join(sides)


@dataclass(frozen=True)
class GeometryQuery:
    """A function of the shapes of one entity or two, and the condition under which it is called.

    All expressions are DuckDB's, over the relation's parameters.
    """

    # A method of `ShapeQueries`: it takes the ids of the entities, and numbers.
    function: Callable[..., Any]
    arguments: tuple[str, ...] = ()  # these numbers
    # The largest distance of two boxes at which the function is called, metres; None to call it for
    # every pair.
    bound: str | None = "0"
    otherwise: str = "FALSE"  # the value beyond the bound, and of an entity with itself
    only_if: str = ""  # a further condition; without it the relation is False
    pairs: str = MEETING_BOXES  # the pairs that are compared, for the manual and EXPLAIN
    # Whether the result is at least the distance of the two boxes.
    is_at_least_box_distance: bool = False
    needs_whole_tick: bool = False  # whether the answer depends on all entities of the tick
    uses_margins: bool = False  # whether the collision margins of shapes count
    # Whether the function compares the boxes itself, so that Python need not.
    decides_alone: bool = False
    # The question that it is about two entities at many recorded ticks, if all ticks can be decided
    # at once.
    over_ticks: QuestionKind | None = None

    @property
    def udf_name(self) -> str:
        """The name of the function in SQL."""
        return udf_name(self.function)

    @property
    def is_predicate(self) -> bool:
        """Whether it is a `PairPredicate`, which depends on a distance or a depth."""
        return self.over_ticks in ("colliding", "within", "touching")

    @property
    def needs_single_pair(self) -> bool:
        """Whether it is decided over many ticks only for two entities, not for all near ones."""
        return self.over_ticks in ("clearance", "gap", "resting")

    @property
    def is_zero_beyond_boxes(self) -> bool:
        """Whether the result is 0 where the boxes do not meet."""
        return self.bound == "0" and self.otherwise == ZERO

    def formula(self, entities: Sequence[str]) -> str:
        """Returns the formula of a relation of these entities.

        >>> GeometryQuery(ShapeQueries.volume).formula(["object"])
        '"narrow volume"($world, object.tick, object.id)'
        """
        rows = [f"{entity}.{column}" for entity in entities for column in ("tick", "id")]
        call = f'"{self.udf_name}"({", ".join(("$world", *rows, *self.arguments))})'
        if len(entities) == 1:
            return call
        if tuple(entities[:2]) != ("a", "b"):
            raise ValueError(f"two entities of a relation of shapes are called a and b: {call}")
        if self.only_if:
            call = f"CASE WHEN {self.only_if} THEN {call} ELSE FALSE END"
        differ = "a.id <> b.id"
        if self.bound is None and self.otherwise != "FALSE":
            return f"CASE WHEN a.id = b.id THEN {self.otherwise} ELSE {call} END"
        if self.bound is None:
            return f"{differ} AND CASE WHEN {differ} THEN {call} END"
        near = f"{differ} AND {boxes_within(self.bound)}"
        if self.otherwise == "FALSE":
            return f"({near}) AND CASE WHEN {near} THEN {call} END"
        return f"CASE WHEN {near} THEN {call} WHEN NOT ({near}) THEN {self.otherwise} END"


@dataclass(frozen=True)
class GeometryUdf:
    """A function of the shapes of a tick, as DuckDB calls it: with the name of a world first."""

    function: Callable[..., Any]  # a method of `ShapeQueries`
    entities: int = 0  # how many entities it takes; each is given as its tick and its id
    numbers: int = 0  # how many numbers it takes after them
    result: str = "BIGINT[]"  # DuckDB's type of the result
    needs_whole_tick: bool = False  # whether the answer depends on all entities of the tick
    uses_margins: bool = False  # whether the collision margins of shapes count

    @property
    def name(self) -> str:
        """Its name in SQL."""
        return udf_name(self.function)

    @property
    def parameters(self) -> tuple[str, ...]:
        """DuckDB's types of the parameters."""
        return ("VARCHAR", *["BIGINT"] * (2 * self.entities), *["DOUBLE"] * self.numbers)


@dataclass(frozen=True)
class PairSearch(GeometryUdf):
    """A function that finds all pairs of a tick at once: it takes their kind, and numbers.

    Its function is a method of `ShapeQueries` or of `BoxQueries` that returns `IdPairs`.
    """

    numbers: int = 1  # 1 if the pairs depend on a distance, or a depth
    # Whether the relation holds of all pairs of the search, and need not be checked.
    is_exact: bool = True
    finds_links: bool = True  # whether it also finds pairs of links, and of links and entities
    # Whether it is a method of `BoxQueries`, which needs no shapes. Its pairs are in the order of
    # the table of entities, not of their numbers.
    of_boxes: bool = False

    @property
    def parameters(self) -> tuple[str, ...]:
        """DuckDB's types of the parameters."""
        return ("VARCHAR", "VARCHAR", *["DOUBLE"] * self.numbers)


COLLIDING = PairSearch(ShapeQueries.all_colliding)
WITHIN = PairSearch(ShapeQueries.all_within)
TOUCHING = PairSearch(ShapeQueries.all_touching, uses_margins=True)
# What rests on a link depends on which links stand beside the rest of their entities.
RESTING = PairSearch(ShapeQueries.all_resting, numbers=0, uses_margins=True, finds_links=False)
STACKED = PairSearch(ShapeQueries.all_on, numbers=0, uses_margins=True)
BOXES_MEETING = PairSearch(ShapeQueries.all_meeting, is_exact=False)
# The boxes are grown by the collision margins of their shapes.
BOXES_REACHING = PairSearch(ShapeQueries.all_reaching, is_exact=False, uses_margins=True)
ABOVE, BELOW, INSIDE = (
    PairSearch(function, numbers=0, finds_links=False, of_boxes=True)
    for function in (BoxQueries.all_above, BoxQueries.all_below, BoxQueries.all_inside)
)
# The entities whose pairs are unknown.
UNKNOWN = PairSearch(ShapeQueries.all_unknown, numbers=0)


@dataclass(frozen=True)
class CandidatePairs:
    """The pairs of a tick of which a relation of two entities may hold."""

    search: PairSearch  # finds them
    distance: str = "0"  # metres, a DuckDB expression over parameters that are values
    distance_with_options: str = "0"  # the same with the optional parameters given


# The functions to which it does not matter whether a simulator takes a closed mesh as a solid.
INDIFFERENT_TO_INSIDES = (
    ShapeQueries.inside,
    ShapeQueries.contains,
    ShapeQueries.encloses,
    ShapeQueries.volume,
    ShapeQueries.all_meeting,
    ShapeQueries.all_reaching,
    ShapeQueries.all_unknown,
)


def name_over_ticks(kind: QuestionKind) -> str:
    """Returns the SQL name of the function that answers a question over many recorded ticks."""
    return f"{kind} over ticks"


def udf_name(function: Callable[..., Any]) -> str:
    """Returns the SQL name of a method of `ShapeQueries`; no user's function has a blank."""
    return f"narrow {function.__name__}"
