"""Contacts of flexible bodies, which are of no geom."""

import mujoco
import numpy as np
import pytest

import ssduck
from tests.support.cases import sampled
from tests.support.mjcf import simulated

pytestmark = pytest.mark.slow

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
    model, data = simulated(CLOTH, 200)
    assert (data.contact.geom < 0).any()
    with ssduck.Interpreter(recording=None) as ss:
        world = ss.add_variable("sim", ssduck.World.attach(model, data))
        world.add_sensor(kind, on="box", name="bump", **options)
        program = ss.compile("SELECT inContact(sim.bump, sim.box) FROM [0] AS list;")
        for _ in range(8):  # the first runs are SQL, later ones one row
            mujoco.mj_step(model, data)
            world.tick()
            assert ss.eval(program) == [False]


def forces_of(model, data):
    """The normal forces on the flex, by MuJoCo's own getter."""
    force, forces = np.zeros(6), []
    for number, contact in enumerate(data.contact):
        mujoco.mj_contactForce(model, data, number, force)
        if contact.geom.min() < 0:
            forces.append(force[0])
    return forces


FLEXES = {
    "cloth": CLOTH,
    "pinned": CLOTH.replace("<contact", '<pin id="0 5"/><contact'),
    "rope": CLOTH.replace('"6 6 1"', '"6 1 1"').replace('dim="2"', 'dim="1"'),
    "soft": CLOTH.replace('"6 6 1"', '"3 3 3"').replace('dim="2"', 'dim="3" dof="trilinear"'),
}


@sampled("kind", FLEXES, every=4)
def test_a_flex_is_one_entity_with_its_contacts(kind):
    try:
        model, data = simulated(FLEXES[kind], 200)
    except ValueError:
        pytest.skip("this version of MuJoCo has no such flex")
    with ssduck.Interpreter() as ss:
        world = ss.add_variable("sim", ssduck.World.attach(model, data))
        assert [entity.name for entity in world] == ["world", "box", "cloth"]
        cloth, forces = world["cloth"], forces_of(model, data)
        assert (cloth.kind, len(cloth.links)) == ("kinbody", model.nbody - 2)
        assert sum(forces) > 3.0
        assert ss.eval("inContact(sim.box, sim.cloth);") is True
        assert ss.eval("contactForce(sim.box, sim.cloth);") == pytest.approx(sum(forces))
        assert ss.eval("force(sim.cloth);")[2] == pytest.approx(sum(forces), rel=1e-3)
        with pytest.warns(UserWarning, match="cloth: spheres about the vertices stand in"):
            assert ss.eval("on(sim.box, sim.cloth);") is True
        rows = ss.sql(
            "SELECT force, link_b FROM sim.contacts JOIN entities e ON b = e.id WHERE e.name = 'cloth'"
        ).fetchall()
        assert sorted(force for force, _ in rows) == pytest.approx(sorted(forces))
        mass = model.body_mass[2:].sum()
        assert ss.eval("mass(sim.cloth);") == pytest.approx(mass)
        assert ss.eval("on(sim.world, sim.cloth);") is False


def test_a_flex_can_be_named_and_falls_as_mujoco_says():
    model, data = simulated(CLOTH, 1)
    with ssduck.Interpreter() as ss:
        world = ss.add_variable("sim", ssduck.World.attach(model, data, names={"cloth_0": "towel"}))
        assert ss.eval("inContact(sim.box, sim.towel);") is False
        for _ in range(30):
            mujoco.mj_step(model, data)
            world.tick()
            links = ss.sql("SELECT z, vz FROM sim.links WHERE entity > 2 ORDER BY link").fetchall()
            assert [z for z, _ in links] == data.xpos[2:, 2].tolist()
        velocity, twist = np.zeros(6), [v for _, v in links]
        for number, seen in zip(range(2, model.nbody), twist, strict=True):
            kind = mujoco.mjtObj.mjOBJ_XBODY
            mujoco.mj_objectVelocity(model, data, kind, number, velocity, 0)
            assert seen == pytest.approx(velocity[5], abs=1e-9)


def test_a_flex_that_is_disabled_meets_nothing():
    model, data = simulated(CLOTH, 200)
    with ssduck.Interpreter() as ss:
        world = ss.add_variable("sim", ssduck.World.attach(model, data))
        cloth = world["cloth"]
        cloth.enabled = False
        mujoco.mj_step(model, data)
        world.tick()
        assert not forces_of(model, data)
        with pytest.warns(UserWarning, match="spheres about the vertices"):
            assert ss.eval("touching(sim.box, sim.cloth);") is True
        model.geom_size[1] *= 1.01  # so that all bodies are described anew
        world.tick()
        assert len(ss.sql("SELECT * FROM sim.shapes WHERE NOT exact").fetchall()) == 36
        cloth.enabled = True
        mujoco.mj_step(model, data)
        assert forces_of(model, data)
