"""Relations of the shapes themselves, and of their boxes: most ask the narrow phase."""

from __future__ import annotations

from typing import Literal

from ssduck.language.intervals import RELATIONS_OF_INTERVALS
from ssduck.sql.relations.common import A_B, ENTITY
from ssduck.sql.relations.relation import CandidatePairs, Parameter, Relation, ValueType

# A third of the mean of the six sides of two boxes.
_BESIDE = "(" + " + ".join(f"{o}.{s}max - {o}.{s}min" for o in "ab" for s in "xyz") + ") / 18"
_TURNS = {entity: tuple(f"{entity}.q{part}" for part in "wxyz") for entity in "ab"}


def boxes_within(apart: str) -> str:
    """Whether two boxes are that near; a nanometre is allowed for what is rounded."""
    far = f"({apart}) + 1e-9"
    sides = [
        f"a.{axis}min <= b.{axis}max + {far} AND b.{axis}min <= a.{axis}max + {far}"
        for axis in "xyz"
    ]
    return " AND ".join(sides)


def _meet(apart: str = "0") -> str:
    """Whether the boxes of two entities are that near."""
    return f"a.id <> b.id AND {boxes_within(apart)}"


def _ask(answer: str, *more: str) -> str:
    """A call of the narrow phase, of two rows; more of what it takes."""
    return f'"narrow {answer}"({", ".join(("$world, a.tick, a.id, b.tick, b.id", *more))})'


def _narrow(call: str, apart: str = "0", otherwise: str = "FALSE") -> str:
    """A formula that calls the narrow phase where the boxes are that near.

    Where it is unknown whether they are, so is what comes of it.
    """
    if otherwise == "FALSE":
        return f"({_meet(apart)}) AND CASE WHEN {_meet(apart)} THEN {call} END"
    return f"CASE WHEN {_meet(apart)} THEN {call} WHEN NOT ({_meet(apart)}) THEN {otherwise} END"


# Of which pairs the narrow phase is asked.
_MEETING = "on pairs whose boxes meet"
_EVERY = "on every pair that is asked for"


def on_shapes(
    name: str,
    result: ValueType,
    formula: str,
    about: str,
    *,
    asked: str = _MEETING,
    more: tuple[Parameter, ...] = (),
    sliced: str | None = None,
    unit: str = "",
    symmetric: bool = False,
    element: ValueType = "real",
    candidates: CandidatePairs | None = None,
    far: Literal["", "more", "nothing"] = "",
    also: tuple[str, ...] = (),
    by_margins: bool = False,
) -> Relation:
    """A relation of the shapes of two entities."""
    return Relation(
        name,
        A_B + more,
        result,
        formula,
        about,
        sliced=sliced,
        unit=unit,
        symmetric=symmetric,
        element=element,
        apart=f"error('{name}: these entities are of two worlds, and only shapes of one are "
        "compared')",
        asked=asked,
        candidates=candidates,
        far=far,
        also=also,
        by_margins=by_margins,
    )


# What is deeper in each other collides, metres.
DEEP = "1e-6"
COLLIDES = _narrow(_ask("collides", DEEP))
# How much farther apart boxes may be, metres, for the margins of shapes.
_MARGINS = '"narrow margins"($world)'
# How far apart boxes may be; beside the boxes it is looked at even if none meet.
_DEPTH_CHECKED = (
    "CASE WHEN depth < 0 OR isnan(depth::DOUBLE) THEN "
    "error('collides: the depth is a number of metres from 0 up, not ' || depth)::DOUBLE "
    "ELSE 0.0::DOUBLE END"
)

_CARRIED = {
    "on": (
        "Checks if b rests on a: they touch (at most 1 mm apart and the collision margins of the "
        "shapes, see touching), a normal there is within 30 degrees of up, and the centre of the "
        "box of b is over the convex hull of the footprint of a. See supports for what carries it "
        "with others."
    ),
    "supports": (
        "Checks if a carries b, alone or with others, wherever the centre of b is: they touch (at "
        "most 1 mm apart and the collision margins of the shapes, see touching), and a normal "
        "there from a to b is within 30 degrees of up, or steeper and needed by others to push so "
        "together, as of the sides of a groove. A plank on two blocks is supported by both, and "
        "on neither. Told by the shapes alone, not by forces."
    ),
}


OF_SHAPES: tuple[Relation, ...] = (
    Relation(
        "overlaps",
        A_B,
        "flag",
        "a.id <> b.id AND a.xmin <= b.xmax AND b.xmin <= a.xmax AND a.ymin <= b.ymax "
        "AND b.ymin <= a.ymax AND a.zmin <= b.zmax AND b.zmin <= a.zmax",
        "Checks if the axis-aligned boxes of a and b meet, touching included. Of two intervals "
        "[start, end] it checks if a begins before b, and ends inside b.",
        of_lists=RELATIONS_OF_INTERVALS["overlaps"].formula,
        symmetric=True,
    ),
    on_shapes(
        "collides",
        "flag",
        COLLIDES,
        "Checks if shapes of a and b are deeper in each other than depth, 1e-6 m if it is not "
        "given. What rests on something is pressed into it by 1e-5 m or so, or stays as far away "
        "as the margins of the simulator are: inContact and touching tell of resting, "
        "collides(a, b, 1e-3) of intrusion. A depth below 0 is an error.",
        more=(Parameter("depth", "real", "a depth, m", optional=True),),
        sliced=_narrow(_ask("collides", "depth"), _DEPTH_CHECKED),
        symmetric=True,
        candidates=CandidatePairs("colliding", DEEP, "depth"),
    ),
    on_shapes(
        "penetration",
        "real",
        _narrow(_ask("penetration"), otherwise="0.0::DOUBLE"),
        "Returns the depth of the deepest penetration of the shapes of a and b: how far they "
        "would have to be moved to be apart; 0 if they are.",
        far="nothing",
        unit="m",
        symmetric=True,
    ),
    on_shapes(
        "clearance",
        "real",
        f"CASE WHEN a.id = b.id THEN 0.0::DOUBLE ELSE {_ask('clearance')} END",
        "Returns the smallest distance between the surfaces of a and b, 0 if they meet. It is "
        "worked out for each pair that is asked for, but for near(a, b, d), and for "
        "WHERE clearance(a, b) < d in SelectScript: they leave out what is far apart. "
        "What has no shapes is infinitely far from everything.",
        far="more",
        asked=_EVERY,
        unit="m",
        symmetric=True,
    ),
    on_shapes(
        "touching",
        "flag",
        _narrow(_ask("touching", "0.001"), f"0.001 + {_MARGINS}"),
        "Checks if shapes of a and b are at most eps apart, 1 mm if it is not given; what meets "
        "touches. The collision margins of the two shapes are added to eps: the simulator keeps "
        "what rests on each other as far apart, 2 mm for two hulls in PyBullet (the column margin "
        "of the table of shapes). near(a, b, d) goes by the surfaces alone.",
        asked="on pairs whose boxes are at most eps and the largest margins apart",
        more=(Parameter("eps", "real", "a distance, m", optional=True),),
        sliced=_narrow(_ask("touching", "eps"), f"(eps) + {_MARGINS}"),
        symmetric=True,
        candidates=CandidatePairs("touching", "0.001", "eps"),
        by_margins=True,
    ),
    on_shapes(
        "near",
        "flag",
        _narrow(_ask("near", "d"), "d"),
        "Checks if the clearance of a and b is at most d.",
        asked="on pairs whose boxes are at most d apart",
        more=(Parameter("d", "real", "a distance, m"),),
        symmetric=True,
        candidates=CandidatePairs("within", "d"),
    ),
    on_shapes(
        "nearestPoints",
        "list",
        f"CASE WHEN a.id = b.id THEN [[a.x, a.y, a.z], [a.x, a.y, a.z]] ELSE {_ask('points')} END",
        "Returns a point on a and one on b, [[x, y, z], [x, y, z]] in the world: the nearest "
        "ones, or where they meet those that are deepest in the other; nothing of what has no "
        "shapes.",
        asked=_EVERY,
        unit="m",
        element="list",
    ),
    *(
        on_shapes(
            name,
            "flag",
            _narrow(_ask(name), f"0.001 + {_MARGINS}"),
            about,
            asked="on pairs whose boxes are at most 1 mm and the largest margins apart",
            candidates=CandidatePairs("reaching", "0.001"),
            also=("onTop",) if name == "on" else (),
            by_margins=True,
        )
        for name, about in _CARRIED.items()
    ),
    on_shapes(
        "restsOn",
        "flag",
        f"a.id <> b.id AND CASE WHEN a.id <> b.id THEN {_ask('rests_on')} END",
        "Checks if b is on a, or on something that rests on a: the cup on a plate on a table rests "
        "on the table. What is on what is found once a tick, for all entities.",
        asked="on all pairs of the tick whose boxes are at most 1 cm apart, once",
        candidates=CandidatePairs("resting"),
        by_margins=True,
    ),
    on_shapes(
        "inside",
        "real",
        _narrow(_ask("inside"), otherwise="0.0::DOUBLE"),
        "Returns the share of the volume of b that is inside the convex hull of a, from 0 to 1; "
        "0 if b has no volume. Open meshes have none: see solidVolume. What is between the legs of "
        "a table is in its hull: enclosed asks for walls.",
        far="nothing",
    ),
    on_shapes(
        "contains",
        "flag",
        _narrow(_ask("contains")),
        "Checks if at least 95 percent of the volume of b is inside the convex hull of a. What is "
        "between the legs of a table is in its hull: enclosed asks for walls.",
        candidates=CandidatePairs("meeting"),
    ),
    on_shapes(
        "enclosed",
        "flag",
        _narrow(_ask("encloses", *_TURNS["a"])),
        "Checks if b is within walls of a, as in a cup, a drawer or a room: along at least two of "
        "the three axes of a's link frame, rays from the centre of the box of b meet a on both "
        "sides. Grazing counts. A convex shape that holds the centre is no wall, a mesh is one "
        "from either side. An axis along which b reaches past a by more than 1 mm at both ends "
        "does not count.",
        candidates=CandidatePairs("meeting"),
    ),
    on_shapes(
        "nextTo",
        "flag",
        _narrow(
            f"CASE WHEN a.zmin <= b.zmax AND b.zmin <= a.zmax AND {_BESIDE} < 1e300 "
            f"THEN {_ask('beside', _BESIDE, *_TURNS['a'], *_TURNS['b'])} ELSE FALSE END",
            _BESIDE,
        ),
        "Checks if a and b are beside each other: the heights of their boxes overlap, their "
        "clearance is at most a third of the mean of the six sides of the two boxes, a horizontal "
        "ray from one meets the other before anything else, and neither supports, contains, "
        "encloses or carries through others the other one. A box without end has nothing beside "
        "it.",
        asked="on pairs whose boxes are at most that far apart",
        symmetric=True,
        by_margins=True,
    ),
    Relation(
        "solidVolume",
        ENTITY,
        "real",
        '"narrow volume"($world, object.tick, object.id)',
        "Returns the sum of the volumes of the object's shapes, infinity for a plane, 0 for an "
        "open mesh.",
        unit="m^3",
    ),
)
