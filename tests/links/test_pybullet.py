"""Links are where PyBullet has them: poses, velocities, boxes, distances, contacts."""

import math

import numpy as np
import pybullet
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import ssduck
from tests.support.bodies import create_linked_body
from tests.support.cases import sampled
from tests.support.cell import STEPS

FINGERS = ("panda_leftfinger", "panda_rightfinger")


def links_of(cell):
    return cell.world["panda"].links


def test_poses_and_velocities(cell):
    for link in links_of(cell)[1:]:
        state = pybullet.getLinkState(cell.panda, link.number - 1, 1, 1, cell.client)
        x, y, z, w = state[5]
        sign = math.copysign(1, np.dot(link.orientation, [w, x, y, z]))
        assert link.position == pytest.approx(state[4], abs=1e-6)
        assert link.orientation == pytest.approx(sign * np.array([w, x, y, z]), abs=1e-6)
        assert link.pose == link.orientation + link.position
        # PyBullet's velocity is that of the centre of mass.
        arm = np.array(state[4]) - state[0]
        velocity = np.array(state[6]) + np.cross(state[7], arm)
        assert link.velocity == pytest.approx([*velocity, *state[7]], abs=1e-5)
        assert link.mass == pybullet.getDynamicsInfo(cell.panda, link.number - 1, cell.client)[0]


def test_boxes_are_within_those_of_pybullet(cell):
    for link in links_of(cell):
        low, high = link.aabb
        outer = pybullet.getAABB(cell.panda, link.number - 1, cell.client)
        if link.name not in ("panda_link8", "panda_grasptarget"):  # they have no shapes
            assert (np.array(low) >= np.array(outer[0]) - 1e-6).all()
            assert (np.array(high) <= np.array(outer[1]) + 1e-6).all()
        values = cell.ss.eval(f"SELECT aabb FROM sim.panda.{link.name} AS value;")
        assert values == [low[0], high[0], low[1], high[1], low[2], high[2]]


@pytest.mark.slow
@pytest.mark.parametrize("name", [*FINGERS, "panda_hand", "panda_link6"])
@pytest.mark.parametrize(("other", "body"), [("cube", "cube"), ("table", "table")])
def test_distances(cell, name, other, body):
    points = pybullet.getClosestPoints(
        cell.panda,
        getattr(cell, body),
        1.0,
        linkIndexA=cell.numbers[name],
        physicsClientId=cell.client,
    )
    expected = min(point[8] for point in points)
    clearance = cell.ss.eval(f"clearance(sim.panda.{name}, sim.{other});")
    # PyBullet's distance leaves out both margins of hulls, 1 mm each.
    assert clearance == pytest.approx(max(expected, 0), abs=3e-3)
    for distance, holds in ((clearance + 1e-6, True), (clearance - 1e-6, clearance < 1e-6)):
        if distance >= 0:
            assert cell.ss.eval(f"near(sim.panda.{name}, sim.{other}, {distance});") is holds
            assert cell.ss.eval(f"near(sim.{other}, sim.panda.{name}, {distance});") is holds


@pytest.mark.slow
def test_contacts_at_the_last_tick(cell):
    for link in links_of(cell):
        for name in ("cube", "table", "plane"):
            force = cell.forces(cell.panda, link.number - 1, getattr(cell, name))[-1]
            arguments = f"sim.panda.{link.name}, sim.{name}"
            assert cell.ss.eval(f"contactForce({arguments});") == pytest.approx(force)
            assert cell.ss.eval(f"inContact({arguments});") is (force > 0)


@pytest.mark.slow
@sampled("name", FINGERS, every=2)
def test_contacts_at_every_tick(cell, name):
    forces = cell.forces(cell.panda, cell.numbers[name], cell.cube)
    if name == "panda_leftfinger":
        assert any(forces)
        assert not all(forces)
    touching = [tick for tick, force in zip(cell.ticks, forces, strict=True) if force > 0]
    link = f"sim.panda.{name}"
    for ss in cell.interpreters:
        found = ss.eval(
            f"SELECT tick FROM links(sim{{}}) WHERE this == {link} AND inContact(this, sim.cube) "
            "AS list;"
        )
        assert found == touching
        found = ss.eval(
            f"SELECT contactForce({link}, this) FROM sim{{}} WHERE this == sim.cube AS list;"
        )
        assert found[-STEPS:] == pytest.approx(forces)
    rows = cell.ss.sql(
        "SELECT l.tick, sim.contactForce(l, c) FROM sim.links_history l "
        "JOIN sim.entities_history c USING (tick) WHERE l.full_name = $1 AND c.name = 'cube' "
        "AND sim.inContact(l, c) ORDER BY tick",
        [f"panda.{name}"],
    ).fetchall()
    assert [tick for tick, _ in rows] == touching
    assert [force for _, force in rows] == pytest.approx([force for force in forces if force > 0])


@pytest.mark.slow
def test_forces_on_the_links_of_a_body_sum_up_to_that_on_the_body(cell):
    whole = cell.ss.eval("force(sim.panda);")
    parts = cell.ss.eval("SELECT force FROM links(sim.panda) AS list;")
    assert np.sum(parts, axis=0) == pytest.approx(whole, abs=1e-9)
    torques = [cell.ss.eval(f"torque({name});") for name in ("sim.cube.baseLink", "sim.cube")]
    assert torques[0] == pytest.approx(torques[1], abs=1e-9)
    rows = cell.ss.sql("SELECT list_sum([sim.force(l)[3]]) FROM sim.links l WHERE l.entity = 3")
    assert sum(z for (z,) in rows.fetchall()) == pytest.approx(whole[2], abs=1e-9)


@pytest.fixture(scope="module")
def chain():
    """A free body of a base and two links, boxes of different sizes, and a box beside it."""
    client = pybullet.connect(pybullet.DIRECT)
    shapes = [
        pybullet.createCollisionShape(pybullet.GEOM_BOX, halfExtents=half, physicsClientId=client)
        for half in ([0.2, 0.1, 0.1], [0.1, 0.3, 0.05], [0.05, 0.05, 0.4], [0.15, 0.15, 0.15])
    ]
    body = create_linked_body(
        client,
        1,
        shapes[0],
        linkCollisionShapeIndices=shapes[1:3],
        linkPositions=[[0.5, 0, 0], [0, 0.6, 0]],
        linkJointTypes=[pybullet.JOINT_REVOLUTE] * 2,
        linkJointAxis=[[0, 0, 1], [1, 0, 0]],
    )
    box = pybullet.createMultiBody(1, shapes[3], physicsClientId=client)
    world = ssduck.World.attach(client, names={body: "chain", box: "box"})
    with ssduck.Interpreter(recording=None) as ss:
        ss.add_variable("sim", world)
        yield client, body, box, world, ss
    pybullet.disconnect(client)


NUMBERS = st.floats(-1, 1)


@pytest.mark.slow
@settings(suppress_health_check=list(HealthCheck))
@given(
    position=st.tuples(NUMBERS, NUMBERS, NUMBERS),
    angles=st.tuples(NUMBERS, NUMBERS, NUMBERS),
    joints=st.tuples(NUMBERS, NUMBERS),
)
def test_distances_of_links_in_any_pose(chain, position, angles, joints):
    client, body, box, world, ss = chain
    turn = pybullet.getQuaternionFromEuler(angles)
    pybullet.resetBasePositionAndOrientation(box, position, turn, client)
    for number, angle in enumerate(joints):
        pybullet.resetJointState(body, number, angle, physicsClientId=client)
    world.tick()
    links = world["chain"].links
    for link in links:
        points = pybullet.getClosestPoints(
            body, box, 9.0, linkIndexA=link.number - 1, physicsClientId=client
        )
        expected = max(0.0, min(point[8] for point in points))
        distance = ss.eval(f"clearance(sim.chain.{link.name}, sim.box);")
        # PyBullet is off by its collision margins.
        assert distance == pytest.approx(expected, abs=2e-3)
        low, high = link.aabb
        outer = pybullet.getAABB(body, link.number - 1, client)
        assert (np.array(low) >= np.array(outer[0]) - 1e-6).all()
        assert (np.array(high) <= np.array(outer[1]) + 1e-6).all()
    nearest = min(ss.eval("SELECT clearance(this, sim.box) FROM links(sim.chain) AS list;"))
    assert nearest == pytest.approx(ss.eval("clearance(sim.chain, sim.box);"), abs=1e-9)
    # Two links of one body are compared by their shapes.
    first, last = links[0], links[2]
    shapes = pybullet.getClosestPoints(
        body, body, 9.0, linkIndexA=-1, linkIndexB=1, physicsClientId=client
    )
    if shapes:
        distance = ss.eval(f"clearance(sim.chain.{first.name}, sim.chain.{last.name});")
        assert distance == pytest.approx(max(0.0, min(p[8] for p in shapes)), abs=2e-3)
