"""Contacts equal a loop over the simulators' own getters, by point, force and distance, at each step."""

from collections import defaultdict

import mujoco
import numpy as np
import pybullet
import pybullet_data
import pytest

import ssduck
from tests.support.mjcf import simulated

ALL = ssduck.Recording(tables=("entities", "links", "contacts"))
COLUMNS = 'a, link_a, b, link_b, ax, ay, az, bx, "by", bz, force, -depth'
VECTORS = "nx, ny, nz, fx, fy, fz"


def duck_drop(client):
    pybullet.loadURDF("plane.urdf", physicsClientId=client)
    pybullet.loadURDF("duck_vhacd.urdf", [0, 0, 0.38], physicsClientId=client)


def pile(client):
    pybullet.loadURDF("plane.urdf", physicsClientId=client)
    for n in range(4):
        place = [0.01 * n, 0.005 * n, 0.1 + 0.08 * n]
        pybullet.loadURDF("cube_small.urdf", place, physicsClientId=client)
        pybullet.loadURDF("sphere_small.urdf", [0.02 * n, 0.2, place[2]], physicsClientId=client)


def batch(client):
    """Bodies that PyBullet makes by one call, of which its list has the last one only."""
    pybullet.loadURDF("plane.urdf", physicsClientId=client)
    ball = pybullet.createCollisionShape(pybullet.GEOM_SPHERE, radius=0.05, physicsClientId=client)
    places = [[0.04 * n, 0, 0.2 + 0.11 * n] for n in range(5)]
    pybullet.createMultiBody(0.1, ball, batchPositions=places, physicsClientId=client)


def robot(client):
    """A robot that stands on its wheels, which are links."""
    pybullet.loadURDF("plane.urdf", physicsClientId=client)
    pybullet.loadURDF("r2d2.urdf", [0, 0, 0.48], physicsClientId=client)


SCENES = {scene.__name__: scene for scene in (duck_drop, pile, batch, robot)}
# The quick form has the first impacts.
STEPS = [pytest.param(90), pytest.param(2000, marks=pytest.mark.long)]


def points_of_pybullet(client, ids):
    """The rows of contacts by PyBullet's getter: where shapes meet, or the solver presses."""
    for point in pybullet.getContactPoints(physicsClientId=client):
        sides = (ids[point[1]], point[3] + 1, *point[5]), (ids[point[2]], point[4] + 1, *point[6])
        (a, link_a, *at_a), (b, link_b, *at_b) = sorted(sides)
        if point[8] <= 0 or point[9] > 0:
            sign = 1 if sides[0] < sides[1] else -1
            normal = [sign * x for x in point[7]]
            friction = [point[10] * x + point[12] * y for x, y in zip(*point[11::2], strict=True)]
            forces = [point[9] * n + sign * f for n, f in zip(normal, friction, strict=True)]
            numbers = (*at_a, *at_b, point[9], point[8], *normal, *forces)
            yield (a, link_a, b, link_b, *numbers)


@pytest.mark.slow
@pytest.mark.parametrize("steps", STEPS)
@pytest.mark.parametrize("scene", SCENES.values(), ids=SCENES)
def test_contacts_of_pybullet(client, scene, steps):
    pybullet.setAdditionalSearchPath(pybullet_data.getDataPath(), physicsClientId=client)
    pybullet.setGravity(0, 0, -9.81, physicsClientId=client)
    scene(client)
    with ssduck.Interpreter(recording=ALL) as ss:
        world = ss.add_variable("sim", ssduck.World.attach(client))
        handles = range(len(world))
        ids = dict(zip(handles, (entity.id for entity in world), strict=True))
        pushes, apart, plane = [], 0, ids[0]
        for _ in range(steps):
            pybullet.stepSimulation(client)
            world.tick()
            expected = sorted(points_of_pybullet(client, ids))
            rows = ss.sql(f"SELECT {COLUMNS}, {VECTORS} FROM sim.contacts").fetchall()
            assert rows == expected  # they are in order
            apart += sum(row[11] > 0 for row in expected)
            forces = defaultdict(float)
            for row in expected:
                forces[row[0], row[2]] += row[10]
            pushes.append(forces[plane, ids[1]])
        assert apart or scene is not duck_drop  # some are pressed at a distance
        assert any(row[3] for row in expected) is (scene is robot)  # of links beyond the base
        hardest = max(pushes)
        first = next(step for step, push in enumerate(pushes, 1) if push > 0)
        one = ", ".join(f"sim.{entity.name}" for entity in list(world)[:2])
        changes = ss.eval(f"changes(inContact({one}));")
        assert next(time for time, holds in changes if holds) == pytest.approx(first / 240)
        time, force = ss.eval(f"greatest(contactForce({one}));")
        assert (time, force) == pytest.approx(((pushes.index(hardest) + 1) / 240, hardest))
        pybullet.removeBody(1, client)
        world.tick()
        expected = sorted(points_of_pybullet(client, ids))
        assert ss.sql(f"SELECT {COLUMNS}, {VECTORS} FROM sim.contacts").fetchall() == expected


# -- MuJoCo ------------------------------------------------------------------------------------

PUSHED = """
<mujoco><option cone="{cone}"/><default><geom margin="{margin}"/></default>
<worldbody>
  <geom type="plane" size="2 2 .1"/>
  <body name="crate" pos="0 0 .06"><freejoint/><geom type="box" size=".1 .1 .05" mass="2"/></body>
  <body name="lid" pos=".02 .01 .16" quat=".98 .1 .1 0"><freejoint/>
    <geom type="box" size=".08 .08 .02" mass=".5"/><geom type="sphere" size=".03" pos="0 0 .04"/></body>
  <body name="arm" pos="-.32 0 .1"><joint name="slide" type="slide" axis="1 0 0" damping="5"/>
    <geom type="capsule" size=".03" fromto="-.2 0 0 .2 0 0" mass="1"/></body>
</worldbody>
<actuator><motor joint="slide" gear="8"/></actuator></mujoco>
"""
CLOTH = """
<mujoco><option solver="CG"/><worldbody>
  <geom name="floor" type="plane" size="2 2 .1"/>
  <body name="box" pos="0 0 .05"><freejoint/><geom type="box" size=".07 .07 .05" mass="5"/></body>
  <flexcomp name="cloth" type="grid" count="4 4 1" spacing=".05 .05 .05" pos="0 0 .13" radius=".01"
    mass=".5" dim="2"><contact condim="3" solref="0.01 1" selfcollide="none"/>
    <edge equality="true"/></flexcomp>
</worldbody></mujoco>
"""
# Every number of friction axes, and contacts at a distance that a margin allows.
SLIDING = '<mujoco><option cone="{cone}" gravity="3 0 -9.81"/><worldbody><geom type="plane" size="0 0 1" condim="1" margin="0.01"/>'
SLIDING += "".join(
    f'<body pos="{n} 0 .099"><joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 0 1"/>'
    f'<geom type="{kind}" size=".1 .1 .1" condim="{dim}" margin="{margin}" friction=".7 .1 .2"/></body>'
    for n, (kind, dim, margin) in enumerate(
        [("box", 1, 0), ("sphere", 3, 0), ("box", 4, 0), ("sphere", 6, 0.02), ("box", 3, 0.02)]
    )
)
SLIDING += "</worldbody></mujoco>"
MODELS = {
    "sliding, elliptic": SLIDING.format(cone="elliptic"),
    "sliding, pyramidal": SLIDING.format(cone="pyramidal"),
    "elliptic": PUSHED.format(cone="elliptic", margin=0.0),
    "margin": PUSHED.format(cone="pyramidal", margin=0.004),
    "cloth": CLOTH,
}
if hasattr(mujoco.MjModel, "geom_adhesion"):  # since MuJoCo 4
    MODELS |= {
        f"adhesion, {cone}": PUSHED.format(cone=cone, margin=0.004).replace(
            "<geom ", '<geom adhesion="3" '
        )
        for cone in ("elliptic", "pyramidal")
    }


def points_of_mujoco(model, data, handles):
    """The rows of contacts by MuJoCo's getter: where shapes meet, or the solver presses."""
    force = np.zeros(6)
    for number, contact in enumerate(data.contact):
        mujoco.mj_contactForce(model, data, number, force)
        if contact.dist > 0 and force[0] <= 0:
            continue
        sides = []
        for side in (0, 1):
            body = model.geom_bodyid[contact.geom[side]]
            root = model.body_rootid[body]
            if contact.geom[side] < 0:  # the vertices of the only flex are a body each
                corners = model.flex_elem.reshape(-1, 3)[contact.elem[side]]
                gaps = np.linalg.norm(data.flexvert_xpos[corners] - contact.pos, axis=1)
                body = model.flex_vertbodyid[corners[gaps.argmin()]]
                root = model.flex_vertbodyid[0]
            sides.append((handles[root], int(body - root), *contact.pos))
        (a, link_a, *at_a), (b, link_b, *at_b) = sorted(sides)
        frame = contact.frame.reshape(3, 3) * (1 if sides[0] < sides[1] else -1)
        vectors = (*-frame[0], *(-force[:3] @ frame))
        yield (a, link_a, b, link_b, *at_a, *at_b, force[0], contact.dist, *vectors)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*has moved on")
@pytest.mark.parametrize("steps", STEPS)
@pytest.mark.parametrize("text", MODELS.values(), ids=MODELS)
def test_contacts_of_mujoco(text, steps):
    """They are asked for after another step, which changes nothing that a tick has read."""
    model, data = simulated(text)
    with ssduck.Interpreter(recording=None) as ss:
        world = ss.add_variable("sim", ssduck.World.attach(model, data))
        query = f"SELECT {COLUMNS}, {VECTORS} FROM sim.contacts"
        ss.sql(query).fetchall()  # the first question reads the table anew
        handles = {body.handle: id for id, body in world.snapshot.layout.bodies}
        count = 0
        data.ctrl[:] = 1.0
        mujoco.mj_step(model, data)
        for _ in range(steps):
            world.tick()
            expected = np.array(sorted(points_of_mujoco(model, data, handles))).reshape(-1, 18)
            mujoco.mj_step(model, data)
            found = np.array(sorted(ss.sql(query).fetchall())).reshape(-1, 18)
            assert found == pytest.approx(expected, abs=1e-9, rel=1e-12)
            count += len(expected)
        assert count > steps / 2


# -- bodies asleep -----------------------------------------------------------------------------

SLEEPY = """
<mujoco><option><flag sleep="enable"/></option><worldbody>
  <geom name="floor" type="plane" size="2 2 .1"/>
  <body name="box" pos="0 0 .1" {sleep}><freejoint/><geom name="g" type="box" size=".1 .1 .1" mass="1"/>
    <site name="s" type="box" size=".11 .11 .11"/></body>
  <body name="book" pos="0 0 .22" {sleep}><freejoint/><geom type="box" size=".1 .1 .02" mass="2"/></body>
  <body name="ball" pos="1 0 2"><freejoint/><geom type="sphere" size=".1" mass="1"/></body>
</worldbody>
<sensor><contact geom1="g" data="found"/><touch site="s"/></sensor></mujoco>
"""
HAS_SLEEP = pytest.mark.skipif(
    not hasattr(mujoco.mjtEnableBit, "mjENBL_SLEEP"), reason="nothing sleeps before MuJoCo 3.4"
)


@pytest.mark.slow
@HAS_SLEEP
@pytest.mark.parametrize("forward", [False, True])
def test_what_sleeps_keeps_its_contacts(forward):
    """MuJoCo's own sensors tell: they keep what they had when the bodies fell asleep."""
    with ssduck.Interpreter(recording=ALL) as ss:
        model, data = simulated(SLEEPY.format(sleep=""))
        world = ss.add_variable("sim", ssduck.World.attach(model, data, forward=forward))
        flags, slept = model.opt.enableflags, 0
        mujoco.mj_step(model, data, 3)
        while data.time < 1.0:
            mujoco.mj_step(model, data)
            world.tick()
            found, touch = data.sensordata
            rows = ss.sql(
                "SELECT force FROM sim.contacts, entities e WHERE e.name = 'box' AND e.id IN (a, b)"
            ).fetchall()
            slept += data.tree_asleep[0] >= 0
            if data.tree_asleep[0] >= 0 or not forward:
                assert len(rows) == found == 8
                assert sum(force for (force,) in rows) == pytest.approx(touch, rel=1e-3)
        assert slept > 10
        assert data.ncon < 8  # those of the ball alone
        assert model.opt.enableflags == flags
        answers = (
            "[inContact(sim.world, sim.box), hasContact(sim.book, sim.box), on(sim.box, sim.book)];"
        )
        assert ss.eval(answers) == [True] * 3
        assert ss.eval("contactForce(sim.box, sim.book);") == pytest.approx(2 * 9.81, rel=0.01)
        assert ss.eval("force(sim.box);")[2] == pytest.approx(9.81, rel=0.01)
        held = ss.eval("holds(inContact(sim.box, sim.book));")
        assert held[-1][0] <= 0.01
        assert held[-1][1] == world.time


@HAS_SLEEP
def test_what_begins_asleep_has_contacts_and_what_wakes_has_its_own():
    with ssduck.Interpreter(recording=None) as ss:
        model, data = simulated(SLEEPY.format(sleep='sleep="init"'))
        world = ss.add_variable("sim", ssduck.World.attach(model, data))
        mujoco.mj_step(model, data, 5)
        world.tick()
        assert data.tree_asleep[0] >= 0
        assert ss.eval("hasContact(sim.box, sim.book);") is True
        data.xfrc_applied[model.body("book").id, 2] = 100.0
        mujoco.mj_step(model, data, 40)
        world.tick()
        assert ss.eval("hasContact(sim.box, sim.book);") is False
