"""What MuJoCo draws of a body: the geoms of its visible groups, with their colours.

MuJoCo's viewer shows the groups 0 to 2. A geom has its own colour unless that is MuJoCo's default
and the geom has a material.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import trimesh

from ssduck.geometry.shapes import Geometry
from ssduck.simulators.interface import Body, VisualShape
from ssduck.simulators.mujoco.bodies import geometry_of, numbers_of
from ssduck.simulators.mujoco.library import mujoco
from ssduck.simulators.visuals import collision_visuals

# The groups that MuJoCo shows unless told otherwise.
VISIBLE_GROUPS = (0, 1, 2)
# A geom of this colour has that of its material, if there is one.
_DEFAULT_COLOUR = (0.5, 0.5, 0.5, 1.0)
# The triangles of a drawn ellipsoid: those of an icosahedron, each divided into four so many times.
_SUBDIVISIONS = 3


def visual_shapes(model: Any, body: Body) -> list[VisualShape]:
    """Returns the geoms that are drawn of a body; its collision shapes if none is."""
    drawn = [
        _shape(model, number, link)
        for link, owner in enumerate(numbers_of(body))
        for number in np.flatnonzero(model.geom_bodyid == owner).tolist()
        if model.geom_group[number] in VISIBLE_GROUPS and _colour(model, number)[3] > 0.0
    ]
    return drawn or collision_visuals(body)


def _shape(model: Any, number: int, link: int) -> VisualShape:
    geometry, centre = _drawn_geometry(model, number)
    position, orientation = model.geom_pos[number].copy(), model.geom_quat[number].copy()
    if centre.any():
        matrix = np.zeros(9)
        mujoco.mju_quat2Mat(matrix, orientation)
        position += matrix.reshape(3, 3) @ centre
    return VisualShape(link, geometry, position, orientation, _colour(model, number))


def _drawn_geometry(model: Any, number: int) -> tuple[Geometry, Any]:
    """Returns the form of a geom, and its centre in the frame of the geom, m."""
    type = int(model.geom_type[number])
    if type == mujoco.mjtGeom.mjGEOM_MESH:
        return _mesh(model, int(model.geom_dataid[number])), np.zeros(3)
    if type == mujoco.mjtGeom.mjGEOM_ELLIPSOID:
        sphere = trimesh.creation.icosphere(subdivisions=_SUBDIVISIONS)
        vertices = np.asarray(sphere.vertices) * model.geom_size[number]
        return _triangles(vertices, sphere.faces), np.zeros(3)
    geometry, centre, _ = geometry_of(model, number)
    return geometry, centre


def _mesh(model: Any, mesh: int) -> Geometry:
    first, face = int(model.mesh_vertadr[mesh]), int(model.mesh_faceadr[mesh])
    vertices = model.mesh_vert[first : first + int(model.mesh_vertnum[mesh])]
    return _triangles(vertices, model.mesh_face[face : face + int(model.mesh_facenum[mesh])])


def _triangles(vertices: Any, faces: Any) -> Geometry:
    corners = np.array(vertices, dtype=np.float64)
    return Geometry("mesh", (0.0, 0.0, 0.0), corners, np.array(faces, dtype=np.int32))


def _colour(model: Any, number: int) -> tuple[float, float, float, float]:
    values = model.geom_rgba[number]
    material = int(model.geom_matid[number])
    if material >= 0 and np.allclose(values, _DEFAULT_COLOUR):
        values = model.mat_rgba[material]
    red, green, blue, alpha = np.clip(values, 0.0, 1.0).tolist()
    return red, green, blue, alpha
