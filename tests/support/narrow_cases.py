"""Shapes and numbers for the tests of the narrow phase."""

import itertools

import numpy as np

from ssduck.geometry.shapes import Geometry
from tests.support.pairs import Shape, ell
from tests.support.solids import STRAIGHT, box, capsule, cylinder, narrow, sphere

ORIGIN = (0.0, 0.0, 0.0)


def floor(size=2.0, cells=4):
    """An open mesh: a square of the ground."""
    axis = np.linspace(-size / 2, size / 2, cells + 1)
    vertices = np.array([[x, y, 0] for x in axis for y in axis])
    faces = []
    for i, j in itertools.product(range(cells), repeat=2):
        n = i * (cells + 1) + j
        faces += [[n, n + cells + 1, n + 1], [n + 1, n + cells + 1, n + cells + 2]]
    return Geometry("mesh", (0, 0, 0), vertices, np.array(faces, np.int32))


def shape(geometry, position=ORIGIN, turn=STRAIGHT):
    turn = np.array(turn, float)
    return Shape(geometry.type, geometry, np.array(position, float), turn / np.linalg.norm(turn))


def two(a, b, at=ORIGIN, turn=STRAIGHT):
    """Entity 0 at the origin, entity 1 at a place."""
    return narrow([(a, ORIGIN)], [(b, at, turn)])


# A shape that reaches 0.5 below its origin, and one whose top is at height 0.
OVER = {
    "box": box(),
    "sphere": sphere(),
    "cylinder": cylinder(),
    "capsule": capsule(0.25, 0.5),
    "hull": Geometry.hull([[0, 0, -0.5], [1, 0, 0], [0, 1, 0], [-1, -1, 0]]),
    "mesh": ell(1.0, 1.0, 1.0),
}


def frame(outer=2.0, inner=1.0, height=1.0):
    """A closed mesh: a square board with a square hole in it."""
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) / 2
    rims = [(size, z) for z in (-height / 2, height / 2) for size in (outer, inner)]
    vertices = np.concatenate([np.column_stack((size * corners, [z] * 4)) for size, z in rims])
    faces = []
    for m in range(4):
        n = (m + 1) % 4
        out, hole, up, hole_up = ((m + k, n + k) for k in (0, 4, 8, 12))
        for (p, q), (r, t) in ((out, up), (hole_up, hole), (hole, out), (up, hole_up)):
            faces += [[p, q, t], [p, t, r]]
    return Geometry("mesh", (0, 0, 0), vertices, np.array(faces, np.int32))


def of_trimesh(mesh):
    return Geometry("mesh", (0, 0, 0), np.array(mesh.vertices), np.array(mesh.faces, np.int32))
