"""Models of the room and its furniture.

The frame of the kitchen is that of the world: its floor is at z = 0.157, its back wall at large y,
its left wall at small x, and it is open towards the viewer. Boxes and outlines are those of the
kitchen in the SelectScript tutorial, whose printed figures follow from them; the shapes in these
boxes were made for this project.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from tools.kitchen.outlines import CHAIR
from tools.scenes.models import Model, Shape, ball, box, cylinder, mesh, thing
from tools.scenes.pieces import Span, Vec, prism

GAP = 0.001  # what PyBullet adds around a convex hull
SLIT = 0.0003  # left under things that stand on boxes, to which it adds nothing


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
    """Returns the room. The units of the two cameras collide here, and are drawn as theirs."""
    parts = [room(), base_cabinets(), sink_unit(), upper_cabinets(), mats()]
    parts += [undrawn(fridge_unit()), on_the_fridge(), undrawn(cooker_unit()), hood(), decoration()]
    return thing("kitchen", 1800.0, *(shape for part in parts for shape in part))


def undrawn(shapes: Iterator[Shape]) -> Iterator[Shape]:
    return (replace(shape, drawn=False) for shape in shapes)


def camera(name: str, position: Vec, unit: Iterator[Shape]) -> Model:
    """Returns a camera of 1 cm, at the position of its unit, which is drawn as a part of it."""
    seen = (
        replace(shape, collides=False, origin=tuple(np.subtract(shape.origin, position).tolist()))
        for shape in unit
    )
    return thing(name, 0.05, ball("charcoal", (0.0, 0.0, 0.0), 0.005), *seen)


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


def on_the_fridge() -> Iterator[Shape]:
    for y, z, colour in ((-2.25, 1.93, "orange"), (-2.0, 1.93, "oak")):
        yield box(colour, (-1.5, y, z), (-1.15, y + 0.2, z + 0.13))


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


def hood() -> Iterator[Shape]:
    x0, x1 = COOKER
    yield box("steel", (x0, 2.10, 1.72), (x1, BACK, 1.79))
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
