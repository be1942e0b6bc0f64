"""Records episodes of a small environment: a gripper moves between 18 bodies for two seconds."""

import gymnasium
import numpy as np

import ssduck
from ssduck.gym import QueryWrapper
from tests.support.of_model import OfModel

STEPS, STEP_TIME, TIMESTEP = 120, 1 / 60, 1 / 240
SHAPES = (
    'type="box" size=".03 .03 .03"',
    'type="sphere" size=".03"',
    'type="cylinder" size=".03 .03"',
    'type="capsule" size=".02 .03"',
)
# Where the bodies are that lie on the table, m.
PLACES = [(-0.32 + 0.16 * (i % 5), -0.24 + 0.16 * (i // 5)) for i in range(15)]


def model():
    """Returns the model of the environment: 20 bodies, 17 of which move."""
    lying = "".join(
        f'<body name="thing_{i}" pos="{x} {y} .44"><freejoint/>'
        f'<geom {SHAPES[i % 4]} mass=".1"/></body>'
        for i, (x, y) in enumerate(PLACES)
    )
    return f"""
<mujoco>
  <option timestep="{TIMESTEP}"/>
  <worldbody>
    <body name="table" pos="0 0 .2"><geom type="box" size=".6 .6 .2"/></body>
    <body name="wall" pos=".7 0 .5"><geom type="box" size=".05 .6 .5"/></body>
    <body name="gripper" pos="-.5 0 .5">
      <joint name="x" type="slide" axis="1 0 0" damping="8"/>
      <joint name="y" type="slide" axis="0 1 0" damping="8"/>
      <geom type="box" size=".04 .04 .06" mass=".5"/>
      <geom type="capsule" size=".015 .05" pos=".05 0 0" mass=".1"/>
    </body>
    <body name="cup" pos="-.35 0 .45"><freejoint/>
      <geom type="cylinder" size=".04 .05" mass=".2"/></body>
    {lying}
    <body name="bin" pos="-.7 0 .3"><geom type="box" size=".05 .3 .3"/></body>
  </worldbody>
  <actuator>
    <motor joint="x" ctrlrange="-4 4"/><motor joint="y" ctrlrange="-4 4"/>
  </actuator>
</mujoco>
"""


class Push(OfModel):
    """The gripper is pushed by forces that change with the seed."""

    action_space = gymnasium.spaces.Box(-4, 4, (2,), np.float32)

    def __init__(self):
        super().__init__(model(), round(STEP_TIME / TIMESTEP))

    def start(self):
        self.data.qpos[:2] = self.np_random.uniform((-0.05, -0.1), (0.05, 0.1))
        self.goal = float(self.np_random.uniform(-0.3, -0.1))

    def step(self, action):
        self.data.ctrl[:] = action
        return super().step(action)


SUCCESS = "x(sim.cup) > goal AND on(sim.table, sim.cup)"
REWARD = {"near": "-distance(sim.gripper, sim.cup)", "done": "10 * int(success)"}


def record_episodes(folder, count, first=0, steps=STEPS):
    """Records episodes into a folder, with seeds from `first` on."""
    env = QueryWrapper(
        Push(),
        success=SUCCESS,
        reward=REWARD,
        variables={"goal": lambda env: env.goal},
        record_to=folder,
        recording=ssduck.Recording(tables=("links", "contacts")),
    )
    for seed in range(first, first + count):
        env.reset(seed=seed)
        random = np.random.default_rng(seed)
        force = random.uniform((0.0, -1.0), (4.0, 1.0))
        for step in range(steps):
            if step % 30 == 29:
                force = random.uniform((-4.0, -2.0), (4.0, 2.0))
            env.step(force)
    env.close()
