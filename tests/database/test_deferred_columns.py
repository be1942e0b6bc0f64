"""Prepared statements read what a tick leaves for later: positions, velocities and contacts.

Nothing else reads them here: nothing is recorded, and each interpreter has one statement.
"""

import mujoco
import pytest

import ssduck
from ssduck.database.plans import RUNS_BEFORE_PLAN
from tests.support.cases import sampled

TICKS = RUNS_BEFORE_PLAN + 8
# Balls that fall one after the other: the number of contacts grows while the statement is prepared.
BALLS = "".join(
    f"<body name='b{n}' pos='{n} 0 {0.11 + 0.04 * n}'><freejoint/><geom size='.1'/></body>"
    for n in range(8)
)
MODEL = f"<mujoco><worldbody><geom type='plane' size='9 9 1'/>{BALLS}</worldbody></mujoco>"
# The plans of these are not kept: they have two sources, and the order of rows might matter.
STATEMENTS = {
    "SELECT sum(a.z) FROM entities a, entities b WHERE a.name = 'b7' AND b.name = 'b7'": (
        lambda data: data.body("b7").xpos[2]
    ),
    "SELECT sum(a.vz) FROM entities a, entities b WHERE a.name = 'b7' AND b.name = 'b7'": (
        lambda data: data.joint(7).qvel[2]
    ),
    "SELECT sum(a.zmax) FROM entities a, entities b WHERE a.name = 'b7' AND b.name = 'b7'": (
        lambda data: data.body("b7").xpos[2] + 0.1
    ),
    "SELECT count(*) + 0 * sum(c.force) FROM contacts c, entities e WHERE e.id = c.b": (
        lambda data: data.ncon
    ),
    "SELECT count(*) + 0 * sum(e.zmax) FROM contacts c, entities e WHERE e.id = c.b": (
        lambda data: data.ncon
    ),
}


@pytest.mark.slow
@sampled("sql", STATEMENTS, every=2)
@pytest.mark.parametrize(
    "recording",
    [None, ssduck.Recording(every=4), ssduck.Recording(tables=("entities",))],
    ids=["unrecorded", "each fourth tick", "entities"],
)
def test_a_prepared_statement_reads_the_present_tick(sql, recording):
    model = mujoco.MjModel.from_xml_string(MODEL)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    expected = []
    with ssduck.Interpreter(recording=recording) as ss:
        ss.add_variable("sim", ssduck.World.attach(model, data))
        world = ss.call_variable("sim")
        for _ in range(TICKS):
            for _ in range(12):
                mujoco.mj_step(model, data)
            mujoco.mj_forward(model, data)
            world.tick()
            ((value,),) = ss.sql(sql).fetchall()
            expected.append(STATEMENTS[sql](data))
            assert (value or 0) == pytest.approx(expected[-1], rel=1e-12), f"tick {len(expected)}"
    assert len(set(expected)) > TICKS // 2  # it changed meanwhile


@pytest.mark.filterwarnings("ignore:b0. the simulator gives a pose")
def test_a_plan_is_made_anew_after_numbers_were_unknown():
    model = mujoco.MjModel.from_xml_string(MODEL)
    data = mujoco.MjData(model)
    counts = {0.5: 81, float("nan"): 72, 0.7: 81}
    with ssduck.Interpreter(recording=None) as ss:
        world = ss.add_variable("sim", ssduck.World.attach(model, data))
        for height, wanted in counts.items():
            data.qpos[2] = height
            mujoco.mj_kinematics(model, data)
            world.tick()
            for _ in range(RUNS_BEFORE_PLAN + 3):
                ((count,),) = ss.sql("SELECT count(a.z) FROM entities a, entities b").fetchall()
                assert count == wanted
