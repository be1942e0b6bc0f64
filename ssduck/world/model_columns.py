"""Computes the columns of links and joints that no tick changes, from the bodies."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, TypeAlias

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
