"""Computes the columns of links, joints and shapes that no tick changes, from the bodies."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any, TypeAlias

from ssduck.geometry.shapes import Geometry
from ssduck.simulators.interface import Body

# The number of rows, and the columns by name.
Rows: TypeAlias = tuple[int, dict[str, Sequence[Any]]]


def link_columns(bodies: Iterable[tuple[int, Body]]) -> Rows:
    """Returns the rows of the links and sites of bodies, each with the id of its entity."""
    links = [(id, n, link) for id, body in bodies for n, link in enumerate(body.links)]
    regions = [link.region for _, _, link in links]
    sizes = [(0.0, 0.0, 0.0) if region is None else region.size for region in regions]
    return len(links), {
        "entity": [entity for entity, _, _ in links],
        "link": [number for _, number, _ in links],
        "name": [link.name for _, _, link in links],
        "parent": [link.parent if link.parent >= 0 else None for _, _, link in links],
        "mass": [link.mass for _, _, link in links],
        "region": [None if region is None else region.type for region in regions],
        **{f"region_{axis}": [size[n] for size in sizes] for n, axis in enumerate("xyz")},
    }


def joint_columns(bodies: Iterable[tuple[int, Body]]) -> Rows:
    """Returns the rows of the joints of bodies, each with the id of its entity."""
    joints = [(id, n, joint) for id, body in bodies for n, joint in enumerate(body.joints)]
    columns = ("link", "name", "type", "lower", "upper", "max_effort", "max_velocity")
    values = {name: [getattr(joint, name) for _, _, joint in joints] for name in columns}
    owners, numbers = [id for id, _, _ in joints], [n for _, n, _ in joints]
    return len(joints), {"entity": owners, "joint": numbers, **values}


def shape_columns(
    bodies: Iterable[tuple[int, Body]], geometry_id: Callable[[Geometry], int]
) -> tuple[Rows, Rows]:
    """Returns the rows of the shapes of bodies, and those of their distinct geometries."""
    shapes = [(id, n, shape) for id, body in bodies for n, shape in enumerate(body.shapes)]
    ids = [geometry_id(shape.geometry) for _, _, shape in shapes]
    distinct = {id: s.geometry for id, (_, _, s) in zip(ids, shapes, strict=True)}
    geometries = distinct.values()
    of_shapes: dict[str, Sequence[Any]] = {
        "entity": [entity for entity, _, _ in shapes],
        "link": [shape.frame for _, _, shape in shapes],
        "shape": [number for _, number, _ in shapes],
        "geometry": ids,
        "margin": [shape.margin for _, _, shape in shapes],
        "exact": [shape.exact for _, _, shape in shapes],
    }
    of_geometries: dict[str, Sequence[Any]] = {
        "id": list(distinct),
        "type": [geometry.type for geometry in geometries],
        **{f"size_{axis}": [g.size[n] for g in geometries] for n, axis in enumerate("xyz")},
        "vertices": [geometry.vertices.tolist() for geometry in geometries],
        "faces": [geometry.faces.tolist() for geometry in geometries],
    }
    return (len(shapes), of_shapes), (len(distinct), of_geometries)
