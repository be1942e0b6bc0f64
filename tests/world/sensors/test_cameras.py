"""What cameras see: spheres, occlusion, the sensor's own body, bounds."""

import math
from itertools import product

import numpy as np
import pybullet
import pytest
from scipy.spatial.transform import Rotation

from ssduck.errors import ArgumentError, SelectScriptError
from ssduck.simulators.pybullet import readings as pybullet_rays
from tests.support.bodies import create_linked_body
from tests.support.cases import sampled
from tests.support.sensing import CAMERA, EXACT, POSES, evaluators, turned

# -- a camera and a sphere -----------------------------------------------------------------------


def pixel_directions(width, height, fov):
    half = math.tan(math.radians(fov) / 2)
    rows = half * (1 - (2 * np.arange(height) + 1) / height)
    columns = half * width / height * (1 - (2 * np.arange(width) + 1) / width)
    up, left = np.meshgrid(rows, columns, indexing="ij")
    return np.stack([np.ones_like(up), left, up], axis=-1)


# (radius, place in the camera's frame)
SPHERES = [(0.5, [3, 0, 0]), (1.0, [4, 0.5, -0.3]), (0.2, [2, -0.4, 0.5]), (0.7, [5, 2.9, 0])]


@pytest.mark.parametrize(("position", "orientation"), POSES)
@pytest.mark.parametrize(("radius", "place"), SPHERES)
def test_a_camera_sees_a_sphere(mast, radius, place, position, orientation):
    """Each pixel whose ray comes nearer to the centre than the radius, and how deep it is."""
    mast.sphere("ball", radius, (np.array(position) + turned(orientation, place)).tolist())
    world = mast.open()
    camera = world.add_sensor(
        "depth_camera", "mast", position=position, orientation=orientation, **CAMERA
    )
    ways = pixel_directions(64, 48, 50)
    units = ways / np.linalg.norm(ways, axis=-1, keepdims=True)
    along = units @ np.array(place)
    square = along**2 - (np.dot(place, place) - radius**2)
    clear = np.abs(np.sqrt(np.dot(place, place) - along**2) - radius) > 2e-3
    ball = world["ball"].id
    assert camera.segmentation.shape == camera.depth.shape == (48, 64)
    assert ((camera.segmentation == ball) == (square > 0))[clear].all()
    seen = (camera.segmentation == ball) & clear
    ranges = along[seen] - np.sqrt(square[seen])
    # Where a ray grazes the surface, a little across is a lot along.
    assert camera.ranges.reshape(48, 64)[seen] == pytest.approx(ranges, abs=1e-2)
    assert camera.depth[seen] == pytest.approx(ranges * units[seen][:, 0], abs=1e-2)
    centre = np.array(position) + turned(orientation, place)
    heights = np.linalg.norm(camera.points - centre, axis=1)
    assert heights == pytest.approx(np.full(len(heights), radius), abs=1e-3)
    assert np.isinf(camera.depth[camera.segmentation == 0]).all()
    assert seen.any()


@pytest.mark.slow
@sampled(("radius", "distance"), [(0.5, 3.0), (0.3, 1.0), (1.0, 4.0)], every=3)
def test_the_share_of_a_sphere_ahead_is_that_of_its_cone(mast, radius, distance):
    """Its cone cuts a disc of radius tan(asin(r/d)) out of the image, in which pixels are even."""
    mast.sphere("ball", radius, [distance, 0, 0])
    world = mast.open()
    camera = world.add_sensor("depth_camera", "mast", **CAMERA | {"width": 160, "height": 120})
    disc = math.pi * math.tan(math.asin(radius / distance)) ** 2
    image = (2 * math.tan(math.radians(25))) ** 2 * 160 / 120
    for ss in evaluators(world):
        program = "SELECT sensingAmount(a.this, b.this) FROM a=sim, b=sim WHERE id(b.this) == 'ball' AND isSensor(a.this) AS value;"
        assert ss.eval(program) == pytest.approx(disc / image, rel=0.01)
    assert camera.reading.hits == {world["ball"].id: np.count_nonzero(camera.segmentation)}


def test_what_a_camera_shows_is_where_it_is(mast):
    """Up is up and left is left, in colours as in the segmentation."""
    mast.box("above", [0.1, 0.3, 0.3], [3, 0, 0.8])
    mast.box("left", [0.1, 0.3, 0.3], [3, 0.8, 0])
    for body, colour in ((1, [1, 0, 0, 1]), (2, [0, 0, 1, 1])):
        pybullet.changeVisualShape(body, -1, rgbaColor=colour, physicsClientId=mast.client)
    world = mast.open()
    camera = world.add_sensor("depth_camera", "mast", **CAMERA | {"width": 60, "height": 60})
    rows, columns = np.nonzero(camera.segmentation == world["above"].id)
    assert rows.max() < 30
    assert 25 < columns.mean() < 35
    rows, columns = np.nonzero(camera.segmentation == world["left"].id)
    assert columns.max() < 30
    assert 25 < rows.mean() < 35
    image = camera.image.astype(int)
    assert image.shape == (60, 60, 3)
    assert camera.image.dtype == np.uint8
    red = image[:, :, 0] - image[:, :, 2] > 100
    blue = image[:, :, 2] - image[:, :, 0] > 100
    assert (red != (camera.segmentation == world["above"].id)).mean() < 0.02  # but for edges
    assert (blue != (camera.segmentation == world["left"].id)).mean() < 0.02


# -- who hides whom ------------------------------------------------------------------------------


def test_what_stands_in_front_hides_what_is_behind(mast):
    mast.box("far", [0.1, 2, 2], [3, 0, 0])
    screen = mast.box("screen", [0.1, 2, 2], [2, 0, 0])
    world = mast.open()
    camera = world.add_sensor("depth_camera", "mast", **CAMERA)
    assert mast.seen(camera) == ["screen"]
    world["screen"].move([2, 2.0, 0])  # its right half is clear
    assert sorted(mast.seen(camera)) == ["far", "screen"]
    half = camera.segmentation == world["screen"].id
    assert half[:, :32].all()
    assert not half[:, 32:].any()
    world["screen"].move([4, 0, 0])
    assert mast.seen(camera) == ["far"]
    assert screen in mast.names


# -- the sensor's own body -----------------------------------------------------------------------


@pytest.fixture
def inside(stage):
    """A stage with a body of two shells, one of them a link, from 0.9 to 1.1 and 1.9 to 2.1."""
    shell = pybullet.createCollisionShape(
        pybullet.GEOM_BOX,
        halfExtents=[0.1, 1, 1],
        collisionFramePosition=[1, 0, 0],
        physicsClientId=stage.client,
    )
    link_shell = pybullet.createCollisionShape(
        pybullet.GEOM_BOX, halfExtents=[0.1, 1, 1], physicsClientId=stage.client
    )
    body = create_linked_body(
        stage.client, 0, shell, link_shape=link_shell, linkPositions=[[2, 0, 0]]
    )
    stage.names[body] = "host"
    return stage


# Where the front face of the other body is: before, in, at and behind the host's shells.
FRONTS = [0.5, 1.0, 1.1, 1.10001, 1.5, 1.9, 2.0, 2.1, 2.10001, 3.0]
IN_THE_SHELLS = [0.95, 1.0, 1.05, 2.0]


@pytest.mark.parametrize(
    ("front", "start"), [*product(FRONTS, [-1.0, 0.0]), *product([3.0], IN_THE_SHELLS)]
)
def test_rays_pass_through_the_sensors_own_body(inside, front, start):
    inside.box("other", [0.3, 1, 1], [front + 0.3, 0, 0])
    world = inside.open()
    finder = world.add_sensor("range_finder", "host", position=[start, 0, 0], max_range=10)
    assert finder.ranges == pytest.approx([front - start], abs=EXACT)
    assert inside.seen(finder) == ["other"]


def test_a_ray_that_meets_but_its_own_body_ends_on_nothing(inside):
    world = inside.open()
    finder = world.add_sensor("range_finder", "host", position=[-1, 0, 0], max_range=10)
    assert np.isinf(finder.ranges).all()
    assert finder.reading.hits == {}
    assert finder.points.shape == (0, 3)


def test_another_sensors_body_is_no_hindrance_to_be_seen(inside):
    """Only its own body is left out."""
    inside.sphere("mast", 0.01, [-1, 0, 0])
    world = inside.open()
    finder = world.add_sensor("range_finder", "mast", max_range=10)
    assert finder.ranges == pytest.approx([1.9], abs=EXACT)
    assert inside.seen(finder) == ["host"]


def test_a_convex_shape_that_a_ray_begins_in_is_not_seen(mast):
    mast.sphere("bubble", 1.0, [0, 0, 0])
    mast.box("wall", [0.1, 5, 5], [3, 0, 0])
    finder = mast.open().add_sensor("range_finder", "mast", max_range=10)
    assert mast.seen(finder) == ["wall"]


@pytest.mark.slow
def test_looking_through_a_body_is_as_if_it_were_not_there(stage):
    """A heap of shapes; each one in turn is looked through, and then taken away."""
    numbers = np.random.default_rng(7)
    bodies = []
    for index in range(40):
        place = numbers.uniform(-2, 2, 3).tolist()
        if index % 2:
            halves = numbers.uniform(0.1, 0.8, 3).tolist()
            bodies.append(stage.box(str(index), halves, place))
        else:
            bodies.append(stage.sphere(str(index), float(numbers.uniform(0.1, 0.8)), place))
    starts, ends = numbers.uniform(-3, 3, (2, 300, 3))
    looked = 0
    for body in bodies:
        place, turn = pybullet.getBasePositionAndOrientation(body, stage.client)
        through = np.full(300, body)
        found = pybullet_rays.cast_rays(stage.client, starts, ends, through)
        pybullet.resetBasePositionAndOrientation(body, [99, 99, 99], turn, stage.client)
        without = pybullet_rays.cast_rays(stage.client, starts, ends, np.full(300, -2))
        pybullet.resetBasePositionAndOrientation(body, place, turn, stage.client)
        assert (found.bodies == without.bodies).all()
        assert found.fractions == pytest.approx(without.fractions, abs=1e-6)
        looked += np.count_nonzero(
            pybullet_rays.cast_rays(stage.client, starts, ends, np.full(300, -2)).bodies == body
        )
    assert looked > 100


# -- just inside, just outside -------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    ("distance", "there"), [(2 - 1e-3, True), (2 + 1e-3, False), (1e-2, True), (50, False)]
)
@pytest.mark.parametrize("kind", ["range_finder", "planar_laser", "depth_camera"])
def test_how_far_a_sensor_sees(mast, kind, distance, there):
    mast.box("wall", [0.5, 9, 9], [distance + 0.5, 0, 0])
    world = mast.open()
    one = {
        "range_finder": {},
        "planar_laser": {"min_angle": 0, "max_angle": 0, "resolution": 1},
        "depth_camera": {"width": 1, "height": 1, "fov": 30},
    }
    sensor = world.add_sensor(kind, "mast", max_range=2, **one[kind])
    assert mast.seen(sensor) == ["wall"] * there
    assert np.isinf(sensor.ranges).all() != there
    for ss in evaluators(world):
        program = "SELECT id(b.this) FROM a=sim, b=sim WHERE isSensing(a.this, b.this) AS list;"
        assert ss.eval(program) == ["wall"] * there


# A camera's last pixels are centred half a pixel inside its field of view; the wall ends there.
@pytest.mark.parametrize(("gap", "there"), [(-2e-3, True), (2e-3, False)])
@pytest.mark.parametrize("side", [(0, 1), (0, -1), (1, 0), (-1, 0)])
def test_how_wide_a_camera_sees(mast, side, gap, there):
    half = math.tan(math.radians(20))
    leftward, upward = side
    edge = 2 * (half * 4 / 3 * (1 - 1 / 40) if leftward else half * (1 - 1 / 30))
    place = [2 + 1e-3, leftward * (edge + gap + 1), upward * (edge + gap + 1)]
    mast.box("wall", [1e-3, 1, 1], place)
    world = mast.open()
    camera = world.add_sensor("depth_camera", "mast", width=40, height=30, fov=40, max_range=5)
    assert mast.seen(camera) == ["wall"] * there


@pytest.mark.parametrize(
    ("angle", "there"), [(44.9, True), (45.1, False), (-44.9, True), (-45.1, False)]
)
def test_how_wide_a_laser_sees(mast, angle, there):
    """A wall along a direction of sight is all to the outer side of it."""
    outward = math.radians(angle + math.copysign(90, angle))
    middle = np.array([math.cos(math.radians(angle)), math.sin(math.radians(angle))])
    middle = 2 * middle + 0.5 * np.array([math.cos(outward), math.sin(outward)])
    turn = Rotation.from_euler("z", math.radians(angle)).as_quat()
    mast.box("wall", [0.5, 0.5, 0.5], [*middle, 0], turn=turn.tolist())
    laser = mast.open().add_sensor(
        "planar_laser", "mast", min_angle=-45, max_angle=45, resolution=0.5, max_range=5
    )
    assert mast.seen(laser) == ["wall"] * there


# -- on and off ----------------------------------------------------------------------------------


EACH = (
    "SELECT id(s.this), isSensing(s.this, o.this), sensingAmount(s.this, o.this), sensingEnvIDs(s.this) "
    "FROM s=sim, o=sim WHERE isSensor(s.this) AND id(o.this) == 'wall' AS list;"
)

RAW = (
    "SELECT s.name, isSensing(s, o), sensingAmount(s, o), sensingEnvIDs(s) "
    "FROM entities s, entities o WHERE isSensor(s) AND o.name = 'wall'"
)


@pytest.mark.slow
def test_a_sensor_that_is_off_perceives_nothing(walled):
    eye = walled.add_sensor("range_finder", "mast", "eye", max_range=5)
    wall = walled["wall"].id
    for ss in evaluators(walled):
        for on in (True, False, True):
            eye.power(on)
            assert eye.powered is on
            expected = ["eye", on, float(on), [wall] * on]
            assert ss.eval(EACH) == expected
            assert ss.sql(RAW).fetchall() == [tuple(expected)]
            assert (
                ss.sql("SELECT sensor, entity, hits, rays FROM sensings").fetchall()
                == [(eye.id, wall, 1, 1)] * on
            )


def test_what_is_off_has_no_reading(mast):
    world = mast.open()
    eye = world.add_sensor("range_finder", "mast", "eye", max_range=5, powered=False)
    assert not eye.powered
    assert eye.reading is None
    for what in ("rays", "ranges", "points"):
        with pytest.raises(SelectScriptError, match=r"'eye' measures nothing.*power\(True\)"):
            getattr(eye, what)
    assert mast.casts == []
    eye.power(True)
    assert eye.rays == 1


def test_a_sensor_tells_what_it_has(mast):
    world = mast.open()
    finder = world.add_sensor("range_finder", "mast", "finder", max_range=5)
    with pytest.raises(
        ArgumentError, match="'finder' is a range_finder: no image, but entities, points, ranges"
    ):
        finder.image  # noqa: B018
    with pytest.raises(ArgumentError, match="no forces"):
        finder.forces  # noqa: B018
    touch = world.add_sensor("contact_sensor", "mast")
    with pytest.raises(ArgumentError, match="no ranges, but entities, points, forces"):
        touch.ranges  # noqa: B018
