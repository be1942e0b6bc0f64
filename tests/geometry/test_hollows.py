"""Things in the holes of others: no form of a question takes what is hollow for its convex hull."""

import itertools
import math

import numpy as np
import pytest

from ssduck.geometry.batch import matching_pairs
from ssduck.geometry.narrow_phase import MIN_DEPTH
from ssduck.geometry.tick_shapes import PairPredicate, pair_number
from tests.support import hollows, pairs
from tests.support.cases import generated, sampled
from tests.support.solids import narrow

SEEDS = range(generated(7))
EDGE = 1e-8


def is_mesh(*shapes):
    return bool({shape.kind for shape in shapes} & set(pairs.MESHES))


def bound_of(a, b):
    """How far a gap may be off."""
    return 1e-9 if is_mesh(a, b) or "cylinder" not in (a.kind, b.kind) else 1e-6


def tick_of(shapes):
    return narrow(*([(one.geometry, one.position, one.quaternion)] for one in shapes))


@pytest.mark.slow
@sampled("seed", SEEDS, every=7)
def test_gaps_in_holes_are_what_the_oracle_says(seed):
    for a, b in itertools.combinations(hollows.scene(seed), 2):
        error, found = pairs.error_of(a, b)
        assert error <= bound_of(a, b), (a.kind, b.kind, found)


def limits(gap):
    """Distances just inside, and just outside."""
    far = max(0.0, gap)
    return {0.0, 1e-3, 0.1, far + EDGE, far * 1.5, *((far - EDGE, far / 2) if far > EDGE else ())}


def asked_alone(shapes, pair, gap):
    """What each form of two entities says, each of a tick that knows nothing yet: it or its gap."""
    i, j = pair
    clearance = max(0.0, gap)
    assert tick_of(shapes).clearance(i, j) == clearance
    assert tick_of(shapes).penetration(j, i) == max(0.0, -gap)
    assert tick_of(shapes).collides(i, j) is (gap < -MIN_DEPTH)
    p, q = tick_of(shapes).nearest_points(i, j)
    assert math.dist(p, q) == pytest.approx(abs(gap), abs=1e-9)
    for apart in (0.5 * -gap, 2.0 * -gap):
        if gap < -1e-5:
            assert tick_of(shapes).collides(i, j, apart) is (-gap > apart)
    for apart in limits(gap):
        tick = tick_of(shapes)
        assert (tick.clearance(i, j, apart) <= apart) is (clearance <= apart)
        assert bool(tick.shapes_touching(i, j, apart)) is (clearance <= apart)
    if clearance > 2e-3:
        assert tick_of(shapes).on(i, j) is False


@pytest.mark.slow
@sampled("seed", SEEDS, every=7)
def test_all_forms_agree_on_what_is_in_holes(seed):
    shapes = hollows.scene(seed)
    every = list(itertools.combinations(range(len(shapes)), 2))
    gaps = {pair: tick_of(shapes).signed_distance(*pair).distance for pair in every}
    for (i, j), gap in gaps.items():
        # Neither in which order they are, nor what else is there, changes a bit.
        two = [shapes[j], shapes[i]]
        assert (
            gap
            == tick_of(shapes).signed_distance(j, i).distance
            == tick_of(two).signed_distance(0, 1).distance
        )
        assert gap == pytest.approx(pairs.gap(shapes[i], shapes[j]).distance, abs=1e-6)
        asked_alone(shapes, (i, j), gap)
        asked_alone(shapes, (j, i), gap)
    together = tick_of(shapes)
    for question in questions(gaps.values()):
        found = [pair for pair, gap in gaps.items() if holds(question, gap)]
        assert together.all_pairs(question).pairs == found, question
        assert many_ticks(shapes, every, question) == found, question


def questions(gaps):
    """Questions whose answers differ just there."""
    for apart in sorted(set().union(*map(limits, gaps))):
        yield PairPredicate("within", apart)
        yield PairPredicate("touching", apart)
    deep = {MIN_DEPTH, 1e-3, *(-gap * share for gap in gaps if gap < -1e-5 for share in (0.5, 2.0))}
    yield from (PairPredicate("colliding", depth) for depth in sorted(deep))


def holds(question, gap):
    return gap < -question.distance if question.kind == "colliding" else gap <= question.distance


def many_ticks(shapes, every, question):
    """The pairs that windows of the past find."""
    tick = tick_of(shapes)
    scene = tick.arrays

    def satisfies(s, t):
        return tick_of([shapes[s], shapes[t]]).shapes.satisfies(0, 1, question)

    found = matching_pairs(scene, question, satisfies, tuple(np.array(every, np.intp).T))
    assert set(found.compared.tolist()) == {pair_number(*one) for one in every}
    return found.pairs
