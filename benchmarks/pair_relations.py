"""Measures relations over all pairs of small scenes, against FCL's tree, in processor time.

`python -m benchmarks relations [OPTION ...]` takes some minutes; `--help` lists the options. The
bodies move as in `benchmarks.pairs`: each in a direction of its own. FCL's tree calls a Python
function for each pair whose boxes are near enough. For `on`, this function also reads a contact
normal of pairs that meet, and compares the centre of one box with the other box: what a user would
write, though not the definition of `on`. The pairs are compared for the other relations.
"""

from __future__ import annotations

import argparse
import gc
import math
import statistics
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import fcl

from benchmarks.pairs import SsduckScene
from benchmarks.peers import Fcl, Pairs
from benchmarks.random_scenes import FORMS, MOTIONS, RandomScene, bodies_of, random_scene
from benchmarks.timing import print_table, text_of

SIZES = (50, 300)
KINDS = ("boxes", "mixed")
# The conditions, and the greatest distance of the pairs, metres.
CONDITIONS = {
    "collides": ("collides(a.this, b.this)", 0.0),
    "near": ("near(a.this, b.this, 0.05)", 0.05),
    "touching": ("touching(a.this, b.this)", 1e-3),
    "on": ("on(a.this, b.this)", 1e-3),
}
HEADER = (
    "all pairs",
    "bodies",
    "move",
    "relation",
    "ssduck",
    "again",
    "FCL, tree",
    "ssduck / tree",
    "pairs",
    "other",
)
NOTES = """\
All pairs of one relation, in processor time: the median of several times of each way, in turns.
`ssduck`: at a fresh tick whose tables are read; `again`: in the same tick. `other`: pairs that only
one of both finds; for `on`, FCL's loop is no more than similar. Between two ticks the bodies move
`apart`, each by 2 mm and 0.5 degrees of its own, or `together`, all by the same vector.
"""
_MIN_UP = math.cos(math.radians(30.0))


class FclRelations(Fcl):
    """Finds the pairs of relations by FCL's tree of boxes.

    Args:
        scene: the scene.
        margins: the collision margin of each body, metres.
    """

    def __init__(self, scene: RandomScene, margins: Sequence[float]) -> None:
        super().__init__(scene)
        self._margins = margins

    def pairs(self, relation: str) -> Pairs:
        """Returns the pairs of a relation; (i, j) for j on i."""
        if relation == "collides":
            return self.managed()
        self.place()
        self._manager.update()
        distance = CONDITIONS[relation][1]
        margins = [0.0] * len(self._margins) if relation == "near" else self._margins
        bound = distance + 2 * max(margins)
        result: Pairs = []

        def compare(one: Any, other: Any, _: Any) -> tuple[bool, float]:
            nearest = fcl.DistanceResult()
            gap = fcl.distance(one, other, fcl.DistanceRequest(), nearest)
            i, j = self._numbers[id(nearest.o1)], self._numbers[id(nearest.o2)]
            if gap <= distance + margins[i] + margins[j]:
                if relation == "on":
                    result.extend(self._on(i, j))
                else:
                    result.append((i, j) if i < j else (j, i))
            return False, bound

        self._manager.distance(fcl.DistanceData(), compare)
        return result

    def _on(self, i: int, j: int) -> Iterator[tuple[int, int]]:
        """Yields the pair in the order in which the second is about on the first."""
        one, other = self._objects[i], self._objects[j]
        contacts = fcl.CollisionResult()
        request = fcl.CollisionRequest(enable_contact=True)
        if not fcl.collide(one, other, request, contacts):
            return
        height = contacts.contacts[0].normal[2]
        if abs(height) < _MIN_UP:
            return
        lower, upper = (i, j) if height > 0.0 else (j, i)
        low, high = _box(self._objects[lower])
        centre = sum(_box(self._objects[upper])) / 2
        if (low[:2] <= centre[:2]).all() and (centre[:2] <= high[:2]).all():
            yield lower, upper


def _box(one: Any) -> tuple[Any, Any]:
    centre = one.getTranslation()
    return centre - 0.1, centre + 0.1


@dataclass(frozen=True)
class _Times:
    """The processor times of a relation: at a fresh tick, again, and FCL's, seconds."""

    fresh: float
    again: float
    tree: float


def rows(
    forms: Sequence[str], sizes: Sequence[int], motions: Sequence[str], rounds: int
) -> Iterator[tuple[str, ...]]:
    """Yields a row of the table for each relation in each scene."""
    for form in forms:
        for kind in KINDS:
            for size, motion in product(sizes, motions):
                scene = replace(random_scene(form, kind, size), motion=motion)
                with bodies_of(scene) as (client, bodies):
                    ours = SsduckScene(scene, client, bodies)
                    try:
                        ours.tick()
                        ours.ss.eval("SELECT id(a) FROM a=world, b=world WHERE touching(a, b);")
                        margins = ours.world.snapshot.tables["shapes"]["margin"].tolist()
                        peer = FclRelations(scene, margins)
                        for relation in CONDITIONS:
                            yield (
                                f"{form}, {kind}",
                                str(size),
                                motion,
                                *_cells(relation, ours, peer, rounds),
                            )
                    finally:
                        ours.ss.close()


def _cells(relation: str, ours: SsduckScene, peer: FclRelations, rounds: int) -> tuple[str, ...]:
    condition, _ = CONDITIONS[relation]
    selection = "id(a.this), id(b.this) FROM a = world, b = world"
    program = ours.ss.compile(f"SELECT {selection} WHERE {condition} AS list;")

    def tick() -> None:
        ours.tick()
        peer.move(ours.ticks)

    times = _measured(tick, lambda: ours.ss.eval(program), lambda: peer.pairs(relation), rounds)
    numbers = [int(name[1:]) for name in ours.ss.eval(program)]
    found = set(zip(numbers[::2], numbers[1::2], strict=True))
    if relation != "on":
        found = {(i, j) for i, j in found if i < j}
    return (
        relation,
        text_of(times.fresh),
        text_of(times.again),
        text_of(times.tree),
        f"{times.fresh / times.tree:.2f}",
        str(len(found)),
        str(len(found ^ set(peer.pairs(relation)))),
    )


def _measured(
    tick: Callable[[], None],
    query: Callable[[], object],
    tree: Callable[[], Pairs],
    rounds: int,
) -> _Times:
    """Returns the median processor times of a query at a fresh tick, again, and of FCL's tree."""
    times: tuple[list[float], list[float], list[float]] = ([], [], [])
    gc.collect()
    gc.disable()
    try:
        for number in range(-3, rounds):
            tick()
            for way, call in zip(times, (query, query, tree), strict=True):
                start = time.process_time()
                call()
                if number >= 0:
                    way.append(time.process_time() - start)
    finally:
        gc.enable()
    return _Times(*map(statistics.median, times))


def main(arguments: Sequence[str]) -> int:
    """Measures the relations and prints their table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks relations")
    parser.add_argument("--sizes", type=int, nargs="+", default=SIZES)
    parser.add_argument("--forms", nargs="+", choices=FORMS, default=FORMS)
    parser.add_argument("--motions", nargs="+", choices=MOTIONS, default=MOTIONS)
    parser.add_argument("--rounds", type=int, default=25, help="how often each way is timed")
    options = parser.parse_args(arguments)
    print(NOTES)
    print_table(HEADER, rows(options.forms, options.sizes, options.motions, options.rounds))
    return 0
