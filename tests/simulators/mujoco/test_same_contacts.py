"""The same bodies at rest in MuJoCo and in PyBullet: contacts and their forces."""

import pytest

import ssduck
from tests.support.bodies import create_linked_body, solid
from tests.support.mjcf import simulated
from tests.support.two_simulators import differences

mujoco, pybullet = pytest.importorskip("mujoco"), pytest.importorskip("pybullet")

# Boxes on each other, and one that touches nothing: (name, half size, position, mass). Beside them, a
# clamp: a plate that is fixed, and one that slides down on a thing.
STAGE = [
    ("table", (0.5, 0.5, 0.1), (0.0, 0.0, 0.1), 0.0),
    ("crate", (0.1, 0.1, 0.1), (0.0, 0.0, 0.3), 2.0),
    ("slab", (0.08, 0.08, 0.02), (0.0, 0.0, 0.42), 0.5),
    ("thing", (0.05, 0.05, 0.05), (1.0, 0.0, 1.06), 0.5),
    ("lonely", (0.1, 0.1, 0.1), (2.0, 0.0, 3.0), 0.0),
]
CLAMP = """<body name="clamp" pos="1 0 1"><geom type="box" size=".2 .2 .01" friction="0.5"/>
  <body name="jaw" pos="0 0 .14"><joint name="down" type="slide" axis="0 0 1"/>
    <geom type="box" size=".2 .2 .02" mass="1" friction="0.5"/></body></body>"""
STEP = 1 / 240


def stage_in_mujoco():
    bodies = "".join(
        f'<body name="{name}" pos="{x} {y} {z}">{"<freejoint/>" if mass else ""}'
        f'<geom type="box" size="{a} {b} {c}" mass="{mass or 1}" friction="0.5"/></body>'
        for name, (a, b, c), (x, y, z), mass in STAGE
    )
    option = f'<option timestep="{STEP}"/>'
    return simulated(f"<mujoco>{option}<worldbody>{bodies}{CLAMP}</worldbody></mujoco>", 480)


def stage_in_pybullet(client):
    names = {}
    for name, half, place, mass in STAGE:
        names[solid(client, pybullet.GEOM_BOX, mass, place, halfExtents=half)] = name
    plates = [
        pybullet.createCollisionShape(
            pybullet.GEOM_BOX, halfExtents=(0.2, 0.2, height), physicsClientId=client
        )
        for height in (0.01, 0.02)
    ]
    clamp = create_linked_body(
        client,
        0,
        plates[0],
        link_shape=plates[1],
        basePosition=[1, 0, 1],
        linkPositions=[[0, 0, 0.14]],
        linkJointTypes=[pybullet.JOINT_PRISMATIC],
    )
    pybullet.setJointMotorControl2(
        clamp, 0, pybullet.VELOCITY_CONTROL, force=0, physicsClientId=client
    )
    names[clamp] = "clamp"
    pybullet.setGravity(0, 0, -9.81, physicsClientId=client)
    for _ in range(480):
        pybullet.stepSimulation(physicsClientId=client)
    return names


# The masses that rest on things by what is on them, kg.
LOADS = {("clamp", "thing"): 1 + 1.5, ("table", "crate"): 2.5, ("crate", "slab"): 0.5}
RELATIONS = ("inContact", "hasContact", "grasped", "on", "restsOn", "touching")


@pytest.mark.slow
def test_contacts_agree(client):
    """Things at rest: solvers share out a force in their own ways, not its sum."""
    with ssduck.Interpreter(recording=None) as ss:
        ss.add_variable("p", ssduck.World.attach(client, stage_in_pybullet(client)))
        ss.add_variable("m", ssduck.World.attach(*stage_in_mujoco()))
        for relation in RELATIONS:
            query = f"SELECT id(a) AS a, id(b) AS b, {relation}(a, b) AS r FROM a=SIM, b=SIM"
            query += " WHERE id(a) != id(b) ORDER BY id(a), id(b);"
            assert differences(ss, query) == []
        for world in "pm":
            assert ss.eval(f"grasped({world}.clamp, {world}.thing);") is True
            for (a, b), mass in LOADS.items():
                force = ss.eval(f"contactForce({world}.{a}, {world}.{b});")
                assert force == pytest.approx(9.81 * mass, rel=0.02)
            assert ss.eval(f"contactForce({world}.crate, {world}.lonely);") == 0.0
            # What the slab and the table do to the crate carries its weight.
            assert ss.eval(f"force({world}.crate);") == pytest.approx([0, 0, 2 * 9.81], abs=0.4)
            assert ss.eval(f"torque({world}.slab);") == pytest.approx([0, 0, 0], abs=0.1)
            assert ss.eval(f"force({world}.lonely);") == [0.0, 0.0, 0.0]
