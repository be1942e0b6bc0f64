"""Arranges bodies and contact points as rows of the tables of a tick."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np

from ssduck.errors import EvaluationError
from ssduck.geometry.arrays import Array, Indices
from ssduck.geometry.shapes import Geometry
from ssduck.simulators.contact_pairs import ContactPairs, are_of
from ssduck.simulators.contact_pairs import Sides as ContactSides
from ssduck.simulators.interface import Body, ContactPoints
from ssduck.world.layout import TableLayout
from ssduck.world.live_tables import LiveTable

# A body and a link as one number: the link in the lower bits.
_LINK_BITS = 32
_LINK = (1 << _LINK_BITS) - 1

# The columns of sides: a, its link, b and its link, (n,) each.
CONTACT_SIDES = ("a", "link_a", "b", "link_b")
Sides: TypeAlias = tuple[Indices, Indices, Indices, Indices]


def write_contacts(table: LiveTable, contacts: ContactPoints, layout: TableLayout) -> None:
    """Writes contacts into their table, sorted by a, its link, b, its link, and the points."""
    table.resize(len(contacts))
    if not len(contacts):
        return
    sides, numbers = contact_rows(contacts, layout.ids_of_handles[contacts.bodies])
    for name, column in zip(CONTACT_SIDES, sides, strict=True):
        table[name][:] = column
    table.doubles("ax", "fz")[:] = numbers


def contact_pairs(
    unwritten: ContactPoints | None, layout: TableLayout, table: Callable[[], LiveTable]
) -> ContactPairs:
    """Returns the contacts of a tick, as the simulator has them until their table is written."""

    def ordered() -> tuple[ContactSides, Array, Array]:
        rows = table()
        if not rows.is_complete:
            raise EvaluationError("a contact has an unknown number")
        entities = np.stack((rows["a"], rows["b"]))
        links = np.stack((rows["link_a"], rows["link_b"]))
        return (entities, links), rows["force"], rows.doubles("nx", "nz")

    def between(a: int, b: int, pressing: bool) -> ContactSides:
        if unwritten is None:
            sides, forces, _ = ordered()
            is_chosen = are_of(sides, a, b) & ((forces > 0) | (not pressing))
            return sides[0][:, is_chosen], sides[1][:, is_chosen]
        # A sensor has no body, and no contacts.
        first, second = (layout.handles.get(id, -2) for id in (a, b))
        bodies, links = unwritten.between(first, second, pressing=pressing)
        return layout.ids_of_handles[bodies.T], links.T

    return ContactPairs(between, ordered)


def contact_rows(
    contacts: ContactPoints, entities: Indices, ticks: Indices | None = None
) -> tuple[Sides, Array]:
    """Returns contacts with a < b, normals from b to a and forces on a, in order.

    Args:
        contacts: the contacts.
        entities: (n, 2), the ids of their bodies.
        ticks: (n,), numbers of their ticks, ascending; None for contacts of one tick.

    Returns:
        The sides; (14, n), the points, the normal, the depth, the normal force and the whole force.
    """
    first, second = ((entities << _LINK_BITS) | contacts.links).T
    is_swapped = first > second
    sign = np.where(is_swapped, -1.0, 1.0)
    at_first, at_second = contacts.points.transpose(1, 2, 0)
    numbers = np.zeros((14, len(contacts)))
    numbers[:3] = np.where(is_swapped, at_second, at_first)
    numbers[3:6] = np.where(is_swapped, at_first, at_second)
    normals = np.multiply(sign, contacts.normals.T, out=numbers[6:9])
    numbers[9], numbers[10] = contacts.depths, contacts.forces
    np.add(contacts.forces * normals, sign * contacts.frictions.T, out=numbers[11:])
    a, b = np.minimum(first, second), np.maximum(first, second)
    order = _order((b, a) if ticks is None else (b, a, ticks), numbers)
    a, b = a.take(order), b.take(order)
    sides = a >> _LINK_BITS, a & _LINK, b >> _LINK_BITS, b & _LINK
    return sides, numbers.take(order, axis=1)


def _order(keys: tuple[Indices, ...], numbers: Array) -> Indices:
    """Returns the order of contacts by the last key first, then the points, and the force."""
    order = np.lexsort((numbers[0], *keys))
    x, ordered = numbers[0].take(order), [key.take(order) for key in keys]
    is_same_side = np.logical_and.reduce([key[1:] == key[:-1] for key in ordered])
    # The place of each contact that the next one is tied with.
    before = (is_same_side & ~(x[1:] > x[:-1])).nonzero()[0]
    if not len(before):
        return order
    is_tied = np.zeros(len(order), dtype=bool)
    is_tied[before] = is_tied[before + 1] = True
    tied = is_tied.nonzero()[0]
    # The same number for tied contacts: both terms rise by 1 from one of them to the next.
    groups = np.arange(len(tied)) - before.searchsorted(tied)
    rows = order[tied]
    places = numbers.take(rows, axis=1)
    order[tied] = rows[np.lexsort((places[10], *places[5::-1], groups))]
    return order


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
) -> tuple[Rows, dict[int, Geometry]]:
    """Returns the rows of the shapes of bodies, and their geometries by id."""
    shapes = [(id, n, shape) for id, body in bodies for n, shape in enumerate(body.shapes)]
    ids = [geometry_id(shape.geometry) for _, _, shape in shapes]
    columns: dict[str, Sequence[Any]] = {
        "entity": [entity for entity, _, _ in shapes],
        "link": [shape.frame for _, _, shape in shapes],
        "shape": [number for _, number, _ in shapes],
        "geometry": ids,
        "margin": [shape.margin for _, _, shape in shapes],
        "exact": [shape.exact for _, _, shape in shapes],
    }
    geometries = {id: shape.geometry for id, (_, _, shape) in zip(ids, shapes, strict=True)}
    return (len(shapes), columns), geometries


def geometry_columns(geometries: Mapping[int, Geometry]) -> Rows:
    """Returns the rows of geometries, by their ids."""
    distinct = geometries.values()
    return len(geometries), {
        "id": list(geometries),
        "type": [geometry.type for geometry in distinct],
        **{f"size_{axis}": [g.size[n] for g in distinct] for n, axis in enumerate("xyz")},
        "vertices": [geometry.vertices.tolist() for geometry in distinct],
        "faces": [geometry.faces.tolist() for geometry in distinct],
    }
