"""The geometry of the entities at a tick, for comparisons: shapes and places, regions, boxes."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate
from typing import Self

import numpy as np

from ssduck.geometry.arrays import Array, Indices
from ssduck.geometry.box_relations import BoxQueries
from ssduck.geometry.broad_phase import Ids, places_by_number
from ssduck.geometry.distance import CallCounter
from ssduck.geometry.margins import Margins
from ssduck.geometry.narrow_phase import NarrowPhase
from ssduck.geometry.queries import ShapeQueries
from ssduck.geometry.solids import solid_of
from ssduck.geometry.tick_shapes import ShapeTable
from ssduck.geometry.tick_solids import ShapePlaces
from ssduck.simulators.interface import LinkPoses
from ssduck.world.layout import BodyGroup, TableLayout
from ssduck.world.live_tables import LiveTable


@dataclass(frozen=True, eq=False)
class ComparableShapes:
    """What comparisons of the shapes of a world need to know besides their places."""

    starts: Sequence[int]  # the first shape of each entity, and the number of all
    numbers: Mapping[int, int]  # the number of each entity by its id
    ids: Ids  # (n,), the ids in the order of the table of entities
    places: Indices  # what `places_by_number` returns of them
    table: ShapeTable  # the properties of the shapes

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
        starts.append(starts[-1])
        return cls(starts, numbers, ids, places_by_number(numbers, ids), table)


class TickPlaces(ShapePlaces):
    """Where the shapes of a tick are."""

    def __init__(self, layout: TableLayout, groups: Iterable[tuple[BodyGroup, LinkPoses]]) -> None:
        self._layout, self._groups = layout, list(groups)

    @cached_property
    def _of_groups(self) -> list[tuple[Array, Array, Array]]:
        """The positions, the orientations and the boxes of the shapes of each group."""
        with np.errstate(invalid="ignore"):  # a diverging simulation has infinite numbers
            return [group.place_shapes(poses) for group, poses in self._groups]

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
    def positions(self) -> Array:  # computed when asked for
        """The positions, (n, 3)."""
        return self._in_order(0, axis=0)

    @cached_property
    def orientations(self) -> Array:
        """The orientations, (n, 4)."""
        return self._in_order(1, axis=0)

    @cached_property
    def boxes(self) -> Array:
        """The boxes, (n, 6): lower corner, upper corner."""
        return self._in_order(2, axis=1).T

    def entity_boxes(self) -> Array:
        """Returns the boxes of the entities by row, (6, entities)."""
        boxes = np.zeros((6, len(self._layout.entities), 1))
        with np.errstate(invalid="ignore"):
            for group, poses in self._groups:
                group.write_boxes(poses, boxes)
        return boxes[..., 0]


class TickGeometry(ABC):
    """What comparisons of the entities of a tick need, made when it is asked for."""

    def __init__(self) -> None:
        self.calls = CallCounter()
        self._live: dict[str, LiveTable] = {}
        self._layout = TableLayout((), is_external=False)
        # The link poses in the tables: of the bodies that cannot move, and of the others.
        self._link_poses: tuple[LinkPoses, ...] = ()
        self._shapes: ShapeQueries | None = None
        self._shapes_and_sites: ShapeQueries | None = None
        self._boxes: BoxQueries | None = None
        self._solids: tuple[TableLayout, ComparableShapes] | None = None
        # The margins of the shapes if those of two are not the sums of theirs.
        self.margins_of_pairs: Margins | None = None

    @abstractmethod
    def write_rows(self) -> None:
        """Writes the rows of this tick, but those of contacts, unless they are written."""

    @property
    def _tables(self) -> dict[str, LiveTable]:
        """The tables, in which the rows of this tick are written, but those of contacts."""
        self.write_rows()
        return self._live

    @property
    def body_groups(self) -> Iterator[tuple[BodyGroup, LinkPoses]]:
        """The groups of bodies that are read together, each with its link poses at this tick."""
        return zip(
            (self._layout.static_bodies, self._layout.moving_bodies), self._link_poses, strict=True
        )

    def _numbers_in(self, table: str, row: int, columns: tuple[str, ...]) -> list[float] | None:
        """Returns numbers that follow from poses, for which no row need be written; else None."""
        if table not in ("entities", "links") or not self._link_poses:
            return None
        found = (
            group.numbers_in(poses, table, row, columns)
            for group, poses in self.body_groups
            if poses.are_finite
        )
        return next((numbers for numbers in found if numbers is not None), None)

    def shapes(self) -> ShapeQueries:
        """Returns the shape queries of this tick; the table of shapes must have been requested."""
        if self._shapes is None:
            shapes, places = self._comparable, TickPlaces(self._layout, self.body_groups)
            self._shapes = ShapeQueries(
                NarrowPhase(shapes.table, places, shapes.starts, self.calls),
                shapes.numbers,
                places.entity_boxes,
                shapes.ids,
                self._live["shapes"]["link"],
                places=shapes.places,
            )
        return self._shapes

    def shapes_and_sites(self) -> ShapeQueries:
        """Returns the shape queries of this tick, in which sites have their regions as shapes."""
        layout = self._layout
        if not layout.sites:
            return self.shapes()
        if self._shapes_and_sites is None:
            placed = [group.place_regions(poses) for group, poses in self.body_groups]
            poses = [np.concatenate(parts) for parts in zip(*placed, strict=True)]
            regions = [region for _, _, region in layout.sites]
            entities, links, _ = (np.array(column) for column in zip(*layout.sites, strict=True))
            self._shapes_and_sites = self.shapes().with_regions(regions, poses, entities, links)
        return self._shapes_and_sites

    def boxes(self) -> BoxQueries:
        """Returns the boxes and the positions of the entities of this tick."""
        if self._boxes is None:
            entities = self._tables["entities"]
            boxes, positions = entities.doubles("xmin", "zmax"), entities.doubles("x", "z")
            self._boxes = BoxQueries(boxes.copy(), positions.copy(), entities["id"].copy())
        return self._boxes

    @property
    def _comparable(self) -> ComparableShapes:
        """What comparisons of the shapes need to know, the same while nothing changes."""
        if self._solids is None or self._solids[0] is not self._layout:
            margins = self.margins_of_pairs or Margins(self._live["shapes"]["margin"].copy())
            self._solids = self._layout, ComparableShapes.of(self._layout, margins)
        return self._solids[1]

    @property
    def margins(self) -> float:
        """The largest distance of two shapes whose margins touch, m."""
        return 2.0 * float(self._tables["shapes"]["margin"].max(initial=0.0))
