"""Poses, velocities, boxes and joints are PyBullet's."""

import xml.etree.ElementTree as ET

import numpy as np
import pybullet
import pytest
import trimesh
from scipy.spatial.transform import Rotation

import ssduck
from tests.support.arm import ARM, HIGH, LIMIT, LOW, POSE, TWIST, unsettle
from tests.support.framed import (
    LIBRARY,
    SINGLE,
    asked,
    base_state,
    link_states,
    matrix,
    rows,
    same_turn,
)
from tests.support.urdf import collision, joint, link, robot

MODELS = [
    "kuka_iiwa/model.urdf",
    "r2d2.urdf",
    "duck_vhacd.urdf",
    "humanoid/humanoid.urdf",
    "cartpole.urdf",
    "pr2_gripper.urdf",
    "laikago/laikago_toes.urdf",
    "tray/traybox.urdf",
]


@pytest.fixture(params=["arm", *MODELS])
def body(request, client, write):
    """A body of a client, in a pose of all its joints and of its base that nothing is special of."""
    path = write("arm.urdf", ARM) if request.param == "arm" else LIBRARY / request.param
    handle = pybullet.loadURDF(str(path), physicsClientId=client)
    unsettle(client, handle, seed=len(request.param))
    return handle


# -- poses and velocities ------------------------------------------------------------------------


def test_link_frames_are_pybullets(client, body):
    world = asked(ssduck.World.attach(client), "links")
    poses = rows(world, "links", POSE)
    states = link_states(client, body)
    assert len(poses) == len(states) + 1
    _, position, turn = base_state(client, body)
    expected = [(position, turn.as_quat()), *(state[4:6] for state in states)]
    assert poses[:, :3] == pytest.approx(np.array([e[0] for e in expected]), abs=SINGLE)
    assert same_turn(poses[:, 3:], np.array([e[1] for e in expected]))
    assert poses[0, :3] == pytest.approx(position, abs=1e-12)
    assert same_turn(poses[:1, 3:], turn.as_quat()[None], tolerance=1e-12)
    assert np.linalg.norm(poses[:, 3:], axis=1) == pytest.approx(np.ones(len(poses)), abs=1e-9)
    columns = POSE + TWIST  # an entity is where its base is
    assert rows(world, "entities", columns).tolist() == rows(world, "links", columns)[:1].tolist()


def test_velocities_are_those_of_the_link_frames_origins(client, body):
    """v of a point of a rigid body: that of its centre of mass, and w x r."""
    world = asked(ssduck.World.attach(client), "links")
    centre, origin, _ = base_state(client, body)
    linear, angular = pybullet.getBaseVelocity(body, client)
    expected = [np.concatenate((linear + np.cross(angular, origin - centre), angular))]
    for state in link_states(client, body):
        arm = np.subtract(state[4], state[0])
        expected.append(np.concatenate((state[6] + np.cross(state[7], arm), state[7])))
    found = rows(world, "links", TWIST)
    assert found == pytest.approx(np.array(expected), abs=1e-5)
    assert found[0] == pytest.approx(expected[0], abs=1e-12)


# -- boxes ---------------------------------------------------------------------------------------


def floats(text, default):
    return np.array([float(x) for x in text.split()]) if text else np.array(default, dtype=float)


def meshes_of(path):
    """Of each link of a URDF: the corners of its collision meshes in the link's frame."""
    found = {}
    for element in ET.parse(path).getroot().findall("link"):  # noqa: S314  # from PyBullet's wheel
        sets = []
        for shape in element.findall("collision"):
            origin, mesh = shape.find("origin"), shape.find("geometry/mesh")
            place = origin.attrib if origin is not None else {}
            loaded = trimesh.load_scene(path.parent / mesh.get("filename"), process=False)
            points = loaded.to_mesh().vertices * floats(mesh.get("scale"), (1, 1, 1))
            turn = Rotation.from_euler("xyz", floats(place.get("rpy"), (0, 0, 0)))
            sets.append(turn.apply(points) + floats(place.get("xyz"), (0, 0, 0)))
        found[element.get("name")] = np.concatenate(sets) if sets else np.zeros((1, 3))
    return found


@pytest.mark.slow
@pytest.mark.parametrize("model", ["kuka_iiwa/model.urdf", "duck_vhacd.urdf", "teddy_vhacd.urdf"])
def test_boxes_are_those_of_all_vertices_of_the_files(client, model):
    handle = pybullet.loadURDF(str(LIBRARY / model), physicsClientId=client)
    unsettle(client, handle, seed=8)
    world = asked(ssduck.World.attach(client), "links")
    _, origin, turn = base_state(client, handle)
    frames = [(origin, turn), *((s[4], matrix(s[5])) for s in link_states(client, handle))]
    names = world.snapshot.tables["links"].arrow["name"].to_pylist()
    meshes = meshes_of(LIBRARY / model)
    points = [t.apply(meshes[name]) + place for name, (place, t) in zip(names, frames, strict=True)]
    lows, highs = rows(world, "links", LOW), rows(world, "links", HIGH)
    assert lows == pytest.approx(np.array([p.min(axis=0) for p in points]), abs=SINGLE)
    assert highs == pytest.approx(np.array([p.max(axis=0) for p in points]), abs=SINGLE)
    every = np.concatenate(points)
    assert rows(world, "entities", LOW + HIGH)[0] == pytest.approx(
        np.concatenate((every.min(axis=0), every.max(axis=0))), abs=SINGLE
    )


SHAPES = [
    ('<box size="0.4 0.2 0.1"/>', (0.2, 0.1, 0.05)),
    ('<sphere radius="0.3"/>', (0.3, 0.3, 0.3)),
    ('<capsule radius="0.1" length="0.4"/>', (0.1, 0.1, 0.3)),
    ('<cylinder radius="0.1" length="0.4"/>', (0.1, 0.1, 0.2)),
]


@pytest.mark.parametrize(("shape", "half"), SHAPES)
def test_boxes_are_pybullets_but_for_its_padding(client, write, shape, half):
    path = write("one.urdf", robot(link("one", com=(1, 2, 3), shapes=collision(shape))))
    handle = pybullet.loadURDF(str(path), [5, 6, 7], physicsClientId=client)
    world = ssduck.World.attach(client)
    _, origin, _ = base_state(client, handle)
    box = rows(world, "entities", LOW + HIGH)[0]
    assert box == pytest.approx(np.concatenate((origin - half, origin + half)), abs=1e-9)
    padded = np.concatenate(pybullet.getAABB(handle, -1, client))
    padding = (box - padded) * ([1] * 3 + [-1] * 3)
    assert np.all(padding >= -1e-7)
    assert np.all(padding <= 0.005)


def test_an_entitys_box_is_that_of_its_links(client, body):
    world = asked(ssduck.World.attach(client), "links")
    lows, highs = rows(world, "links", LOW), rows(world, "links", HIGH)
    arrow = world.snapshot.tables["shapes"].arrow
    shaped = np.unique(arrow["link"].to_numpy())  # a link without shapes is a point, and no part
    assert rows(world, "entities", LOW)[0].tolist() == lows[shaped].min(axis=0).tolist()
    assert rows(world, "entities", HIGH)[0].tolist() == highs[shaped].max(axis=0).tolist()


def test_what_has_no_shapes_is_a_point(client, write):
    path = write("bare.urdf", robot(link("bare", com=(0, 0, 1))))
    pybullet.loadURDF(str(path), [1, 2, 3], physicsClientId=client)
    world = asked(ssduck.World.attach(client), "links")
    place = rows(world, "entities", ["x", "y", "z"]).tolist()
    for table in ("entities", "links"):
        assert rows(world, table, LOW).tolist() == rows(world, table, HIGH).tolist() == place


# -- joints --------------------------------------------------------------------------------------


@pytest.mark.slow
def test_joints_are_pybullets(client, body):
    world = asked(ssduck.World.attach(client), "joints")
    count = pybullet.getNumJoints(body, client)
    states = pybullet.getJointStates(body, range(count), client) if count else ()
    found = rows(world, "joints", ["position", "velocity", "effort"])
    assert found.tolist() == [[state[0], state[1], state[3]] for state in states]
    names = world.snapshot.tables["joints"].arrow["name"].to_pylist()
    infos = [pybullet.getJointInfo(body, index, client) for index in range(count)]
    assert names == [info[1].decode() for info in infos]


def test_efforts_are_those_of_the_last_step(client, write):
    arm = pybullet.loadURDF(str(write("arm.urdf", ARM)), useFixedBase=True, physicsClientId=client)
    pybullet.setGravity(0, 0, -9.81, physicsClientId=client)
    pybullet.setJointMotorControl2(
        arm, 0, pybullet.POSITION_CONTROL, targetPosition=0.5, force=40, physicsClientId=client
    )
    world = ssduck.World.attach(client)
    world.request_tables(["joints"])
    world.step(5)
    efforts = rows(world, "joints", ["effort"])[:, 0]
    assert abs(efforts[0]) > 1e-3
    assert efforts.tolist() == [s[3] for s in pybullet.getJointStates(arm, range(4), client)]


JOINTS = {
    "shoulder": ("revolute", -2.5, 1.5, 40.0, 3.0),
    "extend": ("prismatic", -0.2, 0.3, 15.0, 0.5),
    "mount": ("fixed", None, None, None, None),
    "roll": ("revolute", None, None, None, None),
}


def test_types_and_limits_of_joints(client, write):
    pybullet.loadURDF(str(write("arm.urdf", ARM)), physicsClientId=client)
    world = ssduck.World.attach(client)
    columns = ("type", "lower", "upper", "max_effort", "max_velocity")
    table = world.snapshot.tables["joints"].arrow.to_pylist()
    assert {row["name"]: tuple(row[c] for c in columns) for row in table} == JOINTS
    links = world.snapshot.tables["links"].arrow.to_pylist()
    names = {row["link"]: row["name"] for row in links}
    assert {row["name"]: names[row["link"]] for row in table} == {
        "shoulder": "upper",
        "extend": "slide",
        "mount": "plate",
        "roll": "wheel",
    }
    parents = {row["name"]: row["parent"] and names.get(row["parent"]) for row in links}
    assert parents == {"base": None, "upper": 0, "slide": "upper", "plate": "slide", "wheel": 0}


# A range of nothing is one of its own; a lower limit above the upper one is none.
LIMITS = [
    ("revolute", LIMIT.format(0, 0, 5, 2), (0.0, 0.0)),
    ("prismatic", LIMIT.format(0, 0, 5, 2), (0.0, 0.0)),
    ("prismatic", LIMIT.format(0.25, 0.5, 5, 2), (0.25, 0.5)),
    ("revolute", '<limit effort="5" velocity="2"/>', (None, None)),
    ("prismatic", LIMIT.format(1, -1, 5, 2), (None, None)),
    ("continuous", "", (None, None)),
]


@pytest.mark.parametrize(("kind", "limit", "limits"), LIMITS)
def test_limits_of_a_joint(client, write, kind, limit, limits):
    model = robot(link("a"), link("b"), joint("j", kind, "a", "b", limit=limit))
    pybullet.loadURDF(str(write("joint.urdf", model)), physicsClientId=client)
    world = ssduck.World.attach(client)
    (only,) = world.snapshot.tables["joints"].arrow.to_pylist()
    assert (only["lower"], only["upper"]) == limits
    assert world["model"].kind == "robot"  # it has a joint that moves


@pytest.mark.parametrize(
    ("kind", "name"),
    [("spherical", "spherical"), ("planar", "planar"), ("floating", "fixed"), ("fixed", "fixed")],
)
def test_rare_types_of_joints(client, write, kind, name):
    model = robot(link("a"), link("b"), joint("j", kind, "a", "b"))
    handle = pybullet.loadURDF(str(write("joint.urdf", model)), physicsClientId=client)
    world = asked(ssduck.World.attach(client), "joints", "links")
    assert world.snapshot.tables["joints"].arrow["type"].to_pylist() == [name]
    assert world["model"].kind == ("kinbody" if name == "fixed" else "robot")
    assert rows(world, "links", ["x", "y", "z"])[1] == pytest.approx(
        np.array(link_states(client, handle)[0][4])
    )
