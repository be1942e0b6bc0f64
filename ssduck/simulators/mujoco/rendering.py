"""Draws a MuJoCo simulation with MuJoCo's own renderer, and tells what is drawn of a body.

A context of OpenGL belongs to the thread that made it. So each picture has a context of its own,
which costs some milliseconds.

MuJoCo's viewer shows the groups 0 to 2. A geom has its own colour unless that is MuJoCo's default
and the geom has a material.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import numpy.typing as npt

from ssduck.errors import UnsupportedError
from ssduck.geometry.arrays import Array, Indices
from ssduck.geometry.shapes import Geometry, PlacedGeometry
from ssduck.simulators.interface import Body, CameraView
from ssduck.simulators.mujoco.bodies import geometry_of, numbers_of, pose_of
from ssduck.simulators.mujoco.flexes import entity_roots
from ssduck.simulators.mujoco.library import mujoco
from ssduck.simulators.scenes import Camera

# The depth range of pictures, m.
_NEAR, _FAR = 0.01, 200.0
# The least brightness of the headlight where it is the only light: of all sides, and of those that
# it shines on. MuJoCo's own 0.1 and 0.4 are meant for a headlight beside others.
_AMBIENT, _DIFFUSE = 0.35, 0.65
# The message that there is no OpenGL: MuJoCo ends the process if it is asked a second time.
_FAILED: list[str] = []


def view_of(camera: Camera, width: int, height: int) -> CameraView:
    """Returns the view of a camera of a scene."""
    eye = np.array(camera.eye, dtype=np.float64)
    forward = _unit(np.array(camera.target) - eye)
    across = np.cross(forward, [0.0, 0.0, 1.0])
    if np.linalg.norm(across) < 1e-9:  # straight up or down
        across = np.array([1.0, 0.0, 0.0])
    up = _unit(np.cross(across, forward))
    matrix = np.column_stack((forward, np.cross(up, forward), up))
    return CameraView(eye, matrix, camera.fov, width, height)


def draw(model: Any, data: Any, view: CameraView, *, shadow: bool) -> npt.NDArray[np.uint8]:
    """Returns a colour picture, (height, width, 3)."""
    with _renderer(model, data, view) as renderer:
        renderer.scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = shadow
        picture: npt.NDArray[np.uint8] = renderer.render().copy()
        return picture


def segment(model: Any, data: Any, view: CameraView) -> tuple[Indices, Indices]:
    """Returns the root body and the number of the link in each pixel, (height, width); or -1."""
    with _renderer(model, data, view) as renderer:
        renderer.enable_segmentation_rendering()
        numbers, types = np.moveaxis(renderer.render(), -1, 0)
        roots = np.append(entity_roots(model)[model.geom_bodyid], -1)
        links = np.append(model.geom_bodyid, -2).astype(np.intp) - roots
        shapes = np.where(types == int(mujoco.mjtObj.mjOBJ_GEOM), numbers, -1)
        return roots[shapes], links[shapes]


@contextmanager
def _renderer(model: Any, data: Any, view: CameraView) -> Iterator[Any]:
    """Yields a renderer of the scene; closes it at the end."""
    if _FAILED:
        raise UnsupportedError(_FAILED[0])
    limits = model.vis.global_
    before = limits.offwidth, limits.offheight
    limits.offwidth, limits.offheight = max(before[0], view.width), max(before[1], view.height)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the library of windows warns where there is no screen
            renderer = mujoco.Renderer(model, view.height, view.width)
    except Exception as error:  # each library of OpenGL has its own
        message = (
            f"MuJoCo cannot draw: {error}; without a screen, set the environment variable "
            "MUJOCO_GL to egl or osmesa before MuJoCo is imported"
        )
        if isinstance(error, mujoco.FatalError) and "OpenGL platform library" in str(error):
            _FAILED.append(message)
        raise UnsupportedError(message) from error
    finally:
        limits.offwidth, limits.offheight = before
    try:
        renderer.update_scene(data)
        _place(renderer.scene, view)
        _light(renderer.scene, view)
        yield renderer
    finally:
        renderer.close()


def _place(scene: Any, view: CameraView) -> None:
    """Gives the cameras of a scene a view: one for each eye, which are the same."""
    half = _NEAR * math.tan(math.radians(view.fov) / 2)
    for camera in scene.camera:
        camera.pos = view.position
        camera.forward, camera.up = view.matrix[:, 0], view.matrix[:, 2]
        camera.orthographic = 0
        camera.frustum_center = camera.frustum_width = 0.0  # the width follows from the picture
        camera.frustum_bottom, camera.frustum_top = -half, half
        camera.frustum_near, camera.frustum_far = _NEAR, _FAR


def _light(scene: Any, view: CameraView) -> None:
    """Has the headlight shine from a camera, and alone in a model without other lights."""
    lights = scene.lights[: scene.nlight]
    is_alone = all(light.headlight for light in lights)
    for light in lights:
        if light.headlight:
            light.pos, light.dir = view.position, view.matrix[:, 0]
            if is_alone:
                light.ambient = np.maximum(light.ambient, _AMBIENT)
                light.diffuse = np.maximum(light.diffuse, _DIFFUSE)


def _unit(vector: Array) -> Array:
    unit: Array = vector / np.linalg.norm(vector)
    return unit


# The groups that MuJoCo shows unless told otherwise.
VISIBLE_GROUPS = (0, 1, 2)
# A geom of this colour has that of its material, if there is one.
_DEFAULT_COLOUR = (0.5, 0.5, 0.5, 1.0)
# The triangles of a drawn ellipsoid: those of an icosahedron, each divided into four so many times.
_SUBDIVISIONS = 3


def visual_shapes(model: Any, body: Body) -> list[PlacedGeometry]:
    """Returns the geoms that are drawn of a body; its collision shapes if none is."""
    drawn = [
        _shape(model, number, link)
        for link, owner in enumerate(numbers_of(body))
        for number in np.flatnonzero(model.geom_bodyid == owner).tolist()
        if model.geom_group[number] in VISIBLE_GROUPS and _colour(model, number)[3] > 0.0
    ]
    return drawn or list(body.shapes)


def _shape(model: Any, number: int, link: int) -> PlacedGeometry:
    geometry, centre, _ = geometry_of(model, number)
    type = int(model.geom_type[number])
    if type == mujoco.mjtGeom.mjGEOM_MESH:
        mesh = int(model.geom_dataid[number])
        first, face = int(model.mesh_vertadr[mesh]), int(model.mesh_faceadr[mesh])
        vertices = model.mesh_vert[first : first + int(model.mesh_vertnum[mesh])]
        faces = model.mesh_face[face : face + int(model.mesh_facenum[mesh])]
        geometry = _triangles(vertices, faces)
    elif type == mujoco.mjtGeom.mjGEOM_ELLIPSOID:
        import trimesh

        sphere = trimesh.creation.icosphere(subdivisions=_SUBDIVISIONS)
        geometry = _triangles(sphere.vertices * model.geom_size[number], sphere.faces)
    pose = pose_of(model, number, centre)
    return PlacedGeometry(link, geometry, *pose, colour=_colour(model, number))


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
