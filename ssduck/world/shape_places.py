"""Tells where the shapes of a tick are, from the poses of their links: `TickPlaces`."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cached_property

import numpy as np

from ssduck.geometry.arrays import Array
from ssduck.geometry.tick_solids import ShapePlaces
from ssduck.simulators.interface import LinkPoses
from ssduck.world.layout import BodyGroup, TableLayout


class TickPlaces(ShapePlaces):
    """Where the shapes of a tick are; those of two entities take no arrays of all shapes.

    Args:
        layout: the entities.
        groups: their groups with the link poses of the tick.
    """

    def __init__(self, layout: TableLayout, groups: Iterable[tuple[BodyGroup, LinkPoses]]) -> None:
        self._layout, self._groups = layout, list(groups)

    @cached_property
    def _block(self) -> Array:
        """The columns x to zmax of the table of shapes."""
        block = np.zeros((13, len(self._layout.shape_groups)))
        with np.errstate(invalid="ignore"):  # a diverging simulation has infinite numbers
            for group, poses in self._groups:
                group.write_shapes(poses, block)
        return block

    @cached_property
    def positions(self) -> Array:  # type: ignore[override]  # computed when asked for
        """The positions, (n, 3)."""
        return self._block[:3].T.copy()

    @cached_property
    def orientations(self) -> Array:  # type: ignore[override]
        """The orientations, (n, 4)."""
        return self._block[3:7].T.copy()

    @cached_property
    def boxes(self) -> Array:  # type: ignore[override]
        """The boxes, (n, 6): lower corner, upper corner."""
        return self._block[7:].T.copy()

    def pose(self, shape: int) -> tuple[list[float], list[float]]:
        """Returns the position and the orientation of a shape."""
        number, place = self._layout.shape_groups[shape]
        group, poses = self._groups[number]
        return group.shape_pose(poses, place)

    def box(self, shape: int) -> list[float]:
        """Returns the box of a shape: lower corner, upper corner."""
        number, place = self._layout.shape_groups[shape]
        group, poses = self._groups[number]
        with np.errstate(invalid="ignore"):
            box: list[float] = group.shape_boxes(poses)[:, place].tolist()
        return box
