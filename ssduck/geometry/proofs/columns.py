"""Computes with many vectors at once, each a column of an array."""

from __future__ import annotations

import numpy as np

from ssduck.geometry.arrays import Array


def column_lengths(vectors: Array) -> Array:
    """Returns the lengths (n,) of vectors (3, n).

    >>> column_lengths(np.array([[3.0], [0.0], [4.0]])).tolist()
    [5.0]
    """
    lengths: Array = np.sqrt(np.einsum("cn,cn->n", vectors, vectors))
    return lengths


def unit_columns(vectors: Array) -> Array:
    """Returns vectors (3, n) with length 1; those of length 0 stay as they are.

    >>> unit_columns(np.array([[3.0], [0.0], [4.0]])).ravel().tolist()
    [0.6, 0.0, 0.8]
    """
    units: Array = vectors / np.maximum(column_lengths(vectors), 1e-300)
    return units


def padded_columns(rows: Array, count: int) -> Array:
    """Returns rows as columns (k, count), with the last one repeated.

    >>> padded_columns(np.array([[1.0, 2.0], [3.0, 4.0]]), 3).tolist()
    [[1.0, 3.0, 3.0], [2.0, 4.0, 4.0]]
    """
    return np.ascontiguousarray(rows[np.minimum(np.arange(count), len(rows) - 1)].T)
