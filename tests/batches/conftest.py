"""A model, and simulations of it in states of all kinds."""

import mujoco
import numpy as np
import pytest

import ssduck
from tests.support.cases import factor

MODEL = """
<mujoco><option timestep="0.01"/><worldbody>
  <geom name="floor" type="plane" size="2 2 0.1"/>
  <body name="table" pos="0 0 0.3"><geom type="box" size="0.4 0.4 0.02"/></body>
  <body name="cube" pos="0 0 0.36"><freejoint/>
    <geom type="box" size="0.03 0.03 0.03" mass="0.1"/><site name="top" pos="0 0 0.03"/></body>
  <body name="ball" pos="0.2 0 0.36"><freejoint/><geom type="sphere" size="0.04" mass="0.1"/></body>
  <body name="arm" pos="0.6 0 0.4">
    <geom type="capsule" fromto="0 0 0 0 0 0.2" size="0.02"/>
    <body name="hand" pos="0 0 0.2"><joint name="elbow" axis="0 1 0" range="-1 1" limited="true"/>
      <geom type="capsule" fromto="0 0 0 -0.3 0 0" size="0.02" mass="0.2"/></body></body>
</worldbody></mujoco>
"""
# In `make long`, many environments.
COUNT = 8 if factor() == 1 else 256


class States(list):
    """Data of simulations, with a world that takes the state of each, one after the other."""

    single = None

    def worlds(self, model):
        """Yields an interpreter with a world, `sim`, at the present state of each simulation."""
        if self.single is None:
            self.single = ssduck.Interpreter(recording=None), mujoco.MjData(model)
            self.single[0].add_variable("sim", ssduck.World.attach(model, self.single[1]))
        ss, data = self.single
        for state in self:
            mujoco.mj_copyData(data, model, state)
            ss["sim"].tick()
            yield ss

    def close(self):
        if self.single is not None:
            self.single[0].close()


def simulations(count=COUNT, seed=0):
    """Returns a model, and data in random states near the table, stepped once."""
    model = mujoco.MjModel.from_xml_string(MODEL)
    draw, states = np.random.default_rng(seed), States()
    for number in range(count):
        data = mujoco.MjData(model)
        low = [-0.3, -0.3, 0.32] if number % 2 else [-0.05, -0.05, 0.345]
        data.qpos[:3] = draw.uniform(low, [0.3, 0.3, 0.45])
        data.qpos[7:10] = draw.uniform([-0.1, -0.1, 0.35], [0.1, 0.1, 0.4])
        data.qpos[14] = draw.uniform(-1, 1)
        data.qvel[:] = draw.normal(0, 0.3, model.nv)
        mujoco.mj_step(model, data)
        states.append(data)
    return model, states


@pytest.fixture
def batch():
    """An interpreter with a batch `sim`, its model and its data."""
    model, states = simulations()
    with ssduck.Interpreter(recording=None) as ss:
        sim = ss.add_variable("sim", ssduck.World.batch(model, COUNT))
        sim.tick(states)
        yield ss, sim, model, states
    states.close()


def each(model, states, program, parameters=None):
    """Returns the values of a program in worlds that are attached to the simulations."""
    values = []
    for number, ss in enumerate(states.worlds(model)):
        for name, value in (parameters or {}).items():
            ss.add_variable(name, value[number])
        values.append(ss.eval(program))
    return values
