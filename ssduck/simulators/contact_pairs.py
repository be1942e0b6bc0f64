"""The contacts of a tick between two entities or links: whether they press, and by how much."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, TypeAlias

from ssduck.geometry.arrays import Array, Flags, Indices
from ssduck.schema import LINK_FACTOR, entity_of, link_of

# The cosine of the least angle between the normals of two contacts that oppose each other: 120°.
OPPOSING = -0.5


# The entities of contacts, (2, n), and the numbers of their links there, (2, n).
Sides: TypeAlias = tuple[Indices, Indices]
# Contacts in the order of their table: sides, forces and normals: (n,) and (3, n).
Columns: TypeAlias = tuple[Sides, Array, Array]


class ContactsBetween(Protocol):
    """Returns the contacts of two entities, in any order: all, or those that press."""

    def __call__(self, a: int, b: int, *, pressing: bool) -> Sides:
        """Returns them."""


@dataclass(frozen=True, eq=False)
class ContactPairs:
    """The contacts of a tick.

    The values are those of the relations' formulas in SQL, to the last bit.
    """

    between: ContactsBetween  # a function that returns the contacts of two entities
    # A function that returns the contacts in the order of their table, whose sums depend on it. The
    # normals are of length 1.
    columns: Callable[[], Columns]

    def _ordered(self, a: int, b: int) -> tuple[Array, Array]:
        """Returns the forces and the normals of the contacts of two entities, in order."""
        sides, forces, normals = self.columns()
        rows = are_of(sides, a, b).nonzero()[0]
        return forces.take(rows), normals.take(rows, axis=1)

    def is_pressing(self, a: int, b: int) -> bool:
        """Checks whether a contact of two entities or links presses."""
        return self._is_there(a, b, pressing=True)

    def is_listed(self, a: int, b: int) -> bool:
        """Checks whether two entities or links have a contact, which may press or not."""
        return self._is_there(a, b, pressing=False)

    def _is_there(self, a: int, b: int, *, pressing: bool) -> bool:
        if a == b:
            return False
        sides = self.between(entity_of(a), entity_of(b), pressing=pressing)
        if not sides[0].size or max(a, b) < LINK_FACTOR:
            return bool(sides[0].size)
        return bool(are_of(sides, a, b).any())

    def force(self, a: int, b: int) -> float:
        """Returns the sum of the forces along the normals of two entities' contacts, N."""
        if a == b:
            return 0.0
        total = 0.0
        for force in self._ordered(a, b)[0].tolist():
            total += force
        return total

    def is_opposed(self, a: int, b: int) -> bool:
        """Checks whether two contacts that press have normals that are at least 120° apart."""
        if a == b < LINK_FACTOR:
            return False
        forces, normals = self._ordered(a, b)
        x, y, z = normals[:, forces > 0]
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
