"""Batches of the bodies of a world, with poses from any simulator."""

import numpy as np
import pybullet
import pytest

import ssduck
from ssduck.errors import ArgumentError, UnknownNameError
from tests.support.bodies import create_linked_body, solid

COUNT = 3


@pytest.fixture
def world(client):
    foot, tip = (
        pybullet.createCollisionShape(pybullet.GEOM_BOX, halfExtents=size, physicsClientId=client)
        for size in ([0.15, 0.15, 0.05], [0.05] * 3)
    )
    cube = solid(client, pybullet.GEOM_BOX, 1, [0, 0, 0.05], halfExtents=[0.05] * 3)
    shelf, arm = (
        create_linked_body(
            client,
            1,
            foot,
            link_shape=tip,
            basePosition=place,
            linkJointTypes=[kind],
            linkJointAxis=[[0, 1, 0]],
            linkPositions=[[0.1, 0, 0.3]],
            linkOrientations=[[0, 0, np.sin(0.25), np.cos(0.25)]],
        )
        for place, kind in (
            ([1, 0, 0.05], pybullet.JOINT_FIXED),
            ([0, 1, 0.05], pybullet.JOINT_REVOLUTE),
        )
    )
    pybullet.resetJointState(arm, 0, 0.3, physicsClientId=client)
    return ssduck.World.attach(client, names={cube: "cube", shelf: "shelf", arm: "arm"})


@pytest.fixture
def batch(world):
    with ssduck.Interpreter(recording=None) as ss:
        ss.add_variable("sim", ssduck.World.batch(world, COUNT))
        yield ss, ss["sim"], world


def poses(seed=0):
    """Returns positions and unit quaternions w, x, y, z, (n, 7)."""
    draw = np.random.default_rng(seed)
    turns = draw.normal(size=(COUNT, 4))
    turns /= np.linalg.norm(turns, axis=1, keepdims=True)
    return np.concatenate((draw.uniform(-0.2, 0.2, (COUNT, 3)), turns), axis=1)


def expected(world, moved, text):
    """Returns the values of a program in worlds in which bodies were moved."""
    values = []
    for number in range(COUNT):
        elsewhere = {name: [*own[number, 3:7], *own[number, :3]] for name, own in moved.items()}
        with ssduck.Interpreter(recording=None) as ss:
            ss.add_variable("sim", world.what_if(elsewhere))
            values.append(ss.eval(text))
    return values


TEXTS = [
    "position(sim.cube)",
    "rot(sim.shelf)[0]",
    "distance(sim.cube, sim.shelf)",
    "z(sim.shelf.link1)",
    "distance(sim.shelf.link1, sim.cube)",
    "clearance(sim.cube, sim.shelf)",
    "touching(sim.cube, sim.shelf)",
    "above(sim.shelf.link1, sim.cube)",
    "near(sim.arm, sim.cube, 0.9)",
    "joint(sim.arm, 'joint1')",
]


def test_as_if_the_bodies_were_moved(batch):
    ss, sim, world = batch
    moved = {"cube": poses(1), "shelf": poses(2)}
    sim.tick(poses=moved)
    shelf = world["shelf"].links[1].name
    joint = world["arm"].joints[0].name
    for text in TEXTS:
        program = text.replace("link1", shelf).replace("joint1", joint)
        found = ss.eval(f"{program};")
        wanted = expected(world, moved, f"{program};")
        assert np.allclose(np.array(found, float), np.array(wanted, float), atol=1e-9), program


def test_before_the_first_tick_all_is_as_it_was(batch):
    ss, _, world = batch
    with ssduck.Interpreter(recording=None) as one:
        one.add_variable("sim", world)
        for text in ("position(sim.cube);", "clearance(sim.cube, sim.arm);", "speed(sim.arm);"):
            assert np.allclose(ss.eval(text), [one.eval(text)] * COUNT), text


def test_velocities_and_joints(batch):
    ss, sim, world = batch
    states = np.concatenate((poses(), np.arange(COUNT * 6.0).reshape(COUNT, 6)), axis=1)
    links = np.stack([poses(4), poses(5)], axis=1)
    sim.tick(poses={"cube": states, "arm": links}, joints={"arm": [[0.1], [0.2], [-0.9]]}, time=1.5)
    assert np.allclose(ss.eval("linearVelocity(sim.cube);"), states[:, 7:10])
    assert np.allclose(ss.eval("angularVelocity(sim.cube);"), states[:, 10:])
    joint, tip = world["arm"].joints[0].name, world["arm"].links[1].name
    assert np.allclose(ss.eval(f"joint(sim.arm, '{joint}');"), [0.1, 0.2, -0.9])
    assert np.allclose(ss.eval(f"position(sim.arm.{tip});"), links[:, 1, :3])
    assert ss.eval("getTime() + 0 * z(sim.cube);").tolist() == [1.5] * COUNT
    assert np.isnan(ss.eval("speed(sim.arm);")).all()  # its velocities are not known


@pytest.mark.parametrize(
    ("state", "error", "message"),
    [
        ({"poses": {"cub": poses()}}, UnknownNameError, "cube"),
        ({"poses": {"cube": poses()[:2]}}, ArgumentError, "environments"),
        ({"poses": {"cube": poses()[:, :6]}}, ArgumentError, "7"),
        ({"poses": {"arm": poses()}}, ArgumentError, "2 links"),
        ({"poses": {"cube": 2 * poses()}}, ArgumentError, "length"),
        ({"poses": [1, 2]}, ArgumentError, "dict"),
        ({"pose": {"cube": poses()}}, ArgumentError, "poses"),
        ({"joints": {"arm": [[0.1, 0.2, 0.3]] * COUNT}}, ArgumentError, "shape"),
        ({"poses": {"cube": poses()}, "time": [0.0, 1.0]}, ArgumentError, "time"),
    ],
)
def test_wrong_states_are_errors(batch, state, error, message):
    ss, sim, _ = batch
    before = ss.eval("position(sim.cube);")
    with pytest.raises(error) as raised:
        sim.tick(**state)
    assert message in str(raised.value)
    assert np.array_equal(ss.eval("position(sim.cube);"), before)
