"""A PyBullet client with an arm that presses on a cube, and interpreters of its world."""

import pytest

import ssduck
from ssduck.schema import RECORDABLE

pybullet = pytest.importorskip("pybullet")
pybullet_data = pytest.importorskip("pybullet_data")

STEPS = 120


class Cell:
    """An arm that presses on a cube: the client, the bodies' numbers, the world.

    The arm and the cube start in contact and move for `STEPS` steps, each recorded. The tables
    of the interpreters are those of the last tick.
    """

    def __init__(self):
        self.client = client = pybullet.connect(pybullet.DIRECT)
        pybullet.setAdditionalSearchPath(pybullet_data.getDataPath(), client)
        pybullet.setGravity(0, 0, -9.81, client)
        fixed = {"useFixedBase": True, "physicsClientId": client}
        self.plane = pybullet.loadURDF("plane.urdf", [0, 0, -0.65], physicsClientId=client)
        self.table = pybullet.loadURDF("table/table.urdf", [0.5, 0, -0.65], **fixed)
        self.panda = pybullet.loadURDF("franka_panda/panda.urdf", **fixed)
        self.cube = pybullet.loadURDF("cube_small.urdf", [0.5, 0.05, 0.01], physicsClientId=client)
        self.movable = [
            joint
            for joint in range(pybullet.getNumJoints(self.panda, client))
            if pybullet.getJointInfo(self.panda, joint, client)[2] != pybullet.JOINT_FIXED
        ]
        self.numbers = {
            pybullet.getJointInfo(self.panda, joint, client)[12].decode(): joint
            for joint in range(pybullet.getNumJoints(self.panda, client))
        }
        self.place([0.5, -0.05, 0.02])
        self.contacts, self.ticks = [], []
        self.world = ssduck.World.attach(client)
        self.interpreters = []
        for row_by_row in (False, True):
            recording = ssduck.Recording(tables=RECORDABLE)
            ss = ssduck.Interpreter(row_by_row=row_by_row, recording=recording)
            ss.add_variable("sim", self.world)
            self.interpreters.append(ss)
        for step in range(STEPS):
            self.drive([0.5, 0.001 * step - 0.05, 0.02])
            pybullet.stepSimulation(client)
            self.ticks.append(self.world.tick().snapshot.number)
            self.contacts.append(pybullet.getContactPoints(physicsClientId=client))

    def targets(self, position):
        down = pybullet.getQuaternionFromEuler([3.14159, 0, 0])
        return pybullet.calculateInverseKinematics(
            self.panda, 11, position, down, maxNumIterations=200, physicsClientId=self.client
        )

    def place(self, position):
        for joint, angle in zip(self.movable, (0, -0.3, 0, -2.2, 0, 2.0, 0.8), strict=False):
            pybullet.resetJointState(self.panda, joint, angle, physicsClientId=self.client)
        for _ in range(5):
            for joint, angle in zip(self.movable, self.targets(position), strict=True):
                pybullet.resetJointState(self.panda, joint, angle, physicsClientId=self.client)

    def drive(self, position):
        pybullet.setJointMotorControlArray(
            self.panda,
            self.movable,
            pybullet.POSITION_CONTROL,
            self.targets(position),
            physicsClientId=self.client,
        )

    @property
    def ss(self):
        return self.interpreters[0]

    def forces(self, a, link_a, b):
        """The sum of the normal forces of a link on a body at each tick, by PyBullet's contacts.

        Those of shapes that are still apart, which PyBullet's solver slows down, are no contacts.
        """
        totals = []
        for contacts in self.contacts:
            total = 0.0
            for contact in contacts:
                sides = [(contact[1], contact[3]), (contact[2], contact[4])]
                for (body, link), (other, _) in (sides, sides[::-1]):
                    is_of_link = (body, link, other) == (a, link_a, b)
                    if is_of_link and (contact[8] <= 0 or contact[9] > 0):
                        total += contact[9]
            totals.append(total)
        return totals

    def close(self):
        for ss in self.interpreters:
            ss.close()
        pybullet.disconnect(self.client)
