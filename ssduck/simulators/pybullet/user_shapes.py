"""Reads the shapes that the user gives for bodies whose shapes PyBullet does not return.

A key selects shapes: a body, for all shapes of its base; (body, link), for all of a link; or (body,
link, index), for one of them. Bodies and links are PyBullet's numbers: the base is link -1. A value
is a mesh in the link frame, in metres, or a list of meshes.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ssduck import validation
from ssduck.errors import ArgumentError
from ssduck.formatting import short_repr
from ssduck.geometry.arrays import Array, Triangles
from ssduck.geometry.mesh_files import load_mesh
from ssduck.geometry.shapes import Geometry
from ssduck.simulators.backends import ShapesByBody
from ssduck.simulators.pybullet.bodies import UserShapes
from ssduck.simulators.pybullet.console import pybullet

_KEYS = "a body, (body, link) or (body, link, number), by PyBullet's numbers"
_MESHES = "a trimesh.Trimesh, (vertices, faces), the path of a mesh file, or a list of these"


def user_shapes(
    client: int, handles: Sequence[int], shapes: ShapesByBody | None
) -> dict[int, UserShapes]:
    """Returns the user's own shapes by body.

    Raises:
        ArgumentError: a key is not valid, there is no such body or link, two keys select the same
            shapes, or a value is not a mesh.
    """
    by_body: dict[int, dict[tuple[int, int | None], Sequence[Geometry]]] = {}
    for key, value in (shapes or {}).items():
        body, link, number = _key(client, handles, key)
        shapes_of_body = by_body.setdefault(body, {})
        is_whole = number is None or (link, None) in shapes_of_body
        if (link, number) in shapes_of_body or (
            is_whole and any(other == link for other, _ in shapes_of_body)
        ):
            raise ArgumentError(
                f"shapes: {key!r} and another key select the same shapes of body {body}, "
                f"link {link - 1}"
            )
        shapes_of_body[link, number] = _geometries(key, value)
    return dict(by_body)


def _key(client: int, handles: Sequence[int], key: Any) -> tuple[int, int, int | None]:
    """Returns the body, the link (the base is 0) and the index of a key."""
    parts = key if isinstance(key, tuple) else (key,)
    if not 1 <= len(parts) <= 3 or not all(map(validation.is_integer, parts)):
        raise ArgumentError(f"shapes: {short_repr(key)} is no key: a key is {_KEYS}")
    body, link = int(parts[0]), int(parts[1]) if len(parts) > 1 else -1
    number = int(parts[2]) if len(parts) > 2 else None
    if body not in handles:
        listed = ", ".join(map(str, handles)) or "none"
        raise ArgumentError(f"shapes: PyBullet has no body {body}; its bodies: {listed}")
    count = pybullet.getNumJoints(body, client)
    if not -1 <= link < count:
        raise ArgumentError(
            f"shapes: body {body} has no link {link}; its links: -1 (the base) to {count - 1}"
        )
    return body, link + 1, number


def _geometries(key: Any, value: Any) -> list[Geometry]:
    if isinstance(value, list) and value and not _is_pair(value):
        return [_geometry(key, one) for one in value]
    return [_geometry(key, value)]


def _is_pair(value: Any) -> bool:
    """Checks whether a list is [vertices, faces] rather than some meshes."""
    return len(value) == 2 and all(np.ndim(_array(part)) == 2 for part in value)


def _array(part: Any) -> Any:
    """Converts nested sequences of numbers into an array; None if that is impossible."""
    try:
        return np.asarray(part, dtype=np.float64)
    except (TypeError, ValueError):
        return None


def _geometry(key: Any, value: Any) -> Geometry:
    if isinstance(value, str | Path):
        try:
            return load_mesh(Path(value), (1.0, 1.0, 1.0))
        except ValueError as error:
            raise ArgumentError(f"shapes: {key!r}: {error}") from error
    if hasattr(value, "vertices") and hasattr(value, "faces"):
        value = value.vertices, value.faces
    if not (isinstance(value, tuple | list) and len(value) == 2):
        raise ArgumentError(f"shapes: {key!r}: {short_repr(value)} is no mesh: a mesh is {_MESHES}")
    vertices = _vertices(key, value[0])
    if value[1] is None:
        return Geometry.hull(vertices)
    return Geometry("mesh", (0.0, 0.0, 0.0), vertices, _faces(key, value[1], len(vertices)))


def _vertices(key: Any, values: Any) -> Array:
    vertices = _array(values)
    if vertices is None or vertices.ndim != 2 or vertices.shape[1] != 3 or len(vertices) < 3:
        raise ArgumentError(f"shapes: {key!r}: vertices must be numbers (n, 3), at least three")
    if not np.isfinite(vertices).all():
        row = int(np.argmax(~np.isfinite(vertices).all(axis=1)))
        raise ArgumentError(f"shapes: {key!r}: vertex {row} is not finite: {vertices[row]}")
    return np.array(vertices)


def _faces(key: Any, values: Any, count: int) -> Triangles:
    faces = _array(values)
    if faces is None or faces.ndim != 2 or faces.shape[1] != 3 or not len(faces):
        raise ArgumentError(
            f"shapes: {key!r}: faces must be numbers of vertices (n, 3), at least one triangle"
        )
    wrong = (faces != np.floor(faces)) | ~((faces >= 0) & (faces < count))
    if wrong.any():
        row = int(np.argmax(wrong.any(axis=1)))
        raise ArgumentError(
            f"shapes: {key!r}: face {row} is {faces[row].tolist()}; the vertices have the numbers "
            f"0 to {count - 1}"
        )
    triangles: Triangles = faces.astype(np.int32)
    return triangles
