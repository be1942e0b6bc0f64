"""The contacts of a tick between two entities: whether they press, by how much, and from where."""

from __future__ import annotations

from dataclasses import dataclass

from ssduck.geometry.arrays import Array, Indices

# The cosine of the least angle between the normals of two contacts that oppose each other: 120°.
OPPOSING = -0.5


@dataclass(frozen=True, eq=False)
class ContactPairs:
    """The contacts of a tick, each with the lesser id first.

    The values are those of the relations' formulas in SQL, to the last bit.

    Attributes:
        a: (n,), the ids of the first entities.
        b: (n,), the ids of the second entities.
        forces: (n,), the forces along the normals, N.
        normals: (3, n), of length 1.
    """

    a: Indices
    b: Indices
    forces: Array
    normals: Array

    def _of(self, a: int, b: int) -> Indices:
        """Returns the rows of the contacts of two entities."""
        low, high = (a, b) if a < b else (b, a)
        rows: Indices = ((self.a == low) & (self.b == high)).nonzero()[0]
        return rows

    def is_pressing(self, a: int, b: int) -> bool:
        """Checks whether a contact of two entities presses."""
        return bool((self.forces.take(self._of(a, b)) > 0).any())

    def force(self, a: int, b: int) -> float:
        """Returns the sum of the forces along the normals of two entities' contacts, N."""
        if a == b:
            return 0.0
        total = 0.0
        for force in self.forces.take(self._of(a, b)).tolist():
            total += force
        return total

    def is_opposed(self, a: int, b: int) -> bool:
        """Checks whether two contacts that press have normals that are at least 120° apart."""
        if a == b:
            return False
        rows = self._of(a, b)
        rows = rows[self.forces.take(rows) > 0]
        x, y, z = self.normals.take(rows, axis=1)
        products = x[:, None] * x + y[:, None] * y + z[:, None] * z
        return bool((products <= OPPOSING).any())
