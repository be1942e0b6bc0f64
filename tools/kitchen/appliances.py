"""Models of tableware and appliances."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from tools.kitchen.outlines import COFFE_MACHINE, CUP, MICROWAVE, PLATE, SHAKER, TOASTER
from tools.scenes.models import Frame, Model, Shape, box, cylinder, mesh, thing
from tools.scenes.pieces import Piece, Span, loft, ngon, prism, profile, ring, wall


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
