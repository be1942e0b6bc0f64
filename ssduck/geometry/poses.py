"""Poses and rotations, as functions of numpy arrays.

Lengths are metres, angles radians, and quaternions w, x, y, z of unit length. A pose is that of a
frame B in a frame A: `point_A = position + R(orientation) @ point_B`. The poses of n frames are
arrays (n, 3) and (n, 4).

The bits of a row's result do not depend on the other rows, so that a query over one tick and one
over many ticks agree. Therefore the functions add terms in a fixed order. The order of a matrix
product or of `einsum` would depend on the number of rows.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ssduck.geometry.arrays import Array

IDENTITY = np.array([1.0, 0.0, 0.0, 0.0])


def rotation_matrices(orientations: Array) -> Array:
    """Returns rotation matrices (n, 3, 3) of unit quaternions (n, 4).

    >>> rotation_matrices(np.array([[1.0, 0.0, 0.0, 0.0]]))[0].tolist()
    [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
    """
    return stacked_matrices(flat_rotation_matrices(orientations))


def stacked_matrices(rotations: Array) -> Array:
    """Returns matrices (n, 3, 3), of (9, n), one row for each entry."""
    return np.ascontiguousarray(rotations.T).reshape(-1, 3, 3)


def flat_rotation_matrices(orientations: Array) -> Array:
    """Returns rotation matrices of unit quaternions (n, 4) as (9, n), one row for each entry."""
    # R = (s s - u.u) 1 + 2 u u^T + 2 s [u x], e.g. Shuster 1993, eq. 102 (transposed). Few
    # operations on several rows each: in a small world, calls cost more than sums.
    columns = np.ascontiguousarray(orientations.T)
    products = columns.take(_FIRST, axis=0)
    products *= columns.take(_SECOND, axis=0)
    with_w, mixed, squares = products[:3], products[3:6], products[7:, None] * _SIGNS
    entries = np.zeros((9, len(orientations)))
    diagonal = entries[:3]
    np.add(products[6], squares[0], out=diagonal)
    diagonal += squares[1]
    diagonal += squares[2]
    np.subtract(mixed, with_w, out=entries[3:6])
    np.add(mixed, with_w, out=entries[6:])
    entries[3:] *= 2.0
    flat: Array = entries.take(_ROW_BY_ROW, axis=0)
    return flat


# The products wz, wx, wy; xy, yz, zx; ww, xx, yy, zz.
_FIRST = np.array([0, 0, 0, 1, 2, 3, 0, 1, 2, 3])
_SECOND = np.array([3, 1, 2, 2, 3, 1, 0, 1, 2, 3])
# The signs of xx, yy and zz in each entry of the diagonal.
_SIGNS = np.array([[1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]])[:, :, None]
# Places of the diagonal, of xy - wz, yz - wx, zx - wy and of the sums, as rows of a matrix.
_ROW_BY_ROW = np.array([0, 3, 8, 6, 1, 4, 5, 7, 2])


def rotate(matrices: Array, vectors: Array) -> Array:
    """Returns the product of each matrix of (n, 3, 3) with its vector of (n, 3)."""
    products = matrices * vectors[:, None, :]
    rotated: Array = products[:, :, 0] + products[:, :, 1]
    rotated += products[:, :, 2]
    return rotated


def cross(first: Array, second: Array) -> Array:
    """Returns cross products of the rows of two arrays (n, 3)."""
    products = first.T.take(_CROSSED, axis=0)
    products *= second.T.take(_CROSSED_WITH, axis=0)
    product: Array = (products[:3] - products[3:]).T
    return product


_CROSSED = np.array([1, 2, 0, 2, 0, 1])
_CROSSED_WITH = np.array([2, 0, 1, 1, 2, 0])


def multiply(first: Array, second: Array) -> Array:
    """Returns Hamilton products of quaternions (n, 4): the rotation `second`, then `first`."""
    # (s, u)(t, v) = (s t - u.v, s v + t u + u x v); few operations, as above.
    terms = np.ascontiguousarray(first.T).take(_TERMS_OF_FIRST, axis=0)
    terms *= np.ascontiguousarray(second.T).take(_TERMS_OF_SECOND, axis=0)
    scalars = terms[4:9:4]
    np.negative(scalars, out=scalars)
    product = terms[:4]
    product += terms[4:8]
    product += terms[8:12]
    product -= terms[12:]
    return np.ascontiguousarray(product.T)


# The first, the second, the third and the last term of w, x, y and z of a product.
_TERMS_OF_FIRST = np.array([0, 0, 0, 0, 1, 1, 2, 3, 2, 2, 3, 1, 3, 3, 1, 2])
_TERMS_OF_SECOND = np.array([0, 1, 2, 3, 1, 0, 0, 0, 2, 3, 1, 2, 3, 2, 3, 1])


def unit_quaternions(orientations: Array) -> Array:
    """Returns quaternions (n, 4) scaled to length 1; NaN for a quaternion of length 0."""
    columns = np.ascontiguousarray(orientations.T)  # operations on its rows cost less
    squares = columns * columns
    length = squares[0] + squares[1]
    length += squares[2]
    length += squares[3]
    with np.errstate(invalid="ignore", divide="ignore"):
        unit: Array = columns / np.sqrt(length, out=length)
    return unit.T


def compose(
    positions: Array, orientations: Array, inner_positions: Array, inner_orientations: Array
) -> tuple[Array, Array]:
    """Returns poses of C in A, from poses of B in A and of C in B, all of n rows.

    >>> position, _ = compose(np.ones((1, 3)), IDENTITY[None], np.ones((1, 3)), IDENTITY[None])
    >>> position.tolist()
    [[2.0, 2.0, 2.0]]
    """
    matrices = rotation_matrices(orientations)
    return (
        positions + rotate(matrices, inner_positions),
        multiply(orientations, inner_orientations),
    )


def invert(positions: Array, orientations: Array) -> tuple[Array, Array]:
    """Returns poses of A in B, from poses of B in A."""
    inverse = orientations * np.array([1.0, -1.0, -1.0, -1.0])
    return -rotate(rotation_matrices(inverse), positions), inverse


def quaternion_from_matrix(matrix: Array) -> Array:
    """Returns the unit quaternion of a rotation matrix (3, 3)."""
    from scipy.spatial.transform import Rotation

    quaternion: Array = np.roll(Rotation.from_matrix(matrix).as_quat(), 1)
    return quaternion


def turn_to(direction: Sequence[float]) -> Array:
    """Returns the quaternion w, x, y, z that turns z to a direction by the shortest way.

    >>> turn_to([0.0, 0.0, 2.0]).tolist()
    [1.0, -0.0, 0.0, 0.0]
    """
    x, y, z = np.array(direction) / np.linalg.norm(direction)
    if z < -1.0 + 1e-12:
        return np.array([0.0, 1.0, 0.0, 0.0])
    unit: Array = unit_quaternions(np.array([[1.0 + z, -y, x, 0.0]]))[0]
    return unit
