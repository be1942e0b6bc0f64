"""Functions of time of each row: those of all entities are read at once, with the same values."""

import mujoco
import numpy as np
import pytest

import ssduck
from ssduck.interpreter.over_time import evaluator
from tests.support.bodies import solid

pytestmark = pytest.mark.slow
COUNT, STEPS = 12, 20
BODIES = "".join(
    f'<body name="b{n}" pos="{n} 0 {1 + n / 8}"><freejoint/><geom size=".05" mass="1"/></body>'
    for n in range(COUNT)
)
XML = f"""
<mujoco>
  <option timestep="0.01"/>
  <worldbody>
    <body name="arm" pos="0 3 1"><joint name="hinge" axis="0 1 0"/><geom pos=".2 0 0" size=".05"/></body>
    <body name="leg" pos="0 5 1"><joint name="hip" axis="0 1 0"/><geom pos=".2 0 0" size=".05"/></body>
    {BODIES}
  </worldbody>
</mujoco>
"""


class Fall:
    """Bodies that fall with speeds of their own, and their heights at each tick by MuJoCo."""

    def __init__(self):
        self.model = mujoco.MjModel.from_xml_string(XML)
        data = mujoco.MjData(self.model)
        data.qvel[2:] = np.linspace(-1, 3, self.model.nv - 2)
        mujoco.mj_forward(self.model, data)
        tables = ssduck.Recording(tables=("entities", "links", "joints"))
        self.ss = ssduck.Interpreter(recording=tables)
        world = self.ss.add_variable("sim", ssduck.World.attach(self.model, data))
        self.z, self.hip = [data.xpos[1:, 2].copy()], [float(data.qpos[1])]
        for _ in range(STEPS):
            mujoco.mj_step(self.model, data)
            mujoco.mj_forward(self.model, data)
            world.tick()
            self.z.append(data.xpos[1:, 2].copy())
            self.hip.append(float(data.qpos[1]))


@pytest.fixture(scope="module")
def fall():
    result = Fall()
    with result.ss:
        yield result


def before(fall, steps):
    """How much each body has risen since so many steps ago, m."""
    return fall.z[-1] - fall.z[-1 - steps]


VALUES = [
    ("z(this) - previous(z(this))", lambda fall: before(fall, 1)),
    ("rate(z(this))", lambda fall: before(fall, 1) / 0.01),
    ("z(this) - initially(z(this))", lambda fall: before(fall, STEPS)),
    ("z(this) - at(0.15, z(this))", lambda fall: before(fall, 5)),
    ("greatest(z(this))[1]", lambda fall: np.max(fall.z, axis=0)),
    ("initially(distance(this, sim.b3))", None),
]


@pytest.mark.parametrize(("column", "expected"), VALUES)
@pytest.mark.parametrize("most", [0, evaluator.MOST_ROWS], ids=["each", "all"])
def test_the_values_are_those_of_each_entity(fall, monkeypatch, most, column, expected):
    monkeypatch.setattr(evaluator, "MOST_ROWS", most)
    values = fall.ss.eval(f"SELECT {column} FROM sim AS list;")
    if expected is None:
        places = fall.ss.eval("SELECT position(this) AS p FROM sim{0.0};")
        places = np.array([row["p"] for row in places])
        other = places[2 + 3]
        assert values == pytest.approx(np.linalg.norm(places - other, axis=1), abs=1e-12)
    else:
        assert values == pytest.approx(expected(fall), abs=1e-9)


def test_an_expression_that_fails_for_others_is_read_for_each(fall):
    """Only the two of the condition have joints, and each has another one."""
    rows = fall.ss.eval(
        "SELECT id, initially(joint(this, IF(id == 'arm'; 'hinge'; 'hip'))) AS q FROM sim "
        "WHERE id IN ['arm', 'leg'];"
    )
    assert [row["q"] for row in rows] == pytest.approx([0.0, fall.hip[0]])
    moved = "SELECT joint(this, 'hip') - initially(joint(this, 'hip')) FROM {} AS list;"
    of_two = moved.format("[sim.leg, sim.leg]")
    assert fall.ss.eval(of_two) == pytest.approx([fall.hip[-1] - fall.hip[0]] * 2)


def test_an_entity_that_came_later_has_no_value(client):
    pybullet = pytest.importorskip("pybullet")

    def made(z):
        return solid(client, pybullet.GEOM_SPHERE, 1, [0, 0, z], radius=0.1)

    names = {made(z): f"b{z}" for z in (1, 2, 3)}
    with ssduck.Interpreter() as ss:
        world = ss.add_variable("sim", ssduck.World.attach(client, names=names))
        pybullet.removeBody(1, physicsClientId=client)
        world.tick()
        number = made(5)
        world.tick()
        pybullet.resetBasePositionAndOrientation(number, [0, 0, 6], [0, 0, 0, 1], client)
        world.tick()
        found = ss.eval("SELECT initially(z(this)), previous(z(this)) FROM sim AS list;")
    assert found == [1.0, 1.0, 3.0, 3.0, None, 5.0]
