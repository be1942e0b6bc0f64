"""Contacts of flexible bodies, which are of no geom."""

import mujoco
import pytest

import ssduck

CLOTH = """
<mujoco><option solver="CG"/><worldbody>
  <geom name="floor" type="plane" size="2 2 .1"/>
  <body name="box" pos="0 0 .05"><freejoint/><geom type="box" size=".2 .2 .05" mass="5"/></body>
  <flexcomp name="cloth" type="grid" count="6 6 1" spacing=".05 .05 .05" pos="0 0 .13" radius=".01"
    mass=".5" dim="2"><contact condim="3" solref="0.01 1" selfcollide="none"/></flexcomp>
</worldbody></mujoco>
"""


SENSORS = {"contact_sensor": {}, "range_finder": {"max_range": 1.0}}


@pytest.mark.parametrize(("kind", "options"), SENSORS.items())
def test_no_sensor_is_in_contact_where_cloth_presses(kind, options):
    model = mujoco.MjModel.from_xml_string(CLOTH)
    data = mujoco.MjData(model)
    for _ in range(200):
        mujoco.mj_step(model, data)
    assert (data.contact.geom < 0).any()
    with ssduck.Interpreter(recording=None) as ss:
        world = ss.add_variable("sim", ssduck.World.attach(model, data))
        world.add_sensor(kind, on="box", name="bump", **options)
        program = ss.compile("SELECT inContact(sim.bump, sim.box) FROM [0] AS list;")
        for _ in range(8):  # the first runs are SQL, later ones one row
            mujoco.mj_step(model, data)
            world.tick()
            assert ss.eval(program) == [False]
