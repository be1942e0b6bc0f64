"""The contacts of a tick between two entities or links: whether they press, and by how much."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

from ssduck.geometry.arrays import Array, Flags, Indices
from ssduck.schema import LINK_FACTOR, entity_of, link_of

# The cosine of the least angle between the normals of two contacts that oppose each other: 120°.
OPPOSING = -0.5


# The entities of contacts, (2, n), and the numbers of their links there, (2, n).
Sides: TypeAlias = tuple[Indices, Indices]


@dataclass(frozen=True, eq=False)
class ContactPairs:
    """The contacts of a tick.

    The values are those of the relations' formulas in SQL, to the last bit.
    """

    # Returns those of two entities, in any order: all, or those that press.
    between: Callable[[int, int, bool], Sides]
    # Returns all in the order of their table, which sums depend on: sides, forces (n,), and unit
    # normals (3, n).
    ordered: Callable[[], tuple[Sides, Array, Array]]

    def is_pressing(self, a: int, b: int) -> bool:
        """Checks whether a contact of two entities or links presses."""
        return self._is_there(a, b, is_pressing=True)

    def is_listed(self, a: int, b: int) -> bool:
        """Checks whether two entities or links have a contact, which may press or not."""
        return self._is_there(a, b, is_pressing=False)

    def _is_there(self, a: int, b: int, *, is_pressing: bool) -> bool:
        if a == b:
            return False
        sides = self.between(entity_of(a), entity_of(b), is_pressing)
        return bool(are_of(sides, a, b).any())

    def force(self, a: int, b: int) -> float:
        """Returns the sum of the forces along the normals of two entities' contacts, N."""
        if a == b:
            return 0.0
        total = 0.0
        sides, forces, _ = self.ordered()
        for force in forces[are_of(sides, a, b)].tolist():
            total += force
        return total

    def is_opposed(self, a: int, b: int) -> bool:
        """Checks whether two contacts that press have normals that are at least 120° apart."""
        if a == b < LINK_FACTOR:
            return False
        sides, forces, normals = self.ordered()
        x, y, z = normals[:, are_of(sides, a, b) & (forces > 0)]
        products = x[:, None] * x + y[:, None] * y + z[:, None] * z
        return bool((products <= OPPOSING).any())


def are_of(sides: Sides, a: int, b: int) -> Flags:
    """Checks which contacts are of two entities, two links, or an entity and a link, (n,)."""
    (a1, a2), (b1, b2) = are_at(sides, a), are_at(sides, b)
    are_of: Flags = a1 & b2 | a2 & b1
    if (a < LINK_FACTOR) != (b < LINK_FACTOR):
        first, second = sides[0]
        are_of &= first != second
    return are_of


def are_at(sides: Sides, id: int) -> Flags:
    """Checks which sides of contacts are those of an entity or a link, (2, n)."""
    entities, links = sides
    are_there: Flags = entities == entity_of(id)
    return are_there if id < LINK_FACTOR else are_there & (links == link_of(id))
