"""The array types of geometry, and a test of numbers."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
import numpy.typing as npt

Array: TypeAlias = npt.NDArray[np.float64]
Indices: TypeAlias = npt.NDArray[np.intp]
Triangles: TypeAlias = npt.NDArray[np.int32]
Flags: TypeAlias = npt.NDArray[np.bool_]

# If the squares of numbers add up to less, sums of their products are finite.
_MODERATE = 1e100
# BLAS multiplies longer vectors in threads, which takes far longer.
_UNTHREADED = 8192


def are_moderate(numbers: Array) -> bool:
    """Checks whether numbers (n,) are finite, and so are sums of their products."""
    if len(numbers) <= _UNTHREADED:
        return bool(np.dot(numbers, numbers) < _MODERATE)
    parts = (numbers[n : n + _UNTHREADED] for n in range(0, len(numbers), _UNTHREADED))
    return sum(float(np.dot(part, part)) for part in parts) < _MODERATE
