"""Parameters and formulas that relations of several topics share."""

from __future__ import annotations

from typing import Any

from ssduck.schema import LINK_FACTOR
from ssduck.sql.relations.relation import Parameter, Relation, ValueType

# The function that yields numbers of contacts and sensors at a recorded tick.
RECORDED_NUMBERS_UDF = "recorded numbers"
ENTITY = (Parameter("object", "entity", "an entity"),)
A_B = (Parameter("a", "entity", "an entity"), Parameter("b", "entity", "another entity"))


def entity_relation(
    name: str, result: ValueType, formula: str, about: str, unit: str = "", **further: Any
) -> Relation:
    """Returns a relation of one entity."""
    return Relation(name, ENTITY, result, formula, about, unit=unit, **further)


def if_from_0_up(relation: str, formula: str, **parameters: str) -> str:
    """Returns a condition that is an error if a parameter is negative or not a number."""
    checks = (
        f"WHEN {name} < 0 OR isnan({name}::DOUBLE) THEN "
        f"error('{relation}: {name} is {what}, from 0 up, not ' || {name})::BOOLEAN"
        for name, what in parameters.items()
    )
    return f"CASE {' '.join(checks)} ELSE {formula} END"


def in_frame(frame: str, point: str, origin: str = "") -> tuple[str, str, str]:
    """Returns formulas: the coordinates of a row's position in the frame of another row.

    With an origin, they are those of the way from that row's position, along the axes of the frame.
    """
    w, x, y, z = (f"{frame}.q{part}" for part in "wxyz")
    away = [f"({point}.{axis} - {origin or frame}.{axis})" for axis in "xyz"]
    rows = (
        (
            f"1 - 2 * ({y} ** 2 + {z} ** 2)",
            f"2 * ({x} * {y} + {w} * {z})",
            f"2 * ({x} * {z} - {w} * {y})",
        ),
        (
            f"2 * ({x} * {y} - {w} * {z})",
            f"1 - 2 * ({x} ** 2 + {z} ** 2)",
            f"2 * ({y} * {z} + {w} * {x})",
        ),
        (
            f"2 * ({x} * {z} + {w} * {y})",
            f"2 * ({y} * {z} - {w} * {x})",
            f"1 - 2 * ({x} ** 2 + {y} ** 2)",
        ),
    )
    first, second, third = (
        "(" + " + ".join(f"({a}) * {b}" for a, b in zip(row, away, strict=True)) + ")"
        for row in rows
    )
    return first, second, third


def link_of(entity: str, link: str) -> str:
    """Returns a formula: the id of a link, from the id of its entity and its number."""
    return f"(({link} + 1) * {LINK_FACTOR} + {entity})"


def recorded_numbers(kind: str, a: str, b: str = "") -> str:
    """Returns a formula: numbers of contacts or sensors at the tick of a row (`replay.lookups`)."""
    other = f"{b}.id" if b else "0"
    return f"\"{RECORDED_NUMBERS_UDF}\"($world, '{kind}', {a}.tick, {a}.id, {other})"
