"""Checks that the moves that WHY names change the answer, and that smaller ones do not.

`python -m tools.check_why [COUNT] [--seed N]` generates COUNT conditions about one distance of two
bodies of the kitchen or the hall. In the world that `what_if` makes with the second body moved, the
answer has to be the other one; moved by 10 % less, it has to be the same. 500 take a minute. The
exit status is 1 if a move is wrong; conditions without one are counted.
"""

from __future__ import annotations

import argparse
import math
import random
import sys
import warnings
from collections import Counter
from typing import Any

import ssduck

SCENES = ("kitchen", "hall")


def condition(draw: random.Random, ss: ssduck.Interpreter) -> str:
    """Returns a generated condition of the entities `a` and `b`."""
    clearance, distance = ss.eval("[clearance(a, b), distance(a, b)];")
    limit = round(clearance * draw.uniform(0.2, 1.8) + draw.choice((0, 0, 0.01)), 4)
    sign = draw.choice(("<", "<=", ">", ">="))
    return draw.choice(
        [
            f"near(a, b, {limit})",
            f"near(a, b, {limit})",
            f"clearance(a, b) {sign} {limit}",
            f"touching(a, b{draw.choice(('', ', 0.05'))})",
            f"collides(a, b{draw.choice(('', ', 0.001'))})",
            f"penetration(a, b) {sign} 0.002",
            f"distance(a, b) {sign} {distance * draw.uniform(0.5, 1.5)}",
            f"{draw.choice('xyz')}(b) {sign} {draw.uniform(-2, 2)}",
        ]
    )


def moved(world: ssduck.World, b: ssduck.Entity, way: list[float]) -> ssduck.World:
    """Returns the world with an entity moved."""
    place = [at + by for at, by in zip(b.position, way, strict=True)]
    return world.what_if({b.name: [*b.orientation, *place]})


def verdict(ss: ssduck.Interpreter, text: str, way: Any) -> str:
    """Returns what is wrong with the move of a condition; empty if nothing is."""
    a, b = ss["a"], ss["b"]
    answer, answers = ss.eval(f"{text};"), []
    for share in (1.0, 0.9):
        with ssduck.Interpreter() as other:
            world = moved(a.world, b, [share * part for part in way])
            for name, entity in (("a", a), ("b", b)):
                other.add_variable(name, world[entity.name])
            answers.append(other.eval(f"{text};"))
    # One that is at its limit is flipped by any move, however small.
    if answers == [not answer, answer] or (answers[0] is not answer and math.hypot(*way) < 1e-7):
        return ""
    return f"{answer} becomes {answers[0]}, and {answers[1]} with 10 % less"


def main() -> int:
    parser = argparse.ArgumentParser(description="Check the moves that WHY names.")
    parser.add_argument("count", nargs="?", type=int, default=500)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    draw = random.Random(options.seed)  # noqa: S311  # for generated conditions
    found: Counter[str] = Counter()
    for number, scene in enumerate(SCENES):
        with ssduck.load(scene) as ss:
            ss.run(0.2)
            world = ss.call_variable(scene)
            bodies = [entity for entity in world if entity.kind == "kinbody"]
            for _ in range((options.count + number) // len(SCENES)):
                ss.add_variable("a", a := draw.choice(bodies))
                ss.add_variable("b", b := draw.choice([one for one in bodies if one is not a]))
                text = condition(draw, ss)
                move = ss.why(f"{text};").move
                fault = "" if move is None else verdict(ss, text, move.translation)
                found["none" if move is None else "wrong" if fault else "right"] += 1
                if fault:
                    print(f"{scene}: {text} of {a.name} and {b.name}, {move}: {fault}", flush=True)
    print(
        f"{options.count} conditions: {found['right']} moves flip the answer and 10 % less do "
        f"not, {found['wrong']} are wrong, {found['none']} have none"
    )
    return 1 if found["wrong"] else 0


if __name__ == "__main__":
    sys.exit(main())
