"""Live answers and those about the same ticks of the past are equal to the last bit."""

import numpy as np
import pytest

import ssduck
from tests.support.cases import generated
from tests.support.mjcf import simulated

mujoco = pytest.importorskip("mujoco")

BODIES, TICKS = 3, 8
PAIRS = [(a, b) for a in range(BODIES) for b in range(BODIES) if a != b]
RELATIONS = ("clearance", "penetration")


def shapes(chance):
    """Returns geoms that are not at the origin of their body, and a site."""
    geoms = []
    for kind in chance.choice(["box", "sphere", "cylinder", "capsule", "ellipsoid"], 2):
        pose = " ".join(map(str, chance.uniform(-0.05, 0.05, 3)))
        turn = " ".join(map(str, chance.normal(size=4)))
        size = " ".join(map(str, chance.uniform(0.02, 0.06, 3)))
        geoms.append(f'<geom type="{kind}" pos="{pose}" quat="{turn}" size="{size}"/>')
    return "".join(geoms)


def scene(chance):
    site = '<site name="tip" type="box" size=".05 .05 .05" pos=".1 .02 .03" quat=".5 .5 .5 .4"/>'
    bodies = (
        f'<body name="b{number}"><freejoint/>{shapes(chance)}{site if not number else ""}</body>'
        for number in range(BODIES)
    )
    return f"<mujoco><worldbody>{''.join(bodies)}</worldbody></mujoco>"


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(generated(1)))
def test_past_ticks_answer_as_they_did_live(seed):
    """MuJoCo's matrices are not those of its quaternions to the last bit."""
    chance = np.random.default_rng(seed)
    model, data = simulated(scene(chance))
    calls = [f"{one}(sim.b{a}, sim.b{b})" for one in RELATIONS for a, b in PAIRS]
    with ssduck.Interpreter(recording=ssduck.Recording(tables=("entities", "links"))) as ss:
        world = ss.add_variable("sim", ssduck.World.attach(model, data))
        program = ss.compile(f"SELECT {', '.join(calls)} FROM [0] AS list;")
        live, times = [], []
        for tick in range(TICKS):
            poses = data.qpos.reshape(-1, 7)
            poses[:, :3] = chance.uniform(-0.1, 0.1, (BODIES, 3))
            turns = chance.normal(size=(BODIES, 4))
            poses[:, 3:] = turns / np.linalg.norm(turns, axis=1, keepdims=True)
            data.time = (tick + 1) / 8
            mujoco.mj_forward(model, data)
            world.tick()
            live.append(ss.eval(program))
            times.append(world.time)
        world.tick()
        for time, answers in zip(times, live, strict=True):
            past = [
                ss.eval(
                    f"SELECT {relation}(sim.b{a}, this) FROM sim{{{time}}} WHERE id(this) == 'b{b}' AS value;"
                )
                for relation in RELATIONS
                for a, b in PAIRS
            ]
            assert past == answers
