"""How contact points become rows of the table of contacts."""

import numpy as np
import pytest

from ssduck.simulators.interface import ContactPoints
from ssduck.world.rows import contact_rows


@pytest.mark.parametrize("count", [1, 30])
def test_rows_are_those_of_a_loop_in_python(count):
    """Few different numbers, so that points and sides coincide."""
    draws = np.random.default_rng(count)
    numbers = [0.0, -0.0, 1.0, 0.3, -2.5]
    for _ in range(20):
        points = ContactPoints(
            draws.integers(0, 3, (count, 2)),
            draws.integers(0, 3, (count, 2)),
            draws.choice(numbers[:3], (count, 2, 3)),
            *(draws.choice(numbers, shape) for shape in ((count, 3), count, count, (count, 3))),
        )
        sides, values = contact_rows(points, points.bodies + 1)
        columns = [column.tolist() for column in (*sides, *values)]
        rows = list(zip(*columns, strict=True))
        expected = sorted(map(_row, *points.columns.values()), key=lambda row: (*row[:10], row[14]))
        assert list(map(repr, rows)) == list(map(repr, expected))


def _row(bodies, links, points, normal, depth, force, friction):
    """A row of the table of contacts, without numpy's functions of arrays."""
    sides = [(int(bodies[side]) + 1, int(links[side])) for side in (0, 1)]
    first, sign = (0, 1.0) if sides[0] <= sides[1] else (1, -1.0)
    normal = [sign * x for x in normal]
    forces = [force * n + sign * f for n, f in zip(normal, friction, strict=True)]
    at = [*points[first], *points[1 - first]]
    numbers = map(float, (*at, *normal, depth, force, *forces))
    return (*sides[first], *sides[1 - first], *numbers)
