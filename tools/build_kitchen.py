"""Writes the scene `kitchen`: the URDFs, their meshes and `scene.toml`.

`python tools/build_kitchen.py` writes all files of `scenes/kitchen` in a second or two; `--check`
only compares them, with exit status 1 if a file differs.

Metres, kilograms, radians; z is up. A model is defined in its own link frame, which the scene
places in the world; quaternions are w, x, y, z. The frame of the kitchen is that of the world: its
floor is at z = 0.157, its back wall at large y, its left wall at small x, and it is open towards
the viewer. Boxes and outlines are those of the kitchen in the SelectScript tutorial, whose printed
figures follow from them; the shapes in these boxes were made for this project.

Every shape both collides and is visible. PyBullet treats each `o` group of a mesh as a convex
hull, so a mesh is a list of convex pieces, and hollow things consist of several. PyBullet lets
hulls (and its many-sided cylinders) float 1 mm above their support. The scene leaves this gap
under things on hulls, so that nothing moves when the simulation starts.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

SCENES = Path(__file__).resolve().parent.parent / "scenes"

Span = tuple[float, float]
Vec = tuple[float, float, float]
Quat = tuple[float, float, float, float]
Array = NDArray[np.float64]

GAP = 0.001  # what PyBullet adds around a convex hull
SLIT = 0.0003  # left under things that stand on boxes, to which it adds nothing
RIGHT = math.pi / 2

COLOURS = {
    "cream": (1.0, 0.96, 0.87),
    "sand": (0.98, 0.91, 0.78),
    "parquet": (0.86, 0.67, 0.48),
    "chestnut": (0.82, 0.62, 0.43),
    "honey": (0.89, 0.71, 0.53),
    "sage": (0.46, 0.63, 0.54),
    "mint": (0.60, 0.80, 0.68),
    "marble": (0.93, 0.92, 0.89),
    "oak": (0.93, 0.74, 0.48),
    "walnut": (0.50, 0.31, 0.19),
    "white": (0.97, 0.97, 0.96),
    "steel": (0.78, 0.81, 0.84),
    "iron": (0.45, 0.48, 0.52),
    "charcoal": (0.16, 0.17, 0.19),
    "glass": (0.25, 0.30, 0.36),
    "sky": (0.60, 0.82, 0.96),
    "tile": (0.98, 0.95, 0.90),
    "azure": (0.36, 0.62, 0.78),
    "ice": (0.68, 0.88, 0.93),
    "teal": (0.10, 0.55, 0.58),
    "mustard": (0.95, 0.72, 0.18),
    "red": (0.90, 0.20, 0.17),
    "orange": (0.95, 0.48, 0.12),
    "blue": (0.15, 0.35, 0.72),
    "lime": (0.55, 0.82, 0.20),
    "leaf": (0.25, 0.55, 0.22),
    "rose": (0.93, 0.55, 0.58),
    "toast": (0.80, 0.56, 0.28),
    "coffee": (0.25, 0.14, 0.08),
}


# ---------------------------------------------------------------------------- convex pieces


@dataclass(frozen=True)
class Piece:
    """A convex polyhedron; its faces turn counter-clockwise seen from outside."""

    vertices: Array
    faces: tuple[tuple[int, ...], ...]


def loft(*rings: Array) -> Piece:
    """Returns the solid through rings of as many points each, counter-clockwise from the last."""
    n = len(rings[0])
    faces = [tuple(reversed(range(n)))]
    for base in range(0, n * (len(rings) - 1), n):
        for i in range(n):
            j = (i + 1) % n
            faces.append((base + i, base + j, base + n + j, base + n + i))
    faces.append(tuple(range(n * (len(rings) - 1), n * len(rings))))
    return Piece(np.vstack(rings), tuple(faces))


def ring(outline: Array, z: float, scale: float = 1.0) -> Array:
    """Returns an outline at a height, scaled about the middle of its box."""
    middle = (outline.min(axis=0) + outline.max(axis=0)) / 2
    flat = outline if scale == 1.0 else middle + scale * (outline - middle)
    return np.column_stack([flat, np.full(len(flat), z)])


def prism(outline: Array, z0: float, z1: float, s0: float = 1.0, s1: float | None = None) -> Piece:
    return loft(ring(outline, z0, s0), ring(outline, z1, s0 if s1 is None else s1))


def wall(outer0: Array, inner0: Array, outer1: Array, inner1: Array) -> list[Piece]:
    """Returns the pieces between an outer and an inner ring: sides of a cup, the rim of a plate."""
    n = len(outer0)
    pieces = []
    for i in range(n):
        j = (i + 1) % n
        low = np.array([outer0[i], outer0[j], inner0[j], inner0[i]])
        high = np.array([outer1[i], outer1[j], inner1[j], inner1[i]])
        pieces.append(loft(low, high))
    return pieces


def ngon(n: int, x: float, y: float, radius: float) -> Array:
    """Returns a regular polygon standing on an edge, so that its box is 2 radius cos(pi/n) wide."""
    angles = np.pi / n + 2 * np.pi * np.arange(n) / n
    return np.column_stack([x + radius * np.cos(angles), y + radius * np.sin(angles)])


def profile(points: Sequence[Span], x0: float, x1: float) -> Piece:
    """Returns a side view in y and z, counter-clockwise seen from +x, drawn out along x."""
    yz = np.array(points)
    return loft(*(np.column_stack([np.full(len(yz), x), yz]) for x in (x0, x1)))


# ------------------------------------------------------------------------- shapes and models


@dataclass(frozen=True)
class Shape:
    """A visible shape that collides: a primitive of a `size` or a mesh of `pieces`."""

    colour: str
    kind: str
    size: tuple[float, ...] = ()
    origin: Vec = (0.0, 0.0, 0.0)
    rpy: Vec = (0.0, 0.0, 0.0)
    part: str = ""
    pieces: tuple[Piece, ...] = ()
    drawn: bool = True


@dataclass(frozen=True)
class Frame:
    """The frame of a group of boxes: a translation and a rotation about z."""

    x: float = 0.0
    y: float = 0.0
    yaw: float = 0.0

    def apply(self, point: Vec) -> Vec:
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        x, y, z = point
        return self.x + c * x - s * y, self.y + s * x + c * y, z


HERE = Frame()


def box(colour: str, low: Vec, high: Vec, frame: Frame = HERE) -> Shape:
    (x0, y0, z0), (x1, y1, z1) = low, high
    middle = ((x0 + x1) / 2, (y0 + y1) / 2, (z0 + z1) / 2)
    rpy = (0.0, 0.0, frame.yaw)
    return Shape(colour, "box", (x1 - x0, y1 - y0, z1 - z0), frame.apply(middle), rpy)


def cylinder(colour: str, centre: Vec, radius: float, length: float, axis: str = "z") -> Shape:
    rpy = {"x": (0.0, RIGHT, 0.0), "y": (RIGHT, 0.0, 0.0), "z": (0.0, 0.0, 0.0)}[axis]
    return Shape(colour, "cylinder", (radius, length), centre, rpy)


def ball(colour: str, centre: Vec, radius: float) -> Shape:
    return Shape(colour, "sphere", (radius,), centre)


def mesh(colour: str, part: str, *pieces: Piece) -> Shape:
    return Shape(colour, "mesh", part=part, pieces=pieces)


@dataclass(frozen=True)
class Link:
    name: str
    mass: float
    shapes: Sequence[Shape]
    slippery: bool = False
    grips: bool = False  # rubber: friction 1, that of all else is 0.5


@dataclass(frozen=True)
class Joint:
    """`limit` is lower, upper (rad), effort (N m), velocity (rad/s)."""

    name: str
    kind: str
    parent: str
    child: str
    origin: Vec
    axis: Vec = (0.0, 0.0, 1.0)
    limit: tuple[float, float, float, float] | None = None
    rpy: Vec = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Model:
    name: str
    links: Sequence[Link]
    joints: Sequence[Joint] = ()


def thing(name: str, mass: float, *shapes: Shape) -> Model:
    return Model(name, [Link(name, mass, shapes)])


# -------------------------------------------------------------------------------- furniture

FLOOR = 0.157
WORKTOP = 0.9531  # the mixer, lowest of all, is GAP above
WEST, SOUTH, EAST, NORTH = -1.662781205, -2.42351437, 2.361820435, 2.60764478
TOP = 2.104881455
LEFT, BACK = WEST + 0.05, NORTH - 0.05  # the faces of the two walls


@dataclass(frozen=True)
class Row:
    """A row of fronts along `axis`; drawn in s along it, d out of its plane, and height."""

    axis: str
    plane: float
    out: float

    def box(self, colour: str, s: Span, d: Span, z: Span) -> Shape:
        near, far = sorted((self.plane + self.out * d[0], self.plane + self.out * d[1]))
        if self.axis == "x":
            return box(colour, (s[0], near, z[0]), (s[1], far, z[1]))
        return box(colour, (near, s[0], z[0]), (far, s[1], z[1]))

    def doors(self, colour: str, s: Span, z: Span, n: int, grip: float) -> Iterator[Shape]:
        """Yields `n` doors side by side, each with a bar to grip at this height."""
        width = (s[1] - s[0]) / n
        for i in range(n):
            a, b = s[0] + i * width + 0.004, s[0] + (i + 1) * width - 0.004
            yield self.box(colour, (a, b), (0.0, 0.018), (z[0] + 0.004, z[1] - 0.004))
            middle = (a + b) / 2
            bar, height = (middle - 0.08, middle + 0.08), (grip, grip + 0.014)
            yield self.box("steel", bar, (0.018, 0.034), height)


LEFT_ROW = Row("y", -1.03, 1.0)
BACK_ROW = Row("x", 1.785, -1.0)
WALL_ROW = Row("x", 2.24, -1.0)
FRIDGE_ROW = Row("y", -0.90, 1.0)
COOKER = (1.80, 2.355)


def kitchen() -> Model:
    parts = [room(), base_cabinets(), sink_unit(), upper_cabinets(), mats()]
    parts += [fridge_unit(), cooker_unit(), decoration()]
    return thing("kitchen", 1800.0, *(shape for part in parts for shape in part))


def room() -> Iterator[Shape]:
    edges = np.linspace(WEST, EAST, 13).tolist()
    for i, (x0, x1) in enumerate(pairwise(edges)):
        colour = ("parquet", "chestnut", "honey")[i * 2 % 3]
        yield box(colour, (x0, SOUTH, 0.0), (x1, NORTH, FLOOR))
    yield box("cream", (WEST, BACK, FLOOR), (EAST, NORTH, TOP))
    yield box("sand", (WEST, SOUTH, FLOOR), (LEFT, BACK, TOP))
    yield box("tile", (LEFT, BACK - 0.006, WORKTOP), (EAST, BACK, 1.36))
    for i in range(14):
        x, z = LEFT + 0.1 + 0.28 * i, (1.0, 1.18)[i % 2]
        yield box("azure", (x, BACK - 0.009, z), (x + 0.13, BACK, z + 0.13))
    yield from window(0.10, 0.90)


def window(x0: float, x1: float) -> Iterator[Shape]:
    z0, z1, y = 1.40, 1.98, BACK
    yield box("sky", (x0, y - 0.010, z0), (x1, y, z1))
    middle = (x0 + x1) / 2
    for a, b in ((x0 - 0.05, x0), (middle - 0.02, middle + 0.02), (x1, x1 + 0.05)):
        yield box("white", (a, y - 0.03, z0), (b, y, z1))
    yield box("white", (x0 - 0.05, y - 0.03, z1), (x1 + 0.05, y, z1 + 0.05))
    yield box("white", (x0 - 0.09, y - 0.11, z0 - 0.035), (x1 + 0.09, y, z0))
    for a, b in ((x0 - 0.05, x0 + 0.10), (x1 - 0.10, x1 + 0.05)):  # curtains
        yield box("rose", (a, y - 0.05, z0 + 0.05), (b, y - 0.03, z1 + 0.03))


def base_cabinets() -> Iterator[Shape]:
    """Worktops on cabinets; the back one is cut out for the basin."""
    plinth, body = (FLOOR, 0.25), (0.25, 0.915)
    top = (0.915, WORKTOP)
    y0, y1 = -1.60, BACK_ROW.plane
    left, back = LEFT_ROW.plane - LEFT, BACK - BACK_ROW.plane
    yield LEFT_ROW.box("charcoal", (y0, y1), (-left, -0.05), plinth)
    yield LEFT_ROW.box("sage", (y0, BACK), (-left, 0.0), body)
    yield LEFT_ROW.box("marble", (y0, BACK), (-left, 0.03), top)
    yield from LEFT_ROW.doors("mint", (y0, y1 - 0.02), body, 6, 0.86)

    x0, x1 = LEFT_ROW.plane, COOKER[0] - 0.005
    a, b = BASIN_X
    yield BACK_ROW.box("charcoal", (x0, x1), (-back, -0.05), plinth)
    yield BACK_ROW.box("sage", (x0, a - 0.03), (-back, 0.0), body)
    yield BACK_ROW.box("sage", (a - 0.03, b + 0.03), (-back, 0.0), (0.25, 0.77))
    yield BACK_ROW.box("sage", (a - 0.03, b + 0.03), (-0.02, 0.0), (0.77, 0.915))
    yield BACK_ROW.box("sage", (b + 0.03, x1), (-back, 0.0), body)
    yield BACK_ROW.box("marble", (LEFT_ROW.plane + 0.03, a), (-back, 0.03), top)
    yield BACK_ROW.box("marble", (b, x1), (-back, 0.03), top)
    yield box("marble", (a, BACK_ROW.plane - 0.03, top[0]), (b, BASIN_Y[0], top[1]))
    yield box("marble", (a, BASIN_Y[1], top[0]), (b, BACK, top[1]))
    yield from BACK_ROW.doors("mint", (x0 + 0.02, x1), body, 5, 0.86)


BASIN_X, BASIN_Y = (0.11, 0.59), (1.84, 2.39)


def sink_unit() -> Iterator[Shape]:
    """Yields the basin round the sink's plate, and the tap behind it."""
    (x0, x1), (y0, y1), t = BASIN_X, BASIN_Y, 0.012
    low, high = 0.7995 - GAP, WORKTOP + 0.002
    yield box("steel", (x0 - t, y0 - t, 0.775), (x1 + t, y1 + t, low))
    yield box("steel", (x0 - t, y0 - t, low), (x0 + t, y1 + t, high))
    yield box("steel", (x1 - t, y0 - t, low), (x1 + t, y1 + t, high))
    yield box("steel", (x0 + t, y0 - t, low), (x1 - t, y0 + t, high))
    yield box("steel", (x0 + t, y1 - t, low), (x1 - t, y1 + t, high))
    x, y = 0.35, 2.45
    yield cylinder("iron", (x, y, 1.07), 0.016, 0.24)
    yield cylinder("iron", (x, y - 0.10, 1.19), 0.013, 0.22, "y")
    yield cylinder("iron", (x, y - 0.20, 1.16), 0.013, 0.06)
    yield box("red", (x + 0.016, y - 0.01, 1.02), (x + 0.06, y + 0.01, 1.04))


def upper_cabinets() -> Iterator[Shape]:
    """Cupboards left and right of the window, and the shelf on which two pins stand."""
    depth = BACK - WALL_ROW.plane
    for a, b in ((-0.62, -0.02), (1.04, 1.64)):
        yield WALL_ROW.box("white", (a, b), (-depth, 0.0), (1.45, 2.07))
        yield from WALL_ROW.doors("ice", (a, b), (1.45, 2.07), 2, 1.49)
    shelf = 1.666964345 - SLIT
    yield box("oak", (LEFT, 2.10, shelf - 0.03), (-0.70, BACK, shelf))
    for x in (-1.35, -0.80):
        yield box("iron", (x, 2.20, shelf - 0.07), (x + 0.02, BACK, shelf - 0.03))


def mats() -> Iterator[Shape]:
    """Trays and mats under things that stand above the worktop."""
    yield box("walnut", (-1.40, -0.78, WORKTOP), (-1.07, -0.31, 0.97161989 - GAP))
    yield box("walnut", (-1.51, 0.76, WORKTOP), (-1.19, 1.12, 0.96890336 - GAP))
    yield box("oak", (-0.61, 2.00, WORKTOP), (-0.40, 2.52, 0.96400444 - GAP))
    yield box("teal", (-1.33, 1.29, WORKTOP), (-1.11, 1.49, 0.956964345 - SLIT))
    yield box("marble", (-1.57, -1.45, WORKTOP), (-1.03, -1.0, 0.95505086 - GAP))
    for low, high in (((LEFT, 1.60), (-1.01, BACK)), ((-1.01, 1.765), (-0.64, BACK))):
        yield box("marble", (*low, WORKTOP), (*high, 0.95680173 - SLIT))


def fridge_unit() -> Iterator[Shape]:
    y0, y1 = -2.36, -1.64
    row = FRIDGE_ROW
    yield row.box("charcoal", (y0, y1), (LEFT - row.plane + 0.01, -0.04), (FLOOR, 0.23))
    yield row.box("ice", (y0, y1), (LEFT - row.plane + 0.01, 0.0), (0.23, 1.93))
    for z0, z1 in ((0.25, 0.83), (0.85, 1.91)):
        yield row.box("ice", (y0 + 0.01, y1 - 0.01), (0.0, 0.024), (z0, z1))
        grip = (z1 - 0.36, z1 - 0.06) if z0 < 0.5 else (z0 + 0.06, z0 + 0.50)
        yield row.box("steel", (y1 - 0.10, y1 - 0.07), (0.024, 0.06), grip)
    yield row.box("red", (-2.02, -1.98), (0.024, 0.035), (1.565, 1.60))  # holds the camera
    for y, z, colour in ((-2.2, 1.3, "mustard"), (-2.1, 1.2, "rose"), (-2.22, 1.12, "lime")):
        yield row.box(colour, (y, y + 0.06), (0.024, 0.028), (z, z + 0.07))  # notes
    for y, z, colour in ((-2.25, 1.93, "orange"), (-2.0, 1.93, "oak")):
        yield box(colour, (-1.5, y, z), (-1.15, y + 0.2, z + 0.13))  # boxes on top


def cooker_unit() -> Iterator[Shape]:
    s = x0, x1 = COOKER
    row, depth = BACK_ROW, BACK - BACK_ROW.plane
    yield row.box("charcoal", s, (-depth, -0.04), (FLOOR, 0.23))
    yield row.box("white", s, (-depth, 0.01), (0.23, 0.93))
    yield row.box("charcoal", s, (-depth, 0.03), (0.93, WORKTOP - 0.001))
    yield row.box("white", (x0 + 0.01, x1 - 0.01), (0.01, 0.03), (0.25, 0.82))
    yield row.box("glass", (x0 + 0.07, x1 - 0.07), (0.03, 0.034), (0.36, 0.68))
    yield row.box("steel", (x0 + 0.05, x1 - 0.05), (0.03, 0.06), (0.778, 0.798))
    for i in range(4):
        x = x0 + 0.10 + 0.118 * i
        yield cylinder("red", (x, row.plane - 0.02, 0.876), 0.022, 0.04, "y")
    yield box("red", (1.965, row.plane - 0.055, 0.738), (1.995, row.plane - 0.03, 0.762))
    for x, y, radius in ((1.94, 1.94, 0.09), (2.21, 1.94, 0.09), (1.905, 2.32, 0.07)):
        yield cylinder("iron", (x, y, WORKTOP), radius, 0.012)
    yield cylinder("iron", (2.134, 2.27, WORKTOP), 0.15, 2 * (0.969976945 - 2 * GAP - WORKTOP))
    yield box("steel", (x0, 2.10, 1.72), (x1, BACK, 1.79))  # the hood
    yield box("steel", (x0 + 0.15, 2.30, 1.79), (x1 - 0.15, BACK, TOP))


def decoration() -> Iterator[Shape]:
    """Yields a rack of jars, a picture and a clock on the left wall, and a plant on the shelf."""
    x = LEFT
    yield box("oak", (x, -1.20, 1.52), (x + 0.16, 0.30, 1.545))
    jars = ("mustard", "red", "leaf", "azure", "orange", "white", "teal", "rose")
    for i, colour in enumerate(jars):
        height = 0.13 + 0.04 * (i % 3)
        y = -1.10 + 0.185 * i
        yield cylinder(colour, (x + 0.08, y, 1.545 + height / 2), 0.05, height)
        yield cylinder("charcoal", (x + 0.08, y, 1.555 + height), 0.042, 0.02)
    yield box("walnut", (x, 0.50, 1.45), (x + 0.02, 1.00, 1.85))
    yield box("cream", (x + 0.01, 0.54, 1.49), (x + 0.024, 0.96, 1.81))
    yield cylinder("red", (x + 0.02, 0.75, 1.63), 0.08, 0.02, "x")  # a picture of an apple
    yield box("leaf", (x + 0.02, 0.74, 1.71), (x + 0.028, 0.79, 1.735))
    yield cylinder("charcoal", (x + 0.015, 1.45, 1.75), 0.15, 0.03, "x")
    yield cylinder("white", (x + 0.02, 1.45, 1.75), 0.13, 0.03, "x")
    yield box("charcoal", (x + 0.03, 1.444, 1.75), (x + 0.04, 1.456, 1.85))
    yield box("charcoal", (x + 0.03, 1.45, 1.744), (x + 0.04, 1.52, 1.756))
    yield cylinder("orange", (-0.86, 2.35, 1.72), 0.055, 0.11)
    for dx, dy, dz in ((0.0, 0.0, 0.10), (0.05, 0.03, 0.05), (-0.05, -0.03, 0.05)):
        yield ball("leaf", (-0.86 + dx, 2.35 + dy, 1.79 + dz), 0.07)


def table() -> Model:
    x0, y0, x1, y1 = -0.45639682, -0.910658435, 0.524693221, 0.834311027
    z0, z1 = 0.15728665, 0.919510502
    top, apron = z1 - 0.034, z1 - 0.11
    shapes = [box("oak", (x0, y0, top), (x1, y1, z1))]
    for x in (x0 + 0.006, x1 - 0.066):
        for y in (y0 + 0.006, y1 - 0.066):
            shapes.append(box("walnut", (x, y, z0), (x + 0.06, y + 0.06, top)))
        shapes.append(box("walnut", (x + 0.02, y0 + 0.06, apron), (x + 0.045, y1 - 0.06, top)))
    for y in (y0 + 0.04, y1 - 0.065):
        shapes.append(box("walnut", (x0 + 0.06, y, apron), (x1 - 0.06, y + 0.025, top)))
    return thing("table", 32.0, *shapes)


def chair() -> Model:
    """Returns a chair whose legs stand back from the seat, so that the roomba passes below."""
    z0, z1, seat = 0.157155895, 0.996523761, 0.60
    shapes = [
        mesh("teal", "seat", prism(CHAIR, seat, seat + 0.022)),
        mesh("mustard", "cushion", prism(CHAIR, seat + 0.022, seat + 0.045, 0.90, 0.84)),
    ]
    for y in (-0.158, 0.172):
        for x in (-0.26, 0.15):
            shapes.append(box("teal", (x, y, z0), (x + 0.034, y + 0.034, seat)))
        shapes.append(box("teal", (-0.25, y + 0.007, 0.36), (0.16, y + 0.027, 0.385)))
        shapes.append(box("teal", (-0.28, y, seat), (-0.25, y + 0.034, z1 - 0.03)))
        shapes.append(box("teal", (-0.26, y, seat - 0.05), (-0.25, y + 0.034, seat)))
    for low, high in ((0.70, 0.745), (0.795, 0.84), (0.90, z1)):
        shapes.append(box("teal", (-0.284, -0.165, low), (-0.258, 0.213, high)))
    return thing("chair", 5.5, *shapes)


def sink() -> Model:
    return thing("sink", 0.5, box("azure", (-0.2, -0.2, 0.8995), (0.2, 0.2, 0.9005)))


# ------------------------------------------------------------------------------- appliances


def plate() -> Model:
    z0, z1 = -0.000653114, 0.010523518
    flat, lift = 0.64, 0.004
    rim = wall(
        ring(PLATE, z1 - 0.003),
        ring(PLATE, z0, flat),
        ring(PLATE, z1),
        ring(PLATE, z0 + lift, flat),
    )
    return thing(
        "plate",
        0.5,
        mesh("white", "base", prism(PLATE, z0, z0 + lift, flat)),
        mesh("blue", "rim", *rim),
    )


def cup() -> Model:
    z0, z1, floor, foot = -0.001862166, 0.156071934, 0.008, 0.78
    sides = wall(ring(CUP, z0, foot), ring(CUP, z0, foot - 0.12), ring(CUP, z1), ring(CUP, z1, 0.9))
    bottom = prism(CUP, z0, z0 + floor, foot - 0.06)
    return thing("cup", 0.28, mesh("red", "sides", *sides), mesh("white", "bottom", bottom))


def can() -> Model:
    """Returns a watering can: its spout points to -y, its handle to +y."""
    x0, x1, y0, y1 = -0.122744445, 0.152099722, -0.21632512, 0.209011254
    z0, z1 = 0.00161989, 0.288877203
    x, y = (x0 + x1) / 2, 0.025436594
    body = ngon(12, x, y, (x1 - x0) / 2 / math.cos(math.pi / 12))
    tip = 0.0125
    spout = loft(
        ring(ngon(8, x, -0.075, 0.035), 0.04),
        ring(ngon(8, x, y0 + tip, tip / math.cos(math.pi / 8)), 0.25),
    )
    a, b = x - 0.0085, x + 0.0085
    return thing(
        "can",
        1.6,
        mesh("blue", "body", prism(body, z0, 0.17, 1.0, 0.94), prism(body, 0.17, 0.21, 0.94, 0.6)),
        mesh("mustard", "spout", spout),
        mesh("white", "collar", prism(body, 0.21, 0.232, 0.42)),
        box("mustard", (a, y1 - 0.016, 0.07), (b, y1, 0.20)),
        box("mustard", (a, y + 0.10, 0.07), (b, y1, 0.085)),
        box("mustard", (a, y + 0.08, 0.185), (b, y1, 0.20)),
        box("mustard", (a, y - 0.06, 0.20), (b, y - 0.045, z1)),
        box("mustard", (a, y + 0.045, 0.20), (b, y + 0.06, z1)),
        box("mustard", (a, y - 0.06, z1 - 0.015), (b, y + 0.06, z1)),
    )


def coffe_machine() -> Model:
    z0, z1 = -0.00109664, 0.334122826
    x, y = -0.018, -0.075
    jug = ngon(12, x, y, 0.085)
    return thing(
        "coffe_machine",
        3.4,
        mesh("charcoal", "base", prism(COFFE_MACHINE, z0, 0.028)),
        box("charcoal", (-0.135, 0.03, 0.028), (0.10, 0.13, z1 - 0.09)),
        box("red", (-0.14, -0.13, z1 - 0.09), (0.105, 0.133, z1 - 0.012)),
        box("charcoal", (-0.12, -0.11, z1 - 0.012), (0.085, 0.12, z1)),
        box("white", (-0.05, -0.134, z1 - 0.07), (0.014, -0.13, z1 - 0.03)),
        box("lime", (0.05, -0.135, z1 - 0.06), (0.07, -0.13, z1 - 0.04)),
        mesh("coffee", "coffee", prism(jug, 0.029, 0.09, 0.85, 1.0)),
        mesh("glass", "jug", prism(jug, 0.09, 0.15, 1.0, 0.8)),
        mesh("charcoal", "lid", prism(jug, 0.15, 0.168, 0.82, 0.7)),
        box("steel", (x - 0.009, -0.172, 0.06), (x + 0.009, -0.16, 0.145)),
        box("steel", (x - 0.009, -0.172, 0.13), (x + 0.009, -0.13, 0.145)),
    )


def mixer() -> Model:
    """Returns a stand mixer: the bowl under a head whose nose points to -y."""
    x0, x1, y0, y1 = -0.168449294, 0.091779254, -0.241507185, 0.189543115
    z0, z1 = -0.001874845, 0.387240765
    x, y = (x0 + x1) / 2, -0.0815
    bowl = ngon(12, x, y, (x1 - x0) / 2 / math.cos(math.pi / 12))
    foot = np.array([(x - 0.11, -0.19), (x + 0.11, -0.19), (x + 0.12, y1), (x - 0.12, y1)])
    stand = [(0.075, 0.03), (y1 - 0.005, 0.03), (y1 - 0.02, 0.27), (0.06, 0.27)]
    head = [(y0, 0.29), (-0.16, 0.262), (y1 - 0.02, 0.25), (y1 - 0.01, 0.34), (0.10, z1)]
    sides = wall(
        ring(bowl, 0.055, 0.5), ring(bowl, 0.055, 0.42), ring(bowl, 0.19), ring(bowl, 0.19, 0.93)
    )
    return thing(
        "mixer",
        4.6,
        mesh("teal", "foot", prism(foot, z0, 0.03)),
        mesh("teal", "stand", profile(stand, x - 0.055, x + 0.055)),
        mesh("teal", "head", profile([*head, (-0.10, z1), (y0, 0.35)], x - 0.06, x + 0.06)),
        mesh("steel", "bowl", prism(bowl, 0.03, 0.055, 0.45, 0.5), *sides),
        cylinder("white", (x, y, 0.18), 0.03, 0.19),
        box("white", (x - 0.062, -0.16, 0.31), (x + 0.062, 0.12, 0.322)),
        cylinder("red", (x + 0.063, 0.14, 0.30), 0.016, 0.012, "x"),
    )


def toaster() -> Model:
    """Returns a toaster with slices of toast in two slots along its body."""
    z0, z1 = -0.00494914, 0.287095976
    frame = Frame(-0.0325, -0.0236, math.atan2(-0.03869612, 0.370594527))
    shapes = [
        mesh("charcoal", "foot", prism(TOASTER, z0, 0.022)),
        mesh("red", "body", prism(TOASTER, 0.022, 0.20, 0.96, 0.90)),
        box("charcoal", (-0.18, -0.09, 0.19), (0.18, 0.09, 0.204), frame),
        box("charcoal", (0.18, -0.02, 0.12), (0.212, 0.02, 0.14), frame),
    ]
    for v in (-0.09, -0.016, 0.058):
        shapes.append(box("steel", (-0.18, v, 0.20), (0.18, v + 0.032, 0.235), frame))
    for u in (-0.185, 0.15):
        shapes.append(box("steel", (u, -0.09, 0.20), (u + 0.035, 0.09, 0.235), frame))
    for v in (-0.050, 0.024):
        shapes.append(box("toast", (-0.10, v, 0.20), (0.08, v + 0.026, z1), frame))
    return thing("toaster", 2.1, *shapes)


def microwave() -> Model:
    """Returns a hollow microwave in the corner; u runs along the door, v from the back to it."""
    z0, z1 = -0.00619827, 0.402869869
    corner = MICROWAVE[:4]
    (ax, ay), (bx, by), (cx, cy), _ = corner.tolist()
    a, b = math.hypot(cx - bx, cy - by) / 2, math.hypot(bx - ax, by - ay) / 2
    frame = Frame((ax + cx) / 2, (ay + cy) / 2, math.atan2(cy - by, cx - bx))
    t, floor, roof, split = 0.018, 0.014, z1 - 0.018, 0.15
    rack = 1.139346886 - 0.963 - 0.0005  # just below the plate

    def part(colour: str, u: Span, v: Span, z: Span) -> Shape:
        return box(colour, (u[0], -v[1], z[0]), (u[1], -v[0], z[1]), frame)

    door, sides = (b - 0.016, b), (floor + t, roof)
    shapes = [
        mesh("white", "roof", prism(corner, roof, z1)),
        part("white", (-a, a), (-b, b), (floor, floor + t)),
        part("white", (-a, -a + t), (-b, b - t), sides),
        part("white", (a - t, a), (-b, b), sides),
        part("white", (-a + t, a - t), (-b, -b + t), sides),
        part("white", (split, split + t), (-b + t, b), sides),
        part("charcoal", (split + t, a - t), door, sides),
        part("lime", (split + 0.045, a - 0.045), (b, b + 0.003), (0.30, 0.34)),
        mesh("steel", "handle", *microwave_handle()),
    ]
    for u in ((-a, -a + 0.06), (split - 0.06, split)):  # the door, round its window
        shapes.append(part("charcoal", u, door, sides))
    for z in ((floor + t, 0.085), (0.345, roof)):
        shapes.append(part("charcoal", (-a + 0.06, split - 0.06), door, z))
    for low in (0.07, 0.14, 0.21):
        shapes.append(part("steel", (0.215, 0.255), (b, b + 0.004), (low, low + 0.04)))
    for i in range(7):
        v = -b + 0.06 + 0.06 * i
        shapes.append(part("iron", (-a + t, split), (v, v + 0.012), (rack - 0.008, rack)))
    for x in (-a + 0.03, a - 0.07):
        for y in (-b + 0.03, b - 0.07):
            shapes.append(part("charcoal", (x, x + 0.04), (y, y + 0.04), (z0, floor)))
    return thing("microwave", 14.0, *shapes)


def microwave_handle() -> list[Piece]:
    """Returns a bar along the door, on two posts that reach back to it."""
    outer = MICROWAVE[4:]
    inwards = MICROWAVE[0] - MICROWAVE[1]
    inwards = inwards / np.hypot(*inwards) * 0.0435
    bar, post = (np.vstack([outer, outer[::-1] + share * inwards]) for share in (0.35, 1.0))
    return [prism(bar, 0.08, 0.35), prism(post, 0.08, 0.10), prism(post, 0.33, 0.35)]


def pin() -> Model:
    """Returns a storage jar with a lid."""
    x0, x1, y0, y1 = -0.1084703, 0.07164011, -0.09064139, 0.073378479
    z0, z1 = -0.003035655, 0.197602948
    x, y, lid = (x0 + x1) / 2, (y0 + y1) / 2, z1 - 0.05
    return thing(
        "pin",
        0.8,
        box("orange", (x0 + 0.008, y0 + 0.008, z0), (x1 - 0.008, y1 - 0.008, lid)),
        box("white", (x0, y0, lid), (x1, y1, lid + 0.025)),
        box("white", (x - 0.05, y0 + 0.004, 0.045), (x + 0.05, y1 - 0.004, 0.10)),
        box("charcoal", (x - 0.02, y - 0.02, lid + 0.025), (x + 0.02, y + 0.02, z1)),
    )


def knife_block() -> Model:
    """Returns a knife block that leans towards -y, where the handles stick out."""
    x0, x1, y0, y1 = -0.07257857, 0.08272525, -0.272321226, 0.203616804
    z0, z1 = -0.00399556, 0.265876494
    block = [(-0.10, z0), (y1, z0), (y1, 0.05), (-0.06, 0.225), (-0.17, 0.115)]
    shapes = [mesh("oak", "block", profile(block, x0, x1))]
    lean, across = np.array([-0.82, 0.30]), np.array([0.30, 0.82])
    lean, across = lean / np.hypot(*lean), across / np.hypot(*across)
    handles = []
    for row, start in enumerate((np.array([-0.156, 0.128]), np.array([-0.088, 0.196]))):
        for i in range(3):
            x = x0 + 0.028 + 0.05 * i
            length = 0.10 - 0.012 * ((i + row) % 2)
            foot, tip = start - 0.02 * lean, start + length * lean
            sides = [foot - 0.010 * across, foot + 0.010 * across]
            ends = [tip + 0.012 * across, tip - 0.012 * across]
            outline = [(float(p[0]), float(p[1])) for p in (*sides, *ends)]
            handles.append(profile(outline, x - 0.008, x + 0.008))
    shapes.append(mesh("charcoal", "handles", *stretch(handles, y0, z1)))
    return thing("knife_block", 2.2, *shapes)


def stretch(pieces: Sequence[Piece], y0: float, z1: float) -> list[Piece]:
    """Stretches pieces a little, so that they end at this y (below) and z (above)."""
    points = np.vstack([p.vertices for p in pieces])
    (y_low, z_low), (y_high, z_high) = points[:, 1:].min(axis=0), points[:, 1:].max(axis=0)
    out = []
    for piece in pieces:
        v = piece.vertices.copy()
        v[:, 1] = y0 + (v[:, 1] - y_low) * (y_high - y0) / (y_high - y_low)
        v[:, 2] = z1 + (v[:, 2] - z_high) * (z1 - z_low) / (z_high - z_low)
        out.append(Piece(v, piece.faces))
    return out


def shaker() -> Model:
    """Returns a shaker in the shape of a pepper mill; its foot has the outline."""
    z0, z1 = -0.010023055, 0.60972287
    body = loft(*(ring(SHAKER, z, s) for z, s in ((0.05, 0.88), (0.16, 0.74), (0.28, 0.58))))
    head = [(0.40, 0.52), (0.43, 0.68), (0.49, 0.72), (0.54, 0.56), (0.565, 0.30)]
    return thing(
        "shaker",
        1.9,
        mesh("walnut", "foot", prism(SHAKER, z0, 0.05)),
        mesh("oak", "body", body, prism(SHAKER, 0.28, 0.38, 0.55, 0.45)),
        mesh("steel", "neck", prism(SHAKER, 0.38, 0.40, 0.56)),
        mesh("walnut", "head", loft(*(ring(SHAKER, z, s) for z, s in head))),
        mesh("steel", "knob", prism(SHAKER, 0.565, z1, 0.16, 0.13)),
    )


# ----------------------------------------------------------------------------------- robots


def camera(name: str) -> Model:
    return thing(name, 0.05, ball("charcoal", (0.0, 0.0, 0.0), 0.005))


def roomba() -> Model:
    """Returns a disc on two driven wheels and a caster; its wheels are hulls, hence GAP higher."""
    z1, wheel, caster = 0.089675, 0.034, 0.015
    disc = [
        mesh("charcoal", "disc", prism(ROOMBA, 0.014, 0.066)),
        mesh("steel", "lid", prism(ROOMBA, 0.066, 0.0868, 0.985, 0.97)),
        mesh("white", "cover", prism(ROOMBA, 0.0868, z1 - 0.001, 0.62)),
        mesh("lime", "button", prism(ROOMBA, z1 - 0.001, z1, 0.22)),
        box("red", (0.120, -0.03, 0.08), (0.150, 0.03, 0.0885)),
    ]
    links = [Link("base", 2.9, disc)]
    joints = []
    for side, y in (("left", 0.11), ("right", -0.12)):
        rim = [mesh("iron", "tyre", tyre(wheel, 0.02))]
        links.append(Link(f"{side}_tyre", 0.15, rim))
        origin = (0.0, y, wheel + GAP)
        joints.append(drive(f"{side}_wheel", "base", f"{side}_tyre", origin, 1.5))
    links.append(Link("caster", 0.1, [ball("iron", (0.0, 0.0, 0.0), caster)], slippery=True))
    joints.append(Joint("caster_mount", "fixed", "base", "caster", (0.12, -0.005, caster)))
    return Model("roomba_625x", links, joints)


def tyre(radius: float, width: float) -> Piece:
    """Returns a wheel about y that stands on an edge: on a corner it would creep."""
    sides = 64
    a = ngon(sides, 0.0, 0.0, radius / math.cos(math.pi / sides))
    ends = [np.column_stack([a[:, 1], np.full(sides, y), a[:, 0]]) for y in (-width / 2, width / 2)]
    return loft(*ends)


def drive(name: str, parent: str, child: str, origin: Vec, effort: float) -> Joint:
    limit = (0.0, 0.0, effort, 20.0)
    return Joint(name, "continuous", parent, child, origin, (0.0, 1.0, 0.0), limit)


def barrett() -> Model:
    """Returns a two-wheeled base with casters, an arm of seven joints and a three-fingered hand.

    The base frame is 0.735 above the floor. Nothing reaches beyond x = 0.345 at the height of
    the laser (z = -0.65), which looks forward from x = 0.35. The wheels stand a little lower
    than the casters and behind the centre of mass, so that they always carry the weight and can
    drive: the robot leans on its front caster.
    """
    ground, wheel, caster = -0.735 + 0.0007, 0.24, 0.05
    axle = ground + wheel + GAP - 0.0005
    base = [
        box("orange", (-0.23, -0.19, -0.61), (0.23, 0.19, -0.32)),
        box("charcoal", (-0.25, -0.20, -0.32), (0.25, 0.20, -0.27)),
        box("orange", (-0.21, -0.11, -0.27), (0.01, 0.11, 0.0)),
        box("steel", (0.04, -0.15, -0.27), (0.22, 0.15, -0.14)),
        box("glass", (0.05, -0.13, -0.14), (0.21, 0.13, -0.132)),
        box("charcoal", (0.23, -0.05, -0.61), (0.31, 0.05, -0.59)),
        box("mustard", (0.285, -0.05, -0.69), (0.345, 0.05, -0.60)),
    ]
    links = [Link("base", 52.0, base)]
    joints = []
    for side, y in (("left", 0.245), ("right", -0.245)):
        rim = [
            mesh("charcoal", "tyre", tyre(wheel, 0.06)),
            tube("orange", 0.0, 0.12, 0.066, "y"),
        ]
        links.append(Link(f"{side}_tyre", 3.0, rim))
        joints.append(drive(f"{side}_wheel", "base", f"{side}_tyre", (-0.04, y, axle), 40.0))
    for end, x in (("front", 0.22), ("back", -0.26)):
        foot = [ball("iron", (0.0, 0.0, 0.0), caster), tube("iron", 0.05, 0.03, 0.05)]
        links.append(Link(f"{end}_caster", 0.6, foot, slippery=True))
        mount = (x, 0.0, ground + caster)
        joints.append(Joint(f"{end}_mount", "fixed", "base", f"{end}_caster", mount))
    for link, joint in [*arm(), *hand()]:
        links.append(link)
        joints.append(joint)
    return Model("barrett_4918", links, joints)


def arm() -> Iterator[tuple[Link, Joint]]:
    """Returns an arm that points straight up when all joints are 0."""
    y, z = (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
    turret = [tube("white", 0.11, 0.10, 0.22), tube("charcoal", 0.28, 0.085, 0.20, "y")]
    upper = [tube("white", 0.13, 0.062, 0.24)]
    elbow = [tube("white", 0.08, 0.052, 0.16), tube("charcoal", 0.20, 0.058, 0.14, "y")]
    lower = [tube("white", 0.12, 0.045, 0.20)]
    cuff = [tube("orange", 0.03, 0.042, 0.06)]
    wrist = [tube("charcoal", 0.0, 0.040, 0.10, "y"), tube("white", 0.025, 0.03, 0.04)]
    palm = [tube("charcoal", 0.025, 0.058, 0.05)]
    rows = [  # mass, shapes, height above the joint before, axis, limit
        (4.0, turret, 0.0, z, (-2.6, 2.6, 80.0, 1.5)),
        (3.6, upper, 0.28, y, (-2.0, 2.0, 90.0, 1.5)),
        (2.2, elbow, 0.26, z, (-2.7, 2.7, 60.0, 2.0)),
        (1.8, lower, 0.20, y, (-0.9, 3.1, 50.0, 2.0)),
        (0.6, cuff, 0.22, z, (-4.7, 1.3, 20.0, 3.0)),
        (0.5, wrist, 0.09, y, (-1.6, 1.6, 20.0, 3.0)),
        (0.9, palm, 0.05, z, (-3.0, 3.0, 10.0, 3.0)),
    ]
    parent, x = "base", -0.10
    for i, (mass, shapes, height, axis, limit) in enumerate(rows, start=1):
        name = f"arm{i}"
        joint = Joint(f"j{i}", "revolute", parent, name, (x, 0.0, height), axis, limit)
        yield Link(name, mass, shapes), joint
        parent, x = name, 0.0


def tube(colour: str, z: float, radius: float, length: float, axis: str = "z") -> Shape:
    return cylinder(colour, (0.0, 0.0, z), radius, length, axis)


def hand() -> Iterator[tuple[Link, Joint]]:
    """Returns three fingers that bend to the palm's axis; `spread` swings the first round it."""
    palm, z, top = "arm7", (0.0, 0.0, 1.0), 0.05
    knuckle = [cylinder("steel", (0.0, 0.04, 0.008), 0.016, 0.016)]
    swing = Joint("spread", "revolute", palm, "knuckle", (0.0, 0.0, top), z, (0.0, 2.4, 5.0, 2.0))
    yield Link("knuckle", 0.08, knuckle), swing
    finger = [
        box("steel", (-0.011, -0.011, 0.0), (0.011, 0.011, 0.06)),
        box("charcoal", (-0.010, -0.014, 0.06), (0.010, 0.006, 0.11)),
    ]
    mounts = (("f1", "knuckle", 0.0, 0.016), ("f2", palm, 2.1, top), ("f3", palm, -2.1, top))
    for name, parent, angle, height in mounts:
        origin = (-0.04 * math.sin(angle), 0.04 * math.cos(angle), height)
        limit = (0.0, 2.4, 5.0, 2.0)
        bend = Joint(
            name, "revolute", parent, f"{name}_finger", origin, (1, 0, 0), limit, (0, 0, angle)
        )
        yield Link(f"{name}_finger", 0.1, finger, grips=True), bend


# --------------------------------------------------------------------------------- outlines
# Seen from above, counter-clockwise, in the model's frame. Turned bodies need all of them: their
# box in the world is that of the outline, not that of the model's box.


def outline(*numbers: float) -> Array:
    return np.array(numbers).reshape(-1, 2)


# fmt: off
CHAIR = outline(
    -0.24242186, 0.251681273, -0.279846642, 0.235807618, -0.305915503, 0.103392967,
    -0.305915554, -0.054962843, -0.27984678, -0.187377512, -0.242422009, -0.203251191,
    -0.206246013, -0.203251202, 0.188860881, -0.19756316, 0.209597711, -0.192006955,
    0.224778331, -0.176826344, 0.23033455, -0.156089518, 0.230334668, 0.204519292,
    0.224778463, 0.225256121, 0.209597852, 0.240436741, 0.188861026, 0.245994033,
    -0.206245864, 0.251681261,
)
PLATE = outline(
    -0.115772056, -0.091981659, -0.074751425, -0.132942813, -0.021186815, -0.155058259,
    0.036836503, -0.155058297, 0.090401106, -0.132764483, 0.131362274, -0.091743866,
    0.153477737, -0.038179263, 0.153477746, 0.019844103, 0.13118395, 0.073408714,
    0.090163346, 0.114369894, 0.03659875, 0.136485375, -0.021424663, 0.136485347,
    -0.074989274, 0.114191552, -0.115950456, 0.073170949, -0.138065937, 0.019606353,
    -0.138065887, -0.038417063,
)
CUP = outline(
    0.009175865, -0.041011018, 0.029891554, -0.029060671, 0.041841901, -0.008344982,
    0.041841905, 0.015555712, 0.029891565, 0.036271405, 0.00917588, 0.048221759,
    -0.014724829, 0.048221752, -0.035440522, 0.036271413, -0.047390877, 0.015555727,
    -0.047417184, -0.008344982, -0.03546683, -0.029060667, -0.014751137, -0.041011008,
)
COFFE_MACHINE = outline(
    0.091130353, -0.087785942, 0.11794791, 0.078890268, 0.100533471, 0.120915756,
    0.058541929, 0.138296249, -0.094216309, 0.138296249, -0.136207851, 0.120915756,
    -0.15362229, 0.078890268, -0.119676015, -0.077364436, -0.100224799, -0.137211719,
    -0.049305387, -0.174213158, 0.013631007, -0.174213158, 0.064550419, -0.137211719,
)
TOASTER = outline(
    -0.233734854, 0.10268832, -0.255697518, -0.107649105, -0.24123817, -0.114626543,
    0.129356339, -0.153322665, 0.144945195, -0.14948275, 0.181034173, -0.094767456,
    0.190793932, -0.001297508, 0.166907859, 0.060854674, 0.152406678, 0.06743147,
    -0.218187832, 0.106127592,
)
SHAKER = outline(
    0.144768441, 0.020521549, 0.087462601, 0.105137526, 0.027264613, 0.139884614,
    -0.042229563, 0.139884614, -0.102427551, 0.105137526, -0.137174639, 0.044939538,
    -0.137174651, -0.024554593, -0.102427584, -0.084752593, -0.042229608, -0.119499702,
    0.027264568, -0.119499726, 0.087462568, -0.084752659, 0.144768437, -0.000136701,
)
ROOMBA = outline(
    -0.170950055, 0.002275119, -0.16507507, -0.042324883, -0.147850084, -0.083849889,
    -0.120500097, -0.119524898, -0.084825106, -0.14689991, -0.043275112, -0.164099925,
    0.001299886, -0.16997494, 0.045874888, -0.164099956, 0.087424894, -0.14689997,
    0.123099903, -0.119524983, 0.150474916, -0.083849992, 0.16767493, -0.042324998,
    0.173549945, 0.002275, 0.140249972, 0.079975012, 0.114824984, 0.11310002,
    0.081699993, 0.138525032, 0.043124998, 0.154500045, 0.001725, 0.15995006,
    -0.039675002, 0.154500074, -0.078250007, 0.138525087, -0.111375016, 0.113100099,
    -0.136775028, 0.079975107,
)
MICROWAVE = outline(
    -0.43360658, 0.08792693, -0.116493632, -0.303675013, 0.409956804, 0.122636074,
    0.092843856, 0.514238016, 0.290052537, -0.030370268, 0.306541566, -0.017017718,
)
# fmt: on


# -------------------------------------------------------------------------------- the scene


@dataclass(frozen=True)
class Body:
    name: str
    kind: str
    model: str
    position: Vec
    orientation: Quat = (1.0, 0.0, 0.0, 0.0)
    fixed: bool = False
    joints: dict[str, float] = field(default_factory=dict)
    velocity: tuple[float, ...] = ()


@dataclass(frozen=True)
class Sensor:
    name: str
    on: str
    type: str
    position: Vec
    orientation: Quat
    max_range: float
    more: dict[str, float]  # what this type of sensor has beyond the others
    period: float = 0.2


def looking(yaw: float, down: float = 0.0) -> Quat:
    """Returns the orientation of a sensor that looks to `yaw` and `down`, degrees."""
    a, b = math.radians(yaw) / 2, math.radians(down) / 2
    return (
        math.cos(a) * math.cos(b),
        -math.sin(a) * math.sin(b),
        math.cos(a) * math.sin(b),
        math.sin(a) * math.cos(b),
    )


APPLIANCES = [can(), coffe_machine(), mixer(), toaster(), microwave(), knife_block(), shaker()]
SMALL = [plate(), cup(), pin()]
FURNITURE = [kitchen(), chair(), table(), sink()]
MODELS = [camera("fridge"), camera("cooker"), barrett(), roomba(), *FURNITURE, *SMALL, *APPLIANCES]

# The arm is folded above its base, hand down.
FOLDED = {"j1": 0.55, "j2": -0.35, "j4": 2.4, "j6": 0.9, "f1": 0.35, "f2": 0.35, "f3": 0.35}

ROBOTS = [
    Body("fridge", "robot", "fridge", (-0.87, -2.0, 1.55), fixed=True),
    Body("cooker", "robot", "cooker", (1.98, 1.72, 0.75), fixed=True),
    Body("barrett_4918", "robot", "barrett_4918", (0.42, 1.3, 0.892), joints=FOLDED),
    Body("roomba_625x", "robot", "roomba_625x", (1.8, 0.0, 0.17)),
]


def kinbody(name: str, x: float, y: float, z: float, qw: float = 1.0, qz: float = 0.0) -> Body:
    """Returns a kinbody; its model is the name without the tag: `plate` of `plate_835a`."""
    model = name if name in {m.name for m in MODELS} else name.rsplit("_", 1)[0]
    fixed = model in {m.name for m in FURNITURE}
    return Body(name, "kinbody", model, (x, y, z), (qw, 0.0, 0.0, qz), fixed)


KINBODIES = [
    kinbody("kitchen", 0.0, 0.0, 0.0),
    kinbody("chair_2e39", 0.95, -1.15, 0.0, 0.82402, 0.56657),
    kinbody("chair_12d0", 0.43229, 0.17536, 0.0, 0.98286, -0.18433),
    kinbody("chair_6b56", 1.34, 0.27, 0.0, -0.08079, 0.99673),
    kinbody("chair_083c", 0.52, -0.6, 0.0),
    kinbody("table", 0.91704, -0.12644, 0.0),
    kinbody("plate_835a", 1.06, -0.73, 0.922),
    kinbody("plate_496f", 0.67, -0.45556, 0.922),
    kinbody("plate_fa76", 1.14, 0.0, 0.922),
    kinbody("plate_b4e7", -1.13, 2.01, 1.14),
    kinbody("cup_905a", 1.0, 0.433, 0.922),
    kinbody("cup_58a2", 0.61, 0.45, 0.922),
    kinbody("cup_b6af", 0.76, 0.55, 0.922),
    kinbody("cup_d441", 0.97, 0.58, 0.922),
    kinbody("sink", 0.35, 2.15, -0.1),
    kinbody("can", -1.25, -0.54, 0.97),
    kinbody("coffe_machine", -1.335, 0.96, 0.97),
    kinbody("mixer", 1.69, 2.3, 0.956),
    kinbody("toaster", -1.26, -1.18, 0.96, 0.94893, 0.3155),
    kinbody("microwave", -1.1, 2.0, 0.963),
    kinbody("pin_371e", -1.2, 1.4, 0.96),
    kinbody("pin_a091", -1.466, 2.27, 1.67),
    kinbody("pin_c671", -1.11, 2.286, 1.67),
    kinbody("knife_block", -0.51, 2.3, 0.968),
    kinbody("shaker", 2.13, 2.26, 0.98),
]

BELOW: Vec = (0.0, 0.0, -0.051)


def webcam(name: str, on: str, at: Vec, down: float, reach: float) -> Sensor:
    more = {"width": 64, "height": 48, "fov": 50.0}
    return Sensor(name, on, "depth_camera", at, looking(0, down), reach, more)


def laser(name: str, on: str, at: Vec, yaw: float, reach: float, sweep: Span) -> Sensor:
    more = {"min_angle": sweep[0], "max_angle": sweep[1], "resolution": 1.0}
    return Sensor(name, on, "planar_laser", at, looking(yaw), reach, more)


def distance(number: int, yaw: float, x: float, y: float) -> Sensor:
    name, on = f"roomba_625x_dist{number}", "roomba_625x"
    return Sensor(name, on, "range_finder", (x, y, 0.05), looking(yaw), 0.4, {})


SENSORS = [
    webcam("fridge_webcam", "fridge", BELOW, 35, 2.2),
    laser("cooker_motion_detector", "cooker", BELOW, -90, 1.0, (-45.0, 25.0)),
    laser("barrett_4918_laser_scaner", "barrett_4918", (0.35, 0.0, -0.65), 0, 3.0, (-90.0, 90.0)),
    webcam("roomba_625x_webcam_a40f", "roomba_625x", (0.0, -0.1, 0.2), 0, 1.0),
    distance(1, 0, 0.2, 0.0),
    distance(2, 90, 0.0, 0.2),
    distance(3, 180, -0.2, 0.0),
    distance(4, 270, 0.0, -0.2),
]


# ------------------------------------------------------------------------- mass and inertia


def rotation(rpy: Vec) -> Array:
    (cr, cp, cy), (sr, sp, sy) = np.cos(rpy), np.sin(rpy)
    x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    return np.asarray(z @ y @ x, dtype=np.float64)


def solids(shape: Shape) -> Iterable[Piece]:
    """Returns a shape as polyhedra; a ball as the cube of the same moment of inertia per mass."""
    if shape.kind == "mesh":
        return shape.pieces
    if shape.kind in ("cylinder", "capsule"):  # a capsule of the length of all of it
        radius, length = shape.size
        length += 2 * radius * (shape.kind == "capsule")
        flat, half = ngon(16, 0.0, 0.0, radius), length / 2
    else:
        size = shape.size if shape.kind == "box" else (shape.size[0] * math.sqrt(2.4),) * 3
        (x, y, half) = (edge / 2 for edge in size)
        flat = np.array([(-x, -y), (x, -y), (x, y), (-x, y)])
    piece = prism(flat, -half, half)
    placed = piece.vertices @ rotation(shape.rpy).T + shape.origin
    return [Piece(placed, piece.faces)]


def inertial(link: Link) -> tuple[Array, Array]:
    """Returns the centre of mass and the diagonal of the inertia about it, for one material.

    Summed over the tetrahedra which each face, cut into triangles, forms with the origin.
    """
    volume, first, second = 0.0, np.zeros(3), np.zeros(3)
    for piece in (piece for shape in link.shapes for piece in solids(shape)):
        for face in piece.faces:
            for i in range(1, len(face) - 1):
                corners = piece.vertices[[face[0], face[i], face[i + 1]]]
                v = float(np.linalg.det(corners)) / 6
                total = corners.sum(axis=0)
                volume += v
                first += v * total / 4
                second += v * ((corners**2).sum(axis=0) + total**2) / 20
    centre = first / volume
    spread = (second / volume - centre**2) * link.mass
    return centre, spread.sum() - spread


# ---------------------------------------------------------------------------------- writing


def number(value: float, digits: int = 12) -> str:
    """Returns a number with so few digits that the text is the same on every machine."""
    return f"{round(float(value), 12) + 0.0:.{digits}g}"


def numbers(values: Iterable[float], digits: int = 12) -> str:
    return " ".join(number(v, digits) for v in values)


def obj_text(pieces: Sequence[Piece]) -> str:
    lines, start = [], 1
    for i, piece in enumerate(pieces):
        lines.append(f"o piece{i}")
        lines += [f"v {numbers(v)}" for v in piece.vertices]
        lines += ["f " + " ".join(str(start + k) for k in face) for face in piece.faces]
        start += len(piece.vertices)
    return "\n".join(lines) + "\n"


def geometry(model: Model, shape: Shape) -> str:
    match shape.kind:
        case "box":
            return f'<box size="{numbers(shape.size)}"/>'
        case "cylinder":
            return f'<cylinder radius="{number(shape.size[0])}" length="{number(shape.size[1])}"/>'
        case "sphere":
            return f'<sphere radius="{number(shape.size[0])}"/>'
        case "capsule":
            radius, length = map(number, shape.size)
            return f'<capsule radius="{radius}" length="{length}"/>'
    return f'<mesh filename="meshes/{model.name}_{shape.part}.obj"/>'


def place(origin: Iterable[float], rpy: Vec = (0.0, 0.0, 0.0)) -> str:
    turn = f' rpy="{numbers(rpy)}"' if any(rpy) else ""
    return f'<origin xyz="{numbers(origin)}"{turn}/>'


def link_lines(model: Model, link: Link) -> Iterator[str]:
    centre, moments = inertial(link)
    ixx, iyy, izz = (number(m, 6) for m in moments)
    yield f'  <link name="{link.name}">'
    if link.slippery:
        yield '    <contact><lateral_friction value="0"/></contact>'
    if link.grips:
        yield '    <contact><lateral_friction value="1"/></contact>'
    yield f'    <inertial>{place(centre.round(6))}<mass value="{number(link.mass)}"/>'
    yield f'      <inertia ixx="{ixx}" iyy="{iyy}" izz="{izz}" ixy="0" ixz="0" iyz="0"/>'
    yield "    </inertial>"
    for shape in link.shapes:
        body = f"{place(shape.origin, shape.rpy)}<geometry>{geometry(model, shape)}</geometry>"
        yield f"    <collision>{body}</collision>"
        if not shape.drawn:  # without anything to draw PyBullet draws what collides
            body = f'{place(shape.origin)}<geometry><box size="0.0001 0.0001 0.0001"/></geometry>'
        yield f'    <visual>{body}<material name="{shape.colour}"/></visual>'
    yield "  </link>"


def joint_lines(joint: Joint) -> Iterator[str]:
    yield f'  <joint name="{joint.name}" type="{joint.kind}">'
    yield f'    <parent link="{joint.parent}"/><child link="{joint.child}"/>'
    yield f"    {place(joint.origin, joint.rpy)}"
    if joint.limit:
        lower, upper, effort, velocity = (number(v) for v in joint.limit)
        bounds = "" if joint.kind == "continuous" else f'lower="{lower}" upper="{upper}" '
        yield f'    <axis xyz="{numbers(joint.axis)}"/>'
        yield f'    <limit {bounds}effort="{effort}" velocity="{velocity}"/>'
    yield "  </joint>"


def urdf_text(model: Model) -> str:
    used = {shape.colour for link in model.links for shape in link.shapes}
    lines = ['<?xml version="1.0"?>', f'<robot name="{model.name}">']
    for name in sorted(used):
        rgba = numbers((*COLOURS[name], 1.0))
        lines.append(f'  <material name="{name}"><color rgba="{rgba}"/></material>')
    for link in model.links:
        lines += link_lines(model, link)
    for joint in model.joints:
        lines += joint_lines(joint)
    return "\n".join([*lines, "</robot>"]) + "\n"


def array(values: Iterable[float]) -> str:
    return "[" + ", ".join(real(v) for v in values) + "]"


def real(value: float) -> str:
    """Returns a TOML number; a whole one stays whole."""
    return repr(value) if isinstance(value, int) else repr(round(value, 12) + 0.0)


def body_lines(body: Body) -> Iterator[str]:
    yield "\n[[body]]"
    yield f'name = "{body.name}"\nkind = "{body.kind}"\nurdf = "{body.model}.urdf"'
    yield f"position = {array(body.position)}\norientation = {array(body.orientation)}"
    if body.fixed:
        yield "fixed = true"
    if body.velocity:
        yield f"velocity = {array(body.velocity)}"
    if body.joints:
        values = ", ".join(f"{name} = {real(v)}" for name, v in body.joints.items())
        yield f"joints = {{ {values} }}"


def sensor_lines(sensor: Sensor) -> Iterator[str]:
    yield "\n[[sensor]]"
    yield f'name = "{sensor.name}"\non = "{sensor.on}"\ntype = "{sensor.type}"'
    yield f"position = {array(sensor.position)}\norientation = {array(sensor.orientation)}"
    yield f"period = {real(sensor.period)}\nmax_range = {real(sensor.max_range)}"
    for key, value in sensor.more.items():
        yield f"{key} = {real(value)}"


def scene_text(heading: str, bodies: Iterable[Body], sensors: Iterable[Sensor]) -> str:
    lines = [heading.strip()]
    for body in bodies:
        lines += body_lines(body)
    for sensor in sensors:
        lines += sensor_lines(sensor)
    return "\n".join(lines) + "\n"


def files(scene: str, models: Iterable[Model]) -> dict[Path, str]:
    """Returns the files of a scene by path: `scene.toml` with its text, and the models."""
    texts = {Path("scene.toml"): scene}
    for model in models:
        texts[Path(f"{model.name}.urdf")] = urdf_text(model)
        for shape in (shape for link in model.links for shape in link.shapes):
            if shape.kind == "mesh":
                texts[Path(f"meshes/{model.name}_{shape.part}.obj")] = obj_text(shape.pieces)
    return texts


def write(name: str, texts: dict[Path, str]) -> int:
    """Writes the folder of a scene, or compares it with the files; returns the exit status."""
    parser = argparse.ArgumentParser(description=f"Write the scene {name}.")
    parser.add_argument("--check", action="store_true", help="only report files that differ")
    check = parser.parse_args().check
    folder = SCENES / name
    there = {p.relative_to(folder): p.read_text() for p in folder.rglob("*") if p.is_file()}
    differing = sorted(p for p in texts.keys() | there.keys() if texts.get(p) != there.get(p))
    for path in differing:
        print(path)
        if check:
            continue
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        if path in texts:
            (folder / path).write_text(texts[path])
        else:
            (folder / path).unlink()
    return 1 if check and differing else 0


HEADING = f"""
# Written by tools/build_kitchen.py; change it there.
name = "kitchen"
description = "A kitchen with a laid table, appliances and four robots."
gravity = [0.0, 0.0, -9.81]
timestep = {1 / 240!r}

[camera]
eye = [3.55, -4.1, 3.45]
target = [0.18, 0.03, 0.7]
fov = 47.0
"""


def main() -> int:
    scene = scene_text(HEADING, [*ROBOTS, *KINBODIES], SENSORS)
    return write("kitchen", files(scene, MODELS))


if __name__ == "__main__":
    sys.exit(main())
