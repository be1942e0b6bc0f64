"""The same scenes in MuJoCo and in PyBullet: every relation and form has the same answers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

import ssduck

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
    def vertices(self) -> np.ndarray:
        """The corners of a mesh: those of a box, with one off."""
        signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
        return (signs * self.size * np.where(np.arange(8) == 7, 1.5, 1.0)[:, None]).astype(
            np.float32
        )


def parts_of(seed: int) -> list[Part]:
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


def numbers(values) -> str:
    return " ".join(repr(float(value)) for value in values)


def in_mujoco(parts: list[Part]):
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


def in_pybullet(parts: list[Part], client: int, *, margins: bool = False) -> dict[int, str]:
    def collision(kind, size, vertices=None):
        settings = {
            "box": lambda: {"shapeType": pybullet.GEOM_BOX, "halfExtents": size},
            "sphere": lambda: {"shapeType": pybullet.GEOM_SPHERE, "radius": size[0]},
            "capsule": lambda: {
                "shapeType": pybullet.GEOM_CAPSULE,
                "radius": size[0],
                "height": 2 * size[1],
            },
            "cylinder": lambda: {
                "shapeType": pybullet.GEOM_CYLINDER,
                "radius": size[0],
                "height": 2 * size[1],
            },
            "mesh": lambda: {"shapeType": pybullet.GEOM_MESH, "vertices": vertices.tolist()},
            "plane": lambda: {"shapeType": pybullet.GEOM_PLANE},
        }[kind]()
        return pybullet.createCollisionShape(**settings, physicsClientId=client)

    names = {pybullet.createMultiBody(0, collision("plane", ()), physicsClientId=client): "floor"}
    for part in parts:
        shape = collision(part.kind, part.size, part.vertices if part.kind == "mesh" else None)
        w, *xyz = part.turn.tolist()
        handle = pybullet.createMultiBody(
            part.mass, shape, -1, part.position.tolist(), [*xyz, w], physicsClientId=client
        )
        if not margins:
            pybullet.changeDynamics(handle, -1, collisionMargin=0.0, physicsClientId=client)
        names[handle] = part.name
    shapes = [collision("capsule", (0.05, 0.15)), collision("sphere", (0.12,))]
    arm = pybullet.createMultiBody(
        0, collision("box", (0.1, 0.1, 0.1)), -1, [0.2, -0.9, 0.6],
        linkMasses=[1, 1], linkCollisionShapeIndices=shapes, linkVisualShapeIndices=[-1, -1],
        linkPositions=[[0, 0, 0.2], [0, 0.1, 0.3]], linkOrientations=[[0, 0, 0, 1]] * 2,
        linkInertialFramePositions=[[0, 0, 0]] * 2, linkInertialFrameOrientations=[[0, 0, 0, 1]] * 2,
        linkParentIndices=[0, 1], linkJointAxis=[[1, 0, 0], [0, 1, 0]],
        linkJointTypes=[pybullet.JOINT_REVOLUTE, pybullet.JOINT_PRISMATIC], physicsClientId=client,
    )  # fmt: skip
    for joint, position in enumerate(POSITIONS.values()):
        pybullet.resetJointState(arm, joint, position, physicsClientId=client)
    return names | {arm: "arm"}


@pytest.fixture(
    scope="module", params=[0, *(pytest.param(n, marks=pytest.mark.slow) for n in (1, 2, 3))]
)
def worlds(request):
    """An interpreter with the two worlds, and MuJoCo's model and data."""
    parts = parts_of(request.param)
    client = pybullet.connect(pybullet.DIRECT)
    model, data = in_mujoco(parts)
    with ssduck.Interpreter(recording=None) as ss:
        names = in_pybullet(parts, client)
        # The hulls that PyBullet makes of the corners are up to 5e-5 m smaller.
        handles = {name: handle for handle, name in names.items()}
        hulls = {handles[p.name]: (p.vertices, None) for p in parts if p.kind == "mesh"}
        ss.add_variable("p", ssduck.World.attach(client, names, shapes=hulls))
        ss.add_variable("m", ssduck.World.attach(model, data, {0: "floor"}))
        yield ss, model, data
    pybullet.disconnect(client)


PAIRS = (
    "distance(a, b)", "above(a, b)", "below(a, b)", "within(a, b)", "overlaps(a, b)", "collides(a, b)",
    "collides(a, b, 0.05)", "penetration(a, b)", "clearance(a, b)", "touching(a, b)", "near(a, b, 0.1)",
    "touching(a, b, 0.05)", "on(a, b)", "onTop(a, b)", "supports(a, b)", "inside(a, b)",
    "contains(a, b)", "enclosed(a, b)", "nextTo(a, b)", "collision(a, b)",
    "leftOf(a, b, SIM.box_5)", "behind(a, b, SIM.arm)",
)  # fmt: skip
SINGLE = (
    "x(this)", "y(this)", "z(this)", "aabbVolume(this)", "solidVolume(this)", "aabb(this)",
    "isEnabled(this)", "isSphere(this)", "isPlane(this)", "isBox(this)", "isCapsule(this)", "isCylinder(this)",
    "inBox(this, [-0.5, -0.5, 0.0], [0.5, 0.5, 1.0])", "inSphere(this, [0.0, 0.0, 0.5], 0.6)",
    "joint(SIM.arm, 'joint1')", "linearVelocity(this)", "angularVelocity(this)",
)  # fmt: skip


def same(one, other) -> bool:
    if isinstance(one, list | tuple | np.ndarray):
        return len(one) == len(other) and all(map(same, one, other))
    if isinstance(one, float) and isinstance(other, float):
        return one == other or abs(one - other) <= TOLERANCE
    return one == other


def differences(ss, query: str) -> list:
    """Returns the rows in which the answers differ; rows are told apart by their positions."""
    one, other = (
        [list(row.values()) for row in ss.eval(query.replace("SIM", world))] for world in "pm"
    )
    assert len(one) == len(other) > 1
    return [pair for pair in zip(one, other, strict=True) if not same(*pair)]


@pytest.mark.parametrize("source", ["SIM", "links(SIM)"])
def test_all_relations_of_pairs_agree(worlds, source):
    ss, _, _ = worlds
    selected = ", ".join(f"{relation} AS r{n}" for n, relation in enumerate(PAIRS))
    places = "x(a) AS xa, z(a) AS za, x(b) AS xb, z(b) AS zb"
    query = (
        f"SELECT {places}, {selected} FROM a={source}, b={source} WHERE x(a) != x(b) "
        "ORDER BY x(a), x(b);"
    )
    assert differences(ss, query) == []


def test_all_relations_of_entities_agree(worlds):
    ss, _, _ = worlds
    selected = ", ".join(f"{relation} AS r{n}" for n, relation in enumerate(SINGLE))
    assert differences(ss, f"SELECT id(this) AS name, {selected} FROM SIM;") == []


@pytest.mark.parametrize("form", ["occupancygrid", "voxelgrid"])
def test_grids_agree(worlds, form):
    """Cells are filled in the same places; a shape may end at the edge of one."""
    ss, _, _ = worlds
    height = "z_pos=0.5, " if form == "occupancygrid" else ""
    chosen = f"SELECT obj(this) FROM SIM WHERE id != 'floor' AS {form}({height}grid_size=0.05);"
    one, other = (np.asarray(ss.eval(chosen.replace("SIM", world))) for world in "pm")
    assert one.shape == other.shape
    assert (one != other).mean() < 1e-3 < (one != 0).mean()


def test_what_if_agrees(worlds):
    ss, _, _ = worlds
    moved = {"arm": {"joint1": -0.4, "joint2": 0.6}}
    pose = [0.5, 0.5, -0.5, 0.5, 0.1, -0.2, 0.8]
    asked = [ss.call_variable(name).what_if({"box_5": pose}, moved) for name in "pm"]
    for world in asked:
        world.request_tables(["links", "shapes"])
    places = (
        world.snapshot.tables["links"].doubles("x", "zmax").T[:, [0, 1, 2, *range(13, 19)]]
        for world in asked
    )
    assert np.array_equal(*map(np.shape, (found := list(places))))
    assert found[0] == pytest.approx(found[1], abs=TOLERANCE)


@pytest.mark.parametrize("seed", range(2))
def test_rays_agree(seed):
    """From outside, from within shapes, and through a body; Bullet's rays are less exact.

    Bullet's rays miss shapes without a margin, and hit a capsule that they begin in at once.
    """
    parts, client, rng = parts_of(seed), pybullet.connect(pybullet.DIRECT), np.random.default_rng(7)
    handles = in_pybullet(parts, client, margins=True)
    worlds = [
        ssduck.World.attach(client, handles),
        ssduck.World.attach(in_mujoco(parts), names={0: "floor"}),
    ]
    origins = rng.uniform((-0.8, -0.8, 0.1), (0.8, 0.8, 1.2), (40, 3))
    origins = np.vstack(
        (origins, [p.position for p in parts if p.kind in {"box", "sphere", "mesh"}])
    )
    starts = np.repeat(origins, 12, axis=0)
    ends = starts + rng.normal(size=starts.shape)
    found = []
    for world in worlds:
        names = {info.body.handle: info.name for info in world.snapshot.entities}
        (arm,) = (handle for handle, name in names.items() if name == "arm")
        hits = world.simulator.cast_rays(starts, ends, np.full(len(starts), arm))
        found.append(
            (np.array([names.get(int(handle), "") for handle in hits.bodies]), hits.fractions)
        )
    pybullet.disconnect(client)
    (bodies, fractions), (others, other_fractions) = found
    compared = fractions > 0.0
    assert compared.mean() > 0.9
    assert (bodies == others)[compared].mean() > 0.99  # the others graze an edge
    assert len({*others}) > 8
    assert "arm" not in others
    same_body = compared & (bodies == others)
    errors = np.abs(fractions - other_fractions)[same_body]
    assert (np.quantile(errors, [0.5, 0.98]) < [1e-9, 0.01]).all()


def test_clearance_is_the_distance_that_mujoco_computes(worlds):
    """MuJoCo's own distance of two convex shapes, to its tolerance."""
    ss, model, data = worlds
    rows = ss.eval(
        "SELECT id(a) AS a, id(b) AS b, clearance(a, b) AS c FROM a=m, b=m WHERE id(a) < id(b);"
    )
    compared = 0
    for row in rows:
        if "floor" in row.values() or "arm" in row.values():
            continue
        geoms = [int(model.body_geomadr[model.body(row[side]).id]) for side in "ab"]
        expected = mujoco.mj_geomDistance(model, data, *geoms, 10.0, None)
        compared += 1
        assert row["c"] == pytest.approx(max(expected, 0.0), abs=2e-5), row
    assert compared == 45
