"""Answers questions about pairs of entities at many recorded ticks in one batch.

Each pair at a tick becomes two separate entities of one narrow phase
(`ssduck.geometry.narrow_phase`), so that all pairs are compared together. Shapes of different
pairs are never compared.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from itertools import accumulate

import numpy as np
import numpy.typing as npt

from ssduck.geometry.arrays import Array, Indices
from ssduck.geometry.bounds import BoundingBoxes
from ssduck.geometry.broad_phase import Pairs
from ssduck.geometry.distance import CallCounter
from ssduck.geometry.narrow_phase import NarrowPhase
from ssduck.geometry.pair_batch import Answers, PairBatch, PairQuestion, QuestionKind
from ssduck.geometry.poses import IDENTITY, compose, rotation_matrices
from ssduck.geometry.queries import ShapeQueries
from ssduck.geometry.shapes import Geometry
from ssduck.geometry.solids import Solid, solid_of
from ssduck.geometry.tick_shapes import ShapeTable
from ssduck.geometry.tick_solids import ShapePlaces
from ssduck.world.layout import EntityInfo

Ids = npt.NDArray[np.int64]

# The number of pairs of shapes that are compared at a time.
MAX_BATCH_SIZE = 1 << 15


@dataclass(frozen=True, eq=False)
class _ShapeModel:
    """The n shapes of an entity."""

    solid_indices: Indices  # (n,)
    margins: Array  # (n,), m
    links: Indices  # (n,), the number of each shape's link
    positions: Array  # (n, 3), in the frames of the links, m
    orientations: Array  # (n, 4), w, x, y, z, in the frames of the links
    boxes: BoundingBoxes

    @property
    def count(self) -> int:
        return len(self.solid_indices)


@dataclass(frozen=True, eq=False)
class PairSide:
    """The first or the second entity of each of n pairs."""

    ids: Ids  # (n,), the ids of the entities
    base_poses: Array  # (n, 7), the poses of their base links: x, y, z, m, qw, qx, qy, qz
    # returns the poses of a link for rows of the pairs, (rows, 7), by the rows, the id of the
    # entity and the number of the link
    link_poses: Callable[[Indices, int, int], Array]

    def poses_of(self, rows: Indices, id: int, link: int) -> Array:
        """Returns the poses of the base or of another link for rows of the pairs, (rows, 7)."""
        return self.link_poses(rows, id, link) if link else self.base_poses[rows]


class EntityShapes:
    """The shapes of recorded entities; shapes of the same geometry share a solid."""

    def __init__(self, members: Mapping[int, EntityInfo]) -> None:
        self._members = members
        self._solids: list[Solid] = []
        self._solid_indices: dict[str, int] = {}
        self._shape_models: dict[int, _ShapeModel] = {}

    def _queries(self, places: _Places, calls: CallCounter) -> ShapeQueries:
        """Returns queries of the shapes of entities, by their numbers, at poses of their links."""
        models = [self._shape_model(id) for id in places.ids]
        counts = [model.count for model in models]
        links, solids, margins = (
            np.concatenate([getattr(model, name) for model in models])
            for name in ("links", "solid_indices", "margins")
        )
        numbers = np.arange(len(models))
        table = ShapeTable(self._solids, solids, numbers.repeat(counts), margins)
        placed = list(map(self._shapes_at, models, places.poses))
        shape_places = ShapePlaces(
            *(np.concatenate([part[i] for part in placed]) for i in range(3))
        )
        narrow = NarrowPhase(table, shape_places, list(accumulate(counts, initial=0)), calls)
        boxes = np.array([_enclosing_box(part[2]) for part in placed]).reshape(-1, 6).T
        return ShapeQueries(narrow, {n: n for n in numbers.tolist()}, boxes, numbers, links)

    def _shapes_at(self, model: _ShapeModel, poses: Array) -> tuple[Array, Array, Array]:
        """Returns the positions, orientations and boxes of an entity's shapes."""
        link_poses = poses[model.links]
        with np.errstate(invalid="ignore"):
            positions, orientations = compose(
                link_poses[:, :3], link_poses[:, 3:], model.positions, model.orientations
            )
            matrices = rotation_matrices(poses[:, 3:])
            boxes = model.boxes.boxes(poses[:, :3], matrices).T
        return positions, orientations, boxes

    def answers(
        self,
        first: PairSide,
        second: PairSide,
        question: PairQuestion,
        calls: CallCounter,
        advance: Callable[[int], object] = int,
        groups: Indices | None = None,
    ) -> Answers:
        """Returns the answers to a question about n pairs of entities."""
        values = np.zeros(len(first.ids))
        is_open = np.zeros(len(first.ids), dtype=bool)
        step = partial(advance, 0)
        for rows in self._portions(first.ids, second.ids):
            if question.is_placed:
                values[rows] = self._placed_answers(first, second, rows, question.kind, calls, step)
            else:
                batch = self._batch(first, second, rows, calls, step)
                answers = batch.answers(question, None if groups is None else groups[rows])
                if question.kind != "resting":
                    calls.pairs += batch.compared_count
                values[rows], is_open[rows] = answers.values, answers.is_open
            advance(len(rows))
        return Answers(values, is_open)

    def _portions(self, first: Ids, second: Ids) -> Iterator[Indices]:
        """Yields the rows of pairs, as many at a time as are compared together."""
        counts = self._shape_counts(first) * self._shape_counts(second)
        ends = np.cumsum(np.maximum(counts, 1))
        start = 0
        while start < len(counts):
            before = ends[start - 1] if start else 0
            end = int(np.searchsorted(ends, before + MAX_BATCH_SIZE, side="right"))
            yield np.arange(start, max(end, start + 1))
            start = max(end, start + 1)

    def _placed_answers(
        self,
        first: PairSide,
        second: PairSide,
        rows: Indices,
        kind: QuestionKind,
        calls: CallCounter,
        step: Callable[[], object],
    ) -> Array:
        """Returns the answers about some pairs; two poses of two entities are compared once."""
        places = _Places()
        numbers = [self._place(side, rows, places) for side in (first, second)]
        queries = self._queries(places, calls)
        answers: dict[tuple[int, int], float] = {}
        pairs = list(zip(*numbers, strict=True))
        for a, b in pairs:
            if (a, b) not in answers:
                step()
                answer: float | None
                if kind == "inside":
                    answer = queries.inside(a, b)
                elif kind == "contains":
                    answer = queries.contains(a, b)
                else:
                    answer = queries.encloses(a, b, *places.poses[a][0, 3:].tolist())
                answers[a, b] = float("nan") if answer is None else float(answer)
        return np.array([answers[pair] for pair in pairs])

    def _place(self, side: PairSide, rows: Indices, places: _Places) -> list[int]:
        """Adds the entities of one side of some pairs to places; returns their numbers."""
        numbers = np.zeros(len(rows), dtype=np.intp)
        ids = side.ids[rows]
        for id in _unique_ids(ids):
            members = np.flatnonzero(ids == id)
            body = self._members[id].body
            count = 1 if body is None else len(body.links)
            links = [side.poses_of(rows[members], id, link) for link in range(count)]
            poses = np.stack(links, axis=1)
            numbers[members] = [places.number(id, at_row) for at_row in poses]
        listed: list[int] = numbers.tolist()
        return listed

    def _shape_counts(self, ids: Ids) -> Indices:
        counts = np.zeros(len(ids), np.intp)
        for id in _unique_ids(ids):
            counts[ids == id] = self._shape_model(id).count
        return counts

    def _batch(
        self,
        first: PairSide,
        second: PairSide,
        rows: Indices,
        calls: CallCounter,
        step: Callable[[], object],
    ) -> PairBatch:
        """Returns n of the pairs with their shapes; the entities of pair k are k and n + k."""
        parts = [*self._place_shapes(first, rows, 0), *self._place_shapes(second, rows, len(rows))]
        owners, solid_indices = (np.concatenate([part[i] for part in parts]) for i in (0, 1))
        margins, *poses = (np.concatenate([part[i] for part in parts]) for i in (2, 3, 4))
        positions, orientations = poses
        if (owners[1:] < owners[:-1]).any():  # the shapes of an entity have to be consecutive
            order = np.argsort(owners, kind="stable")
            owners, solid_indices, margins = owners[order], solid_indices[order], margins[order]
            positions, orientations = positions[order], orientations[order]
        count = len(rows)
        counts = np.bincount(owners, minlength=2 * count)
        starts = np.concatenate(([0], np.cumsum(counts)))
        sides = (starts[:count], counts[:count], starts[count:-1], counts[count:])
        boxes = np.tile([-np.inf] * 3 + [np.inf] * 3, (len(owners), 1))
        places = ShapePlaces(positions, orientations, boxes)
        table = ShapeTable(self._solids, solid_indices, owners, margins)
        narrow = NarrowPhase(table, places, starts.tolist(), calls)
        return PairBatch(_cross_pairs(*sides), count, narrow, starts, step)

    def _place_shapes(
        self, side: PairSide, rows: Indices, start: int
    ) -> list[tuple[Indices, Indices, Array, Array, Array]]:
        """Returns owners, solid indices, margins and poses of the shapes of one side of pairs."""
        parts = []
        ids = side.ids[rows]
        for id in _unique_ids(ids):
            model = self._shape_model(id)
            members = np.flatnonzero(ids == id)
            for link in np.unique(model.links).tolist():
                link_poses = side.poses_of(rows[members], id, link)
                for shape in np.flatnonzero(model.links == link).tolist():
                    poses = _compose_fixed(
                        link_poses, model.positions[shape], model.orientations[shape]
                    )
                    solid = np.full(len(members), model.solid_indices[shape])
                    margins = np.full(len(members), model.margins[shape])
                    parts.append((start + members, solid, margins, *poses))
        empty = np.zeros(0, dtype=np.intp)
        return [*parts, (empty, empty, np.zeros(0), np.zeros((0, 3)), np.zeros((0, 4)))]

    def _shape_model(self, id: int) -> _ShapeModel:
        if id not in self._shape_models:
            body = self._members[id].body
            shapes = [] if body is None else list(body.shapes)
            self._shape_models[id] = _ShapeModel(
                np.array([self._solid_index(shape.geometry) for shape in shapes], dtype=np.intp),
                np.array([shape.margin for shape in shapes], dtype=np.float64),
                np.array([shape.frame for shape in shapes], dtype=np.intp),
                np.array([shape.position for shape in shapes]).reshape(-1, 3),
                np.array([shape.orientation for shape in shapes]).reshape(-1, 4),
                BoundingBoxes(shapes, range(len(shapes)), len(shapes)),
            )
        return self._shape_models[id]

    def _solid_index(self, geometry: Geometry) -> int:
        if geometry.key not in self._solid_indices:
            self._solid_indices[geometry.key] = len(self._solids)
            self._solids.append(solid_of(geometry))
        return self._solid_indices[geometry.key]


@dataclass
class _Places:
    """Entities at some of their poses, (links, 7), numbered from 0."""

    ids: list[int] = field(default_factory=list)
    poses: list[Array] = field(default_factory=list)
    _numbers: dict[tuple[int, bytes], int] = field(default_factory=dict)

    def number(self, id: int, poses: Array) -> int:
        """Returns the number of an entity at poses of its links."""
        key = id, poses.tobytes()
        if key not in self._numbers:
            self._numbers[key] = len(self.ids)
            self.ids.append(id)
            self.poses.append(poses)
        return self._numbers[key]


def _enclosing_box(boxes: Array) -> Array:
    """Returns the box around boxes, (6,); NaN if there are none."""
    if not len(boxes):
        return np.full(6, np.nan)
    return np.concatenate((boxes[:, :3].min(axis=0), boxes[:, 3:].max(axis=0)))


def _unique_ids(ids: Ids) -> list[int]:
    """Returns the distinct ids; mostly there is one."""
    if len(ids) and (ids == ids[0]).all():
        return [int(ids[0])]
    distinct: list[int] = np.unique(ids).tolist()
    return distinct


def _compose_fixed(frames: Array, position: Array, orientation: Array) -> tuple[Array, Array]:
    """Returns the positions and orientations of something at a pose in each of n frames, (n, 7)."""
    placed = frames[:, :3], frames[:, 3:]
    if not position.any() and np.array_equal(orientation, IDENTITY):
        return placed
    count = len(frames)
    inner = np.broadcast_to(position, (count, 3)), np.broadcast_to(orientation, (count, 4))
    return compose(*placed, *inner)


def _cross_pairs(first: Indices, counts: Indices, second: Indices, others: Indices) -> Pairs:
    """Returns all pairs of a shape of a run and a shape of the corresponding other run."""
    sizes = counts * others
    pair = np.repeat(np.arange(len(sizes)), sizes)
    place = np.arange(len(pair)) - np.repeat(np.cumsum(sizes) - sizes, sizes)
    width = others[pair]
    return first[pair] + place // width, second[pair] + place % width
