"""Gives the triangles of geometries to formats that lack their primitives."""

from __future__ import annotations

import numpy as np
import trimesh

from ssduck.geometry.arrays import Array, Triangles
from ssduck.geometry.shapes import Geometry
from ssduck.geometry.solids import solid_of

_SIDES = 32
# Half the edge of the square that stands for a plane, m.
PLANE_HALF_SIZE = 10.0


def mesh_of(geometry: Geometry) -> tuple[Array, Triangles]:
    """Returns the vertices (n, 3), m, and triangles (m, 3) of a hull, mesh, capsule or plane.

    A capsule has so many sides; a plane is a square around the origin.
    """
    match geometry.type:
        case "plane":
            return _square(np.array(geometry.size))
        case "capsule":
            radius, length, _ = geometry.size
            capsule = trimesh.creation.capsule(radius=radius, height=length, count=[_SIDES, _SIDES])
            capsule.apply_translation(-capsule.bounds.mean(axis=0))
            return np.array(capsule.vertices), np.array(capsule.faces, dtype=np.int32)
        case _:
            surface = solid_of(geometry).surface
            return surface.vertices, surface.faces.astype(np.int32)


def _square(normal: Array) -> tuple[Array, Triangles]:
    along = np.eye(3)[np.argmin(np.abs(normal))]
    first = np.cross(normal, along)
    first /= np.linalg.norm(first)
    sides = np.array([first, np.cross(normal, first)])
    signs = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    return PLANE_HALF_SIZE * (signs @ sides), np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32)
