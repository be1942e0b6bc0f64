"""Arranges the contact points of a tick as rows of the table of contacts."""

from __future__ import annotations

import numpy as np

from ssduck.geometry.arrays import Array, Indices
from ssduck.simulators.interface import ContactPoints


def contact_rows(contacts: ContactPoints, entities: Indices) -> tuple[Indices, Array]:
    """Returns contacts with a < b, normals from b to a and forces on a, in order.

    Args:
        contacts: the contacts.
        entities: (n, 2), the ids of their bodies.

    Returns:
        (n, 4), a, its link, b and its link; (n, 14), the points, the normal, the depth, the normal
        force and the whole force.
    """
    (a, b), (link_a, link_b) = entities.T, contacts.links.T
    swapped = (a > b) | ((a == b) & (link_a > link_b))
    first = swapped.astype(np.intp)
    sides = np.zeros((len(contacts), 4), dtype=np.int64)
    rows = np.arange(len(contacts))
    for column, side in ((0, first), (2, 1 - first)):
        sides[:, column], sides[:, column + 1] = entities[rows, side], contacts.links[rows, side]
    sign = np.where(swapped, -1.0, 1.0)[:, None]
    normals = sign * contacts.normals
    forces = contacts.forces[:, None] * normals + sign * contacts.frictions
    numbers = np.column_stack(
        (
            contacts.points[rows, first],
            contacts.points[rows, 1 - first],
            normals,
            contacts.depths,
            contacts.forces,
            forces,
        )
    )
    # Points that coincide differ in their forces.
    order = np.lexsort((contacts.forces, *numbers.T[5::-1], *sides.T[::-1]))
    return sides[order], numbers[order]
