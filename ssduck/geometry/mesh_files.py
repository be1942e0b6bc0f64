"""Reads geometries from mesh files."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from ssduck.geometry.arrays import Array, Triangles
from ssduck.geometry.shapes import Geometry
from ssduck.lazy import import_whole

# A scene has a few dozen mesh files at most, each in one or two sizes. Files that are no longer
# used are dropped, so that big meshes do not add up.
CACHED_FILES = 64


def load_mesh(path: Path, scale: tuple[float, ...]) -> Geometry:
    """Reads all triangles of a mesh file (OBJ, STL, …)."""
    return _cached_mesh(path, scale, _version(path))


def load_hulls(path: Path, scale: tuple[float, ...]) -> tuple[Geometry, ...]:
    """Reads the convex hull of each object in a mesh file (OBJ, STL, …)."""
    return _cached_hulls(path, scale, _version(path))


def _version(path: Path) -> tuple[int, int]:
    """Returns the time and size of a file, which change when the file is written again."""
    try:
        status = path.stat()
    except OSError as error:
        raise ValueError(f"{path} cannot be read: {error.strerror}") from error
    return status.st_mtime_ns, status.st_size


@lru_cache(maxsize=CACHED_FILES)
def _cached_mesh(path: Path, scale: tuple[float, ...], _: tuple[int, int]) -> Geometry:
    vertices, objects = _read_triangles(path)
    return Geometry("mesh", (0.0, 0.0, 0.0), vertices * scale, np.concatenate(objects))


@lru_cache(maxsize=CACHED_FILES)
def _cached_hulls(path: Path, scale: tuple[float, ...], _: tuple[int, int]) -> tuple[Geometry, ...]:
    vertices, objects = _read_triangles(path)
    return tuple(Geometry.hull(vertices[np.unique(faces)] * scale) for faces in objects)


def _read_triangles(path: Path) -> tuple[Array, list[Triangles]]:
    """Returns the vertices of a file, and the triangles of each of its objects."""
    try:
        if path.suffix.lower() == ".obj":
            vertices, objects = _read_obj(path.read_text(encoding="utf-8", errors="replace"))
        else:
            vertices, objects = _read_other(path)
    except Exception as error:  # of any kind: trimesh lets its readers' own errors through
        raise ValueError(f"{path} cannot be read as a mesh: {error}") from error
    if not objects:
        raise ValueError(f"{path} has no triangles")
    used = np.concatenate(objects)
    if used.min() < 0 or used.max() >= len(vertices):
        raise ValueError(f"{path}: a face refers to a missing vertex")
    if not np.isfinite(vertices[used]).all():
        raise ValueError(f"{path}: a vertex is no finite number")
    return vertices, objects


def _read_obj(text: str) -> tuple[Array, list[Triangles]]:
    """Parses an OBJ file. `o` and `g` begin an object, as they do for PyBullet."""
    vertices: list[list[float]] = []
    objects: list[list[list[int]]] = [[]]
    for line in text.splitlines():
        match line.partition("#")[0].split():
            case ["v", x, y, z, *_]:
                vertices.append([float(x), float(y), float(z)])
            case ["f", *corners]:
                # A corner is vertex/texture/normal; numbers count from 1, or back from the end.
                numbers = [int(corner.partition("/")[0]) for corner in corners]
                face = [n - 1 if n > 0 else len(vertices) + n for n in numbers]
                objects[-1] += [[face[0], *edge] for edge in pairwise(face[1:])]
            case ["o" | "g", *_]:
                objects.append([])
    return (
        np.array(vertices, dtype=np.float64).reshape(-1, 3),
        [np.array(triangles, dtype=np.int32) for triangles in objects if triangles],
    )


@dataclass(frozen=True)
class _FilesBeside:
    """Reads the files that a mesh file names, as glTF does, in its folder only."""

    folder: Path

    def get(self, name: str) -> bytes:
        file = (self.folder / name).resolve()
        if not file.is_relative_to(self.folder.resolve()):
            raise ValueError(f"{file} is not beside it")
        return file.read_bytes()

    __getitem__ = get

    def keys(self) -> list[str]:
        """Returns no names: what is in the folder is nothing that the mesh tells."""
        return []


def _read_other(path: Path) -> tuple[Array, list[Triangles]]:
    """Reads a file with trimesh, as one object."""
    import_whole("trimesh")
    import trimesh

    loaded: Any = trimesh.load_mesh(path, process=False, resolver=_FilesBeside(path.parent))
    faces = np.asarray(loaded.faces, dtype=np.int32).reshape(-1, 3)
    return np.asarray(loaded.vertices, dtype=np.float64), [faces] if len(faces) else []
