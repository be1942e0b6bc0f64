"""Writes the scene `hall`, a cluttered hall.

`python -m tools.build_hall` writes all files of `scenes/hall` in a second or two; `--check` only
compares them, with exit status 1 if a file differs.

The hall is 12 m by 8 m, from the origin to positive x and y; its floor is at z = 0. The places of
the shelves are given here; a fixed seed determines those of the other bodies, which keep a
distance from each other. Metres, kilograms, radians.
"""

from __future__ import annotations

import math
import random
import sys
from collections.abc import Iterator
from dataclasses import dataclass

from tools.scenes.bodies import Body, Sensor, looking
from tools.scenes.models import Joint, Link, Model, ball, box, cylinder, thing
from tools.scenes.pieces import RIGHT, Vec
from tools.scenes.writing import files, scene_text, write

LENGTH, WIDTH = 12.0, 8.0
START, GOAL = (1.0, 1.0), (11.0, 7.0)
SEED = 8

HEADING = f"""
# Written by tools/build_hall.py; change it there.
name = "hall"
description = "A cluttered hall of 12 m by 8 m, a wheeled robot with a laser scanner, and a goal."
gravity = [0.0, 0.0, -9.81]
timestep = {1 / 240!r}

[camera]
eye = [6.0, -5.0, 11.5]
target = [6.0, 3.6, 0.0]
fov = 44.0
"""


# --------------------------------------------------------------------------------- models


def floor() -> Model:
    return thing("floor", 500.0, box("sand", (0.0, 0.0, -0.1), (LENGTH, WIDTH, 0.0)))


def walls() -> Model:
    thick, high = 0.15, 0.6
    return thing(
        "walls",
        2000.0,
        box("cream", (-thick, -thick, -0.1), (LENGTH + thick, 0.0, high)),
        box("cream", (-thick, WIDTH, -0.1), (LENGTH + thick, WIDTH + thick, high)),
        box("cream", (-thick, 0.0, -0.1), (0.0, WIDTH, high)),
        box("cream", (LENGTH, 0.0, -0.1), (LENGTH + thick, WIDTH, high)),
    )


def pillar() -> Model:
    foot = box("iron", (-0.24, -0.24, 0.0), (0.24, 0.24, 0.12))
    return thing("pillar", 900.0, foot, cylinder("mint", (0.0, 0.0, 1.06), 0.2, 1.88))


def shelf() -> Model:
    """Returns four boards between two sides, 1.8 m long, open at the front and the back."""
    half, deep, high = 0.9, 0.22, 1.5
    boards = [
        box("oak", (0.03 - half, -deep, z), (half - 0.03, deep, z + 0.03))
        for z in (0.05, 0.53, 1.01, high - 0.03)
    ]
    sides = [box("walnut", (x, -deep, 0.0), (x + 0.03, deep, high)) for x in (-half, half - 0.03)]
    goods = [
        box("teal", (-0.7, -0.15, 0.08), (-0.3, 0.15, 0.4)),
        box("mustard", (0.1, -0.18, 0.56), (0.6, 0.14, 0.9)),
        box("azure", (-0.5, -0.16, 1.04), (0.0, 0.16, 1.3)),
    ]
    return thing("shelf", 60.0, *boards, *sides, *goods)


def table() -> Model:
    """Returns a table that the robot fits under."""
    legs = [
        box("iron", (x - 0.03, y - 0.03, 0.0), (x + 0.03, y + 0.03, 0.7))
        for x in (-0.72, 0.72)
        for y in (-0.37, 0.37)
    ]
    return thing("table", 30.0, box("honey", (-0.8, -0.45, 0.7), (0.8, 0.45, 0.74)), *legs)


def crate() -> Model:
    lid = box("chestnut", (-0.27, -0.27, 0.46), (0.27, 0.27, 0.5))
    return thing("crate", 12.0, box("oak", (-0.25, -0.25, 0.0), (0.25, 0.25, 0.46)), lid)


def barrel() -> Model:
    rims = [cylinder("iron", (0.0, 0.0, z), 0.25, 0.03) for z in (0.2, 0.55)]
    return thing("barrel", 15.0, cylinder("blue", (0.0, 0.0, 0.375), 0.24, 0.75), *rims)


def goal() -> Model:
    """Returns a mark on the floor, one millimetre high."""
    return thing("goal", 0.1, cylinder("red", (0.0, 0.0, 0.0005), 0.3, 0.001))


def rover() -> Model:
    """Returns a round base on two driven wheels and two casters, with a mast for the scanner.

    All of it is within 0.2 m of the vertical axis through its origin, which is on the floor.
    """
    base = [
        cylinder("charcoal", (0.0, 0.0, 0.1), 0.2, 0.12),
        cylinder("orange", (0.0, 0.0, 0.17), 0.17, 0.02),
        cylinder("iron", (-0.05, 0.0, 0.25), 0.03, 0.14),
        cylinder("charcoal", (-0.05, 0.0, 0.35), 0.06, 0.06),
    ]
    links = [Link("base", 14.0, base)]
    joints = []
    wheel, limit = 0.07, (0.0, 0.0, 5.0, 15.0)
    for side, y in (("left", 0.15), ("right", -0.15)):
        tyre = f"{side}_tyre"
        links.append(Link(tyre, 0.5, [cylinder("iron", (0.0, 0.0, 0.0), wheel, 0.03, "y")]))
        place, axis = (0.0, y, wheel), (0.0, 1.0, 0.0)
        joints.append(Joint(f"{side}_wheel", "continuous", "base", tyre, place, axis, limit))
    for end, x in (("front", 0.14), ("rear", -0.14)):
        ball_ = ball("steel", (0.0, 0.0, 0.0), 0.025)
        links.append(Link(f"{end}_caster", 0.2, [ball_], slippery=True))
        joints.append(Joint(f"{end}_mount", "fixed", "base", f"{end}_caster", (x, 0.0, 0.025)))
    return Model("rover", links, joints)


MODELS = [
    floor(), walls(), pillar(), shelf(), table(), crate(), barrel(), goal(), rover()
]  # fmt: skip


# ------------------------------------------------------------------------------ the scene


@dataclass(frozen=True)
class Sort:
    """A kind of scattered bodies: model, number, radius, distance from others."""

    model: str
    count: int
    radius: float
    apart: float


# Rows of shelves leave one way round each: x, y, and whether they stand along y.
SHELVES = [
    (3.4, 7.05, True), (3.4, 5.2, True), (3.4, 3.35, True),
    (7.6, 0.95, True), (7.6, 2.8, True), (7.6, 4.65, True),
]  # fmt: skip
PILLARS = [(2.0, 4.0), (5.5, 4.0), (9.5, 4.0), (5.5, 6.6), (5.5, 1.4)]
# Where the rows end: x, y, and how far around nothing is strewn.
PASSAGES = [(3.4, 1.4, 0.5), (7.6, 6.7, 0.5)]
STREWN = [
    Sort("table", 3, 0.95, 0.35),
    Sort("crate", 10, 0.38, 0.6),
    Sort("barrel", 6, 0.25, 0.6),
]


def placed(name: str, model: str, x: float, y: float, yaw: float = 0.0, *, fixed: bool) -> Body:
    turn = (math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2))
    place: Vec = (round(x, 3), round(y, 3), 0.0)
    return Body(name, "kinbody", model, place, turn, fixed)


def standing() -> Iterator[Body]:
    """Yields the bodies at given places."""
    for name in ("floor", "walls"):
        yield placed(name, name, 0.0, 0.0, fixed=True)
    for i, (x, y) in enumerate(PILLARS, 1):
        yield placed(f"pillar_{i}", "pillar", x, y, fixed=True)
    for i, (x, y, along_y) in enumerate(SHELVES, 1):
        yield placed(f"shelf_{i}", "shelf", x, y, RIGHT if along_y else 0.0, fixed=True)


def strewn() -> Iterator[Body]:
    """Yields the bodies at random places, clear of others, the start and the goal."""
    draw = random.Random(SEED)  # noqa: S311  # no secret
    taken = [(x, y, 0.37) for x, y in PILLARS]
    taken += [(x, y + dy, 0.35) for x, y, _ in SHELVES for dy in (-0.6, 0.0, 0.6)]
    taken += [(*START, 0.5), (*GOAL, 0.5), *PASSAGES]
    for sort in STREWN:
        for i in range(1, sort.count + 1):
            while True:
                x = draw.uniform(0.2 + sort.radius, LENGTH - 0.2 - sort.radius)
                y = draw.uniform(0.2 + sort.radius, WIDTH - 0.2 - sort.radius)
                far = sort.radius + sort.apart
                if all(math.dist((x, y), (u, v)) > r + far for u, v, r in taken):
                    break
            taken.append((x, y, sort.radius))
            yaw = round(draw.uniform(0.0, math.pi), 3)
            yield placed(f"{sort.model}_{i}", sort.model, x, y, yaw, fixed=sort.model != "crate")


ROBOT = Body("rover", "robot", "rover", (*START, 0.0))
MARK = Body("goal", "kinbody", "goal", (*GOAL, 0.0), fixed=True)
SCANNER = Sensor(
    "rover_laser_scanner",
    "rover",
    "planar_laser",
    (-0.05, 0.0, 0.35),
    looking(0.0),
    6.0,
    {"min_angle": -135.0, "max_angle": 135.0, "resolution": 1.0},
    0.1,
)


def main() -> int:
    scene = scene_text(HEADING, [ROBOT, MARK, *standing(), *strewn()], [SCANNER])
    return write("hall", files(scene, MODELS))


if __name__ == "__main__":
    sys.exit(main())
