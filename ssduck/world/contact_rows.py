"""Arranges the contact points of a tick as rows of the table of contacts."""

from __future__ import annotations

import numpy as np

from ssduck.geometry.arrays import Array, Indices
from ssduck.simulators.interface import ContactPoints

# A body and a link as one number: the link in the lower bits.
_LINK_BITS = 32


def contact_rows(contacts: ContactPoints, entities: Indices) -> tuple[Indices, Array]:
    """Returns contacts with a < b, normals from b to a and forces on a, in order.

    Args:
        contacts: the contacts.
        entities: (n, 2), the ids of their bodies.

    Returns:
        (n, 4), a, its link, b and its link; (n, 14), the points, the normal, the depth, the normal
        force and the whole force.
    """
    count = len(contacts)
    sides = (entities << _LINK_BITS) | contacts.links
    is_swapped = sides[:, 0] > sides[:, 1]
    # The places of a and b among the sides of all contacts, one contact after the other.
    first = np.arange(0, 2 * count, 2) + is_swapped
    places = np.stack((first, first ^ 1), axis=1)
    sign = np.where(is_swapped, -1.0, 1.0)[:, None]
    numbers = np.zeros((count, 14))
    numbers[:, :6] = contacts.points.reshape(-1, 3).take(places, axis=0).reshape(-1, 6)
    normals = np.multiply(sign, contacts.normals, out=numbers[:, 6:9])
    numbers[:, 9], numbers[:, 10] = contacts.depths, contacts.forces
    np.add(contacts.forces[:, None] * normals, sign * contacts.frictions, out=numbers[:, 11:])
    sides = sides.take(places)
    order = _order(sides, numbers)
    return _split(sides.take(order, axis=0)), numbers.take(order, axis=0)


def _split(sides: Indices) -> Indices:
    """Returns bodies and links of two sides, (n, 4)."""
    columns = np.zeros((len(sides), 4), dtype=np.int64)
    np.right_shift(sides, _LINK_BITS, out=columns[:, ::2])
    np.bitwise_and(sides, (1 << _LINK_BITS) - 1, out=columns[:, 1::2])
    return columns


def _order(sides: Indices, numbers: Array) -> Indices:
    """Returns the order of contacts by a, b, the points, and the normal force.

    Few contacts have an equal x of the point on a, so the other coordinates are compared for these
    only. Points that coincide differ in their forces.
    """
    order = np.lexsort((numbers[:, 0], sides[:, 1], sides[:, 0]))
    a, b = sides.take(order, axis=0).T
    x = numbers[:, 0].take(order)
    is_next = (a[1:] != a[:-1]) | (b[1:] != b[:-1]) | (x[1:] > x[:-1])
    if is_next.all():
        return order
    is_first = np.ones(len(order), dtype=bool)
    is_first[1:] = is_next
    is_tied = ~is_first
    is_tied[:-1] |= ~is_next
    tied = is_tied.nonzero()[0]
    rows = order[tied]
    keys = numbers.take(rows, axis=0)
    order[tied] = rows[np.lexsort((keys[:, 10], *keys.T[5::-1], is_first.cumsum()[tied]))]
    return order
