"""An environment of gymnasium on a model of MuJoCo's."""

import gymnasium
import mujoco
import numpy as np


class OfModel(gymnasium.Env):
    """An environment of a model of MuJoCo's: what is observed are its positions.

    Args:
        xml: the model.
        substeps: the physics steps of a step.
    """

    action_space = gymnasium.spaces.Box(-1, 1, (1,), np.float32)

    def __init__(self, xml, substeps=1):
        self.xml, self.substeps = xml, substeps
        self.build()
        self.observation_space = gymnasium.spaces.Box(-100, 100, (self.model.nq,), np.float64)

    def build(self):
        """Makes the simulation."""
        self.model = mujoco.MjModel.from_xml_string(self.xml)
        self.data = mujoco.MjData(self.model)

    def start(self):
        """Sets the state at the beginning of an episode."""

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        mujoco.mj_resetData(self.model, self.data)
        self.start()
        mujoco.mj_forward(self.model, self.data)
        return self.data.qpos.copy(), {}

    def step(self, action):
        mujoco.mj_step(self.model, self.data, self.substeps)
        return self.data.qpos.copy(), 0.0, False, False, {}
