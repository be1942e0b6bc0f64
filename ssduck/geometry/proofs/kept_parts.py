"""Keeps from tick to tick how the directions of pairs of shapes were divided.

`ssduck.geometry.proofs.contact_directions` divides triangles of directions until bounds of the
overlaps in them tell whether the contact normal points up. Shapes move little between two ticks, so
that the same parts probably tell it again. They are only where the next proof starts: its bounds
are those of the new tick.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ssduck.geometry.arrays import Array, Indices
from ssduck.geometry.proofs.kept_verdicts import Keys

# The greatest number of parts of a pair that are kept: many would take longer than dividing anew.
_MAX_PARTS = 256
# The number of pairs whose parts are kept.
_MAX_PAIRS = 4096


@dataclass(frozen=True, eq=False)
class Parts:
    """Parts of the triangles of a mesh of directions.

    Attributes:
        owners: (n,), the pair of each.
        faces: (n,), the triangle of the mesh that it is a part of. All parts of a triangle cover it.
        corners: (9, n), the directions at its corners, one after another.
    """

    owners: Indices
    faces: Indices
    corners: Array


class KeptParts:
    """The parts of one condition on all pairs of shapes, for the next tick."""

    def __init__(self) -> None:
        self._parts: dict[int, Parts] = {}

    def find(self, keys: Keys) -> Parts | None:
        """Returns the parts that are kept of pairs; None if there are none."""
        kept = self._parts
        found = [kept.get(key) for key in keys.tolist()]
        if not any(found):
            return None
        counts = [0 if parts is None else len(parts.faces) for parts in found]
        known = [parts for parts in found if parts is not None]
        return Parts(
            np.repeat(np.arange(len(keys)), counts),
            np.concatenate([parts.faces for parts in known]),
            np.concatenate([parts.corners for parts in known], axis=1),
        )

    def keep(self, keys: Keys, parts: Parts) -> None:
        """Replaces the parts of pairs.

        Args:
            keys: (m,), the pairs.
            parts: their parts, in any order.
        """
        if len(self._parts) + len(keys) > _MAX_PAIRS:
            self._parts.clear()
        order = np.argsort(parts.owners, kind="stable")
        faces, corners = parts.faces[order], parts.corners.take(order, axis=1)
        ends = np.cumsum(np.bincount(parts.owners, minlength=len(keys))).tolist()
        for key, start, end in zip(keys.tolist(), [0, *ends], ends, strict=False):
            self._parts.pop(key, None)
            if 0 < end - start <= _MAX_PARTS:
                place = slice(start, end)
                owners = np.zeros(end - start, np.intp)
                self._parts[key] = Parts(owners, faces[place], corners[:, place])
