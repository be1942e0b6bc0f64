"""Pairs of entities that a search finds, by their places in a table and by their ids."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Self, TypeAlias

import numpy as np
import numpy.typing as npt

from ssduck.geometry.arrays import Indices
from ssduck.schema import ID_FACTOR

Ids: TypeAlias = npt.NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class IdPairs:
    """Pairs of entities.

    Attributes:
        ids: the ids of all entities, in the order of their table.
        first: (n,), the places of the first entities there.
        second: (n,), those of the second ones.
    """

    ids: Ids
    first: Indices
    second: Indices

    @classmethod
    def sorted(cls, ids: Ids, first: Indices, second: Indices) -> Self:
        """Returns pairs in the order of their numbers."""
        order = _numbers(ids, first, second).argsort()
        return cls(ids, first.take(order), second.take(order))

    @classmethod
    def in_both_orders(cls, ids: Ids, first: Indices, second: Indices) -> Self:
        """Returns pairs in the order of their numbers, each pair in both orders."""
        both = np.concatenate((first, second)), np.concatenate((second, first))
        return cls.sorted(ids, *both)

    @cached_property
    def numbers(self) -> list[int]:
        """The pairs as numbers, `first * ID_FACTOR + second` of the ids."""
        numbers: list[int] = _numbers(self.ids, self.first, self.second).tolist()
        return numbers


def _numbers(ids: Ids, first: Indices, second: Indices) -> Ids:
    numbers = ids.take(first)
    numbers *= ID_FACTOR
    numbers += ids.take(second)
    return numbers


def places_by_number(numbers: Mapping[int, int], ids: Ids) -> Indices:
    """Returns the place of each number of an entity among the ids of all, by the number."""
    places = np.zeros(1 + max(numbers.values(), default=-1), np.intp)
    places[[numbers[id] for id in ids.tolist()]] = np.arange(len(ids))
    return places
