"""The names, kinds and shapes of the bodies of a client that ssduck did not fill.

The user's shapes stand for those that PyBullet does not return. A key selects shapes: a body, for
all shapes of its base; (body, link), for all of a link; or (body, link, index), for one of them.
Bodies and links are PyBullet's numbers: the base is link -1. A value is a mesh in the link frame,
in metres, or a list of meshes.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path, PurePath
from typing import Any

import numpy as np

from ssduck import validation
from ssduck.errors import ArgumentError, ProgramWarning, warn
from ssduck.formatting import joined_names, short_repr
from ssduck.geometry.arrays import Array
from ssduck.geometry.mesh_files import load_mesh
from ssduck.geometry.shapes import Geometry
from ssduck.simulators.backends import ShapesByBody
from ssduck.simulators.interface import Body, Kind
from ssduck.simulators.naming import (
    body_name,
    name_by_file,
    names_a_file,
    tells_nothing,
    unique_name,
)
from ssduck.simulators.pybullet.bodies import UserShapes
from ssduck.simulators.pybullet.clients import pybullet


class GivenBodies:
    """What the user says of present bodies, by PyBullet body number.

    PyBullet reuses the numbers, so it is not said of later bodies, with one exception: an episode
    begins with bodies that were built again. One that is like the first of its number has its name
    and its kind.
    """

    def __init__(
        self,
        names: Mapping[int, str] | None,
        kinds: Mapping[int, Kind] | None,
        shapes: Mapping[int, UserShapes] | None,
    ) -> None:
        self.names, self.kinds, self.shapes = dict(names or {}), dict(kinds or {}), shapes or {}
        self._all = dict(self.names), dict(self.kinds)
        # The forms of the bodies that were described first.
        self._forms: dict[int, Any] | None = None
        self._has_told_of_reset = False

    def begin_episode(self) -> None:
        """Says the names and kinds of the bodies that are described next."""
        self.names, self.kinds = dict(self._all[0]), dict(self._all[1])

    def changed(self, bodies: Iterable[Body]) -> list[int]:
        """Returns the numbers of bodies that are not like the first; warns, and forgets these."""
        forms = {b.handle: _form(b) for b in bodies if b.handle in {**self.names, **self.kinds}}
        if self._forms is None:
            self._forms = forms
        changed = [handle for handle, form in forms.items() if form != self._forms.get(handle)]
        names = [self.names.pop(handle) for handle in changed if handle in self.names]
        for handle in changed:
            self.kinds.pop(handle, None)
        if names:
            warn(
                f"{joined_names(names)}: begin_episode found other bodies, or other shapes, under "
                "the numbers of these, and names them as in their models: attach the client again, "
                "with names=, after each reset that builds another scene",
                ProgramWarning,
            )
        return changed

    def warn_of_reset(self, bodies: Collection[Body]) -> None:
        """Warns, once, of several bodies that were built again and have their names no longer."""
        forms = self._forms or {}
        again = [b.handle for b in bodies if _form(b) == forms.get(b.handle)]
        is_reset = len(bodies) > 1 and again and not self.names and not self.kinds
        if is_reset and not self._has_told_of_reset:
            self._has_told_of_reset = True
            names = joined_names([self._all[0].get(handle, f"body {handle}") for handle in again])
            warn(
                f"{names}: all bodies were built again, and the names and kinds of World.attach do "
                "not go on to new bodies: call world.begin_episode() after resetSimulation",
                ProgramWarning,
            )

    def end(self) -> None:
        """Says nothing of the bodies that are described next."""
        self.names, self.kinds, self.shapes = {}, {}, {}


def _form(body: Body) -> Any:
    """Returns what two bodies of the same model have in common."""
    shapes = [
        (shape.frame, shape.geometry.key, shape.position.tolist(), shape.orientation.tolist())
        for shape in body.shapes
    ]
    links = [(link.name, link.parent) for link in body.links]
    return body.movable, links, [(joint.name, joint.type) for joint in body.joints], shapes


def names_of(
    client: int, handles: Sequence[int], added: Sequence[int], given: Mapping[int, str]
) -> dict[int, str]:
    """Returns names of new bodies, not yet unique but for those that are given.

    A body has the name of its model. The name of the mesh of its base is better where the two
    disagree and the model's name may not be meant: it tells nothing, it is that of a file, or
    another body has it with another mesh. PyBullet does not tell the files of models.
    """
    models = {h: pybullet.getBodyInfo(h, client)[1].decode(errors="replace") for h in handles}

    def name(handle: int) -> str:
        model = models[handle]
        own = body_name(model)
        mesh = _base_mesh(client, handle) if own else ""
        if mesh and (by_mesh := name_by_file(model, PurePath(mesh))) != own:
            meshes = (_base_mesh(client, other) for other in handles if models[other] == model)
            is_vague = tells_nothing(model) or names_a_file(model)
            if is_vague or any(other != mesh for other in meshes):
                return by_mesh
        return own or f"body_{handle}"

    return {h: given.get(h) or unique_name(name(h), given.values()) for h in added}


def _base_mesh(client: int, handle: int) -> str:
    """Returns the file of the first mesh that is drawn of the base of a body; empty if none is."""
    entries = pybullet.getVisualShapeData(handle, physicsClientId=client)
    meshes = (entry[4] for entry in entries if entry[1] == -1 and entry[2] == pybullet.GEOM_MESH)
    return str(next(meshes, b"").decode(errors="replace"))


_KEYS = "a body, (body, link) or (body, link, number), by PyBullet's numbers"
_MESHES = "a trimesh.Trimesh, (vertices, faces), the path of a mesh file, or a list of these"


def user_shapes(
    client: int, handles: Sequence[int], shapes: ShapesByBody | None
) -> dict[int, UserShapes]:
    """Returns the user's own shapes by body."""
    by_body: dict[int, dict[tuple[int, int | None], Sequence[Geometry]]] = {}
    for key, value in (shapes or {}).items():
        body, link, number = _key(client, handles, key)
        shapes_of_body = by_body.setdefault(body, {})
        others = {other for owner, other in shapes_of_body if owner == link}
        if others and (number is None or None in others or number in others):
            raise ArgumentError(
                f"shapes: {key!r} and another key select the same shapes of body {body}, "
                f"link {link - 1}"
            )
        # A list of two tables of numbers is [vertices, faces] rather than two meshes.
        is_list = isinstance(value, list) and [np.ndim(_array(one)) for one in value] != [2, 2]
        meshes = value if is_list and value else [value]
        shapes_of_body[link, number] = [_geometry(key, mesh) for mesh in meshes]
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
    vertices = _rows(key, value[0], 3, "vertices must be numbers (n, 3), at least three")
    is_wrong = ~np.isfinite(vertices).all(axis=1)
    if is_wrong.any():
        row = int(is_wrong.argmax())
        raise ArgumentError(f"shapes: {key!r}: vertex {row} is not finite: {vertices[row]}")
    if value[1] is None:
        return Geometry.hull(vertices)
    rule = "faces must be numbers of vertices (n, 3), at least one triangle"
    faces = _rows(key, value[1], 1, rule)
    is_wrong = ~((faces == np.floor(faces)) & (faces >= 0) & (faces < len(vertices))).all(axis=1)
    if is_wrong.any():
        row = int(is_wrong.argmax())
        raise ArgumentError(
            f"shapes: {key!r}: face {row} is {faces[row].tolist()}; the vertices have the numbers "
            f"0 to {len(vertices) - 1}"
        )
    return Geometry("mesh", (0.0, 0.0, 0.0), vertices, faces.astype(np.int32))


def _rows(key: Any, values: Any, least: int, rule: str) -> Array:
    """Returns a copy of rows of three numbers; at least some of them."""
    rows = _array(values)
    if rows is None or rows.ndim != 2 or rows.shape[1] != 3 or len(rows) < least:
        raise ArgumentError(f"shapes: {key!r}: {rule}")
    return np.array(rows)
