"""All pairs that collide, by ssduck at a fresh tick, and by FCL, PyBullet and coal.

ssduck's tick is taken and its tables are read beforehand; every tick has all bodies shifted by
the same way. The others have their shapes and poses made beforehand; see `benchmarks.peers`. What
all of them find is compared. Where another finds something else, `benchmarks.referee` says who is
right, or that a pair that ssduck calls touching within `TOUCHING` may be; it is a failure if that
is not ssduck.
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
from benchmarks.crowds import FORMS, KINDS, NEIGHBOURS, PIECES, Crowd, bodies_of, crowd
from benchmarks.peers import COLLIDES, Coal, Fcl, Pairs, coal_or_none, pybullet_loop
from benchmarks.referee import may_touch, verdict
from benchmarks.timing import Way, minima, printed, shown
from ssduck.geometry.queries import Statistics
from ssduck.simulators.pybullet.simulator import PyBulletSimulator

SIZES = (50, 300, 1000, 3000, 10000)
# More bodies are too many to ask FCL, or PyBullet, about all of their pairs.
LOOPED, CLOSEST = 1000, 300
# Then so many are asked about with all others, and the time is scaled.
SAMPLED = 20
# What is at most as deep, or as far apart, metres, may be called either.
TOUCHING = 1e-5

PROGRAM = (
    "SELECT id(a.this), id(b.this) FROM a = world, b = world WHERE collides(a.this, b.this) "
    "AS list;"
)
SQL = "SELECT a.name, b.name FROM entities a, entities b WHERE collides(a, b) AND a.id < b.id"
_LOAD = "SELECT (SELECT count(x) FROM entities), (SELECT count(x) FROM shapes)"
_GAPS = """
    SELECT clearance(a, b) - penetration(a, b)
    FROM (SELECT unnest($one) AS one, unnest($other) AS other) asked
    JOIN entities a ON a.name = asked.one JOIN entities b ON b.name = asked.other
    ORDER BY a.id, b.id
"""


class Ours:
    """A crowd in a world of ssduck's.

    Attributes:
        world: the world.
        ss: the interpreter.
        asked: what the narrow phase was asked at a fresh tick, by the way.
    """

    def __init__(self, crowd: Crowd, client: int, bodies: Sequence[int]) -> None:
        names = {body: f"b{number}" for number, body in enumerate(bodies)}
        self._numbers = {name: number for number, name in enumerate(names.values())}
        self._crowd, self._client, self._bodies = crowd, client, bodies
        self.world = ssduck.World(PyBulletSimulator(client, owned=True, names=names))
        self.ss = ssduck.Interpreter()
        self.ss.add_variable("world", self.world)
        self._compiled = self.ss.compile(PROGRAM)
        self._ticks = 0
        self._before = Statistics(0, 0)
        self.asked: dict[str, Statistics] = {}

    def tick(self) -> None:
        """A tick of which nothing is asked yet: all bodies are shifted by the same."""
        self._ticks += 1
        shift = np.array([0.25, 0.125, 0.0]) * (self._ticks % 8)
        places = (self._crowd.positions + shift).tolist()
        turns = self._crowd.orientations.tolist()
        for body, place, turn in zip(self._bodies, places, turns, strict=True):
            pybullet.resetBasePositionAndOrientation(body, place, turn, self._client)
        self.world.tick()
        self.ss.sql(_LOAD).fetchall()
        self._before = self.ss.statistics()["world"]

    def ask(self) -> list[str]:
        """Ask in SelectScript."""
        found: list[str] = self.ss.eval(self._compiled)
        self._note("ours")
        return found

    def ask_sql(self) -> list[tuple[str, str]]:
        """Ask in SQL."""
        found: list[tuple[str, str]] = self.ss.sql(SQL).fetchall()
        self._note("sql")
        return found

    def _note(self, way: str) -> None:
        """Note once what it took since the tick: a call more would take minutes of some worlds."""
        if way not in self.asked:
            after, before = self.ss.statistics()["world"], self._before
            pairs, calls = after.pairs - before.pairs, after.calls - before.calls
            self.asked[way] = Statistics(pairs, calls)

    def pairs(self, names: list[str]) -> Pairs:
        """The pairs that names stand for, one behind the other."""
        numbers = [self._numbers[name] for name in names]
        return [(i, j) for i, j in zip(numbers[::2], numbers[1::2], strict=True) if i < j]

    def gaps(self, pairs: Pairs) -> list[float]:
        """How far apart pairs in ascending order are, metres; less than 0 is how deep."""
        one, other = ([f"b{number}" for number in side] for side in zip(*pairs, strict=True))
        found = self.ss.sql(_GAPS, {"one": one, "other": other}).fetchall()
        return [gap for (gap,) in found]


# -- one scene ----------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Difference:
    """What another way finds that ssduck does not, and the other way round.

    Attributes:
        touching: how many pairs, of those that ssduck calls touching.
        other: the rest.
        failures: of both, where the referee does not say what ssduck does.
    """

    touching: int
    other: int
    failures: Pairs

    def __str__(self) -> str:
        return f"{self.touching} + {self.other}"


@dataclass(frozen=True, eq=False)
class Measured:
    """What was measured of a crowd.

    Attributes:
        form: of the crowd.
        kind: of the crowd.
        crowd: itself.
        found: how many pairs collide.
        times: by the way, seconds.
        scaled: the ways of which a sample was timed.
        asked: what the narrow phase is asked, in SelectScript and in SQL.
        differences: by the way.
    """

    form: str
    kind: str
    crowd: Crowd
    found: int
    times: dict[str, float]
    scaled: frozenset[str]
    asked: dict[str, Statistics]
    differences: dict[str, Difference]

    @property
    def name(self) -> str:
        """What it is called in tables."""
        return f"{self.form}, {self.kind}"

    def ratio(self, way: str, other: str) -> float:
        """How long one way takes, in times of another."""
        return self.times[way] / self.times[other]

    def growth(self, before: Measured | None) -> float:
        """The exponent of ssduck's time from a smaller crowd to this one."""
        if before is None:
            return math.nan
        sizes = len(self.crowd) / len(before.crowd)
        return math.log(self.times["ours"] / before.times["ours"]) / math.log(sizes)

    def shown(self, way: str) -> str:
        """A time as tables have it."""
        if way not in self.times:
            return "not installed"
        return ("≈ " if way in self.scaled else "") + shown(self.times[way])


class Sample:
    """The pairs that a loop is timed on: all, or those of some bodies with all others."""

    def __init__(self, count: int, most: int) -> None:
        self.is_whole = count <= most
        self.pairs: Pairs
        if self.is_whole:
            self.pairs = list(combinations(range(count), 2))
        else:
            some = np.random.default_rng(count).choice(count, SAMPLED, replace=False).tolist()
            self.pairs = [(min(i, j), max(i, j)) for i in some for j in range(count) if i != j]
        self.scale = count * (count - 1) / 2 / len(self.pairs)


class Contest:
    """A crowd, and all that find its pairs."""

    def __init__(self, crowd: Crowd, client: int, bodies: Sequence[int]) -> None:
        self.crowd = crowd
        self.ours = Ours(crowd, client, bodies)
        self.closest = pybullet_loop(client, bodies)
        self.fcl = Fcl(crowd)
        coal = coal_or_none()
        self.coal = None if coal is None else Coal(coal, crowd)
        self.some, self.few = Sample(len(crowd), LOOPED), Sample(len(crowd), CLOSEST)

    def times(self, rounds: int, most: float) -> dict[str, float]:
        """How long each way takes, seconds."""
        ours = self.ours
        ways = {
            "ours": Way(ours.ask, before=ours.tick),
            "again": Way(ours.ask, before=ours.ask),
            "sql": Way(ours.ask_sql, before=ours.tick),
            "manager": Way(self.fcl.managed),
            "loop": Way(partial(self.fcl.loop, self.some.pairs), before=self.fcl.place),
            "pybullet": Way(partial(self.closest, self.few.pairs)),
        }
        if self.coal is not None:
            ways["coal"] = Way(self.coal.managed)
        times = minima(ways, rounds, most)
        times["loop"] *= self.some.scale
        times["pybullet"] *= self.few.scale
        return times

    def differences(self, found: set[tuple[int, int]]) -> dict[str, Difference]:
        """How what the other ways find differs from what ssduck does."""
        names = [name for pair in self.ours.ask_sql() for name in pair]
        others = {
            "again": self.ours.pairs(self.ours.ask()),
            "sql": self.ours.pairs(names),
            "manager": self.fcl.managed(),
            "pybullet": self.closest([(i, j) for i, j in self.crowd.met.tolist()]),
        }
        if self.coal is not None:
            others["coal"] = self.coal.managed()
        differing = {way: found.symmetric_difference(pairs) for way, pairs in others.items()}
        looped = self.fcl.loop(self.some.pairs)
        differing["loop"] = found.intersection(self.some.pairs).symmetric_difference(looped)
        return {way: self._judged(sorted(pairs), found) for way, pairs in differing.items()}

    def _judged(self, pairs: Pairs, found: set[tuple[int, int]]) -> Difference:
        """Who is right about the pairs that only one of two has."""
        gaps = dict(zip(pairs, self.ours.gaps(pairs), strict=True)) if pairs else {}
        touching = [pair for pair in pairs if abs(gaps[pair]) <= TOUCHING]
        wrong = [pair for pair in touching if not may_touch(self.crowd, *pair, 2 * TOUCHING)]
        left = [pair for pair in pairs if abs(gaps[pair]) > TOUCHING]
        wrong += [p for p in left if verdict(self.crowd, *p, COLLIDES) is not (p in found)]
        return Difference(len(touching), len(left), wrong)


def measured(form: str, kind: str, count: int, rounds: int, most: float) -> Measured:
    """Time all ways of one crowd, and compare what they find."""
    made = crowd(form, kind, count)
    with bodies_of(made) as (client, bodies):
        contest = Contest(made, client, bodies)
        ours = contest.ours
        try:
            times = contest.times(rounds, most)
            found = set(ours.pairs(ours.ask()))
            differences = contest.differences(found)
        finally:
            ours.ss.close()
    samples = {"loop": contest.some, "pybullet": contest.few}
    scaled = frozenset(way for way, sample in samples.items() if not sample.is_whole)
    return Measured(form, kind, made, len(found), times, scaled, ours.asked, differences)


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
`growth`: the exponent from the size before, from 300 bodies up. A kind has {PIECES} shapes; a crowd
has the room, found by bisection, in which a body's box meets {NEIGHBOURS:g} others.
"""
MEANINGS = f"""\
`boxes met`: others that a body's box meets, mean. `compared`: pairs of shapes that were compared
one by one in SelectScript, and in SQL. `other`: pairs that a way finds and ssduck does not, or the
other way round: those within {TOUCHING:g} m of touching + the rest, in which ssduck is right if
nothing else is said below.
"""


def _cells(one: Measured, before: Measured | None) -> tuple[str, ...]:
    """A row of the table of times."""
    growth = one.growth(before if before and len(before.crowd) >= 300 else None)
    return (
        one.name,
        f"{len(one.crowd):,}",
        *map(one.shown, WAYS),
        _share(one.ratio("ours", "loop")),
        f"{one.ratio('ours', 'manager'):.2f}",
        f"{one.ratio('again', 'manager'):.2f}",
        "" if math.isnan(growth) else f"{growth:.2f}",
    )


def _share(ratio: float) -> str:
    return f"1/{1 / ratio:.0f}" if ratio < 0.1 else f"{ratio:.2f}"


def _counts(one: Measured) -> tuple[str, ...]:
    """A row of the table of counts."""
    given = [str(one.differences[way]) for way in ("sql", "loop", "manager", "pybullet")]
    return (
        one.name,
        f"{len(one.crowd):,}",
        f"{one.crowd.neighbours:.2f}",
        f"{len(one.crowd.met):,}",
        f"{one.found:,}",
        *(f"{one.asked[way].calls:,}" for way in ("ours", "sql")),
        *given,
        str(one.differences.get("coal", "not installed")),
    )


# -- budgets ------------------------------------------------------------------------------------


def budgets(results: Sequence[Measured]) -> Iterator[str]:
    """A line a budget: whether it is met, the worst figure, and of what that is."""
    sizes = sorted({len(one.crowd) for one in results})
    for size, share in ((1000, 20), (10000, 100)):
        of = [one for one in results if len(one.crowd) == size]
        figures = {_of(one): one.ratio("ours", "loop") for one in of}
        yield _line(f"at {size:,} bodies at most 1/{share} of FCL's loop", figures, 1 / share)
    for size in sizes:
        of = [one for one in results if len(one.crowd) == size]
        figures = {_of(one): one.ratio("ours", "manager") for one in of}
        yield _line(f"at {size:,} bodies at most 1.5 of FCL's tree", figures, 1.5)
        figures = {_of(one): one.ratio("again", "manager") for one in of}
        yield _line(f"again at {size:,} bodies at most 1/3 of FCL's tree", figures, 1 / 3)
        exponents = {
            f"{_of(before)} to {len(one.crowd):,}": one.growth(before)
            for before, one in pairwise(results)
            if before.name == one.name and len(before.crowd) >= 300
        }
    yield _line("growth at most n^1.3 from 300 bodies up", exponents, 1.3)


def _of(one: Measured) -> str:
    return f"{one.name}, {len(one.crowd):,}"


def _line(what: str, figures: dict[str, float], most: float) -> str:
    if not figures:
        return f"not measured: {what}"
    worst = max(figures, key=lambda of: figures[of])
    answer = "met" if figures[worst] <= most else "not met"
    return f"{answer}: {what}: {_share(figures[worst])} ({worst})"


# -- the run ------------------------------------------------------------------------------------


def run(
    forms: Sequence[str], kinds: Sequence[str], sizes: Sequence[int], rounds: int, most: float
) -> list[Measured]:
    """Measure, and print the table of times."""
    results: list[Measured] = []

    def rows() -> Iterator[tuple[str, ...]]:
        for form in forms:
            for kind in kinds:
                before = None
                for size in sorted(sizes):
                    results.append(measured(form, kind, size, rounds, most))
                    yield _cells(results[-1], before)
                    before = results[-1]

    printed(HEADER, rows())
    return results


def failures(results: Sequence[Measured]) -> list[str]:
    """What is wrong, a line each: ssduck is not right, or says two things."""
    return [
        f"{_of(one)}: {WAYS[way]} and ssduck differ in pairs, {difference}; of these ssduck is not "
        f"known to be right in {len(difference.failures)}: {difference.failures[:5]}"
        for one in results
        for way, difference in one.differences.items()
        if difference.failures
        or (way in ("again", "sql") and (difference.touching or difference.other))
    ]


def main(arguments: Sequence[str]) -> int:
    """Run what is asked for; 1 if ssduck is not right about a pair."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks pairs")
    parser.add_argument("--sizes", type=int, nargs="+", default=SIZES)
    parser.add_argument("--forms", nargs="+", choices=FORMS, default=FORMS)
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=list(KINDS))
    parser.add_argument("--rounds", type=int, default=25, help="how often each way is timed")
    parser.add_argument("--seconds", type=float, default=0.8, help="a way is not timed again after")
    given = parser.parse_args(arguments)
    print(NOTES)
    results = run(given.forms, given.kinds, given.sizes, given.rounds, given.seconds)
    print(MEANINGS)
    printed(COUNTS, map(_counts, results))
    print("\n".join(budgets(results)))
    wrong = failures(results)
    print("".join(f"\nDISAGREEMENT: {line}" for line in wrong))
    return 1 if wrong else 0
