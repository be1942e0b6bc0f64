"""Computes the mass distribution of links."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from tools.scenes.models import Link, Shape
from tools.scenes.pieces import Array, Piece, Vec, ngon, prism


def rotation(rpy: Vec) -> Array:
    (cr, cp, cy), (sr, sp, sy) = np.cos(rpy), np.sin(rpy)
    x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    return np.asarray(z @ y @ x, dtype=np.float64)


def solids(shape: Shape) -> Iterable[Piece]:
    """Returns a shape as polyhedra; a ball as the cube of the same moment of inertia per mass."""
    if shape.kind == "mesh":
        return shape.pieces
    if shape.kind in ("cylinder", "capsule"):  # a capsule of the length of all of it
        radius, length = shape.size
        length += 2 * radius * (shape.kind == "capsule")
        flat, half = ngon(16, 0.0, 0.0, radius), length / 2
    else:
        size = shape.size if shape.kind == "box" else (shape.size[0] * math.sqrt(2.4),) * 3
        (x, y, half) = (edge / 2 for edge in size)
        flat = np.array([(-x, -y), (x, -y), (x, y), (-x, y)])
    piece = prism(flat, -half, half)
    placed = piece.vertices @ rotation(shape.rpy).T + shape.origin
    return [Piece(placed, piece.faces)]


def inertial(link: Link) -> tuple[Array, Array]:
    """Returns the centre of mass and the diagonal of the inertia about it, for one material.

    Summed over the tetrahedra which each face, cut into triangles, forms with the origin.
    """
    volume, first, second = 0.0, np.zeros(3), np.zeros(3)
    for piece in (piece for shape in link.shapes if shape.collides for piece in solids(shape)):
        for face in piece.faces:
            for i in range(1, len(face) - 1):
                corners = piece.vertices[[face[0], face[i], face[i + 1]]]
                v = float(np.linalg.det(corners)) / 6
                total = corners.sum(axis=0)
                volume += v
                first += v * total / 4
                second += v * ((corners**2).sum(axis=0) + total**2) / 20
    centre = first / volume
    spread = (second / volume - centre**2) * link.mass
    return centre, spread.sum() - spread
