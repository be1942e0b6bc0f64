"""Relations of contacts: those that the physics solver found in the last step."""

from __future__ import annotations

from ssduck.sql.relations.common import A_B, recorded_numbers
from ssduck.sql.relations.relation import Relation

CONTACT_RELATIONS: tuple[Relation, ...] = (
    Relation(
        "inContact",
        A_B,
        "boolean",
        "(least(a.id, b.id), greatest(a.id, b.id)) IN "
        "(SELECT contacts.a, contacts.b FROM contacts WHERE contacts.force > 0)",
        "Checks if the physics solver found a contact of a and b with a normal force above 0 in "
        "the last step.",
        is_symmetric=True,
        across_worlds="FALSE",
        recorded_formula="a.id <> b.id "
        f"AND COALESCE(list_max({recorded_numbers('pressing', 'a', 'b')}) > 0, FALSE)",
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
        across_worlds="0.0::DOUBLE",
        recorded_formula="CASE WHEN a.id = b.id THEN 0.0::DOUBLE "
        f"ELSE COALESCE(list_sum({recorded_numbers('pressing', 'a', 'b')}), 0.0) END",
    ),
)


def contact_sum(*terms: str) -> str:
    """Returns a formula: sums over the contacts of an entity, of forces and contact points."""
    sides = " UNION ALL ".join(
        f"SELECT contacts.{side} AS entity, contacts.{side}x - entities.x AS x, "  # noqa: S608
        f"contacts.{side}y - entities.y AS y, contacts.{side}z - entities.z AS z, "
        f"{sign}fx AS fx, {sign}fy AS fy, {sign}fz AS fz "
        f"FROM contacts JOIN entities ON entities.id = contacts.{side}"
        for side, sign in (("a", ""), ("b", "-"))
    )
    sums = ", ".join(f"sum({term})" for term in terms)
    return (
        "COALESCE(map_extract_value((SELECT map(list(entity), list(total)) "  # noqa: S608
        f"FROM (SELECT entity, [{sums}] AS total FROM ({sides}) AS sides GROUP BY entity) "
        "AS summed), object.id), [0.0, 0.0, 0.0]::DOUBLE[])"
    )
