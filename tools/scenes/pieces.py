"""Makes convex pieces, of which meshes consist.

PyBullet treats each `o` group of a mesh as a convex hull, so a mesh is a list of convex pieces, and
hollow things consist of several.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Span = tuple[float, float]
Vec = tuple[float, float, float]
Quat = tuple[float, float, float, float]
Array = NDArray[np.float64]


RIGHT = math.pi / 2


@dataclass(frozen=True)
class Piece:
    """A convex polyhedron; its faces turn counter-clockwise seen from outside."""

    vertices: Array
    faces: tuple[tuple[int, ...], ...]


def loft(*rings: Array) -> Piece:
    """Returns the solid through rings of as many points each, counter-clockwise from the last."""
    n = len(rings[0])
    faces = [tuple(reversed(range(n)))]
    for base in range(0, n * (len(rings) - 1), n):
        for i in range(n):
            j = (i + 1) % n
            faces.append((base + i, base + j, base + n + j, base + n + i))
    faces.append(tuple(range(n * (len(rings) - 1), n * len(rings))))
    return Piece(np.vstack(rings), tuple(faces))


def ring(outline: Array, z: float, scale: float = 1.0) -> Array:
    """Returns an outline at a height, scaled about the middle of its box."""
    middle = (outline.min(axis=0) + outline.max(axis=0)) / 2
    flat = outline if scale == 1.0 else middle + scale * (outline - middle)
    return np.column_stack([flat, np.full(len(flat), z)])


def prism(outline: Array, z0: float, z1: float, s0: float = 1.0, s1: float | None = None) -> Piece:
    return loft(ring(outline, z0, s0), ring(outline, z1, s0 if s1 is None else s1))


def wall(outer0: Array, inner0: Array, outer1: Array, inner1: Array) -> list[Piece]:
    """Returns the pieces between an outer and an inner ring: sides of a cup, the rim of a plate."""
    n = len(outer0)
    pieces = []
    for i in range(n):
        j = (i + 1) % n
        low = np.array([outer0[i], outer0[j], inner0[j], inner0[i]])
        high = np.array([outer1[i], outer1[j], inner1[j], inner1[i]])
        pieces.append(loft(low, high))
    return pieces


def ngon(n: int, x: float, y: float, radius: float) -> Array:
    """Returns a regular polygon standing on an edge, so that its box is 2 radius cos(pi/n) wide."""
    angles = np.pi / n + 2 * np.pi * np.arange(n) / n
    return np.column_stack([x + radius * np.cos(angles), y + radius * np.sin(angles)])


def profile(points: Sequence[Span], x0: float, x1: float) -> Piece:
    """Returns a side view in y and z, counter-clockwise seen from +x, drawn out along x."""
    yz = np.array(points)
    return loft(*(np.column_stack([np.full(len(yz), x), yz]) for x in (x0, x1)))
