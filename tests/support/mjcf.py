"""MJCF models for tests of MuJoCo worlds."""

import numpy as np

# Boxes, balls and a robot: hinges off the origin, a slide and a hinge of one body, a ball joint.
LAB = """
<mujoco model="lab">
  <option timestep="0.002"/>
  <asset><mesh name="wedge" vertex="0 0 0  .2 0 0  0 .2 0  0 0 .2  .02 .02 .02"/></asset>
  <worldbody>
    <geom name="floor" type="plane" size="0 0 .1"/>
    <geom name="paint" type="box" size="9 9 .01" contype="0" conaffinity="0"/>
    <body name="table" pos="0 0 .2"><geom type="box" size=".5 .5 .2" mass="7"/></body>
    <body name="box" pos="0 0 .501"><freejoint/><geom type="box" size=".1 .1 .1" mass="2"/></body>
    <body name="ball" pos=".3 .3 .451"><freejoint/><geom type="sphere" size=".05" mass=".5"/></body>
    <body name="wedge" pos="-.3 -.3 .402"><freejoint/><geom type="mesh" mesh="wedge" mass="1"/></body>
    <body name="arm" pos="2 0 1">
      <joint name="turn" type="hinge" axis="0 0 1" pos=".05 0 0"/>
      <geom type="capsule" size=".05 .2"/>
      <body name="fore" pos=".3 0 0" quat=".9 .1 .2 .3">
        <joint name="push" type="slide" axis="1 0 0" range="-.5 .5" limited="true" ref=".1"/>
        <joint name="bend" type="hinge" axis="0 1 0" pos="0 0 .1" range="-90 90" limited="true"/>
        <geom type="cylinder" size=".05 .1"/>
        <body pos=".3 0 0"><joint name="wrist" type="ball"/><geom type="box" size=".02 .1 .02"/></body>
      </body>
    </body>
    <body name="hand" mocap="true" pos="3 3 3"><geom type="sphere" size=".1"/></body>
  </worldbody>
  <actuator>
    <position name="servo" joint="bend" kp="20" kv="2"/>
    <velocity name="spin" joint="turn" kv="3"/>
    <motor name="force" joint="push" ctrlrange="-1 1" ctrllimited="true"/>
  </actuator>
</mujoco>
"""
# A ball that falls beside a box.
BALL_AND_BOX = """
<mujoco><option timestep="0.01"/><worldbody>
  <geom type="plane" size="1 1 0.1"/>
  <body name="ball" pos="0 0 0.3"><freejoint/><geom type="sphere" size="0.05"/></body>
  <body name="box" pos="0.3 0 0.05"><freejoint/><geom type="box" size="0.05 0.05 0.05"/></body>
</worldbody></mujoco>
"""


def simulated(text, steps=0):
    """Returns the model of a text and its data, with all that follows from the state, after steps."""
    import mujoco

    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    for _ in range(steps):
        mujoco.mj_step(model, data)
    return model, data


def random_state(model, data, seed):
    """Gives all joints and velocities of a simulation random values."""
    import mujoco

    rng = np.random.default_rng(seed)
    data.qpos[:] = rng.uniform(-0.6, 0.6, model.nq)
    mujoco.mj_normalizeQuat(model, data.qpos)
    data.qvel[:] = rng.uniform(-2, 2, model.nv)
    mujoco.mj_forward(model, data)
