"""Makes the entities of a record from what the caller says of them: names, kinds and shapes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from ssduck import validation
from ssduck.errors import ArgumentError, check_known
from ssduck.formatting import short_repr
from ssduck.geometry.mesh_files import load_hulls, load_mesh
from ssduck.geometry.poses import IDENTITY, unit_quaternions
from ssduck.geometry.shapes import Geometry, PlacedGeometry
from ssduck.schema import LINK_FACTOR, MAX_LINKS
from ssduck.simulators.interface import Body, Link
from ssduck.simulators.scene_bodies import PRIMITIVES
from ssduck.world.layout import EntityInfo

# The descriptions of entities by name, or their names alone.
Entities: TypeAlias = Mapping[str, Mapping[str, Any]] | Sequence[str]

KINDS = ("robot", "kinbody")
_PRIMITIVES = {**PRIMITIVES, "ellipsoid": (3, "half its lengths along x, y and z")}
_FORMS = (*_PRIMITIVES, "mesh", "hull")
_SHAPE_KEYS = (*_FORMS, "scale", "position", "orientation")
_LINK_KEYS = (*_SHAPE_KEYS, "shapes", "mass")
_ENTITY_KEYS = (*_LINK_KEYS, "kind", "movable", "links")


def entities_of(entities: Entities) -> list[EntityInfo]:
    """Returns the entities of a record, with the ids from 1 on."""
    if isinstance(entities, str) or not isinstance(entities, Mapping | Sequence):
        raise ArgumentError(
            f"entities: give a dict of descriptions by name, or a list of names, not "
            f"{short_repr(entities)}"
        )
    described = entities if isinstance(entities, Mapping) else _undescribed(entities)
    if len(described) >= LINK_FACTOR:
        raise ArgumentError(f"entities: a world has at most {LINK_FACTOR - 1:,} of them")
    return [
        _entity(number, name, description)
        for number, (name, description) in enumerate(described.items(), start=1)
    ]


def _undescribed(names: Sequence[str]) -> dict[str, dict[str, Any]]:
    described: dict[str, dict[str, Any]] = {}
    for name in names:
        if name in described:
            raise ArgumentError(f"entities: {short_repr(name)} is there twice")
        described[name] = {}
    return described


def _entity(id: int, name: Any, description: Any) -> EntityInfo:
    where = f"entities[{short_repr(name)}]"
    if not isinstance(name, str) or not name or not name.isprintable():
        raise ArgumentError(f"{where}: a name is a text of one letter or more")
    values = _checked(description, _ENTITY_KEYS, where)
    kind = values.get("kind", "kinbody")
    message = f"{where}: kind: {short_repr(kind)} is neither robot nor kinbody"
    check_known(kind, KINDS, message, ArgumentError)
    links, shapes = _links(values, name, where)
    movable = validation.boolean(values.get("movable", True), f"{where}: movable")
    body = Body(id, name, kind, movable, tuple(links), (), tuple(shapes))
    return EntityInfo(id, name, kind, body=body)


def _links(
    values: Mapping[str, Any], name: str, where: str
) -> tuple[list[Link], list[PlacedGeometry]]:
    """Returns the links of an entity, its base first, and their shapes."""
    links = [Link(name, -1, _mass(values, where))]
    shapes = list(_shapes(values, 0, where))
    numbers = {name: 0}
    described = validation.mapping(values.get("links"), f"{where}: links are given in a dict")
    if len(described) > MAX_LINKS - 1:
        raise ArgumentError(f"{where}: an entity has at most {MAX_LINKS:,} links")
    for link, description in described.items():
        place = f"{where}: links[{short_repr(link)}]"
        if not isinstance(link, str) or not link or link in numbers:
            raise ArgumentError(f"{place}: a name is a text that no other link of it has")
        values = _checked(description, (*_LINK_KEYS, "parent"), place)
        parent = values.get("parent", name)
        message = f"{place}: parent: {short_repr(parent)} is no link before it"
        check_known(parent, numbers, message, ArgumentError)
        numbers[link] = len(links)
        shapes += _shapes(values, len(links), place)
        links.append(Link(link, numbers[parent], _mass(values, place)))
    return links, shapes


def _checked(description: Any, keys: Sequence[str], where: str) -> Mapping[str, Any]:
    values = validation.mapping(description, f"{where} is described in a dict")
    for key in values:
        check_known(key, keys, f"{where}: there is no key {short_repr(key)}", ArgumentError)
    return values


def _mass(values: Mapping[str, Any], where: str) -> float:
    mass = validation.finite_number(values.get("mass", 0.0), f"{where}: mass", "kg")
    if mass < 0.0:
        raise ArgumentError(f"{where}: mass: {mass:g} kg is less than 0")
    return mass


# -- shapes -----------------------------------------------------------------------------------


def _shapes(values: Mapping[str, Any], link: int, where: str) -> Iterator[PlacedGeometry]:
    """Yields the shapes of a link: the one that is described with it, and those of a list."""
    if any(key in values for key in _SHAPE_KEYS):
        own = {key: values[key] for key in _SHAPE_KEYS if key in values}
        yield from _shape(own, link, where)
    listed = values.get("shapes", ())
    if isinstance(listed, str) or not isinstance(listed, Sequence):
        raise ArgumentError(f"{where}: shapes: give a list of dicts, not {short_repr(listed)}")
    for number, shape in enumerate(listed):
        place = f"{where}: shapes[{number}]"
        yield from _shape(_checked(shape, _SHAPE_KEYS, place), link, place)


def _shape(values: Mapping[str, Any], link: int, where: str) -> Iterator[PlacedGeometry]:
    forms = [form for form in _FORMS if form in values]
    if len(forms) != 1:
        told = " and ".join(forms) or "no form"
        raise ArgumentError(f"{where}: a shape has one form of {', '.join(_FORMS)}, not {told}")
    (form,) = forms
    if "scale" in values and form not in ("mesh", "hull"):
        raise ArgumentError(f"{where}: scale is for meshes and hulls of files, not for a {form}")
    position = validation.finite_array(
        values.get("position", (0.0, 0.0, 0.0)), 3, f"{where}: position"
    )
    orientation = validation.finite_array(
        values.get("orientation", IDENTITY), 4, f"{where}: orientation"
    )
    if not np.linalg.norm(orientation) > 0.0:
        raise ArgumentError(f"{where}: orientation: the quaternion w, x, y, z has the length 0")
    turned = unit_quaternions(orientation[None])[0]
    for geometry in _geometries(form, values, where):
        yield PlacedGeometry(link, geometry, position, turned)


def _geometries(form: str, values: Mapping[str, Any], where: str) -> Sequence[Geometry]:
    value, place = values[form], f"{where}: {form}"
    if form in _PRIMITIVES:
        return [_primitive(form, value, place)]
    if not isinstance(value, str | PathLike):
        if form == "mesh":
            raise ArgumentError(f"{place}: give the path of a file, not {short_repr(value)}")
        return [_hull(value, place)]
    file = Path(value).absolute()
    scale = values.get("scale", 1.0)
    scales = [scale] * 3 if validation.is_number(scale) else scale
    factors = tuple(validation.finite_array(scales, 3, f"{where}: scale").tolist())
    try:
        return [load_mesh(file, factors)] if form == "mesh" else load_hulls(file, factors)
    except ValueError as error:
        raise ArgumentError(f"{place}: {error}") from error


def _primitive(form: str, value: Any, place: str) -> Geometry:
    count, meaning = _PRIMITIVES[form]
    numbers = [value] if count == 1 and validation.is_number(value) else value
    size = validation.finite_array(numbers, count, f"{place} ({meaning})")
    if form == "plane":
        length = float(np.linalg.norm(size))
        if not length > 0.0:
            raise ArgumentError(f"{place}: the normal has the length 0")
        return Geometry.primitive("plane", (size / length).tolist())
    if not (size > 0.0).all():
        raise ArgumentError(f"{place}: {meaning}: a length is not above 0")
    return Geometry.primitive(form, [*size.tolist(), *[0.0] * (3 - count)])  # type: ignore[arg-type]


def _hull(points: Any, place: str) -> Geometry:
    try:
        array = np.array(points, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ArgumentError(f"{place}: give a file, or points (n, 3)") from error
    if array.ndim != 2 or array.shape[1] != 3 or len(array) < 4 or not np.isfinite(array).all():
        raise ArgumentError(f"{place}: give a file, or four or more points (n, 3) that are finite")
    return Geometry.hull(array)
