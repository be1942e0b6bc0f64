"""Closed concave meshes: surfaces to PyBullet, solids to ssduck, which tells of what is in one."""

import pybullet
import pybullet_data
import pytest

import ssduck
from tests.support.warned import heard

pytestmark = pytest.mark.slow

TOLD = "closed concave mesh of room is around something"


@pytest.fixture
def room(client):
    """A room of 4 m that is a mesh, and a ball in its middle and one outside; returns the world."""
    pybullet.setAdditionalSearchPath(pybullet_data.getDataPath(), physicsClientId=client)
    walls = pybullet.createCollisionShape(
        pybullet.GEOM_MESH,
        fileName="cube.obj",
        meshScale=[4, 4, 4],
        flags=pybullet.GEOM_FORCE_CONCAVE_TRIMESH,
        physicsClientId=client,
    )
    sphere = pybullet.createCollisionShape(pybullet.GEOM_SPHERE, radius=0.2, physicsClientId=client)
    names = {
        pybullet.createMultiBody(mass, shape, basePosition=place, physicsClientId=client): name
        for name, mass, shape, place in (
            ("room", 0, walls, [0, 0, 2]),
            ("ball", 1, sphere, [0, 0, 2]),
            ("outside", 1, sphere, [3, 0, 2]),
        )
    }
    return ssduck.World.attach(client, names=names)


def told_by(ask):
    return heard(ask, TOLD)[1]


@pytest.mark.parametrize(
    "asked",
    [
        "clearance(sim.room, sim.ball);",
        "near(sim.ball, sim.room, 0.1);",
        "collides(sim.room, sim.ball);",
        "on(sim.room, sim.ball);",
        "SELECT a.id AS a, b.id AS b FROM a=sim, b=sim WHERE touching(a.this, b.this);",
    ],
)
def test_a_mesh_around_something_is_told_of_once(client, room, asked):
    # getClosestPoints is the truth: 1.8 m from the surface, which ssduck takes for a solid.
    gaps = [point[8] for point in pybullet.getClosestPoints(0, 1, 5.0, physicsClientId=client)]
    assert min(gaps) == pytest.approx(1.8)
    with ssduck.Interpreter() as ss:
        ss.add_variable("sim", room)
        assert len(told_by(lambda: ss.eval(asked))) == 1
        assert told_by(lambda: ss.eval(asked)) == []


def test_records_tell_of_it_too(room, tmp_path):
    with ssduck.Interpreter() as ss:
        ss.add_variable("sim", room)
        ss.export(tmp_path / "record")
    with ssduck.open(tmp_path / "record") as record:
        assert len(told_by(lambda: record.eval("clearance(sim.room, sim.ball);"))) == 1


def test_what_no_inside_decides_is_not_told_of(client, room):
    gaps = [point[8] for point in pybullet.getClosestPoints(0, 2, 5.0, physicsClientId=client)]
    with ssduck.Interpreter() as ss:
        ss.add_variable("sim", room)
        assert told_by(lambda: ss.eval("enclosed(sim.room, sim.ball);")) == []
        assert told_by(lambda: ss.eval("contains(sim.room, sim.ball);")) == []
        assert told_by(lambda: ss.eval("clearance(sim.room, sim.outside);")) == []
        assert ss.eval("clearance(sim.room, sim.outside);") == pytest.approx(min(gaps))
