"""Which pairs of entities collide, or are near each other, at many recorded ticks at once.

Each pair at a tick stands for two entities of its own in one narrow phase
(`ssduck.geometry.narrow_phase`), so that all of them are decided together; pairs of different ticks
are never compared.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate

import numpy as np
import numpy.typing as npt

from ssduck.geometry.arrays import Array, Indices
from ssduck.geometry.batch import (
    PairPredicate,
    ShapeTable,
    TickShapes,
    matching_pairs,
    of_known_entities,
)
from ssduck.geometry.bounds import BoundingBoxes
from ssduck.geometry.broad_phase import Pairs
from ssduck.geometry.distance import CallCounter
from ssduck.geometry.narrow_phase import NarrowPhase
from ssduck.geometry.poses import (
    compose,
    flat_rotation_matrices,
    rotation_matrices,
    unit_quaternions,
)
from ssduck.geometry.queries import ShapeQueries
from ssduck.geometry.shapes import Geometry
from ssduck.geometry.solids import Solid, solid_of
from ssduck.world.layout import EntityInfo

Ids = npt.NDArray[np.int64]

# So many pairs of shapes are compared together.
MAX_BATCH_SIZE = 1 << 15


@dataclass(frozen=True, eq=False)
class _Model:
    """The shapes of an entity: which solid each is, on which link, where there; their boxes."""

    of: Indices
    margins: Array
    links: Indices
    positions: Array
    orientations: Array
    boxer: BoundingBoxes

    @property
    def count(self) -> int:
        return len(self.of)


@dataclass(frozen=True, eq=False)
class LinkPosesOverTicks:
    """Where n links are: positions (n, 3), orientations (n, 4), w, x, y, z."""

    positions: Array
    orientations: Array


@dataclass(frozen=True, eq=False)
class PairSide:
    """One of the two entities of n pairs.

    Attributes:
        ids: (n,), of the entities.
        base: where their base links are.
        links: gives where a link of entities is, of rows of the pairs.
    """

    ids: Ids
    base: LinkPosesOverTicks
    links: Callable[[Indices, int, int], LinkPosesOverTicks]


class EntityShapes:
    """What shapes entities have; a solid that several have is there once.

    Args:
        members: the entities, by id.
    """

    def __init__(self, members: Mapping[int, EntityInfo]) -> None:
        self._members = members
        self._solids: list[Solid] = []
        self._places: dict[str, int] = {}
        self._models: dict[int, _Model] = {}
        self._sorts: dict[tuple[int, ...], ShapeTable] = {}

    def moving_links(self, id: int) -> range:
        """The links of an entity but its base, by number."""
        body = self._members[id].body
        return range(1, 1 if body is None else len(body.links))

    def shapes(
        self, ids: Sequence[int], poses: Sequence[Array], calls: CallCounter
    ) -> ShapeQueries:
        """The shapes of some entities at one tick.

        Args:
            ids: of the entities, ascending: of what is equal, the order tells which comes first.
            poses: of each the positions and orientations of its links, (links, 7).
            calls: counts what is compared.
        """
        models = [self._model(id) for id in ids]
        placed = [self._shapes_at(model, own) for model, own in zip(models, poses, strict=True)]
        key = tuple(ids)
        if key not in self._sorts:
            owners = np.repeat(np.arange(len(ids)), [model.count for model in models])
            of, margins = _joined(models)
            self._sorts[key] = ShapeTable(self._solids, of, owners, margins)
        of, margins = _joined(models)
        positions, orientations, boxes = (
            np.concatenate([part[i] for part in placed]) for i in range(3)
        )
        starts = list(accumulate((model.count for model in models), initial=0))
        narrow = NarrowPhase(
            self._solids, of, positions, orientations, boxes, starts, calls, margins
        )
        numbers = {id: number for number, id in enumerate(ids)}
        around = np.array([_around(part[2]) for part in placed]).reshape(-1, 6).T
        return ShapeQueries(
            narrow, numbers, self._sorts[key], around, np.array(ids, dtype=np.int64)
        )

    def _shapes_at(self, model: _Model, poses: Array) -> tuple[Array, Array, Array]:
        """Positions, orientations and boxes of an entity's shapes."""
        own = poses[model.links]
        with np.errstate(invalid="ignore"):
            positions, orientations = compose(
                own[:, :3], own[:, 3:], model.positions, model.orientations
            )
            matrices = rotation_matrices(poses[:, 3:])
            boxes = model.boxer.boxes(poses[:, :3], matrices).T
        return positions, orientations, boxes

    def together(
        self, first: PairSide, second: PairSide, question: PairPredicate, calls: CallCounter
    ) -> tuple[npt.NDArray[np.bool_], npt.NDArray[np.bool_]]:
        """Of which pairs something holds, and of which of them that is known, (n,) each.

        Args:
            first: the one entity of each pair,
            second: and the other.
            question: what is to hold.
            calls: counts what is compared.
        """
        holds = np.zeros(len(first.ids), dtype=bool)
        known = np.zeros(len(first.ids), dtype=bool)
        counts = self._counts(first.ids) * self._counts(second.ids)
        ends = np.cumsum(np.maximum(counts, 1))
        start = 0
        while start < len(counts):
            before = ends[start - 1] if start else 0
            end = int(np.searchsorted(ends, before + MAX_BATCH_SIZE, side="right"))
            run = np.arange(start, max(end, start + 1))
            holds[run], known[run] = self._some(first, second, run, question, calls)
            start = int(run[-1]) + 1
        return holds, known

    def _counts(self, ids: Ids) -> Indices:
        counts = np.zeros(len(ids), np.intp)
        for id in _different(ids):
            counts[ids == id] = self._model(id).count
        return counts

    def _some(
        self,
        first: PairSide,
        second: PairSide,
        run: Indices,
        question: PairPredicate,
        calls: CallCounter,
    ) -> tuple[npt.NDArray[np.bool_], npt.NDArray[np.bool_]]:
        """Of these n pairs, compared together: the two entities of pair k are k and n + k."""
        parts = [*self._placed(first, run, 0), *self._placed(second, run, len(run))]
        owners, of = (np.concatenate([part[i] for part in parts]) for i in (0, 1))
        margins, *poses = (np.concatenate([part[i] for part in parts]) for i in (2, 3, 4))
        positions, orientations = poses
        if (owners[1:] < owners[:-1]).any():  # each entity's shapes together
            order = np.argsort(owners, kind="stable")
            owners, of, margins = owners[order], of[order], margins[order]
            positions, orientations = positions[order], orientations[order]
        count = len(run)
        counts = np.bincount(owners, minlength=2 * count)
        starts = np.cumsum(counts) - counts
        shapes = _each_with_each(starts[:count], counts[:count], starts[count:], counts[count:])
        table = ShapeTable(self._solids, of, owners, margins)
        scene = _scene_of(table, positions, orientations)
        endless = np.array([[-np.inf] * 3 + [np.inf] * 3] * 2)

        def holds_of(s: int, t: int) -> bool:  # of the few that only a closer look decides
            two = [s, t]
            placed = positions[two], orientations[two], endless
            narrow = NarrowPhase(self._solids, of[two], *placed, [0, 1, 2], calls, margins[two])
            return narrow.answer(0, 1, question)

        found = matching_pairs(scene, question, holds_of, shapes)
        calls.pairs += len(found.compared)
        holds = np.zeros(count, dtype=bool)
        holds[found.sides[0]] = True
        are_known = np.ones(2 * count, dtype=bool)
        are_known[owners[~scene.is_known]] = False
        return holds, are_known[:count] & are_known[count:]

    def _placed(
        self, side: PairSide, run: Indices, start: int
    ) -> list[tuple[Indices, Indices, Array, Array, Array]]:
        """Whose, which solids, with which margins and where the shapes of one side's entities are.

        Args:
            side: one of the two entities of pairs.
            run: which of these pairs.
            start: the number of the first of their entities.
        """
        found = []
        ids = side.ids[run]
        for id in _different(ids):
            model = self._model(id)
            own = np.flatnonzero(ids == id)
            for link in np.unique(model.links).tolist():
                frames = self._frames(side, run[own], id, link)
                for shape in np.flatnonzero(model.links == link).tolist():
                    placed = _composed(frames, model.positions[shape], model.orientations[shape])
                    solid = np.full(len(own), model.of[shape])
                    margins = np.full(len(own), model.margins[shape])
                    poses = placed.positions, placed.orientations
                    found.append((start + own, solid, margins, *poses))
        nothing = np.zeros(0, dtype=np.intp)
        return [*found, (nothing, nothing, np.zeros(0), np.zeros((0, 3)), np.zeros((0, 4)))]

    def _frames(self, side: PairSide, rows: Indices, id: int, link: int) -> LinkPosesOverTicks:
        if link == 0:
            return LinkPosesOverTicks(side.base.positions[rows], side.base.orientations[rows])
        return side.links(rows, id, link)

    def _model(self, id: int) -> _Model:
        if id not in self._models:
            body = self._members[id].body
            shapes = [] if body is None else list(body.shapes)
            self._models[id] = _Model(
                np.array([self._place(shape.geometry) for shape in shapes], dtype=np.intp),
                np.array([shape.margin for shape in shapes], dtype=np.float64),
                np.array([shape.frame for shape in shapes], dtype=np.intp),
                np.array([shape.position for shape in shapes]).reshape(-1, 3),
                np.array([shape.orientation for shape in shapes]).reshape(-1, 4),
                BoundingBoxes(shapes, range(len(shapes)), len(shapes)),
            )
        return self._models[id]

    def _place(self, geometry: Geometry) -> int:
        if geometry.key not in self._places:
            self._places[geometry.key] = len(self._solids)
            self._solids.append(solid_of(geometry))
        return self._places[geometry.key]


def _joined(models: Sequence[_Model]) -> tuple[Indices, Array]:
    """The solids and the margins of all their shapes."""
    of, margins = ([getattr(model, name) for model in models] for name in ("of", "margins"))
    return np.concatenate(of), np.concatenate(margins)


def _around(boxes: Array) -> Array:
    """The box around boxes, (6,); of none a point that is nowhere."""
    if not len(boxes):
        return np.full(6, np.nan)
    return np.concatenate((boxes[:, :3].min(axis=0), boxes[:, 3:].max(axis=0)))


def _different(ids: Ids) -> list[int]:
    """Which ids there are; mostly it is one."""
    if len(ids) and (ids == ids[0]).all():
        return [int(ids[0])]
    found: list[int] = np.unique(ids).tolist()
    return found


def _composed(
    frames: LinkPosesOverTicks, position: Array, orientation: Array
) -> LinkPosesOverTicks:
    """Where something is that is fixed to each of n frames.

    Args:
        frames: the frames.
        position: (3,), in a frame.
        orientation: (4,), w, x, y, z, in a frame.
    """
    if not position.any() and np.array_equal(orientation, _UPRIGHT):
        return frames
    count = len(frames.positions)
    inner = np.broadcast_to(position, (count, 3)), np.broadcast_to(orientation, (count, 4))
    return LinkPosesOverTicks(*compose(frames.positions, frames.orientations, *inner))


_UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])


def _each_with_each(first: Indices, counts: Indices, second: Indices, others: Indices) -> Pairs:
    """Runs of shapes, each shape of the one with each of the other.

    Args:
        first: where the runs of the one side begin,
        counts: and how long they are.
        second: where those of the other side begin,
        others: and how long they are.
    """
    sizes = counts * others
    pair = np.repeat(np.arange(len(sizes)), sizes)
    place = np.arange(len(pair)) - np.repeat(np.cumsum(sizes) - sizes, sizes)
    width = others[pair]
    return first[pair] + place // width, second[pair] + place % width


def _scene_of(table: ShapeTable, positions: Array, orientations: Array) -> TickShapes:
    """Shapes at poses, without boxes.

    Args:
        table: what they are, and whose.
        positions: (n, 3), in the world.
        orientations: (n, 4), quaternions w, x, y, z; their lengths do not matter.
    """
    unit = unit_quaternions(orientations)
    with np.errstate(invalid="ignore"):
        finite = np.isfinite(positions).all(axis=1) & np.isfinite(unit).all(axis=1)
        matrices = flat_rotation_matrices(unit).reshape(3, 3, -1).transpose(2, 0, 1)
    known = of_known_entities(table, finite & table.is_known)
    return TickShapes(table, known, np.zeros((6, 0)), positions, matrices)
