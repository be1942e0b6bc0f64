"""Measures finding all pairs that collide, by ssduck at a fresh tick, FCL, PyBullet and coal.

`python -m benchmarks pairs [OPTION ...]` takes many minutes, most of them for the scenes of 10,000
bodies; `--sizes 50 300` takes a few. `--help` lists the options.

The tick of ssduck is taken and its tables are read beforehand; between two ticks each body moves by
2 mm in a direction of its own and turns by 0.5 degrees. The other libraries have their shapes and
poses made beforehand; see `benchmarks.peers`. The pairs of all of them are compared. If another way
finds different pairs, `benchmarks.referee` decides which is right, or whether a pair that ssduck
calls touching within `TOUCHING` may be touching. It is a failure if ssduck is not right.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import combinations, pairwise

import numpy as np
import pybullet

import ssduck
from benchmarks.peers import COLLIDES, Coal, Fcl, Pairs, coal_or_none, pybullet_loop
from benchmarks.random_scenes import (
    FORMS,
    KINDS,
    NEIGHBOURS,
    PERIOD,
    PIECES,
    RandomScene,
    bodies_of,
    random_scene,
)
from benchmarks.referee import may_touch, verdict
from benchmarks.timing import Way, minima, print_table, text_of
from ssduck.geometry.distance import Statistics
from ssduck.simulators.pybullet.simulator import PyBulletSimulator

SIZES = (50, 300, 1000, 3000, 10000)
# The largest scenes in which FCL and PyBullet test all pairs in a loop.
LOOPED, CLOSEST = 1000, 300
# In larger scenes, this number of bodies is tested with all others, and the time is scaled.
SAMPLED = 20
# Pairs of at most this depth or distance, metres, may count as either.
TOUCHING = 1e-5

PROGRAM = (
    "SELECT id(a.this), id(b.this) FROM a = world, b = world WHERE collides(a.this, b.this) "
    "AS list;"
)
SQL = "SELECT a.name, b.name FROM entities a, entities b WHERE collides(a, b) AND a.id < b.id"
_LOAD = "SELECT (SELECT count(x) FROM entities), (SELECT count(x) FROM shapes)"
_GAPS = """
    SELECT clearance(a, b) - penetration(a, b)
    FROM (SELECT unnest($one) AS one, unnest($other) AS other) pairs
    JOIN entities a ON a.name = pairs.one JOIN entities b ON b.name = pairs.other
    ORDER BY a.id, b.id
"""


class SsduckScene:
    """A random scene in a world of ssduck.

    Attributes:
        world: the world.
        ss: the interpreter.
        statistics: the work of the narrow phase at a fresh tick, by the way.
    """

    def __init__(self, scene: RandomScene, client: int, bodies: Sequence[int]) -> None:
        names = {body: f"b{number}" for number, body in enumerate(bodies)}
        self._numbers = {name: number for number, name in enumerate(names.values())}
        self._scene, self._client, self._bodies = scene, client, bodies
        self.world = ssduck.World(PyBulletSimulator(client, owned=True, names=names))
        self.ss = ssduck.Interpreter()
        self.ss.add_variable("world", self.world)
        self._compiled = self.ss.compile(PROGRAM)
        self.ticks = 0
        self._poses = [
            (moved.positions.tolist(), moved.orientations.tolist())
            for moved in map(scene.at, range(PERIOD))
        ]
        self._before = Statistics(0, 0)
        self.statistics: dict[str, Statistics] = {}

    def tick(self) -> None:
        """Moves all bodies and takes a tick."""
        self.ticks += 1
        for body, place, turn in zip(self._bodies, *self._poses[self.ticks % PERIOD], strict=True):
            pybullet.resetBasePositionAndOrientation(body, place, turn, self._client)
        self.world.tick()
        self.ss.sql(_LOAD).fetchall()
        self._before = self.ss.statistics()["world"]

    def return_to_start(self) -> None:
        """Takes the ticks up to that at which the bodies are where they began."""
        while self.ticks % PERIOD:
            self.tick()

    def query(self) -> list[str]:
        """Runs the SelectScript query."""
        names: list[str] = self.ss.eval(self._compiled)
        self._record_statistics("ours")
        return names

    def query_sql(self) -> list[tuple[str, str]]:
        """Runs the SQL query."""
        pairs: list[tuple[str, str]] = self.ss.sql(SQL).fetchall()
        self._record_statistics("sql")
        return pairs

    def _record_statistics(self, way: str) -> None:
        """Records the work since the tick once; another call would take minutes in some scenes."""
        if way not in self.statistics:
            after, before = self.ss.statistics()["world"], self._before
            pairs, calls = after.pairs - before.pairs, after.calls - before.calls
            self.statistics[way] = Statistics(pairs, calls)

    def pairs(self, names: list[str]) -> Pairs:
        """Returns the pairs of a flat list of names."""
        numbers = [self._numbers[name] for name in names]
        return [(i, j) for i, j in zip(numbers[::2], numbers[1::2], strict=True) if i < j]

    def gaps(self, pairs: Pairs) -> list[float]:
        """Returns the distances of pairs in ascending order, metres; depths are negative."""
        one, other = ([f"b{number}" for number in side] for side in zip(*pairs, strict=True))
        rows = self.ss.sql(_GAPS, {"one": one, "other": other}).fetchall()
        return [gap for (gap,) in rows]


# -- one scene ----------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Difference:
    """The pairs that only one of ssduck and another way finds.

    Attributes:
        touching: the number of such pairs that ssduck calls touching.
        other: the number of the others.
        failures: the pairs in which the referee does not agree with ssduck.
    """

    touching: int
    other: int
    failures: Pairs

    def __str__(self) -> str:
        return f"{self.touching} + {self.other}"


@dataclass(frozen=True, eq=False)
class Measurement:
    """The measurements of a random scene.

    Attributes:
        form: the form of the scene.
        kind: the kind of the shapes.
        scene: the scene.
        collisions: the number of pairs that collide.
        times: the times of the ways, seconds.
        scaled: the ways of which only a sample was timed.
        statistics: the work of the narrow phase, in SelectScript and in SQL.
        differences: the differences from ssduck, by the way.
    """

    form: str
    kind: str
    scene: RandomScene
    collisions: int
    times: dict[str, float]
    scaled: frozenset[str]
    statistics: dict[str, Statistics]
    differences: dict[str, Difference]

    @property
    def name(self) -> str:
        """The label in tables."""
        return f"{self.form}, {self.kind}"

    def ratio(self, way: str, other: str) -> float:
        """Returns the time of a way relative to another."""
        return self.times[way] / self.times[other]

    def growth(self, before: Measurement | None) -> float:
        """Returns the exponent of the growth of ssduck's time from a smaller scene."""
        if before is None:
            return math.nan
        sizes = len(self.scene) / len(before.scene)
        return math.log(self.times["ours"] / before.times["ours"]) / math.log(sizes)

    def text_of(self, way: str) -> str:
        """Returns the text of a time in tables."""
        if way not in self.times:
            return "not installed"
        return ("≈ " if way in self.scaled else "") + text_of(self.times[way])


class Sample:
    """The pairs on which a loop is timed: all, or those of some bodies with all others."""

    def __init__(self, count: int, max_count: int) -> None:
        self.is_whole = count <= max_count
        self.pairs: Pairs
        if self.is_whole:
            self.pairs = list(combinations(range(count), 2))
        else:
            sample = np.random.default_rng(count).choice(count, SAMPLED, replace=False).tolist()
            self.pairs = [(min(i, j), max(i, j)) for i in sample for j in range(count) if i != j]
        self.scale = count * (count - 1) / 2 / len(self.pairs)


class Contest:
    """A random scene and all the ways to find its pairs."""

    def __init__(self, scene: RandomScene, client: int, bodies: Sequence[int]) -> None:
        self.scene = scene
        self.ours = SsduckScene(scene, client, bodies)
        self.closest = pybullet_loop(client, bodies)
        self.fcl = Fcl(scene)
        coal = coal_or_none()
        self.coal = None if coal is None else Coal(coal, scene)
        self.fcl_sample = Sample(len(scene), LOOPED)
        self.pybullet_sample = Sample(len(scene), CLOSEST)

    def times(self, rounds: int, max_seconds: float) -> dict[str, float]:
        """Returns the time of each way, seconds."""
        ours = self.ours
        ways = {
            "ours": Way(ours.query, before=ours.tick),
            "again": Way(ours.query, before=ours.query),
            "sql": Way(ours.query_sql, before=ours.tick),
            "manager": Way(self.fcl.managed, before=lambda: self.fcl.move(ours.ticks)),
            "loop": Way(partial(self.fcl.loop, self.fcl_sample.pairs), before=self.fcl.place),
            "pybullet": Way(partial(self.closest, self.pybullet_sample.pairs)),
        }
        if (coal := self.coal) is not None:
            ways["coal"] = Way(coal.managed, before=lambda: coal.move(ours.ticks))
        times = minima(ways, rounds, max_seconds)
        times["loop"] *= self.fcl_sample.scale
        times["pybullet"] *= self.pybullet_sample.scale
        return times

    def return_to_start(self) -> None:
        """Moves all bodies to where they began."""
        self.ours.return_to_start()
        self.fcl.move(self.ours.ticks)
        self.fcl.place()
        if self.coal is not None:
            self.coal.move(self.ours.ticks)

    def differences(self, collisions: set[tuple[int, int]]) -> dict[str, Difference]:
        """Returns how the pairs of the other ways differ from those of ssduck."""
        names = [name for pair in self.ours.query_sql() for name in pair]
        others = {
            "again": self.ours.pairs(self.ours.query()),
            "sql": self.ours.pairs(names),
            "manager": self.fcl.managed(),
            "pybullet": self.closest([(i, j) for i, j in self.scene.met.tolist()]),
        }
        if self.coal is not None:
            others["coal"] = self.coal.managed()
        differing = {way: collisions.symmetric_difference(pairs) for way, pairs in others.items()}
        looped = self.fcl.loop(self.fcl_sample.pairs)
        sampled = collisions.intersection(self.fcl_sample.pairs)
        differing["loop"] = sampled.symmetric_difference(looped)
        return {way: self._judge(sorted(pairs), collisions) for way, pairs in differing.items()}

    def _judge(self, pairs: Pairs, collisions: set[tuple[int, int]]) -> Difference:
        """Judges the pairs that only one of two ways finds."""
        gaps = dict(zip(pairs, self.ours.gaps(pairs), strict=True)) if pairs else {}
        touching = [pair for pair in pairs if abs(gaps[pair]) <= TOUCHING]
        wrong = [pair for pair in touching if not may_touch(self.scene, *pair, 2 * TOUCHING)]
        clear = [pair for pair in pairs if abs(gaps[pair]) > TOUCHING]
        wrong += [p for p in clear if verdict(self.scene, *p, COLLIDES) is not (p in collisions)]
        return Difference(len(touching), len(clear), wrong)


def measure(form: str, kind: str, count: int, rounds: int, max_seconds: float) -> Measurement:
    """Times all ways in one scene and compares their pairs."""
    scene = random_scene(form, kind, count)
    with bodies_of(scene) as (client, bodies):
        contest = Contest(scene, client, bodies)
        ours = contest.ours
        try:
            times = contest.times(rounds, max_seconds)
            contest.return_to_start()
            collisions = set(ours.pairs(ours.query()))
            differences = contest.differences(collisions)
        finally:
            ours.ss.close()
    samples = {"loop": contest.fcl_sample, "pybullet": contest.pybullet_sample}
    scaled = frozenset(way for way, sample in samples.items() if not sample.is_whole)
    return Measurement(
        form, kind, scene, len(collisions), times, scaled, ours.statistics, differences
    )


# -- tables -------------------------------------------------------------------------------------

WAYS = {
    "ours": "ssduck",
    "again": "again",
    "sql": "in SQL",
    "loop": "FCL, loop",
    "manager": "FCL, tree",
    "pybullet": "PyBullet, loop",
    "coal": "coal, tree",
}
HEADER = (
    "all pairs that collide",
    "bodies",
    *WAYS.values(),
    "ssduck / loop",
    "ssduck / tree",
    "again / tree",
    "growth",
)
COUNTS = (
    "all pairs that collide",
    "bodies",
    "boxes met",
    "boxes that meet",
    "collide",
    "compared",
    "compared in SQL",
    *(f"other {WAYS[way]}" for way in ("sql", "loop", "manager", "pybullet", "coal")),
)
NOTES = f"""\
The least of several times of each way, in turns. `ssduck` and `in SQL`: at a fresh tick whose
tables are read; `again`: the same program in the same tick. `≈`: the time of {SAMPLED} bodies with
all others, scaled to all pairs (FCL's loop beyond {LOOPED:,} bodies, PyBullet's beyond {CLOSEST}).
`growth`: the exponent from the size before, from 300 bodies up. A kind has {PIECES} shapes; a scene
has the size, found by bisection, at which a body's box meets {NEIGHBOURS:g} others.
"""
MEANINGS = f"""\
`boxes met`: others that a body's box meets, mean. `compared`: pairs of shapes that were compared
one by one in SelectScript, and in SQL. `other`: pairs that a way finds and ssduck does not, or the
other way round: those within {TOUCHING:g} m of touching + the rest, in which ssduck is right if
nothing else is said below.
"""


def _cells(one: Measurement, before: Measurement | None) -> tuple[str, ...]:
    """Returns a row of the table of times."""
    growth = one.growth(before if before and len(before.scene) >= 300 else None)
    return (
        one.name,
        f"{len(one.scene):,}",
        *map(one.text_of, WAYS),
        _share(one.ratio("ours", "loop")),
        f"{one.ratio('ours', 'manager'):.2f}",
        f"{one.ratio('again', 'manager'):.2f}",
        "" if math.isnan(growth) else f"{growth:.2f}",
    )


def _share(ratio: float) -> str:
    return f"1/{1 / ratio:.0f}" if ratio < 0.1 else f"{ratio:.2f}"


def _counts(one: Measurement) -> tuple[str, ...]:
    """Returns a row of the table of counts."""
    different = [str(one.differences[way]) for way in ("sql", "loop", "manager", "pybullet")]
    return (
        one.name,
        f"{len(one.scene):,}",
        f"{one.scene.neighbours:.2f}",
        f"{len(one.scene.met):,}",
        f"{one.collisions:,}",
        *(f"{one.statistics[way].calls:,}" for way in ("ours", "sql")),
        *different,
        str(one.differences.get("coal", "not installed")),
    )


# -- budgets ------------------------------------------------------------------------------------


def budgets(results: Sequence[Measurement]) -> Iterator[str]:
    """Yields a line for each budget: whether it is met, and the worst figure."""
    sizes = sorted({len(one.scene) for one in results})
    for size, share in ((1000, 20), (10000, 100)):
        selected = [one for one in results if len(one.scene) == size]
        figures = {_label(one): one.ratio("ours", "loop") for one in selected}
        yield _line(f"at {size:,} bodies at most 1/{share} of FCL's loop", figures, 1 / share)
    for size in sizes:
        selected = [one for one in results if len(one.scene) == size]
        figures = {_label(one): one.ratio("ours", "manager") for one in selected}
        yield _line(f"at {size:,} bodies at most 1.5 of FCL's tree", figures, 1.5)
        figures = {_label(one): one.ratio("again", "manager") for one in selected}
        yield _line(f"again at {size:,} bodies at most 1/3 of FCL's tree", figures, 1 / 3)
        exponents = {
            f"{_label(before)} to {len(one.scene):,}": one.growth(before)
            for before, one in pairwise(results)
            if before.name == one.name and len(before.scene) >= 300
        }
    yield _line("growth at most n^1.3 from 300 bodies up", exponents, 1.3)


def _label(one: Measurement) -> str:
    return f"{one.name}, {len(one.scene):,}"


def _line(budget: str, figures: dict[str, float], maximum: float) -> str:
    if not figures:
        return f"not measured: {budget}"
    worst = max(figures, key=figures.__getitem__)
    outcome = "met" if figures[worst] <= maximum else "not met"
    return f"{outcome}: {budget}: {_share(figures[worst])} ({worst})"


# -- the run ------------------------------------------------------------------------------------


def run(
    forms: Sequence[str],
    kinds: Sequence[str],
    sizes: Sequence[int],
    rounds: int,
    max_seconds: float,
) -> list[Measurement]:
    """Measures the scenes and prints the table of times."""
    results: list[Measurement] = []

    def rows() -> Iterator[tuple[str, ...]]:
        for form in forms:
            for kind in kinds:
                before = None
                for size in sorted(sizes):
                    results.append(measure(form, kind, size, rounds, max_seconds))
                    yield _cells(results[-1], before)
                    before = results[-1]

    print_table(HEADER, rows())
    return results


def failures(results: Sequence[Measurement]) -> list[str]:
    """Returns a line for each error: ssduck is not right, or contradicts itself."""
    return [
        f"{_label(one)}: {WAYS[way]} and ssduck differ in pairs, {difference}; of these ssduck is "
        f"not known to be right in {len(difference.failures)}: {difference.failures[:5]}"
        for one in results
        for way, difference in one.differences.items()
        if difference.failures
        or (way in ("again", "sql") and (difference.touching or difference.other))
    ]


def main(arguments: Sequence[str]) -> int:
    """Runs the requested scenes; returns 1 if ssduck is not right about a pair."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks pairs")
    parser.add_argument("--sizes", type=int, nargs="+", default=SIZES)
    parser.add_argument("--forms", nargs="+", choices=FORMS, default=FORMS)
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=list(KINDS))
    parser.add_argument("--rounds", type=int, default=25, help="how often each way is timed")
    parser.add_argument(
        "--seconds", type=float, default=0.8, help="the time after which a way is not timed again"
    )
    options = parser.parse_args(arguments)
    print(NOTES)
    results = run(options.forms, options.kinds, options.sizes, options.rounds, options.seconds)
    print(MEANINGS)
    print_table(COUNTS, map(_counts, results))
    print("\n".join(budgets(results)))
    wrong = failures(results)
    print("".join(f"\nDISAGREEMENT: {line}" for line in wrong))
    return 1 if wrong else 0
