"""The contacts of a tick between two entities: whether they press, by how much, and from where."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

from ssduck.geometry.arrays import Array, Indices

# The cosine of the least angle between the normals of two contacts that oppose each other: 120°.
OPPOSING = -0.5


# Contacts in the order of their table: a < b, forces and normals, (n,), (n,), (n,) and (3, n).
Columns: TypeAlias = tuple[Indices, Indices, Array, Array]


@dataclass(frozen=True, eq=False)
class ContactPairs:
    """The contacts of a tick.

    The values are those of the relations' formulas in SQL, to the last bit.

    Attributes:
        pairs: (n, 2), the ids of the entities of each contact, in any order.
        forces: (n,), the forces along the normals, N, in the same order.
        columns: a function that returns the contacts in the order of their table, whose sums
            depend on it. The normals are of length 1.
    """

    pairs: Indices
    forces: Array
    columns: Callable[[], Columns]

    def _ordered(self, a: int, b: int) -> tuple[Array, Array]:
        """Returns the forces and the normals of the contacts of two entities, in order."""
        low, high = (a, b) if a < b else (b, a)
        first, second, forces, normals = self.columns()
        rows = ((first == low) & (second == high)).nonzero()[0]
        return forces.take(rows), normals.take(rows, axis=1)

    def is_pressing(self, a: int, b: int) -> bool:
        """Checks whether a contact of two entities presses."""
        first, second = self.pairs.T
        are_of_both = (first == a) & (second == b) | (first == b) & (second == a)
        return bool((are_of_both & (self.forces > 0)).any())

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
        if a == b:
            return False
        forces, normals = self._ordered(a, b)
        x, y, z = normals[:, forces > 0]
        products = x[:, None] * x + y[:, None] * y + z[:, None] * z
        return bool((products <= OPPOSING).any())
