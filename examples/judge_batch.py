"""Judges 256 environments at once, whose states are arrays of NumPy.

`python examples/judge_batch.py` needs `pip install 'ssduck[mujoco]'`. The "simulator" is a few
lines of NumPy: grippers carry cubes to a goal, each with another error of its aim, and let go.
ssduck judges all environments in one evaluation a step. It prints the successes, the failures and
the mean reward every half second.
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt

import ssduck

XML = """
<mujoco>
  <worldbody>
    <body name="table"><geom type="box" size=".5 .5 .2"/></body>
    <body name="cube"><freejoint/><geom type="box" size=".025 .025 .025" mass=".1"/></body>
  </worldbody>
</mujoco>
"""
COUNT, STEP = 256, 0.05  # environments; s
GOAL = [0.4, 0.0, 0.225]  # the same for all; an array (COUNT, 3) has one for each
TERMS: dict[str, Any] = {
    "success": "heldFor(on(sim.table, sim.cube) AND distance(sim.cube, goal) < 0.1) >= 0.3",
    "failure": "z(sim.cube) < 0.0",
    "reward": {"near": "-distance(sim.cube, goal)", "done": "5 * int(success)"},
}


def positions(time: float, aims: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Returns where the cubes are, (COUNT, 3): carried for 2 s, then they fall."""
    begin = np.array([-0.4, 0.0])
    xy = begin + min(time / 2.0, 1.0) * (aims - begin)
    fallen = 0.3 - 4.905 * max(time - 2.0, 0.0) ** 2
    on_the_table = np.all(np.abs(xy) < 0.5, axis=1)
    return np.column_stack((xy, np.where(on_the_table, max(fallen, 0.225), fallen)))


def main() -> None:
    """Carries the cubes, and judges them at each step."""
    aims = np.random.default_rng(1).normal(GOAL[:2], 0.06, (COUNT, 2))
    with ssduck.Interpreter() as ss:
        model = mujoco.MjModel.from_xml_string(XML)
        sim = ss.add_variable("sim", ssduck.World.batch(model, COUNT))
        ss.add_variable("goal", GOAL)
        terms = ss.terms(**TERMS)
        # The poses of all bodies: the world body, the table and the cube.
        xpos, xquat = np.zeros((COUNT, 3, 3)), np.tile([1.0, 0, 0, 0], (COUNT, 3, 1))
        for step in range(1, 61):
            time = step * STEP
            xpos[:, 2] = positions(time, aims)
            sim.tick(xpos=xpos, xquat=xquat, time=time)
            judged = terms()
            if step % 10 == 0:
                won, lost = judged.success.sum(), judged.failure.sum()
                print(f"{time:.1f} s: {won} won, {lost} lost, reward {judged.reward.mean():.3f}")


if __name__ == "__main__":
    main()
