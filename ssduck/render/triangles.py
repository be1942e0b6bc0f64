"""The triangles of geometries, with the normals that they are lit by."""

from __future__ import annotations

from typing import Any

import numpy as np
import trimesh

from ssduck.geometry.arrays import Array
from ssduck.geometry.shapes import Geometry
from ssduck.geometry.solids import solid_of

# Half the side of the square that is drawn of a plane, m.
PLANE_HALF_SIZE = 100.0
# Faces that meet at a smaller angle, degrees, look like one curved surface.
SMOOTH_ANGLE = 35.0
_SIDES = 48


def triangles(geometry: Geometry) -> Array:
    """Returns the corners of a geometry's triangles, (3 n, 6): x y z, and the normal there."""
    if geometry.type == "plane":
        return _plane(np.array(geometry.size))
    mesh = _mesh(geometry)
    corners = mesh.vertices[mesh.faces].reshape(-1, 3)
    return np.hstack((corners, _normals(mesh)))


def _mesh(geometry: Geometry) -> Any:
    a, b, c = geometry.size
    match geometry.type:
        case "box":
            return trimesh.creation.box((a, b, c))
        case "sphere":
            return trimesh.creation.icosphere(subdivisions=4, radius=a)
        case "cylinder":
            return trimesh.creation.cylinder(radius=a, height=b, sections=_SIDES)
        case "capsule":
            capsule = trimesh.creation.capsule(radius=a, height=b, count=[_SIDES, _SIDES])
            return capsule.apply_translation(-capsule.bounds.mean(axis=0))
        case _:
            surface = solid_of(geometry).surface
            return trimesh.Trimesh(surface.vertices, surface.faces, process=False)


def _plane(normal: Array) -> Array:
    """Returns two triangles of a half-space's surface through the origin."""
    along = np.eye(3)[np.argmin(np.abs(normal))]
    first = np.cross(normal, along)
    first /= np.linalg.norm(first)
    second = np.cross(normal, first)
    signs = np.array([[-1, -1], [1, -1], [1, 1], [-1, -1], [1, 1], [-1, 1]])
    corners = PLANE_HALF_SIZE * (signs @ np.array([first, second]))
    return np.hstack((corners, np.broadcast_to(normal, corners.shape)))


def _normals(mesh: Any) -> Array:
    """Returns the normal of each corner: the mean of the adjacent faces that are smooth with it."""
    faces, face_normals = np.asarray(mesh.faces), np.asarray(mesh.face_normals)
    weighted = face_normals * np.asarray(mesh.area_faces)[:, None]
    # The corners by vertex: those of a vertex are compared with each other.
    vertices = faces.ravel()
    order = np.argsort(vertices, kind="stable")
    owners = np.repeat(np.arange(len(faces)), 3)
    normals = face_normals[owners].copy()
    starts = np.flatnonzero(np.r_[True, np.diff(vertices[order]) > 0])
    counts = np.diff(np.r_[starts, len(order)])
    limit = np.cos(np.radians(SMOOTH_ANGLE))
    for count in np.unique(counts):  # all vertices with as many faces at once
        corners = order[starts[counts == count][:, None] + np.arange(count)]
        around = owners[corners]
        own = face_normals[around]
        is_smooth = np.einsum("nik,njk->nij", own, own) > limit
        normals[corners] = np.einsum("nij,njk->nik", is_smooth, weighted[around])
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    flat = face_normals[owners]
    return np.where(lengths > 0, normals / np.where(lengths > 0, lengths, 1.0), flat)
