"""The shapes of a world for comparisons, and where they are at a tick."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate
from typing import Self

import numpy as np

from ssduck.geometry.arrays import Array, Indices
from ssduck.geometry.id_pairs import Ids, places_by_number
from ssduck.geometry.margins import Margins
from ssduck.geometry.solids import solid_of
from ssduck.geometry.tick_shapes import ShapeTable
from ssduck.geometry.tick_solids import ShapePlaces, ShapeSolids
from ssduck.simulators.interface import LinkPoses
from ssduck.world.layout import BodyGroup, TableLayout


@dataclass(frozen=True, eq=False)
class ComparableShapes:
    """What comparisons of the shapes of a world need to know besides their places.

    Attributes:
        starts: the first shape of each entity, and the number of all.
        numbers: the number of each entity by its id.
        ids: (n,), the ids in the order of the table of entities.
        places: what `places_by_number` returns of them.
        table: the entities of the shapes, and what else they have.
        solids: their solids and margins.
    """

    starts: Sequence[int]
    numbers: Mapping[int, int]
    ids: Ids
    places: Indices
    table: ShapeTable
    solids: ShapeSolids

    @classmethod
    def of(cls, layout: TableLayout, margins: Margins) -> Self:
        """Returns that of the bodies of a layout, whose shapes have some margins."""
        bodies = layout.bodies
        shapes = [shape for _, body in bodies for shape in body.shapes]
        distinct = {shape.geometry.key: shape.geometry for shape in shapes}
        indices = {key: index for index, key in enumerate(distinct)}
        solid_indices = np.array([indices[shape.geometry.key] for shape in shapes], dtype=np.intp)
        solids = list(map(solid_of, distinct.values()))
        counts = [len(body.shapes) for _, body in bodies]
        starts = list(accumulate(counts, initial=0))
        numbers = {id: number for number, (id, _) in enumerate(bodies)}
        # Sensors have no shapes: they share an empty range after those of all bodies.
        sensor_ids = [info.id for info in layout.entities if info.body is None]
        numbers |= dict.fromkeys(sensor_ids, len(bodies))
        owners = np.repeat(np.arange(len(bodies)), counts)
        table = ShapeTable(solids, solid_indices, owners, margins)
        ids = np.array([info.id for info in layout.entities], np.int64)
        shape_solids = ShapeSolids(solids, solid_indices, margins)
        starts.append(starts[-1])
        return cls(starts, numbers, ids, places_by_number(numbers, ids), table, shape_solids)


class TickPlaces(ShapePlaces):
    """Where the shapes of a tick are; those of two entities take no arrays of all shapes.

    Args:
        layout: the entities.
        groups: their groups with the link poses of the tick.
    """

    def __init__(self, layout: TableLayout, groups: Iterable[tuple[BodyGroup, LinkPoses]]) -> None:
        self._layout, self._groups = layout, list(groups)

    @cached_property
    def _of_groups(self) -> list[tuple[Array, Array, Array]]:
        """The positions, the orientations and the boxes of the shapes of each group."""
        with np.errstate(invalid="ignore"):  # a diverging simulation has infinite numbers
            return [group.place_shapes(poses) for group, poses in self._groups]

    @property
    def _are_placed(self) -> bool:
        """Whether the arrays of all shapes are there."""
        return "_of_groups" in self.__dict__

    def _in_order(self, part: int, axis: int) -> Array:
        """Returns a part of what is known of each group, of all shapes in their order."""
        order = self._layout.shape_order
        parts = [of_group[part] for of_group in self._of_groups]
        some = [values for values in parts if values.shape[axis]]
        if len(some) != 1:
            some = [np.concatenate(parts, axis=axis)]
        ordered: Array = some[0] if order is None else some[0].take(order, axis=axis)
        return ordered

    @cached_property
    def positions(self) -> Array:  # type: ignore[override]  # computed when asked for
        """The positions, (n, 3)."""
        return self._in_order(0, axis=0)

    @cached_property
    def orientations(self) -> Array:  # type: ignore[override]
        """The orientations, (n, 4)."""
        return self._in_order(1, axis=0)

    @cached_property
    def boxes(self) -> Array:  # type: ignore[override]
        """The boxes, (n, 6): lower corner, upper corner."""
        return self._in_order(2, axis=1).T

    def entity_boxes(self) -> Array:
        """Returns the boxes of the entities by row, (6, entities)."""
        boxes = np.zeros((6, len(self._layout.entities), 1))
        with np.errstate(invalid="ignore"):
            for group, poses in self._groups:
                group.write_boxes(poses, boxes)
        return boxes[..., 0]

    def pose(self, shape: int) -> tuple[list[float], list[float]]:
        """Returns the position and the orientation of a shape."""
        if self._are_placed:
            return super().pose(shape)
        number, place = self._layout.shape_groups[shape]
        group, poses = self._groups[number]
        return group.shape_pose(poses, place)

    def box(self, shape: int) -> list[float]:
        """Returns the box of a shape: lower corner, upper corner."""
        if self._are_placed:
            return super().box(shape)
        number, place = self._layout.shape_groups[shape]
        group, poses = self._groups[number]
        with np.errstate(invalid="ignore"):
            return group.shape_box(poses, place)
