"""`inside`, `contains` and `enclosed` at many ticks: as at each tick, and each pose placed once."""

import pybullet
import pytest

import ssduck
from ssduck.schema import POSE
from tests.support.bodies import solid
from tests.support.urdf import collision, joint, link, robot

STEPS = 30
NAMES = ("bin", "cart", "ball", "box", "drawer", "coin")
PROGRAMS = {
    "inside": "SELECT tick, id, inside({a}, this) FROM sim{{}} AS list;",
    "contains": "SELECT tick, id, contains({a}, this) FROM sim{{}} AS list;",
    "enclosed": "SELECT tick, id, enclosed({a}, this) FROM sim{{}} AS list;",
}


def _walls():
    """The shapes of an open box, 40 cm wide."""
    floor = collision('<box size="0.4 0.4 0.02"/>')
    sides = [
        collision(f'<box size="{size}"/>', xyz=(x, y, 0.2))
        for size, x, y in (
            ("0.02 0.4 0.4", 0.2, 0),
            ("0.02 0.4 0.4", -0.2, 0),
            ("0.4 0.02 0.4", 0, 0.2),
            ("0.4 0.02 0.4", 0, -0.2),
        )
    ]
    return floor + "".join(sides)


@pytest.fixture(scope="module")
def ss(tmp_path_factory):
    """A bin into which a ball falls, a cart that passes a box, and a tray that comes to a coin."""
    folder = tmp_path_factory.mktemp("bins")
    client = pybullet.connect(pybullet.DIRECT)
    own = {"physicsClientId": client}
    pybullet.setGravity(0, 0, -9.81, **own)
    (folder / "bin.urdf").write_text(robot(link("bin", shapes=_walls())))
    limit = '<limit lower="-9" upper="9" effort="99" velocity="9"/>'
    drawer = robot(
        link("case", shapes=_walls()),
        link("tray", shapes=collision('<box size="0.3 0.3 0.1"/>')),
        joint("slide", "prismatic", "case", "tray", xyz=(0, 0, 0.1), axis=(1, 0, 0), limit=limit),
    )
    (folder / "drawer.urdf").write_text(drawer)
    bodies = [
        pybullet.loadURDF(str(folder / "bin.urdf"), (0, 0, 0), useFixedBase=True, **own),
        pybullet.loadURDF(str(folder / "bin.urdf"), (2, 0, 0), useFixedBase=True, **own),
        solid(client, pybullet.GEOM_SPHERE, 1, (0, 0, 0.48), radius=0.05),
        solid(client, pybullet.GEOM_BOX, 0, (2.1, 0, 0.2), halfExtents=[0.05] * 3),
        pybullet.loadURDF(str(folder / "drawer.urdf"), (4, 0, 0), useFixedBase=True, **own),
    ]
    bodies.append(solid(client, pybullet.GEOM_BOX, 0, (4.25, 0, 0.12), halfExtents=[0.02] * 3))
    pybullet.setJointMotorControl2(
        bodies[4], 0, pybullet.VELOCITY_CONTROL, targetVelocity=2, force=99, **own
    )
    world = ssduck.World.attach(client, names=dict(zip(bodies, NAMES, strict=True)))
    with ssduck.Interpreter() as interpreter:
        interpreter.add_variable("sim", world)
        for step in range(STEPS):
            pybullet.resetBasePositionAndOrientation(
                bodies[1], (2 + 0.02 * step, 0, 0), (0, 0, 0, 1), **own
            )
            world.step(4, every=4)
        for name in NAMES:
            interpreter.add_variable(name, world[name])
        yield interpreter
    pybullet.disconnect(client)


def _singly(ss, relation, a):
    """The same, by the shapes of each tick."""
    past, found = ss.past("sim"), []
    for tick in past.ticks:
        world = past.at(tick)
        shapes = world.shapes()
        table = world.snapshot.tables["entities"]
        row = world.snapshot.rows[world[a].id]
        orientation = [float(table[name][row]) for name in POSE[3:]]
        for entity in world:
            ids = world[a].id, entity.id
            if ids[0] == ids[1]:
                answer = 0.0 if relation == "inside" else False
            elif relation == "inside":
                answer = shapes.inside(*ids)
            elif relation == "contains":
                answer = shapes.contains(*ids)
            else:
                answer = shapes.encloses(*ids, *orientation)
            found += [tick, entity.name, answer]
    return found


@pytest.mark.slow
@pytest.mark.parametrize("a", ["bin", "cart", "drawer"])
@pytest.mark.parametrize("relation", PROGRAMS)
def test_all_ticks_together_have_the_answers_of_each_tick(ss, relation, a):
    program = PROGRAMS[relation].format(a=a)
    found = ss.eval(program)
    singly = _singly(ss, relation, a)
    assert found == singly
    if a != "drawer" or relation == "inside":  # a tray has no walls, and reaches a part of the coin
        assert len(set(found[2::3])) > 1
    assert ss.eval(program) == singly
