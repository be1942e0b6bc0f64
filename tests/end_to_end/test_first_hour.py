"""The first hour with a simulation of one's own: an arm pushes a cube off a table.

The bodies are PyBullet's own, the loop is the user's: `stepSimulation`, then `tick`. In the same loop
plain Python asks PyBullet's getters; the answers are the same, to the step and to the last bit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import pybullet
import pybullet_data
import pytest

import ssduck

STEPS = 1440
STEP = 1 / 240
HOME = [0.0, 0.2, 0.0, -2.2, 0.0, 2.4, 0.8]
# PyBullet's number of the link panda_leftfinger, and of the frame between the fingers.
LEFT_FINGER, GRASP = 9, 11


@dataclass
class Loop:
    """The user's client, what plain Python notes of each step, and the interpreter beside it."""

    client: int
    plane: int = 0
    table: int = 0
    panda: int = 0
    cube: int = 0
    # By step: the normal forces of the left finger on the cube; whether cube and table, and cube and
    # plane, touch; the height of the cube.
    finger: dict[int, list[float]] = field(default_factory=dict)
    on_table: list[bool] = field(default_factory=list)
    on_plane: list[bool] = field(default_factory=list)
    height: list[float] = field(default_factory=list)

    def build(self):
        """Loads PyBullet's own models."""
        client = {"physicsClientId": self.client}
        pybullet.setAdditionalSearchPath(pybullet_data.getDataPath(), **client)
        pybullet.setGravity(0, 0, -9.81, **client)
        self.plane = pybullet.loadURDF("plane.urdf", **client)
        self.table = pybullet.loadURDF("table/table.urdf", [0.5, 0, 0], useFixedBase=True, **client)
        self.panda = pybullet.loadURDF(
            "franka_panda/panda.urdf", [-0.2, 0, 0.625], useFixedBase=True, **client
        )
        self.cube = pybullet.loadURDF("cube_small.urdf", [0.4, 0.3, 0.66], **client)
        for joint, angle in enumerate(HOME):
            pybullet.resetJointState(self.panda, joint, angle, **client)

    def drive(self, step):
        """Moves the fingers beside the cube, then across the table, then up."""
        time = step * STEP
        if time < 1.5:
            target = [0.4, 0.15, 0.72]
        elif time < 4.5:
            target = [0.4, 0.15 + 0.15 * (time - 1.5), 0.64]
        else:
            target = [0.4, 0.6, 0.8]
        angles = pybullet.calculateInverseKinematics(
            self.panda,
            GRASP,
            target,
            pybullet.getQuaternionFromEuler([math.pi, 0, math.pi / 2]),
            lowerLimits=[-2.9, -1.8, -2.9, -3.1, -2.9, 0, -2.9],
            upperLimits=[2.9, 1.8, 2.9, 0, 2.9, 3.8, 2.9],
            jointRanges=[5.8] * 7,
            restPoses=HOME,
            physicsClientId=self.client,
        )
        control = {"controlMode": pybullet.POSITION_CONTROL, "physicsClientId": self.client}
        pybullet.setJointMotorControlArray(
            self.panda, range(7), targetPositions=angles[:7], **control
        )
        pybullet.setJointMotorControlArray(
            self.panda, [9, 10], targetPositions=[0.0, 0.0], **control
        )

    def note(self):
        """Asks PyBullet about the last step."""

        def points(a, b):
            found = pybullet.getContactPoints(a, b, physicsClientId=self.client)
            # Separate shapes do not touch, unless the solver presses them.
            return [point for point in found if point[8] <= 0 or point[9] > 0]

        step = len(self.height) + 1
        forces = [p[9] for p in points(self.panda, self.cube) if p[3] == LEFT_FINGER]
        if forces:
            self.finger[step] = forces
        self.on_table.append(bool(points(self.table, self.cube)))
        self.on_plane.append(bool(points(self.plane, self.cube)))
        position, _ = pybullet.getBasePositionAndOrientation(self.cube, self.client)
        self.height.append(position[2])


@pytest.fixture(scope="module")
def hour():
    """The loop, after its last step."""
    client = pybullet.connect(pybullet.DIRECT)
    loop = Loop(client)
    loop.build()
    with ssduck.Interpreter() as ss:
        sim = ss.add_variable("sim", ssduck.World.attach(client))
        for step in range(STEPS):
            loop.drive(step)
            pybullet.stepSimulation(client)
            sim.tick()
            loop.note()
        yield loop, ss
    pybullet.disconnect(client)


def test_time_went_on_with_each_step(hour):
    _, ss = hour
    assert ss.call_variable("sim").time == pytest.approx(STEPS * STEP, abs=1e-12)
    rows = ss.sql("SELECT tick, time FROM ticks_history ORDER BY tick").fetchall()
    assert [tick for tick, _ in rows] == list(range(1, STEPS + 2))
    assert [time for _, time in rows] == pytest.approx(
        [n * STEP for n in range(STEPS + 1)], abs=1e-12
    )


def test_the_finger_touched_the_cube(hour):
    """When first, and with what greatest force: to the step, and to the last bit."""
    loop, ss = hour
    rows = ss.sql(
        """
        SELECT c.tick - 1, c.force
        FROM contacts_history c
        JOIN entities_model a ON c.a = a.id JOIN entities_model b ON c.b = b.id
        WHERE a.name = 'panda' AND c.link_a = ? AND b.name = 'cube'
        """,
        [LEFT_FINGER + 1],
    ).fetchall()
    steps = {}
    for step, force in rows:
        steps.setdefault(step, []).append(force)
    assert {step: sorted(forces) for step, forces in steps.items()} == {
        step: sorted(forces) for step, forces in loop.finger.items()
    }
    assert min(steps) == min(loop.finger) > 240
    greatest = max(max(forces) for forces in loop.finger.values())
    assert max(force for _, force in rows) == greatest > 1.0


@pytest.mark.slow
def test_questions_about_the_finger_as_a_value(hour):
    """In SelectScript and in raw SQL: when, with what force, and where it was."""
    loop, ss = hour
    steps = sorted(step for step, forces in loop.finger.items() if max(forces) > 0)
    finger = "sim.panda.panda_leftfinger"
    times = pytest.approx([step * STEP for step in steps], abs=1e-12)
    of_links = f"FROM links(sim{{}}) WHERE this == {finger} AND inContact(this, sim.cube)"
    assert ss.eval(f"SELECT time {of_links} AS list;") == times
    of_cube = f"FROM sim{{}} WHERE this == sim.cube AND inContact({finger}, this)"
    assert ss.eval(f"SELECT time {of_cube} AS list;") == times
    first = ss.eval(f"min(SELECT time {of_links} AS list);")
    assert first == pytest.approx(steps[0] * STEP, abs=1e-12)
    changes = ss.eval(f"changes(inContact({finger}, sim.cube));")
    assert next(time for time, holds in changes if holds) == first
    forces = [math.fsum(loop.finger[step]) for step in steps]
    time, force = ss.eval(f"greatest(contactForce({finger}, sim.cube));")
    assert force == pytest.approx(max(forces), abs=1e-9)
    assert time == times.expected[forces.index(max(forces))]
    found = ss.eval(f"SELECT contactForce(this, sim.cube) {of_links} AS list;")
    assert found == pytest.approx(forces, abs=1e-9)
    rows = ss.sql("""
        SELECT l.time, contactForce(l, e) FROM links_history l JOIN entities_history e USING (tick)
        WHERE l.full_name = 'panda.panda_leftfinger' AND e.name = 'cube' AND inContact(l, e)
        ORDER BY tick
    """).fetchall()
    assert [time for time, _ in rows] == times
    assert [force for _, force in rows] == pytest.approx(forces, abs=1e-9)


def test_the_cube_left_the_table(hour):
    """Each time at which cube and table began or ceased to touch."""
    loop, ss = hour
    changes = ss.eval("changes(inContact(sim.table, sim.cube));")
    touching = [False, *loop.on_table]
    expected = [0] + [n for n in range(1, STEPS + 1) if touching[n] != touching[n - 1]]
    assert [time for time, _ in changes] == pytest.approx([n * STEP for n in expected], abs=1e-12)
    assert [value for _, value in changes] == [touching[n] for n in expected]
    last = max(n for n in range(STEPS + 1) if touching[n])
    assert 720 < last < 1000
    ((time,),) = ss.sql("""
        SELECT max(c.time) FROM contacts_history c
        JOIN entities_model a ON c.a = a.id JOIN entities_model b ON c.b = b.id
        WHERE a.name = 'table' AND b.name = 'cube'
    """).fetchall()
    assert time == pytest.approx(last * STEP, abs=1e-12)


@pytest.mark.slow
def test_how_long_the_cube_rests(hour):
    loop, ss = hour
    start = STEPS + 1
    while loop.on_plane[start - 2] and loop.height[start - 2] < 0.03:
        start -= 1
    assert 960 < start < STEPS
    condition = "inContact(sim.plane, sim.cube) AND z(sim.cube) < 0.03"
    assert ss.eval(f"since({condition});") == pytest.approx(start * STEP, abs=1e-12)
    assert ss.eval(f"heldFor({condition});") == pytest.approx((STEPS - start) * STEP, abs=1e-12)
    heights = ss.sql(
        "SELECT z FROM entities_history WHERE name = 'cube' AND tick > 1 ORDER BY tick"
    ).fetchall()
    assert [z for (z,) in heights] == pytest.approx(loop.height, abs=1e-9)
