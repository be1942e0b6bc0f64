"""The array types of geometry, a test of numbers, and vectors as the columns of an array."""

from __future__ import annotations

from typing import TypeAlias, TypeVar

import numpy as np
import numpy.typing as npt

Array: TypeAlias = npt.NDArray[np.float64]
Indices: TypeAlias = npt.NDArray[np.intp]
Triangles: TypeAlias = npt.NDArray[np.int32]
Flags: TypeAlias = npt.NDArray[np.bool_]

T = TypeVar("T")

# If the squares of numbers add up to less, sums of their products are finite.
_MODERATE = 1e100


def are_moderate(numbers: Array) -> bool:
    """Checks whether numbers (n,) are finite, and so are sums of their products."""
    return bool(np.einsum("n,n->", numbers, numbers) < _MODERATE)


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


def selected(record: T, places: Indices) -> T:
    """Returns a dataclass of arrays (…, n) with some of their n columns; the rest stays."""
    parts = (
        part.take(places, axis=-1) if isinstance(part, np.ndarray) else part
        for part in vars(record).values()
    )
    return type(record)(*parts)


def ranges(starts: Indices, counts: Indices) -> tuple[Indices, Indices]:
    """Returns the row and the value of each element of ranges `starts + [0, counts)`.

    >>> [part.tolist() for part in ranges(np.array([5, 8]), np.array([2, 1]))]
    [[0, 0, 1], [5, 6, 8]]
    """
    rows = np.repeat(np.arange(len(starts)), counts)
    values = np.arange(len(rows)) + np.repeat(starts - np.cumsum(counts) + counts, counts)
    return rows, values
