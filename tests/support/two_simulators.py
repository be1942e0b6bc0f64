"""The same scenes in MuJoCo and in PyBullet, and the comparison of what they answer."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

import ssduck
from tests.support.bodies import create_linked_body

mujoco, pybullet = pytest.importorskip("mujoco"), pytest.importorskip("pybullet")

# MuJoCo keeps the corners of meshes in single precision, PyBullet those of links.
TOLERANCE = 1e-6
KINDS = ("box", "sphere", "capsule", "cylinder", "mesh")


@dataclass(frozen=True)
class Part:
    """A shape at a pose; sizes are half sizes, or radius and half length."""

    name: str
    kind: str
    size: tuple[float, ...]
    position: np.ndarray
    turn: np.ndarray
    mass: float

    @property
    def vertices(self):
        """The corners of a mesh: those of a box, with one off."""
        signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
        return (signs * self.size * np.where(np.arange(8) == 7, 1.5, 1.0)[:, None]).astype(
            np.float32
        )


def parts_of(seed):
    """Random shapes in a heap, two of each kind; the first ones are fixed."""
    rng = np.random.default_rng(seed)
    parts = []
    for number, kind in enumerate(KINDS * 2):
        turn = rng.normal(size=4) if seed % 2 else [1, 0, 0, 0]
        size = tuple(
            rng.uniform(0.05, 0.3, {"sphere": 1, "capsule": 2, "cylinder": 2}.get(kind, 3))
        )
        position = rng.uniform((-0.6, -0.6, 0.2), (0.6, 0.6, 1.0))
        mass = 0.0 if number < 2 else 1.0 + number
        parts.append(
            Part(f"{kind}_{number}", kind, size, position, turn / np.linalg.norm(turn), mass)
        )
    return parts


ARM = """<body name="arm" pos="0.2 -0.9 0.6"><geom type="box" size=".1 .1 .1" mass="0"/>
  <body name="upper" pos="0 0 .2"><joint name="joint1" axis="1 0 0" range="-2 2" limited="true"/>
    <geom type="capsule" size=".05 .15" mass="1"/>
    <body name="fore" pos="0 .1 .3"><joint name="joint2" type="slide" axis="0 1 0" range="-1 1" limited="true"/>
      <geom type="sphere" size=".12" mass="1"/></body></body></body>"""
POSITIONS = {"joint1": 0.7, "joint2": -0.25}


def numbers(values):
    return " ".join(repr(float(value)) for value in values)


def in_mujoco(parts):
    meshes = "".join(
        f'<mesh name="{p.name}" vertex="{numbers(p.vertices.reshape(-1))}"/>'
        for p in parts
        if p.kind == "mesh"
    )
    bodies = "".join(
        f'<body name="{p.name}" pos="{numbers(p.position)}" quat="{numbers(p.turn)}">'
        + ("<freejoint/>" if p.mass else "")
        + (
            f'<geom type="mesh" mesh="{p.name}"'
            if p.kind == "mesh"
            else f'<geom type="{p.kind}" size="{numbers(p.size)}"'
        )
        + f' mass="{p.mass or 1}"/></body>'
        for p in parts
    )
    model = mujoco.MjModel.from_xml_string(
        f"<mujoco><compiler angle='radian'/><asset>{meshes}</asset><worldbody>"
        f'<geom name="floor" type="plane" size="0 0 1"/>{bodies}{ARM}</worldbody></mujoco>'
    )
    data = mujoco.MjData(model)
    for name, position in POSITIONS.items():
        data.joint(name).qpos[0] = position
    mujoco.mj_forward(model, data)
    return model, data


def in_pybullet(parts, client, *, margins=False):
    def collision(kind, size=(), vertices=()):
        match kind:
            case "plane":
                given = {}
            case "mesh":
                given = {"vertices": vertices}
            case "box":
                given = {"halfExtents": size}
            case "sphere":
                given = {"radius": size[0]}
            case _:
                given = {"radius": size[0], "height": 2 * size[1]}
        number = getattr(pybullet, f"GEOM_{kind.upper()}")
        return pybullet.createCollisionShape(number, **given, physicsClientId=client)

    names = {pybullet.createMultiBody(0, collision("plane"), physicsClientId=client): "floor"}
    for part in parts:
        shape = collision(
            part.kind, part.size, part.vertices.tolist() if part.kind == "mesh" else ()
        )
        w, *xyz = part.turn.tolist()
        handle = pybullet.createMultiBody(
            part.mass, shape, -1, part.position.tolist(), [*xyz, w], physicsClientId=client
        )
        if not margins:
            pybullet.changeDynamics(handle, -1, collisionMargin=0.0, physicsClientId=client)
        names[handle] = part.name
    shapes = [collision("capsule", (0.05, 0.15)), collision("sphere", (0.12,))]
    arm = create_linked_body(
        client,
        0,
        collision("box", (0.1, 0.1, 0.1)),
        basePosition=[0.2, -0.9, 0.6],
        linkCollisionShapeIndices=shapes,
        linkPositions=[[0, 0, 0.2], [0, 0.1, 0.3]],
        linkJointAxis=[[1, 0, 0], [0, 1, 0]],
        linkJointTypes=[pybullet.JOINT_REVOLUTE, pybullet.JOINT_PRISMATIC],
    )
    for joint, position in enumerate(POSITIONS.values()):
        pybullet.resetJointState(arm, joint, position, physicsClientId=client)
    return names | {arm: "arm"}


def same(one, other):
    """Whether answers are equal up to the tolerance; entities, by their names."""
    if isinstance(one, ssduck.Entity) and isinstance(other, ssduck.Entity):
        return one.name == other.name
    if isinstance(one, list | tuple | np.ndarray):
        if len(one) in (4, 7) and all(isinstance(number, float) for number in one):
            # A quaternion and its negative are the same orientation.
            sign = float(np.sign(np.dot(one[:4], other[:4]))) or 1.0
            other = [*(sign * number for number in other[:4]), *other[4:]]
        return len(one) == len(other) and all(map(same, one, other))
    if isinstance(one, float) and isinstance(other, float):
        return one == other or abs(one - other) <= TOLERANCE
    return one == other


def differences(ss, query):
    """Returns the rows in which the answers of the worlds p and m differ, in order."""
    one, other = (
        [list(row.values()) for row in ss.eval(query.replace("SIM", world))] for world in "pm"
    )
    assert len(one) == len(other) > 1
    return [pair for pair in zip(one, other, strict=True) if not same(*pair)]
