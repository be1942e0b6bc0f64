"""Draws triangles without a screen, by OpenGL: four samples a pixel, and soft shadows.

Matrices act on columns (x, y, z, 1).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import trimesh

from ssduck.adapters.optional import library
from ssduck.errors import UnsupportedError
from ssduck.geometry.arrays import Array
from ssduck.geometry.shapes import Geometry
from ssduck.geometry.solids import solid_of
from ssduck.interchange.motion import capsule_mesh, square
from ssduck.simulators.scenes import Camera

# Half the side of the square that is drawn of a plane, m.
PLANE_HALF_SIZE = 100.0
# Faces that meet at a smaller angle, degrees, look like one curved surface.
SMOOTH_ANGLE = 35.0
_SIDES = 48


def triangles(geometry: Geometry) -> Array:
    """Returns the corners of a geometry's triangles, (3 n, 6): x y z, and the normal there."""
    if geometry.type == "plane":
        normal = np.array(geometry.size)
        vertices, faces = square(normal, PLANE_HALF_SIZE)
        corners = vertices[faces].reshape(-1, 3)
        return np.hstack((corners, np.broadcast_to(normal, corners.shape)))
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
            return capsule_mesh(geometry, _SIDES)
        case _:
            surface = solid_of(geometry).surface
            return trimesh.Trimesh(surface.vertices, surface.faces, process=False)


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


# -- triangles --------------------------------------------------------------------------------


# The direction to the light.
SUN = np.array([0.35, -0.45, 0.82]) / np.linalg.norm([0.35, -0.45, 0.82])
NEAR = 0.02


def look_at(eye: Array, target: Array) -> Array:
    """Returns the transformation (4, 4) from the world to a camera that looks along its -z."""
    forward = (target - eye) / np.linalg.norm(target - eye)
    up = np.array([0.0, 0.0, 1.0]) if abs(forward[2]) < 0.999 else np.array([0.0, 1.0, 0.0])
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    rotation = np.array([right, np.cross(right, forward), -forward])
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation, -rotation @ eye
    return matrix


def projection(fov: float, aspect: float, far: float) -> Array:
    """Returns OpenGL's perspective projection (4, 4)."""
    scale = 1.0 / math.tan(math.radians(fov) / 2)
    matrix = np.zeros((4, 4))
    matrix[0, 0], matrix[1, 1] = scale / aspect, scale
    matrix[2, 2], matrix[2, 3] = -(far + NEAR) / (far - NEAR), -2 * far * NEAR / (far - NEAR)
    matrix[3, 2] = -1.0
    return matrix


def sun_matrix(centre: Array, radius: float) -> Array:
    """Returns the projection (4, 4) of the light, which covers a sphere."""
    matrix = np.eye(4)
    view = look_at(centre + SUN * 2 * radius, centre)
    matrix[0, 0] = matrix[1, 1] = 1 / radius
    matrix[2, 2], matrix[2, 3] = -1 / (1.5 * radius), -2 * radius / (1.5 * radius)
    return matrix @ view


# -- canvas -----------------------------------------------------------------------------------


Picture = npt.NDArray[np.uint8]

SAMPLES = 4
SHADOW_SIZE = 2048
# The colours above and below the horizon, sRGB.
SKY, HORIZON = (0.80, 0.86, 0.93), (0.93, 0.95, 0.97)
# The floats of an instance: a matrix of 4 columns, a colour, and whether it is a plane.
_INSTANCE = 21
_FORMAT = "4f 4f 4f 4f 4f 1f/i"
_NAMES = ("column_0", "column_1", "column_2", "column_3", "colour", "is_plane")

_SHADOW_VERTEX = """
#version 330
uniform mat4 light;
in vec3 position;
in vec4 column_0, column_1, column_2, column_3;
void main() {
    gl_Position = light * (mat4(column_0, column_1, column_2, column_3) * vec4(position, 1.0));
}
"""
_SHADOW_FRAGMENT = """
#version 330
void main() {}
"""
_VERTEX = """
#version 330
uniform mat4 view;
in vec3 position, normal;
in vec4 column_0, column_1, column_2, column_3, colour;
in float is_plane;
out vec3 place, direction;
out vec4 paint;
flat out float ground;
void main() {
    mat4 pose = mat4(column_0, column_1, column_2, column_3);
    place = (pose * vec4(position, 1.0)).xyz;
    direction = mat3(pose) * normal;
    paint = colour;
    ground = is_plane;
    gl_Position = view * vec4(place, 1.0);
}
"""
_FRAGMENT = """
#version 330
uniform vec3 eye, sun, horizon;
uniform mat4 light;
uniform float texel, reach;
uniform sampler2DShadow shadows;
in vec3 place, direction;
in vec4 paint;
flat in float ground;
out vec4 pixel;

float lit(vec3 normal) {
    // Moved along the normal, so that a surface does not shade itself.
    vec4 seen = light * vec4(place + normal * texel * 2.5, 1.0);
    vec3 at = seen.xyz * 0.5 + 0.5;
    if (any(lessThan(at, vec3(0.0))) || any(greaterThan(at, vec3(1.0)))) return 1.0;
    float sum = 0.0;
    vec2 size = 1.0 / vec2(textureSize(shadows, 0));
    for (int i = -1; i <= 1; i++)
        for (int j = -1; j <= 1; j++)
            sum += texture(shadows, vec3(at.xy + vec2(i, j) * size * 1.3, at.z - 0.0004));
    return sum / 9.0;
}

float lines(vec2 at, float width) {
    vec2 away = abs(fract(at - 0.5) - 0.5) / max(fwidth(at), vec2(1e-6));
    return 1.0 - min(min(away.x, away.y) / width, 1.0);
}

void main() {
    vec3 towards = normalize(eye - place);
    vec3 normal = normalize(direction);
    if (dot(normal, towards) < 0.0 && ground < 0.5) normal = -normal;
    vec3 base = pow(paint.rgb, vec3(2.2));
    if (ground > 0.5) base *= 1.0 - 0.25 * lines(place.xy, 1.2);
    float facing = max(dot(normal, sun), 0.0);
    float bright = facing > 0.0 ? facing * lit(normal) : 0.0;
    vec3 above = mix(vec3(0.30, 0.28, 0.26), vec3(0.46, 0.49, 0.54), normal.z * 0.5 + 0.5);
    float shine = pow(max(dot(normal, normalize(sun + towards)), 0.0), 40.0) * bright * 0.12;
    vec3 light_in = base * (above + 0.72 * vec3(1.0, 0.97, 0.92) * bright);
    vec3 colour = pow(min(light_in + shine * (1.0 - ground), vec3(1.0)), vec3(1.0 / 2.2));
    float far = ground * smoothstep(reach * 0.6, reach * 4.0, distance(eye, place));
    pixel = vec4(mix(colour, horizon, far), paint.a);
}
"""
_SKY_VERTEX = """
#version 330
in vec2 corner;
out float height;
void main() { height = corner.y; gl_Position = vec4(corner, 0.99999, 1.0); }
"""
_SKY_FRAGMENT = """
#version 330
uniform vec3 sky, horizon;
in float height;
out vec4 pixel;
void main() { pixel = vec4(mix(horizon, sky, max(height, 0.0)), 1.0); }
"""


@dataclass(frozen=True, eq=False)
class _Group:
    """The shapes of one geometry, drawn at once."""

    rows: npt.NDArray[np.intp]
    instances: Any
    array: Any  # what draws them; `shadow` draws their depths
    shadow: Any
    is_plane: bool  # whether they are planes, which cast no shadows


class Canvas:
    """A picture in memory, and the shapes that are drawn on it."""

    def __init__(self, width: int, height: int) -> None:
        self.width, self.height = width, height
        self._gl = gl = _context()
        self._groups: list[_Group] = []
        samples = min(SAMPLES, gl.max_samples)
        size = (width, height)
        self._frame = gl.framebuffer(
            [gl.renderbuffer(size, 4, samples=samples)],
            gl.depth_renderbuffer(size, samples=samples),
        )
        self._resolved = gl.framebuffer([gl.renderbuffer(size, 4)])
        self._depths = gl.depth_texture((SHADOW_SIZE, SHADOW_SIZE))
        self._depths.compare_func = "<="
        self._depths.repeat_x = self._depths.repeat_y = False
        self._shadows = gl.framebuffer(depth_attachment=self._depths)
        self._program = gl.program(_VERTEX, _FRAGMENT)
        self._shadow_program = gl.program(_SHADOW_VERTEX, _SHADOW_FRAGMENT)
        sky = gl.program(_SKY_VERTEX, _SKY_FRAGMENT)
        sky["sky"].value, sky["horizon"].value = SKY, HORIZON
        corners = gl.buffer(np.array([-1, -1, 1, -1, -1, 1, 1, 1], "f4"))
        self._sky = gl.vertex_array(sky, [(corners, "2f", "corner")])

    def set_shapes(self, geometries: Sequence[Geometry]) -> None:
        """Sets the geometries of the shapes that are drawn from now on."""
        self._release_shapes()
        by_key: dict[str, list[int]] = {}
        for row, geometry in enumerate(geometries):
            by_key.setdefault(geometry.key, []).append(row)
        for rows in by_key.values():
            geometry = geometries[rows[0]]
            corners = triangles(geometry)
            if len(corners):
                self._groups.append(self._group(corners, rows, is_plane=geometry.type == "plane"))
        self._groups.sort(key=lambda group: not group.is_plane)

    def _group(self, corners: Array, rows: list[int], *, is_plane: bool) -> _Group:
        gl = self._gl
        vertices = gl.buffer(corners.astype("<f4"))
        instances = gl.buffer(reserve=4 * _INSTANCE * len(rows), dynamic=True)
        array = gl.vertex_array(
            self._program,
            [(vertices, "3f 3f", "position", "normal"), (instances, _FORMAT, *_NAMES)],
        )
        shadow = gl.vertex_array(
            self._shadow_program,
            [(vertices, "3f 12x", "position"), (instances, "4f 4f 4f 4f 20x/i", *_NAMES[:4])],
        )
        return _Group(np.array(rows), instances, array, shadow, is_plane)

    def draw(
        self, matrices: Array, colours: Array, camera: Camera, low: Array, high: Array
    ) -> Picture:
        """Returns the picture (height, width, 3) of the shapes."""
        centre, radius = (low + high) / 2, max(float(np.linalg.norm(high - low)) / 2, 0.05)
        light = sun_matrix(centre, radius)
        self._draw_shadows(matrices, colours, light)
        eye, target = np.array(camera.eye, float), np.array(camera.target, float)
        distance = float(np.linalg.norm(eye - centre)) + radius
        view = projection(camera.fov, self.width / self.height, max(20 * distance, 50.0))
        program = self._program
        program["view"].write((view @ look_at(eye, target)).T.astype("<f4").tobytes())
        program["light"].write(light.T.astype("<f4").tobytes())
        program["eye"].value, program["sun"].value = tuple(eye), tuple(SUN)
        program["horizon"].value = HORIZON
        program["texel"].value, program["reach"].value = 2 * radius / SHADOW_SIZE, distance
        self._depths.use(0)
        return self._draw_colours(matrices, colours)

    def _draw_shadows(self, matrices: Array, colours: Array, light: Array) -> None:
        gl = self._gl
        self._shadows.use()
        self._shadows.clear(depth=1.0)
        gl.enable_only(gl.DEPTH_TEST)
        self._shadow_program["light"].write(light.T.astype("<f4").tobytes())
        for group in self._groups:
            rows = group.rows[colours[group.rows, 3] > 0.5]
            if len(rows) and not group.is_plane:
                _write(group, rows, matrices, colours)
                group.shadow.render(instances=len(rows))

    def _draw_colours(self, matrices: Array, colours: Array) -> Picture:
        gl = self._gl
        self._frame.use()
        self._frame.clear(*HORIZON, 1.0, depth=1.0)
        gl.enable_only(gl.NOTHING)
        self._sky.render(gl.TRIANGLE_STRIP)
        gl.enable_only(gl.DEPTH_TEST)
        self._draw_groups(matrices, colours, colours[:, 3] >= 1.0)
        gl.enable(gl.BLEND)
        gl.blend_func = gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA
        self._frame.depth_mask = False
        self._draw_groups(matrices, colours, (colours[:, 3] > 0.0) & (colours[:, 3] < 1.0))
        self._frame.depth_mask = True
        gl.copy_framebuffer(self._resolved, self._frame)
        pixels = np.frombuffer(self._resolved.read(components=3, alignment=1), np.uint8)
        return pixels.reshape(self.height, self.width, 3)[::-1].copy()

    def _draw_groups(self, matrices: Array, colours: Array, drawn: npt.NDArray[np.bool_]) -> None:
        for group in self._groups:
            rows = group.rows[drawn[group.rows]]
            if len(rows):
                _write(group, rows, matrices, colours)
                group.array.render(instances=len(rows))

    def _release_shapes(self) -> None:
        for group in self._groups:
            for part in (group.array, group.shadow, group.instances):
                part.release()
        self._groups = []

    def close(self) -> None:
        """Releases the memory of the picture and the shapes."""
        self._gl.release()


def _write(group: _Group, rows: npt.NDArray[np.intp], matrices: Array, colours: Array) -> None:
    values = np.zeros((len(rows), _INSTANCE), "<f4")
    values[:, :16] = matrices[rows].transpose(0, 2, 1).reshape(-1, 16)
    values[:, 16:20], values[:, 20] = colours[rows], group.is_plane
    group.instances.write(values.tobytes())


def _context() -> Any:
    moderngl = library("moderngl", "render")
    try:
        return moderngl.create_standalone_context(require=330, backend="egl")
    except Exception as error:  # moderngl raises the bare class
        raise UnsupportedError(
            f"there is no OpenGL to draw with: {error}; on Debian and Ubuntu, apt install libegl1 "
            "libgl1-mesa-dri does it"
        ) from error
