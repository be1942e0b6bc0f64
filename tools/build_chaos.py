"""Writes the scene `chaos`, bodies that fly about in a box.

`python -m tools.build_chaos` writes all files of `scenes/chaos` in a second or two; `--check` only
compares them, with exit status 1 if a file differs.

As in SelectScript's demonstration of its dialect for ODE, bodies of random kinds move in a closed
box without gravity and without losing energy. A fixed seed determines their kinds and initial
states. Metres, kilograms, m/s, rad/s.
"""

from __future__ import annotations

import random
import sys
from collections.abc import Iterator
from dataclasses import replace
from itertools import product

from tools.scenes.bodies import Body, Sensor, looking
from tools.scenes.models import Model, Shape, ball, box, cylinder, thing
from tools.scenes.pieces import Quat, Vec
from tools.scenes.writing import files, scene_text, write

SEED = 1
HALF = 2.0  # of the box's inner edge
CELLS = (-1.35, -0.45, 0.45, 1.35)  # bodies begin at these coordinates, one in a cell
COUNT = 30

HEADING = f"""
# Written by tools/build_chaos.py; change it there.
name = "chaos"
description = "Boxes, spheres, cylinders and capsules fly about in a closed box, without gravity."
gravity = [0.0, 0.0, 0.0]
timestep = {1 / 240!r}
elastic = true

[camera]
eye = [5.6, -6.0, 4.7]
target = [0.0, 0.0, -0.35]
fov = 42.0
"""


# --------------------------------------------------------------------------------- models


def side(name: str, colour: str, low: Vec, high: Vec, *, drawn: bool = True) -> Model:
    return thing(name, 100.0, replace(box(colour, low, high), drawn=drawn))


def sides() -> Iterator[Model]:
    """Yields six sides; those towards the viewer are invisible."""
    a, b = HALF, HALF + 0.2
    yield side("side_west", "ice", (-b, -b, -b), (-a, b, b))
    yield side("side_east", "ice", (a, -b, -b), (b, b, b), drawn=False)
    yield side("side_south", "ice", (-a, -b, -b), (a, -a, b), drawn=False)
    yield side("side_north", "sky", (-a, a, -b), (a, b, b))
    yield side("side_bottom", "steel", (-a, -a, -b), (a, a, -a))
    yield side("side_top", "ice", (-a, -a, a), (a, a, b), drawn=False)


def capsule(colour: str, radius: float, length: float) -> Shape:
    return Shape(colour, "capsule", (radius, length))


KINDS = [
    thing("box", 1.0, box("orange", (-0.2, -0.15, -0.12), (0.2, 0.15, 0.12))),
    thing("sphere", 1.0, ball("teal", (0.0, 0.0, 0.0), 0.18)),
    thing("cylinder", 1.0, cylinder("mustard", (0.0, 0.0, 0.0), 0.14, 0.36)),
    thing("capsule", 1.0, capsule("rose", 0.11, 0.28)),
]
EYE = thing("eye", 1.0, box("charcoal", (-0.06, -0.06, -0.06), (0.06, 0.06, 0.06)))
WALLS = list(sides())
MODELS = [*WALLS, EYE, *KINDS]


# ------------------------------------------------------------------------------ the scene


def flying() -> Iterator[Body]:
    draw = random.Random(SEED)  # noqa: S311  # no secret
    cells = list(product(CELLS, repeat=3))
    draw.shuffle(cells)
    counts = dict.fromkeys((kind.name for kind in KINDS), 0)
    for x, y, z in cells[:COUNT]:
        kind = draw.choice(KINDS).name
        counts[kind] += 1
        velocity = tuple(round(draw.uniform(-2.0, 2.0), 2) for _ in range(6))
        yield Body(
            f"{kind}_{counts[kind]}", "kinbody", kind, (x, y, z), turned(draw), False, {}, velocity
        )


def turned(draw: random.Random) -> Quat:
    """Returns a random orientation about the vertical and a horizontal axis."""
    return looking(draw.uniform(-180.0, 180.0), draw.uniform(-90.0, 90.0))


# In the middle of the western side, looking in.
WATCHER = Body("eye", "kinbody", "eye", (-1.9, 0.0, 0.0), fixed=True)
SENSOR = Sensor(
    "watcher",
    "eye",
    "depth_camera",
    (0.06, 0.0, 0.0),
    looking(0.0),
    3.7,
    {"width": 32, "height": 24, "fov": 60.0},
    0.1,
)


def main() -> int:
    walls = [Body(wall.name, "kinbody", wall.name, (0.0, 0.0, 0.0), fixed=True) for wall in WALLS]
    scene = scene_text(HEADING, [*walls, WATCHER, *flying()], [SENSOR])
    return write("chaos", files(scene, MODELS))


if __name__ == "__main__":
    sys.exit(main())
