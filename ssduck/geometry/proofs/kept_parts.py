"""Keeps from tick to tick how the directions of pairs of shapes were divided.

`ssduck.geometry.proofs.contact_directions` divides triangles of directions until bounds of the
overlaps in them tell whether the contact normal points up. Shapes move little between two ticks, so
that the same parts probably tell it again. They are only where the next proof starts: its bounds
are those of the new tick.

Of these parts, and of the triangles that were not divided, a verdict needs those alone that have
directions that contradict it. They are tried first, together with the direction of least overlap,
which turns with one of the shapes: if the overlaps in all of them are larger than in this
direction, the verdict is proved again. The other pairs begin with directions all around.

Where shapes move far between two ticks, more parts are needed at each, and some pairs have to be
divided further all the same, which takes longer than to begin anew. So it is counted how many pairs
were decided undivided. If they are too few, all parts are given up, and tried again much later.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ssduck.geometry.arrays import Array, Flags, Indices
from ssduck.geometry.proofs.direction_triangles import OTHER_ONLY, UPWARD_ONLY, Mesh
from ssduck.geometry.proofs.kept_columns import KeptColumns
from ssduck.geometry.proofs.kept_verdicts import Keys
from ssduck.geometry.proofs.verdicts import Verdicts

# The greatest number of parts of a pair that are kept: many would take longer than dividing anew.
_MAX_PARTS = 1024
# The number of pairs whose parts are kept.
_MAX_PAIRS = 4096
# If more pairs are divided together, it takes longer to keep their parts than to divide them anew.
MAX_DIVIDED = 128
# A pair that has to be divided further costs as much as so many save that need not be.
_COST = 8.0
# Parts are given up when the cost exceeds what was saved by those of so many ticks.
_CREDIT = 12.0
# The number of ticks at which pairs are divided anew then.
_PAUSE = 96
_NO_CORNERS, _NO_STRETCH = np.zeros((3, 0), np.intp), np.zeros(0)


@dataclass(frozen=True, eq=False)
class Parts:
    """Parts of the triangles of a mesh of directions.

    Attributes:
        owners: (n,), the pair of each.
        faces: (n,), the triangle of the mesh that it is a part of; all parts of one cover it.
        classes: (n,), which directions may be in it.
        stretch: (n,), the greatest sum of weights of corners whose combination has length 1.
        corners: (3, n), the places of its corners.
        directions: (3, m), the unit directions of the corners.
        corner_owners: (m,), the pair of each direction.
    """

    owners: Indices
    faces: Indices
    classes: Indices
    stretch: Array
    corners: Indices
    directions: Array
    corner_owners: Indices

    def at_corners(self, places: Indices) -> Array:
        """Returns the directions at the corners of parts, (3, 3, n): (corner, axis, part)."""
        directions: Array = self.directions.take(self.corners[:, places], axis=1).swapaxes(0, 1)
        return directions


@dataclass(frozen=True, eq=False)
class Proofs:
    """What proved verdicts on pairs: their normals were not in directions that contradict them.

    Attributes:
        pairs: (n,), the place of the pair of each proof.
        verdicts: (n,), the verdicts.
        owners: (t,), the proof of each triangle; together they have all directions that contradict.
        stretch: (t,), see `Parts`.
        corners: (3, t), the places of their corners.
        directions: (3, m), the unit directions of the corners, and others.
        direction_pairs: (m,), the place of the pair of each.
        caps: (k,), places of directions whose points exclude all upward directions by themselves.
        cap_proofs: (k,), the proof of each, which has no triangles.
    """

    pairs: Indices
    verdicts: Verdicts
    owners: Indices
    stretch: Array
    corners: Indices
    directions: Array
    direction_pairs: Indices
    caps: Indices
    cap_proofs: Indices


@dataclass(frozen=True, eq=False)
class _PairProof:
    """What proved the verdict on a pair; without triangles, the first direction is that of a cap.

    Attributes:
        verdict: the verdict.
        corners: (3, n), the places of the corners of its triangles.
        stretch: (n,), see `Parts`.
        directions: (3, m), the directions of the corners, and others.
    """

    verdict: int
    corners: Indices
    stretch: Array
    directions: Array


@dataclass(frozen=True, eq=False)
class _PairParts:
    """The parts of one pair.

    Attributes:
        numbers: (5, n), faces, classes and corners; see `Parts`.
        stretch: (n,).
        directions: (3, m).
    """

    numbers: Indices
    stretch: Array
    directions: Array


class KeptParts:
    """The parts and the proofs of one condition on all pairs of shapes, for the next tick.

    Attributes:
        least: the direction of least overlap that was found of each pair, in the frame of the
            first shape, and in that of the second.
    """

    def __init__(self) -> None:
        self.least = KeptColumns(6)
        self._proofs: dict[int, tuple[_PairProof, ...]] = {}
        self._parts: dict[int, _PairParts] = {}
        self._credit, self._pause = _CREDIT, 0

    def judge(self, sufficed: Flags) -> None:
        """Counts the pairs whose parts decided them undivided, and gives all up if these are few.

        Args:
            sufficed: (n,), whether the parts of a pair did, of those for which some were found.
        """
        share = float(np.count_nonzero(sufficed)) / len(sufficed)
        self._credit = min(self._credit + share - _COST * (1.0 - share), _CREDIT)
        if self._credit <= 0.0:
            self._parts.clear()
            self._proofs.clear()
            self._credit, self._pause = _CREDIT, _PAUSE

    def are_known(self, keys: Keys) -> Flags:
        """Checks of which pairs parts are kept, (n,)."""
        parts = self._parts
        return np.array([key in parts for key in keys.tolist()], dtype=bool)

    def proofs(self, keys: Keys) -> Proofs | None:
        """Returns what proved the verdicts on pairs; None if nothing is kept of them.

        It is called once a tick for all pairs.
        """
        self._pause = max(0, self._pause - 1)
        kept = self._proofs
        found = [(n, proof) for n, key in enumerate(keys.tolist()) for proof in kept.get(key, ())]
        if not found:
            return None
        pairs = np.array([n for n, _ in found])
        counts = np.array([len(proof.stretch) for _, proof in found])
        sizes = np.array([proof.directions.shape[1] for _, proof in found])
        starts, caps = np.cumsum(sizes) - sizes, np.flatnonzero(counts == 0)
        corners = np.concatenate([proof.corners for _, proof in found], axis=1)
        corners += np.repeat(starts, counts)
        return Proofs(
            pairs,
            np.array([proof.verdict for _, proof in found], np.int8),
            np.repeat(np.arange(len(found)), counts),
            np.concatenate([proof.stretch for _, proof in found]),
            corners,
            np.concatenate([proof.directions for _, proof in found], axis=1),
            np.repeat(pairs, sizes),
            starts.take(caps),
            caps,
        )

    def keep_proofs(
        self, keys: Keys, verdicts: Verdicts, best: Array, mesh: Mesh, caps: Indices
    ) -> None:
        """Replaces what proved verdicts on pairs, unless parts were given up lately.

        Args:
            keys: (n,), the pairs.
            verdicts: (n,), `UPWARD`, `NOT_UPWARD` or `UNDECIDED`.
            best: (3, n), the directions of least overlap.
            mesh: the triangles of which the parts are.
            caps: (n,), directions of the mesh that prove a verdict by themselves; -1 for none.
        """
        if self._pause:
            return
        if len(self._proofs) + len(keys) > _MAX_PAIRS:
            self._proofs.clear()
        for n, (key, verdict) in enumerate(zip(keys.tolist(), verdicts.tolist(), strict=True)):
            if verdict:
                proof = self._proof(key, verdict, best[:, n : n + 1], mesh, caps[n])
                # Of a pair whose verdict changes to and fro, both are kept.
                before = self._proofs.pop(key, ())
                others = [p for p in before if len(before) == 1 and p.verdict != verdict]
                self._proofs[key] = (proof, *others)

    def _proof(self, key: int, verdict: int, best: Array, mesh: Mesh, cap: int) -> _PairProof:
        """Returns the triangles of a pair that contain all directions that contradict a verdict.

        The direction of a cap, if there is one, needs none. The best direction is added: at a later
        tick, it may be the best one again.
        """
        if cap >= 0:
            directions = np.concatenate((mesh.directions[:, cap : cap + 1], best), axis=1)
            return _PairProof(verdict, _NO_CORNERS, _NO_STRETCH, directions)
        contradicted = UPWARD_ONLY if verdict < 0 else OTHER_ONLY
        is_whole, parts = mesh.classes & contradicted > 0, self._parts.get(key)
        corners, stretch, directions = mesh.corners, mesh.stretch, mesh.directions
        if parts is not None:
            is_whole = is_whole.copy()
            is_whole[parts.numbers[0]] = False
            some = parts.numbers[1] & contradicted > 0
            corners = parts.numbers[2:, some] + directions.shape[1]
            corners = np.concatenate((mesh.corners[:, is_whole], corners), axis=1)
            stretch = np.concatenate((stretch[is_whole], parts.stretch[some]))
            directions = np.concatenate((directions, parts.directions), axis=1)
        else:
            corners, stretch = corners[:, is_whole], stretch[is_whole]
        used, places = np.unique(corners, return_inverse=True)
        directions = np.concatenate((directions.take(used, axis=1), best), axis=1)
        return _PairProof(verdict, places.reshape(3, -1), stretch, directions)

    def find(self, keys: Keys) -> Parts | None:
        """Returns the parts that are kept of pairs; None if there are none."""
        kept = [(n, self._parts.get(key)) for n, key in enumerate(keys.tolist())]
        found = [(n, parts) for n, parts in kept if parts is not None]
        if not found:
            return None
        owners = np.array([n for n, _ in found])
        counts = [len(parts.stretch) for _, parts in found]
        sizes = np.array([parts.directions.shape[1] for _, parts in found])
        numbers = np.concatenate([parts.numbers for _, parts in found], axis=1)
        numbers[2:] += np.repeat(np.cumsum(sizes) - sizes, counts)
        return Parts(
            np.repeat(owners, counts),
            numbers[0],
            numbers[1],
            np.concatenate([parts.stretch for _, parts in found]),
            numbers[2:],
            np.concatenate([parts.directions for _, parts in found], axis=1),
            np.repeat(owners, sizes),
        )

    def keep(
        self, key: int, faces: Indices, classes: Indices, stretch: Array, corners: Array
    ) -> None:
        """Replaces the parts of a pair, unless parts were given up lately.

        Args:
            key: the pair.
            faces: (n,), see `Parts`.
            classes: (n,), likewise.
            stretch: (n,), likewise.
            corners: (3, 3, n), the directions at the corners (corner, axis, part).
        """
        self._parts.pop(key, None)
        if self._pause or not 0 < len(faces) <= _MAX_PARTS:
            return
        if len(self._parts) >= _MAX_PAIRS:
            self._parts.clear()
        directions, places = np.unique(
            corners.swapaxes(0, 1).reshape(3, -1), axis=1, return_inverse=True
        )
        numbers = np.concatenate((faces[None], classes[None], places.reshape(3, -1)))
        # A copy: the stretch may be a row of an array that has all that is known of the parts.
        self._parts[key] = _PairParts(numbers, stretch.copy(), directions)
