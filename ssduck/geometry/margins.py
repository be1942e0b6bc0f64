"""The collision margins of shapes: the distances at which a simulator presses them apart."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ssduck.geometry.arrays import Array, Indices


@dataclass(frozen=True, eq=False)
class Margins:
    """The collision margins of n shapes, m.

    Attributes:
        numbers: (n,), the margin of each shape. That of two shapes is the sum of theirs, or less if
            there are classes.
        classes: (n,), the class of each shape; None for no classes.
        of_classes: (k, k), the margin of two shapes of some classes.
    """

    numbers: Array
    classes: Indices | None = None
    of_classes: Array | None = None

    @classmethod
    def of(cls, numbers: Margins | Array | None, count: int) -> Margins:
        """Returns those of a count of shapes from their margins; None for none."""
        if isinstance(numbers, Margins):
            return numbers
        return cls(np.zeros(count) if numbers is None else numbers)

    @cached_property
    def listed(self) -> list[float]:
        """The margin of each shape."""
        numbers: list[float] = self.numbers.tolist()
        return numbers

    def of_two(self, s: int, t: int) -> float:
        """Returns the margin of two shapes."""
        if self.classes is None or self.of_classes is None:
            return self.listed[s] + self.listed[t]
        return float(self.of_classes[self.classes[s], self.classes[t]])

    def of_pairs(self, first: Indices, second: Indices) -> Array:
        """Returns the margins of pairs of shapes, (m,)."""
        if self.classes is None or self.of_classes is None:
            return self.numbers[first] + self.numbers[second]
        of_pairs: Array = self.of_classes[self.classes[first], self.classes[second]]
        return of_pairs

    def take(self, shapes: Indices) -> Margins:
        """Returns those of some of the shapes."""
        classes = None if self.classes is None else self.classes[shapes]
        return Margins(self.numbers[shapes], classes, self.of_classes)

    def padded(self, count: int) -> Margins:
        """Returns these and those of further shapes, whose own margins are 0."""
        numbers = np.concatenate((self.numbers, np.zeros(count)))
        if self.classes is None or self.of_classes is None:
            return Margins(numbers)
        further = len(self.of_classes)
        of_classes = np.pad(self.of_classes, (0, 1))
        of_classes[further, self.classes] = of_classes[self.classes, further] = self.numbers
        classes = np.concatenate((self.classes, np.full(count, further)))
        return Margins(numbers, classes, of_classes)
