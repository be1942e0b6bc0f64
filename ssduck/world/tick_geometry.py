"""The geometry of the entities at a tick, for comparisons: shapes, regions of sites, boxes."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator

import numpy as np

from ssduck.geometry.box_relations import BoxQueries
from ssduck.geometry.distance import CallCounter
from ssduck.geometry.margins import Margins
from ssduck.geometry.narrow_phase import NarrowPhase
from ssduck.geometry.queries import ShapeQueries
from ssduck.simulators.interface import LinkPoses
from ssduck.world.layout import BodyGroup, TableLayout
from ssduck.world.live_tables import LiveTable
from ssduck.world.shape_places import ComparableShapes, TickPlaces


class TickGeometry(ABC):
    """What comparisons of the entities of a tick need, made when it is asked for.

    Attributes:
        calls: the number of narrow-phase calls over all ticks.
    """

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
        for group, poses in reversed(list(self.body_groups)):  # most asked for can move
            if poses.are_finite:
                found = group.numbers_in(poses, table, row, columns)
                if found is not None:
                    return found
        return None

    def shapes(self) -> ShapeQueries:
        """Returns the shape queries of this tick; the table of shapes must have been requested."""
        if self._shapes is None:
            shapes, places = self._comparable, TickPlaces(self._layout, self.body_groups)
            self._shapes = ShapeQueries(
                NarrowPhase(shapes.solids, places, shapes.starts, self.calls),
                shapes.numbers,
                shapes.table,
                places.entity_boxes,
                shapes.ids,
                self._tables["shapes"]["link"],
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
            margins = self.margins_of_pairs or Margins(self._tables["shapes"]["margin"].copy())
            self._solids = self._layout, ComparableShapes.of(self._layout, margins)
        return self._solids[1]

    @property
    def margins(self) -> float:
        """The largest distance of two shapes whose margins touch, m."""
        return 2.0 * float(self._tables["shapes"]["margin"].max(initial=0.0))
