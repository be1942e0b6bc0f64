"""Small environments of gymnasium on MuJoCo and PyBullet."""

import gymnasium
import numpy as np
import pytest

from tests.support.bodies import solid
from tests.support.of_model import OfModel

pybullet = pytest.importorskip("pybullet")

PUSH = """
<mujoco>
  <option timestep="0.002"/>
  <worldbody>
    <geom name="floor" type="plane" size="0 0 .1"/>
    <body name="table" pos="0 0 .2"><geom type="box" size=".5 .5 .2"/></body>
    <body name="pusher" pos="-.3 0 .45">
      <joint name="push" type="slide" axis="1 0 0" damping="5"/>
      <geom type="box" size=".05 .05 .04" mass="1"/><site name="tray" pos="0 0 .04"/>
    </body>
    <body name="ball" pos="0 0 .45"><freejoint/><geom type="sphere" size=".05" mass=".1"/></body>
  </worldbody>
  <actuator><motor joint="push" gear="10" ctrlrange="-1 1"/></actuator>
</mujoco>
"""


class Push(OfModel):
    """A slide pushes a ball along a table, to a goal that only Python knows.

    Args:
        rebuilds: whether each reset makes a new model.
        most: the number of steps after which an episode is over.
    """

    def __init__(self, *, rebuilds=False, most=1000):
        super().__init__(PUSH, 5)
        self.rebuilds, self.most, self.steps = rebuilds, most, 0
        self.goal = np.zeros(3)

    def reset(self, *, seed=None, options=None):
        if self.rebuilds:
            self.build()
        return super().reset(seed=seed)

    def start(self):
        self.goal = np.array([self.np_random.uniform(0.02, 0.1), 0.0, 0.45])
        self.steps = 0

    def step(self, action):
        self.data.ctrl[:] = action
        observation, *_ = super().step(action)
        self.steps += 1
        reward = -float(np.linalg.norm(self.data.body("ball").xpos - self.goal))
        return observation, reward, False, self.steps >= self.most, {}


class Drop(gymnasium.Env):
    """A cube falls onto the ground, in PyBullet; each reset builds the simulation.

    Args:
        reconnects: whether each reset connects a new client.
    """

    def __init__(self, *, reconnects=False):
        self.reconnects = reconnects
        self.physics_client = pybullet.connect(pybullet.DIRECT)
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (3,), np.float64)
        self.action_space = gymnasium.spaces.Discrete(2)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        if self.reconnects:
            before = self.physics_client
            self.physics_client = pybullet.connect(pybullet.DIRECT)
            pybullet.disconnect(before)
        client = self.physics_client
        pybullet.resetSimulation(physicsClientId=client)
        pybullet.setGravity(0, 0, -9.81, client)
        for mass, half, height in ((0, (5, 5, 0.5), -0.5), (1, (0.1, 0.1, 0.1), 0.5)):
            self.cube = solid(client, pybullet.GEOM_BOX, mass, (0, 0, height), halfExtents=half)
        return self._observation(), {}

    def _observation(self):
        return np.array(pybullet.getBasePositionAndOrientation(self.cube, self.physics_client)[0])

    def step(self, action):
        for _ in range(4):
            pybullet.stepSimulation(self.physics_client)
        return self._observation(), 0.0, False, False, {}

    def close(self):
        pybullet.disconnect(self.physics_client)


# A task file, and the model that it names.
TASK = """
scene = "push.xml"
success = "x(sim.ball) > goal"
failure = "z(sim.ball) < 0.3"
stop_when = "success OR failure"
seeds = [1, 2]
steps = 8
step_time = 0.02

[reward]
near = "-distance(sim.pusher, sim.ball)"
done = "10 * int(success)"

[variables]
goal = 0.05

[observation]
pusher = "x(sim.pusher)"
ball = "x(sim.ball)"

[[actions]]
entity = "pusher"
joint = "push"
control = "velocity"
low = -1
high = 1

[[starts]]
entity = "ball"
low = [0, -0.1, 0.45]
high = [0.04, 0.1, 0.45]
"""
TASK_MODEL = PUSH.replace('<motor joint="push" gear="10"', '<velocity joint="push" kv="50"')
