"""The camera of a world that has none of its own: it frames what is small and moves."""

import numpy as np
import pytest

import ssduck
from ssduck.errors import ArgumentError
from ssduck.simulators.backends import drawn_shapes
from ssduck.simulators.scenes import Camera
from tests.support.bodies import solid

pybullet = pytest.importorskip("pybullet")
data = pytest.importorskip("pybullet_data")


def box(client, half, position, mass=0.0):
    return solid(client, pybullet.GEOM_BOX, mass, position, halfExtents=half)


def seen(camera, point):
    """Returns how far from the middle of a square picture a point is; 1 at its edge."""
    eye, target = np.array(camera.eye), np.array(camera.target)
    forward = (target - eye) / np.linalg.norm(target - eye)
    way = np.array(point) - eye
    depth = way @ forward
    return np.linalg.norm(way - depth * forward) / depth / np.tan(np.radians(camera.fov) / 2)


def test_a_wide_ground_is_not_framed(client):
    box(client, [100, 100, 5], [0, 0, -5])
    box(client, [0.05] * 3, [1, 2, 0.05], mass=1)
    camera = ssduck.World.attach(client).camera
    assert camera.target == pytest.approx((1, 2, 0.05))
    assert 0.3 < seen(camera, [1.05, 2.05, 0.1]) <= 1


def test_furniture_is_framed_and_a_thing_far_larger_than_the_others_is_not(client):
    box(client, [0.5, 0.5, 0.3], [0, 0, 0.3])
    for number in range(3):
        box(client, [0.05] * 3, [0.2 * number, 0, 0.65], mass=1)
    box(client, [20, 20, 20], [90, 0, 0], mass=1)
    camera = ssduck.World.attach(client).camera
    assert np.linalg.norm(camera.target) < 1
    assert all(seen(camera, [x, y, 0]) <= 1.01 for x in (-0.5, 0.5) for y in (-0.5, 0.5))


def test_it_stays_while_bodies_move_and_follows_other_bodies(client):
    thing = box(client, [0.05] * 3, [0, 0, 0], mass=1)
    world = ssduck.World.attach(client)
    first = world.camera
    pybullet.resetBasePositionAndOrientation(thing, [9, 0, 0], [0, 0, 0, 1], client)
    world.tick()
    assert world.camera == first
    box(client, [0.05] * 3, [10, 0, 0], mass=1)
    world.tick()
    assert world.camera.target == pytest.approx((9.5, 0, 0))


def test_an_attached_world_takes_a_camera(client):
    box(client, [0.05] * 3, [0, 0, 0], mass=1)
    mine, other = Camera((1, 0, 0), (0, 0, 0)), Camera((0, 1, 0), (0, 0, 0))
    world = ssduck.World.attach(client, camera=mine)
    assert world.camera == mine
    world.camera = other
    assert world.camera == other
    with pytest.raises(ArgumentError, match="is no Camera"):
        world.camera = [1, 0, 0]


def test_a_page_begins_with_a_camera(client):
    pytest.importorskip("websockets")
    box(client, [0.05] * 3, [0, 0, 0], mass=1)
    camera = Camera((1, 0, 0), (0, 0, 0))
    with ssduck.Interpreter() as ss:
        world = ss.add_variable("lab", ssduck.World.attach(client))
        ss.view(camera=camera).close()
        assert world.camera == camera


def test_a_world_without_bodies_has_a_camera(client):
    assert ssduck.World.attach(client).camera == Camera()


def test_the_mesh_of_a_plane_is_drawn_as_the_ground(client):
    pybullet.loadURDF(f"{data.getDataPath()}/plane.urdf", physicsClientId=client)
    world = ssduck.World.attach(client)
    (shape,) = drawn_shapes(world.simulator, world["plane"].info.body)
    assert (shape.geometry.type, shape.geometry.size) == ("plane", (0, 0, 1))
    assert shape.colour is None
