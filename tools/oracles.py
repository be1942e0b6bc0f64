"""Checks the narrow phase against oracles: closed forms and other libraries.

`python -m tools.oracles [COUNT] [--seed N]` prints the worst error of each combination of shapes;
the exit status is 1 if one exceeds its bound. `--write` also writes docs/reference/shapes.md, the
table of methods and errors. 100,000 pairs take many minutes.

The pairs are random, of all combinations of shapes; half of them have parallel edges and touching
faces. The decisions for many convex pairs at once are compared with the distances, and with the
contact normals.
"""

from __future__ import annotations

import argparse
import math
import os
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from multiprocessing import Pool
from pathlib import Path
from typing import Any

# Threads for matrices as small as these only wait for each other.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from ssduck.geometry.contact_support import MIN_RISING, MIN_UP
from tests.support import hollows, pairs

PAGE = Path(__file__).resolve().parent.parent / "docs" / "reference" / "shapes.md"
# The allowed error of a gap, metres; and that of a cylinder or an ellipsoid and a shape that is no
# sphere or plane.
BOUND, ROUND_BOUND = 1e-9, 1e-6
# Of each method: the combinations of shapes, what it is, and its bound.
METHODS = {
    "formula": (
        "a plane and any shape; a sphere and what is no hull or mesh; two capsules",
        "closed form",
        BOUND,
    ),
    "surfaces": (
        "boxes and hulls, also with a capsule; a sphere and a hull",
        "FCL's distance of triangle surfaces, certified by a separating direction",
        BOUND,
    ),
    "round": (
        "a cylinder and a box, a capsule, a cylinder or a hull",
        "the same, refined until a direction separates the cylinder itself up to 1e-7 m",
        ROUND_BOUND,
    ),
    "support": (
        "an ellipsoid and what is no sphere, plane or mesh",
        "support points whose hull grows until a direction separates the shapes up to 1e-7 m",
        ROUND_BOUND,
    ),
    "mesh": (
        "a mesh and what is no plane",
        "FCL's distance of triangle surfaces",
        BOUND,
    ),
}
# The gaps with which all pairs of convex shapes are compared at once.
LIMITS = (-1e-6, 0.0, 1e-3, 0.1)
# The least heights of upward normals, with which they are compared at once, too.
MIN_HEIGHTS = (0.05, MIN_RISING, 0.5, MIN_UP, 0.99)
# One pair in so many is also compared swapped and moved.
MOVED_EVERY = 4
HEAD = """\
# Shapes

How exactly the relations of shapes (`clearance`, `collides`, `penetration`, `nearestPoints`, …)
compare each combination of shapes. `python -m tools.oracles --write` writes this page: it
compared {count} random pairs (first seed {seed}) with oracles. Half of the pairs have parallel
edges and touching faces; some are things in the holes of rings, tubes, cups, frames, profiles,
boxes with a cavity and bowls. The oracles have their own geometry, except that they cut faces
into the same triangles if a mesh takes part. No combination raises an error.

The depth is the length of the shortest translation that separates the shapes. For meshes it is
that of the deepest corner or crossing triangle, which is at most as long.

Against a mesh, a cylinder is a prism with 64 sides, and an ellipsoid a polyhedron with 5,120
faces: their surfaces are off by up to 0.0013 of the radius, or of the longest half length. A closed
mesh is the solid that it encloses; a convex closed mesh is a hull. An open mesh is a surface. A
plane is the half-space below it. Hulls may be flat.

Errors are the worst ones found, in metres, for shapes up to 1 m, rounded up to a power of ten.

| shapes | method | clearance | depth | bound |
|---|---|---|---|---|
"""


@dataclass
class Worst:
    """The worst errors of a combination, metres, and the time of its pairs, microseconds."""

    clearance: float = 0.0
    depth: float = 0.0
    pairs: int = 0
    micros: float = 0.0
    failures: list[str] = field(default_factory=list)

    def add(self, other: Worst) -> None:
        self.clearance = max(self.clearance, other.clearance)
        self.depth = max(self.depth, other.depth)
        self.pairs += other.pairs
        self.micros += other.micros
        self.failures += other.failures


def bound(kinds: tuple[str, str]) -> float:
    return METHODS[method(kinds)][-1]


def method(kinds: tuple[str, str]) -> str:
    both = set(kinds)
    if "plane" in both or both <= {"sphere", "capsule"}:
        return "formula"
    if both & set(pairs.MESHES):
        return "mesh"
    if both in ({"sphere", "box"}, {"sphere", "cylinder"}, {"sphere", "ellipsoid"}):
        return "formula"
    if "ellipsoid" in both:
        return "support"
    return "round" if "cylinder" in both else "surfaces"


def compared(task: tuple[tuple[str, str], int, int]) -> tuple[tuple[str, str], Worst]:
    """Returns the worst errors of some pairs of a combination."""
    kinds, first, count = task
    worst = Worst()
    compared_pairs, gaps, rises = [], [], []
    for seed in range(first, first + count):
        a, b = pairs.pair(kinds, seed)
        started = time.perf_counter()
        result = pairs.gap(a, b)
        compared_pairs.append((a, b))
        gaps.append(result.distance)
        rises.append(math.nan if result.normal is None else -result.normal[2])
        worst.micros += 1e6 * (time.perf_counter() - started)
        error, _ = pairs.error_of(a, b)
        if seed % MOVED_EVERY == 0:
            error = max(error, *differences(a, b, result.distance, seed))
        if result.distance > 0:
            worst.clearance = max(worst.clearance, error)
        else:
            worst.depth = max(worst.depth, error)
        worst.pairs += 1
        if not error <= bound(kinds):
            label = f"{' '.join(kinds)}, seed {seed}"
            worst.failures.append(f"{label}: gap {result.gap}, off by {error}")
    if "plane" not in kinds and not set(kinds) & set(pairs.MESHES):
        for limit in LIMITS:
            wrong = pairs.wrong_verdicts(compared_pairs, np.array(gaps), limit)
            worst.failures += [f"{' '.join(kinds)}, seed {first + n}: not {limit}" for n in wrong]
        for min_height in MIN_HEIGHTS:
            wrong, _ = pairs.wrong_normals(compared_pairs, np.array(rises), min_height)
            worst.failures += [f"{' '.join(kinds)}, seed {first + n}: normal" for n in wrong]
    return kinds, worst


def shapes_of(seed: int) -> list[Any]:
    """Returns a hollow shape and shapes in its hole."""
    scene: Any = hollows.scene
    shapes: list[Any] = scene(seed)
    return shapes


def in_holes(task: tuple[int, int]) -> Worst:
    """Returns the worst errors of scenes with three shapes in a hole each."""
    first, count = task
    worst = Worst()
    for seed in range(first, first + count):
        hollow, *things = shapes_of(seed)
        for number, thing in enumerate(things):
            error, result = pairs.error_of(hollow, thing)
            error = max(error, *differences(hollow, thing, result.distance, seed))
            is_apart = result.distance > 0
            worst.add(Worst(error if is_apart else 0.0, 0.0 if is_apart else error, 1))
            if not error <= BOUND:
                worst.failures.append(f"in holes, seed {seed}, thing {number}: off by {error}")
    return worst


def differences(a: Any, b: Any, gap: float, seed: int) -> Iterator[float]:
    """Yields the changes of the distance if the shapes are swapped or moved together."""
    swapped = pairs.gap(b, a).distance
    yield 0.0 if swapped == gap else abs(swapped - gap)
    random = np.random.default_rng(seed + 1)
    shift, turn = random.uniform(-2, 2, 3), random.normal(size=4)
    moved = (pairs.moved(one, shift, turn / np.linalg.norm(turn)) for one in (a, b))
    gap_moved = pairs.gap(*moved).distance
    # Far from the origin, floats have fewer decimals.
    yield 0.0 if gap_moved == gap else abs(gap_moved - gap)


def page(worst: dict[tuple[str, str], Worst], count: int, seed: int) -> str:
    rows = []
    for name, (shapes, about, allowed) in METHODS.items():
        group = Worst()
        for kinds, one in worst.items():
            if method(kinds) == name:
                group.add(one)
        errors = f"{_power(group.clearance)} | {_power(group.depth)}"
        rows.append(f"| {shapes} | {about} | {errors} | {allowed:.0e} |\n")
    return HEAD.format(count=count, seed=seed) + "".join(rows)


def _power(error: float) -> str:
    if error in (0.0, math.inf):
        return f"{error:.0f}"
    return f"1e{math.ceil(math.log10(error) - 1e-9)}"


def main() -> int:
    parser = argparse.ArgumentParser(description="Compare the narrow phase with oracles.")
    parser.add_argument("count", nargs="?", type=int, default=100_000)
    parser.add_argument(
        "--seed", type=int, default=0, help="the seed of a combination's first pair"
    )
    parser.add_argument("--write", action="store_true", help="write docs/reference/shapes.md")
    options = parser.parse_args()
    started = time.monotonic()
    pairs_of_each = max(1, -(-options.count // len(pairs.COMBINATIONS)))
    step = 100
    tasks = [
        (kinds, options.seed + first, min(step, pairs_of_each - first))
        for kinds in pairs.COMBINATIONS
        for first in range(0, pairs_of_each, step)
    ]
    worst = {kinds: Worst() for kinds in pairs.COMBINATIONS}
    with Pool() as pool:
        for kinds, some in pool.imap(compared, tasks):
            worst[kinds].add(some)
            if worst[kinds].pairs == pairs_of_each:
                one = worst[kinds]
                print(
                    f"{kinds[0]:10}{kinds[1]:10} clearance {one.clearance:.1e}  "
                    f"depth {one.depth:.1e}  {one.micros / pairs_of_each:6.0f} us",
                    flush=True,
                )
    holes = Worst()
    scenes = [
        (options.seed + first, min(step, pairs_of_each - first))
        for first in range(0, pairs_of_each, step)
    ]
    with Pool() as pool:
        for some in pool.imap(in_holes, scenes):
            holes.add(some)
    print(
        f"things in holes: {holes.pairs} pairs, clearance {holes.clearance:.1e}, "
        f"depth {holes.depth:.1e}"
    )
    failures = [text for one in (*worst.values(), holes) for text in one.failures]
    print("\n".join(failures[:50]))
    total = pairs_of_each * len(worst) + holes.pairs
    print(
        f"{total} pairs in {time.monotonic() - started:.0f} s, {len(failures)} beyond their bounds"
    )
    if options.write:
        PAGE.write_text(page(worst, total, options.seed), encoding="utf-8")
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
