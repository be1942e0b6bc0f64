"""Builds the solids of MuJoCo's height fields."""

from __future__ import annotations

from typing import Any

import numpy as np

from ssduck.geometry.arrays import Indices
from ssduck.geometry.shapes import Geometry


def height_field(model: Any, number: int) -> Geometry:
    """Returns the solid under a height field, as MuJoCo collides it, in the frame of its shape.

    MuJoCo divides each cell by the diagonal from its first to its last corner, and puts a prism
    under each triangle, which ends at the bottom of the field. The closed surface of all prisms is
    the same solid.
    """
    rows, columns = int(model.hfield_nrow[number]), int(model.hfield_ncol[number])
    x_half, y_half, height, depth = model.hfield_size[number].tolist()
    first = int(model.hfield_adr[number])
    heights = model.hfield_data[first : first + rows * columns].astype(np.float64) * height
    xs, ys = np.linspace(-x_half, x_half, columns), np.linspace(-y_half, y_half, rows)
    x, y = np.meshgrid(xs, ys)
    top = np.column_stack((x.reshape(-1), y.reshape(-1), heights))
    numbers = np.arange(rows * columns).reshape(rows, columns)
    outline = _outline(numbers)
    below = len(top) + np.arange(len(outline))
    bottom = top[outline]
    bottom[:, 2] = -depth
    centre = np.array([[0.0, 0.0, -depth]])
    following, following_below = np.roll(outline, -1), np.roll(below, -1)
    middle = np.full(len(below), len(top) + len(below))
    faces = np.concatenate(
        (
            _cells(numbers),
            np.column_stack((outline, below, following_below)),
            np.column_stack((outline, following_below, following)),
            np.column_stack((below, middle, following_below)),
        )
    )
    vertices = np.concatenate((top, bottom, centre))
    return Geometry("mesh", (0.0, 0.0, 0.0), vertices, faces.astype(np.int32))


def _cells(numbers: Indices) -> Indices:
    """Returns the two triangles of each cell of a grid of vertices, seen from above."""
    here, right = numbers[:-1, :-1].reshape(-1), numbers[:-1, 1:].reshape(-1)
    ahead, diagonal = numbers[1:, :-1].reshape(-1), numbers[1:, 1:].reshape(-1)
    lower = np.column_stack((here, right, diagonal))
    return np.concatenate((lower, np.column_stack((here, diagonal, ahead))))


def _outline(numbers: Indices) -> Indices:
    """Returns the vertices of the outline of a grid, to the left around it."""
    sides = (numbers[0, :-1], numbers[:-1, -1], numbers[-1, :0:-1], numbers[:0:-1, 0])
    return np.concatenate(sides)
