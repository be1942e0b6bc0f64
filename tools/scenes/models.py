"""Describes models: links with shapes, and joints.

Metres, kilograms, radians; z is up. A model is defined in its own link frame, which a scene places
in the world. A shape collides and is drawn, unless another model draws it in its place.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from tools.scenes.pieces import RIGHT, Piece, Vec

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


@dataclass(frozen=True)
class Shape:
    """A shape: a primitive of a `size` or a mesh of `pieces`."""

    colour: str
    kind: str
    size: tuple[float, ...] = ()
    origin: Vec = (0.0, 0.0, 0.0)
    rpy: Vec = (0.0, 0.0, 0.0)
    part: str = ""
    pieces: tuple[Piece, ...] = ()
    drawn: bool = True
    collides: bool = True


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
