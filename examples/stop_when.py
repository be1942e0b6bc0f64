"""Ends an episode of a MuJoCo simulation when a condition holds.

`python examples/stop_when.py` needs `pip install 'ssduck[mujoco]'`. A cube slides down a ramp. The
loop is yours: it steps the simulation, and ssduck says when the cube has come to rest on the floor.
It prints when and where that is, and how fast the cube was at most.
"""

from __future__ import annotations

import mujoco

import ssduck

XML = """
<mujoco>
  <worldbody>
    <body name="floor"><geom type="plane" size="5 5 .1" friction=".6"/></body>
    <body name="ramp" pos="0 0 .3" euler="0 25 0">
      <geom type="box" size=".6 .3 .02" friction=".2"/>
    </body>
    <body name="cube" pos="-.4 0 .54" euler="0 25 0">
      <freejoint/><geom type="box" size=".04 .04 .04" mass=".1" friction=".2"/>
    </body>
  </worldbody>
</mujoco>
"""
# At rest for a tenth of a second, on the floor and not on the ramp.
DONE = "heldFor(settled(sim.cube)) >= 0.1 AND on(sim.floor, sim.cube)"
TIMEOUT = 10.0  # s


def main() -> None:
    """Steps until the condition holds, or time is up."""
    model = mujoco.MjModel.from_xml_string(XML)
    data = mujoco.MjData(model)
    with ssduck.Interpreter() as ss:
        # `forward`: queries see the poses of the time of the tick, not those of a step before.
        sim = ss.add_variable("sim", ssduck.World.attach(model, data, forward=True))
        done = ss.compile(f"{DONE};")
        while not ss.eval(done) and data.time < TIMEOUT:
            mujoco.mj_step(model, data)
            sim.tick()
        fastest, speed = ss.eval("greatest(speed(sim.cube));")
        print(f"done at {sim.time:.3f} s" if ss.eval(done) else "not done in time")
        print(f"at x = {ss.eval('x(sim.cube);'):.3f} m")
        print(f"at most {speed:.3f} m/s, at {fastest:.3f} s")


if __name__ == "__main__":
    main()
