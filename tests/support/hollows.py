"""Random scenes of shapes with holes, and things in the holes; each is a list of `pairs.Shape`.

Rings, tubes, cups, frames, profiles, boxes with a cavity: their convex hulls do not decide about
things in the hole. Flat and straight hulls have no inside.
"""

import math

import numpy as np

from ssduck.geometry.shapes import Geometry
from tests.support.pairs import PATCH, TURNS, Shape, ell, patch_vertices


def mesh(vertices, faces):
    return Geometry("mesh", (0.0, 0.0, 0.0), np.array(vertices, float), np.array(faces, np.int32))


def revolved(profile, sides):
    """Returns a closed mesh: an outline of (radius, height), counterclockwise, turned about z."""
    angles = np.arange(sides) * 2 * math.pi / sides
    count = len(profile)
    vertices = [[r * math.cos(a), r * math.sin(a), z] for a in angles for r, z in profile]
    faces = []
    for i in range(sides):
        for j in range(count):
            k = (j + 1) % count
            a, b = i * count + j, (i + 1) % sides * count + j
            c, d = (i + 1) % sides * count + k, i * count + k
            faces += [(a, b, c), (a, c, d)]
    return mesh(vertices, faces)


def torus(radius, tube, sides=16, rounds=8):
    turns = np.arange(rounds) * 2 * math.pi / rounds
    return revolved([(radius + tube * math.cos(t), tube * math.sin(t)) for t in turns], sides)


def tube(radius, wall, length, sides=12):
    outer, half = radius + wall, length / 2
    return revolved([(radius, -half), (outer, -half), (outer, half), (radius, half)], sides)


def cup(radius, wall, length, sides=12):
    """Returns a tube with a bottom, which has a pinhole: an outline may not touch the axis."""
    outer, half, in_ = radius + wall, length / 2, 1e-3
    outline = [(in_, -half - wall), (outer, -half - wall), (outer, half), (radius, half)]
    return revolved([*outline, (radius, -half), (in_, -half)], sides)


def shell(radius, wall):
    """Returns a closed mesh: a box with a box-shaped cavity."""
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
    faces = [[0, 1, 3], [0, 3, 2], [4, 7, 5], [4, 6, 7], [0, 5, 1], [0, 4, 5]]
    faces += [[2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]
    inner = [[a + 8, c + 8, b + 8] for a, b, c in faces]
    return mesh(np.concatenate((corners * (radius + wall), corners * radius)), faces + inner)


def profile(radius):
    """Returns a closed mesh: an L whose open corner is around the origin."""
    whole = ell(4 * radius, 3 * radius, 4 * radius)
    return mesh(whole.vertices - [radius, 0, radius], whole.faces)


def bowl(radius, sides=12):
    """Returns an open mesh: the lower half of a sphere, without its lowest point."""
    rings = [(radius * math.cos(t), -radius * math.sin(t)) for t in (0.0, 0.5, 1.0, 1.5)]
    angles = np.arange(sides) * 2 * math.pi / sides
    vertices = [[r * math.cos(a), r * math.sin(a), z] for a in angles for r, z in rings]
    faces = []
    for i in range(sides):
        for j in range(3):
            a, b = 4 * i + j, 4 * ((i + 1) % sides) + j
            faces += [(a, b, b + 1), (a, b + 1, a + 1)]
    return mesh(vertices, faces)


# By name: functions of the radius of a ball at the origin that fits the hole, and of the thickness.
HOLLOWS = {
    "ring": lambda r, wall: torus(r * 1.1 + wall, wall),
    "tube": lambda r, wall: tube(r * 1.1, wall, 2 * r),
    "cup": lambda r, wall: cup(r * 1.1, wall, 2 * r),
    "frame": lambda r, wall: tube(r * 1.5, wall, wall, sides=4),
    "profile": lambda r, _: profile(r),
    "shell": shell,
    "bowl": lambda r, _: bowl(r * 1.1),
}


def _box(r, _):
    return Geometry.primitive("box", np.array([1.0, 1.0, 1.0]) * r)


THINGS = {
    "sphere": lambda r, _: Geometry.primitive("sphere", (r, 0, 0)),
    "box": _box,
    "cylinder": lambda r, _: Geometry.primitive("cylinder", (r / 2, 1.5 * r, 0)),
    "capsule": lambda r, _: Geometry.primitive("capsule", (r / 2, r, 0)),
    "hull": lambda r, random: Geometry.hull(_ball(random, 12) * r),
    "flat": lambda r, random: Geometry.hull(_ball(random, 6) * [r, r, 0]),
    "straight": lambda r, _: Geometry.hull([[-r, 0, 0], [r, 0, 0]]),
    "point": lambda *_: Geometry.hull([[0, 0, 0]]),
    "corner": lambda r, _: Geometry.hull(np.eye(3) * r),
    "sheet": lambda r, _: mesh(patch_vertices(r, r, r), PATCH),
    "small ring": lambda r, _: torus(r * 0.7, r * 0.2, 10, 6),
    "small ell": lambda r, _: ell(r, r, r),
}


def _ball(random, count):
    points = random.normal(size=(count, 3))
    return points / np.linalg.norm(points, axis=1)[:, None]


def kind_of(name, geometry):
    """Returns the kind of a shape in `pairs`."""
    if geometry.type == "mesh":
        return "open mesh" if name in ("bowl", "sheet") else "mesh"
    return "flat" if name in ("flat", "straight", "point", "corner") else geometry.type


def random_orientation(random):
    turn = np.array(TURNS[random.integers(len(TURNS))], float)
    turn = turn if random.integers(2) else random.normal(size=4)
    return turn / np.linalg.norm(turn)


def scene(seed, things=3):
    """Returns a hollow shape, and shapes in its hole, in its wall, or half in either."""
    random = np.random.default_rng(seed)
    name = list(HOLLOWS)[seed % len(HOLLOWS)]
    r, wall = random.choice([0.25, 0.5, 1.0]), random.choice([0.02, 0.1, 0.3])
    hollow = Shape(name, HOLLOWS[name](r, wall), np.zeros(3), random_orientation(random))
    hollow = Shape(
        kind_of(name, hollow.geometry),
        hollow.geometry,
        random.uniform(-1, 1, 3),
        random_orientation(random),
    )
    shapes = [hollow]
    for number in random.permutation(len(THINGS))[:things]:
        thing = list(THINGS)[number]
        size = r * random.choice([0.02, 0.3, 0.9, 1.0, 1.3])
        geometry = THINGS[thing](size, random)
        off = _ball(random, 1)[0] * r * random.choice([0.0, 0.05, 0.5, 1.0])
        shapes.append(
            Shape(
                kind_of(thing, geometry),
                geometry,
                hollow.position + off,
                random_orientation(random),
            )
        )
    return shapes
