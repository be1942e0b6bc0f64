"""Models of the robots."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from tools.kitchen.furniture import GAP
from tools.kitchen.outlines import ROOMBA
from tools.scenes.models import Joint, Link, Model, Shape, ball, box, cylinder, mesh
from tools.scenes.pieces import Piece, Vec, loft, ngon, prism


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
