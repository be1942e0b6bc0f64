"""Relations of contacts, which the physics solver found in the last step, and of sensors."""

from __future__ import annotations

from itertools import cycle

from ssduck.simulators.contact_pairs import OPPOSING, ContactPairs
from ssduck.sql.relations.common import A_B, link_of, recorded_numbers
from ssduck.sql.relations.relation import Parameter, Relation

_LINK_A, _LINK_B = (link_of(f"contacts.{side}", f"contacts.link_{side}") for side in "ab")
_PAIR = "(least(a.id, b.id), greatest(a.id, b.id))"
# The pairs of ids that a contact is of, the lesser id first: of entities, links, or one of each.
# One of two links of an entity is of these alone.
_PAIRS = (
    "SELECT list_sort(unnest(CASE WHEN contacts.a = contacts.b "  # noqa: S608
    f"THEN [[{_LINK_A}, {_LINK_B}]] ELSE [[contacts.a, contacts.b], "
    f"[{_LINK_A}, contacts.b], [contacts.a, {_LINK_B}], [{_LINK_A}, {_LINK_B}]] END)) AS pair, "
    "contacts.force AS force, contacts.nx AS nx, contacts.ny AS ny, contacts.nz AS nz FROM contacts"
)


def _opposing(pairs: str) -> str:
    """Returns a formula: whether two pressing contacts of a pair of ids oppose each other."""
    one, other = (
        f"(SELECT unnested.* FROM ({pairs}) AS unnested WHERE unnested.force > 0) AS {name}"  # noqa: S608
        for name in ("one", "other")
    )
    product = " + ".join(f"one.n{axis} * other.n{axis}" for axis in "xyz")
    return (
        f"{_PAIR} IN (SELECT one.pair[1], one.pair[2] FROM {one} JOIN {other} "  # noqa: S608
        f"ON one.pair = other.pair WHERE {product} <= {OPPOSING})"
    )


_ENTITY_PAIRS = (
    "SELECT [contacts.a, contacts.b] AS pair, contacts.force AS force, contacts.nx AS nx, "
    "contacts.ny AS ny, contacts.nz AS nz FROM contacts WHERE contacts.a < contacts.b"
)

CONTACT_RELATIONS: tuple[Relation, ...] = (
    Relation(
        "inContact",
        A_B,
        "boolean",
        f"a.id <> b.id AND {_PAIR} IN "  # noqa: S608
        "(SELECT contacts.a, contacts.b FROM contacts WHERE contacts.force > 0)",
        "Checks if the physics solver found a contact of a and b with a normal force above 0 in "
        "the last step.",
        is_symmetric=True,
        recorded_formula="a.id <> b.id "
        f"AND COALESCE(list_max({recorded_numbers('contact_forces', 'a', 'b')}) > 0, FALSE)",
        link_formula=f"{_PAIR} IN (SELECT pairs.pair[1], pairs.pair[2] FROM ({_PAIRS}) AS pairs "  # noqa: S608
        "WHERE pairs.force > 0)",
        of_contacts=ContactPairs.is_pressing,
    ),
    Relation(
        "hasContact",
        A_B,
        "boolean",
        f"a.id <> b.id AND {_PAIR} IN (SELECT contacts.a, contacts.b FROM contacts)",  # noqa: S608
        "Checks if the physics solver listed a contact of a and b in the last step: their shapes "
        "meet, even if they do not press, as when they are moving apart, or they press at a "
        "distance, which margins allow.",
        is_symmetric=True,
        recorded_formula="a.id <> b.id "
        f"AND len({recorded_numbers('contact_forces', 'a', 'b')}) > 0",
        link_formula=f"{_PAIR} IN (SELECT pairs.pair[1], pairs.pair[2] "  # noqa: S608
        f"FROM ({_PAIRS}) AS pairs)",
        of_contacts=ContactPairs.is_listed,
    ),
    Relation(
        "contactForce",
        A_B,
        "double",
        "CASE WHEN a.id = b.id THEN 0.0::DOUBLE ELSE COALESCE(map_extract_value((SELECT "
        "map(list((pair[1], pair[2])), list(total)) FROM (SELECT [contacts.a, contacts.b] AS pair, "
        "sum(contacts.force) AS total FROM contacts GROUP BY ALL) AS summed), "
        "(least(a.id, b.id), greatest(a.id, b.id))), 0.0::DOUBLE) END",
        "Returns the sum of the normal forces between a and b in the last step, from the "
        "physics solver.",
        unit="N",
        is_symmetric=True,
        recorded_formula="CASE WHEN a.id = b.id THEN 0.0::DOUBLE "
        f"ELSE COALESCE(list_sum({recorded_numbers('contact_forces', 'a', 'b')}), 0.0) END",
        link_formula="CASE WHEN a.id = b.id THEN 0.0::DOUBLE ELSE COALESCE(map_extract_value(("  # noqa: S608
        "SELECT map(list((pair[1], pair[2])), list(total)) FROM (SELECT pairs.pair AS pair, "
        f"sum(pairs.force) AS total FROM ({_PAIRS}) AS pairs GROUP BY ALL) AS summed), {_PAIR}), "
        "0.0::DOUBLE) END",
        positive_only_if="inContact",
        of_contacts=ContactPairs.force,
    ),
    Relation(
        "grasped",
        (
            Parameter("a", "entity", "a gripper, or an entity that has one"),
            Parameter("b", "entity", "another entity"),
        ),
        "boolean",
        _opposing(_ENTITY_PAIRS),
        "Checks if a presses b from opposite sides: of their contacts in the last step with a "
        "normal force above 0, two have normals that are at least 120 degrees apart.",
        is_symmetric=True,
        recorded_formula="a.id <> b.id "
        f"AND COALESCE(list_min({recorded_numbers('opposition', 'a', 'b')}) <= {OPPOSING}, FALSE)",
        link_formula=_opposing(_PAIRS),
        of_contacts=ContactPairs.is_opposed,
    ),
)


def contact_sum(*terms: str, of_links: bool = False) -> str:
    """Returns a formula: sums over the contacts of an entity, of forces and contact points."""
    parts = [("entities", f"entities.id = contacts.{side}", f"contacts.{side}") for side in "ab"]
    if of_links:
        parts += [
            (
                "links",
                f"links.entity = contacts.{side} AND links.link = contacts.link_{side}",
                link_of(f"contacts.{side}", f"contacts.link_{side}"),
            )
            for side in "ab"
        ]
    sides = " UNION ALL ".join(
        f"SELECT {id} AS entity, contacts.{side}x - {table}.x AS x, "  # noqa: S608
        f"contacts.{side}y - {table}.y AS y, contacts.{side}z - {table}.z AS z, "
        f"{sign}fx AS fx, {sign}fy AS fy, {sign}fz AS fz "
        f"FROM contacts JOIN {table} ON {condition}"
        for (table, condition, id), (side, sign) in zip(
            parts, cycle((("a", ""), ("b", "-"))), strict=False
        )
    )
    sums = ", ".join(f"sum({term})" for term in terms)
    return (
        "COALESCE(map_extract_value((SELECT map(list(entity), list(total)) "  # noqa: S608
        f"FROM (SELECT entity, [{sums}] AS total FROM ({sides}) AS sides GROUP BY entity) "
        "AS summed), object.id), [0.0, 0.0, 0.0]::DOUBLE[])"
    )


_SENSOR = (Parameter("s", "entity", "a sensor"),)
_SENSOR_AND_OTHER = (*_SENSOR, Parameter("e", "entity", "another entity"))

SENSOR_RELATIONS: tuple[Relation, ...] = (
    Relation(
        "isSensing",
        _SENSOR_AND_OTHER,
        "boolean",
        "(s.id, e.id) IN (SELECT sensor, entity FROM sensings)",
        "Checks if sensor s perceives e at the tick: if a ray, a pixel or a contact point of s "
        "ends on e. It is False while s is switched off, for the body on which s is mounted, if "
        "e is a sensor, and if s is not one.",
        recorded_formula=f"len({recorded_numbers('sensed', 's', 'e')}) > 0",
    ),
    Relation(
        "sensingAmount",
        _SENSOR_AND_OTHER,
        "double",
        "COALESCE(map_extract_value((SELECT map(list((sensor, entity)), list(hits / rays)) "
        "FROM sensings), (s.id, e.id)), 0.0::DOUBLE)",
        "Returns the share of the rays, pixels or contact points of sensor s that end on e, "
        "from 0 to 1; 0 if isSensing(s, e) is False.",
        recorded_formula=f"COALESCE({recorded_numbers('sensed', 's', 'e')}[1], 0.0)",
    ),
    Relation(
        "sensingEnvIDs",
        _SENSOR,
        "list",
        "COALESCE(map_extract_value((SELECT map(list(sensor), list(ids)) FROM (SELECT sensor, "
        "list(entity ORDER BY entity) AS ids FROM sensings GROUP BY sensor) AS seen), s.id), "
        "[]::BIGINT[])",
        "Returns the ids (see environmentID) of the entities that sensor s perceives at the "
        "tick, in ascending order; an empty list while it is switched off.",
        element="integer",
        recorded_formula=f"{recorded_numbers('perceived', 's')}::BIGINT[]",
    ),
)
