"""Sensors: what they measure against closed forms, what they perceive, when they are read, at what cost."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pybullet
import pytest
from scipy.spatial.transform import Rotation

import ssduck
from ssduck.errors import ArgumentError, RemovedEntityError, SelectScriptError, UnknownNameError
from ssduck.schema import FORGOTTEN_AFTER
from ssduck.simulators.pybullet import rays as pybullet_rays
from ssduck.simulators.pybullet.simulator import PyBulletSimulator
from ssduck.simulators.scenes import SensorSpec, find_scene, read_sensor
from ssduck.simulators.sensor_types import MAX_RAYS, SENSOR_TYPES
from ssduck.world.sensor_readings import Reading
from tests.support.bodies import create_linked_body
from tests.support.cases import sampled
from tests.support.urdf import collision, joint, link, robot

ROOT = Path(__file__).resolve().parents[2]
# What Bullet's rays are true to, metres: its convex hulls are 1 mm larger, its steps end at 0.1 mm.
EXACT = 5e-4
LASER = {"min_angle": -180, "max_angle": 180, "resolution": 1, "max_range": 20}
CAMERA = {"width": 64, "height": 48, "fov": 50, "max_range": 10}


class Stage:
    """A PyBullet client of ssduck's own that tests fill with shapes."""

    def __init__(self):
        self.client = pybullet.connect(pybullet.DIRECT)
        self.names = {}
        self.world = None
        self.casts = []

    def add(self, name, kind, position, mass=0.0, turn=(0, 0, 0, 1), **size):
        shape = pybullet.createCollisionShape(kind, physicsClientId=self.client, **size)
        body = pybullet.createMultiBody(
            mass, shape, basePosition=position, baseOrientation=turn, physicsClientId=self.client
        )
        self.names[body] = name
        return body

    def box(self, name, halves, position, **more):
        return self.add(name, pybullet.GEOM_BOX, position, halfExtents=halves, **more)

    def sphere(self, name, radius, position, **more):
        return self.add(name, pybullet.GEOM_SPHERE, position, radius=radius, **more)

    def open(self, *, owned=True):
        """The world of what is there; it counts the rays that are cast."""
        simulator = PyBulletSimulator(self.client, owned=owned, names=self.names)
        cast = simulator.cast_rays

        def counted(starts, ends, through):
            self.casts.append(len(starts))
            return cast(starts, ends, through)

        simulator.cast_rays = counted
        self.world = ssduck.World(simulator)
        return self.world

    def seen(self, sensor):
        """The names of what a sensor perceives."""
        return [self.world.entity(id).name for id in sensor.reading.hits]


@pytest.fixture
def stage():
    made = Stage()
    yield made
    if pybullet.isConnected(made.client):
        pybullet.disconnect(made.client)


@pytest.fixture
def mast(stage):
    """A stage with a small body at its origin to put sensors on."""
    stage.sphere("mast", 0.01, [0, 0, 0])
    return stage


def evaluators(world):
    """Interpreters of both kinds with the world as `sim`."""
    for row_by_row in (False, True):
        with ssduck.Interpreter(row_by_row=row_by_row) as ss:
            ss.add_variable("sim", world)
            yield ss


# -- lasers in a room of known size ------------------------------------------------------------

LOW, HIGH = np.array([-2.0, -3.0, -1.0]), np.array([4.0, 1.5, 2.0])


def room(stage):
    """Six walls whose inner faces are those of a box from LOW to HIGH."""
    middle, halves = (LOW + HIGH) / 2, (HIGH - LOW) / 2
    for axis in range(3):
        for side, at in (("low", LOW), ("high", HIGH)):
            thick = np.full(3, 10.0)
            thick[axis] = 0.5
            place = middle.copy()
            place[axis] = at[axis] + (-0.5 if side == "low" else 0.5)
            stage.box(f"{'xyz'[axis]}_{side}", (halves * 0 + thick).tolist(), place.tolist())


def to_wall(start, directions):
    """How far it is to the walls in these directions, and to which."""
    with np.errstate(divide="ignore"):
        ways = np.maximum((LOW - start) / directions, (HIGH - start) / directions)
    axes = np.argmin(ways, axis=1)
    names = [
        f"{'xyz'[axis]}_{'high' if direction[axis] > 0 else 'low'}"
        for axis, direction in zip(axes, directions, strict=True)
    ]
    return ways.min(axis=1), names


POSES = [
    ([0, 0, 0], [1, 0, 0, 0]),
    ([1.2, -0.7, 0.4], [1, 0, 0, 0]),
    ([0.3, 0.2, 0.1], [0.9659258, 0, 0, 0.2588190]),
    ([-1.0, 1.0, 1.2], [0.8, 0.0, 0.6, 0.0]),
    ([2.5, -2.0, -0.5], [0.5, 0.5, -0.5, 0.5]),
]


def turned(orientation, vectors):
    return Rotation.from_quat(np.roll(orientation, -1)).apply(vectors)


@pytest.mark.parametrize(("position", "orientation"), POSES)
def test_a_laser_measures_a_room(mast, position, orientation):
    room(mast)
    world = mast.open()
    laser = world.add_sensor(
        "planar_laser", "mast", position=position, orientation=orientation, **LASER
    )
    angles = np.radians(np.arange(-180, 180))  # 180 is where -180 is
    own = np.stack([np.cos(angles), np.sin(angles), np.zeros_like(angles)], axis=1)
    directions = turned(orientation, own)
    expected, names = to_wall(np.array(position), directions)
    assert laser.rays == 360
    assert laser.ranges == pytest.approx(expected, abs=EXACT)
    assert laser.points == pytest.approx(position + directions * expected[:, None], abs=EXACT)
    hits = laser.reading.hits
    for name in set(names):  # but for rays into a corner
        assert hits[world[name].id] == pytest.approx(names.count(name), abs=2)


@pytest.mark.parametrize(("position", "orientation"), POSES)
def test_a_lidar_measures_a_room(mast, position, orientation):
    room(mast)
    world = mast.open()
    lidar = world.add_sensor(
        "lidar",
        world["mast"],
        position=position,
        orientation=orientation,
        max_range=20,
        min_angle=-90,
        max_angle=90,
        resolution=7,
        min_elevation=-60,
        max_elevation=80,
        layers=9,
    )
    up, left = np.meshgrid(
        np.radians(np.linspace(-60, 80, 9)), np.radians(np.arange(-90, 91, 7)), indexing="ij"
    )
    own = np.stack([np.cos(up) * np.cos(left), np.cos(up) * np.sin(left), np.sin(up)], axis=-1)
    expected, _ = to_wall(np.array(position), turned(orientation, own.reshape(-1, 3)))
    assert lidar.rays == 9 * 26
    assert lidar.ranges == pytest.approx(expected, abs=EXACT)


def test_a_lidar_needs_but_a_range(mast):
    lidar = mast.open().add_sensor("lidar", "mast", max_range=5)
    assert lidar.rays == 16 * 360
    assert np.isinf(lidar.ranges).all()
    assert lidar.points.shape == (0, 3)


# (min_angle, max_angle, resolution, rays)
SWEEPS = [
    (-45, 45, 1, 91),
    (-45, 25, 1, 71),
    (0, 0, 1, 1),
    (0, 1, 0.1, 11),
    (0, 1, 0.3, 4),
    (0, 1, 2, 1),
    (-180, 180, 1, 360),
    (0, 360, 90, 4),
    (-360, 0, 7, 52),
    (-179, 180, 1, 360),
]


@pytest.mark.parametrize(("low", "high", "resolution", "rays"), SWEEPS)
def test_how_many_rays_a_sweep_has(low, high, resolution, rays):
    settings = {"min_angle": low, "max_angle": high, "resolution": resolution}
    kind = SENSOR_TYPES["planar_laser"]
    ends = kind.rays(2.0, settings)
    assert ends.shape == (rays, 3)
    assert kind.shape(settings) == (rays,)
    assert len(np.unique(ends.round(9), axis=0)) == rays
    assert np.linalg.norm(ends, axis=1) == pytest.approx(2.0)
    assert ends[0] == pytest.approx(
        [2 * math.cos(math.radians(low)), 2 * math.sin(math.radians(low)), 0]
    )


@pytest.mark.parametrize("kind", SENSOR_TYPES.values(), ids=lambda kind: kind.name)
def test_every_type_is_complete(kind):
    assert kind.about.endswith(".")
    for setting in kind.settings:
        assert setting.about
        assert setting.unit in ("m", "degrees", "pixels", "")
    page = (ROOT / "docs" / "reference" / "sensors.md").read_text(encoding="utf-8")
    assert f"`{kind.name}`" in page
    for setting in kind.settings:
        assert f"`{setting.name}`" in page


def test_only_the_simulators_know_pybullet():
    package = ROOT / "ssduck"
    others = [p for p in package.rglob("*.py") if package / "simulators/pybullet" not in p.parents]
    assert len(others) > 100
    for path in others:
        assert "import pybullet" not in path.read_text(encoding="utf-8")


# -- a camera and a sphere ---------------------------------------------------------------------


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


@pytest.mark.parametrize(("radius", "distance"), [(0.5, 3.0), (0.3, 1.0), (1.0, 4.0)])
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


# -- who hides whom ----------------------------------------------------------------------------


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


# -- the sensor's own body ---------------------------------------------------------------------


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
@pytest.mark.parametrize("front", [0.5, 1.0, 1.1, 1.10001, 1.5, 1.9, 2.0, 2.1, 2.10001, 3.0])
@pytest.mark.parametrize("start", [-1.0, 0.0])
def test_rays_pass_through_the_sensors_own_body(inside, front, start):
    inside.box("other", [0.3, 1, 1], [front + 0.3, 0, 0])
    world = inside.open()
    finder = world.add_sensor("range_finder", "host", position=[start, 0, 0], max_range=10)
    assert finder.ranges == pytest.approx([front - start], abs=EXACT)
    assert inside.seen(finder) == ["other"]


@pytest.mark.parametrize("start", [0.95, 1.0, 1.05, 2.0])
def test_a_ray_may_begin_in_the_sensors_own_body(inside, start):
    inside.box("other", [0.3, 1, 1], [3.3, 0, 0])
    world = inside.open()
    finder = world.add_sensor("range_finder", "host", position=[start, 0, 0], max_range=10)
    assert finder.ranges == pytest.approx([3 - start], abs=EXACT)


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


# -- just inside, just outside -----------------------------------------------------------------


@pytest.mark.parametrize(
    ("distance", "there"), [(2 - 1e-3, True), (2 + 1e-3, False), (1e-2, True), (50, False)]
)
@sampled("kind", ["range_finder", "planar_laser", "depth_camera"], every=3)
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


# -- on and off --------------------------------------------------------------------------------

EACH = (
    "SELECT id(s.this), isSensing(s.this, o.this), sensingAmount(s.this, o.this), sensingEnvIDs(s.this) "
    "FROM s=sim, o=sim WHERE isSensor(s.this) AND id(o.this) == 'wall' AS list;"
)
RAW = (
    "SELECT s.name, isSensing(s, o), sensingAmount(s, o), sensingEnvIDs(s) "
    "FROM entities s, entities o WHERE isSensor(s) AND o.name = 'wall'"
)


@pytest.mark.slow
def test_a_sensor_that_is_off_perceives_nothing(mast):
    mast.box("wall", [0.5, 9, 9], [2, 0, 0])
    world = mast.open()
    eye = world.add_sensor("range_finder", "mast", "eye", max_range=5)
    wall = world["wall"].id
    for ss in evaluators(world):
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


# -- what perceives what -----------------------------------------------------------------------


def test_nothing_senses_itself_its_body_or_a_sensor(mast):
    mast.box("wall", [0.5, 9, 9], [2, 0, 0])
    world = mast.open()
    world.add_sensor("range_finder", "mast", "one", position=[-0.5, 0, 0], max_range=5)
    world.add_sensor("range_finder", "mast", "two", max_range=5)
    world.add_sensor("planar_laser", "wall", "three", position=[-1, 0, 0], **LASER)
    for ss in evaluators(world):
        pairs = ss.eval(
            "SELECT id(a.this), id(b.this) FROM a=sim, b=sim WHERE isSensing(a.this, b.this) AS list;"
        )
        assert pairs == ["one", "wall", "two", "wall", "three", "mast"]
        # The first argument is no sensor.
        assert (
            ss.eval(
                "SELECT id FROM sim WHERE isSensing(this, this) OR sensingAmount(this, this) > 0 AS list;"
            )
            == []
        )
        assert ss.eval("SELECT sensingEnvIDs FROM sim WHERE NOT isSensor(this) AS list;") == [
            [],
            [],
        ]
        assert (
            ss.eval(
                "SELECT id(b.this) FROM a=sim, b=sim WHERE id(a.this) == 'wall' AND isSensing(a.this, b.this) AS list;"
            )
            == []
        )


@pytest.mark.slow
def test_aliases_in_sql_may_be_words_of_the_table(mast):
    mast.box("wall", [0.5, 9, 9], [2, 0, 0])
    world = mast.open()
    world.add_sensor("range_finder", "mast", "eye", max_range=5)
    for ss in evaluators(world):
        for a, b in (
            ("sensor", "entity"),
            ("hits", "rays"),
            ("ids", "seen"),
            ("s", "e"),
            ("e", "s"),
        ):
            rows = ss.sql(
                f"SELECT {a}.name, {b}.name, sensingAmount({a}, {b}), sensingEnvIDs({a}) "
                f"FROM entities {a}, entities {b} WHERE isSensing({a}, {b})"
            )
            assert rows.fetchall() == [("eye", "wall", 1.0, [world["wall"].id])]
        for a, b in (("sensor", "hits"), ("rays", "seen"), ("s", "e")):
            program = f"SELECT id({a}.this), id({b}.this) FROM {a}=sim, {b}=sim WHERE isSensing({a}.this, {b}.this) AS list;"
            assert ss.eval(program) == ["eye", "wall"]


# Programs with `eye`, which sees wall and post, as a variable: (program, result).
PROGRAMS = [
    ("SELECT id FROM sim WHERE isSensing(eye, this) AS list;", ["wall", "post"]),
    ("SELECT id FROM sim WHERE NOT isSensing(eye, this) AS list;", ["eye", "mast"]),
    (
        "SELECT id FROM sim WHERE isSensing(eye, this) == False AND isKinbody(this) AS list;",
        ["mast"],
    ),
    ("SELECT id FROM sim WHERE isSensing(eye, this) XOR id(this) == 'post' AS list;", ["wall"]),
    (
        "SELECT id FROM sim WHERE isSensing(eye, this) AND x(this) < 1.5 OR id(this) == 'mast' AS list;",
        ["mast", "post"],
    ),
    ("SELECT id FROM sim WHERE sensingAmount(eye, this) > 0.5 AS list;", ["wall"]),
    (
        "SELECT id FROM sim WHERE environmentID(this) IN sensingEnvIDs(eye) AS list;",
        ["wall", "post"],
    ),
    (
        "SELECT id FROM sim ORDER BY sensingAmount(eye, this) DESC, id LIMIT 2 AS list;",
        ["wall", "post"],
    ),
    (
        "SELECT id, count(sensingEnvIDs(this)) FROM sim WHERE count(sensingEnvIDs(this)) > 0;",
        [{"id": "eye", "count": 2}],
    ),
    ("count(sensingEnvIDs(eye)) + 0;", 2),
    ("isSensing(eye, wall);", True),
    (
        "[isSensing(eye, eye), isSensing(wall, eye), sensingAmount(wall, eye), sensingEnvIDs(wall)];",
        [False, False, 0.0, []],
    ),
    (
        "SELECT id FROM sim WHERE [] != (SELECT id(s.this) FROM s=sim WHERE isSensing(s.this, wall) AS list) AND isSensing(eye, this) AS list;",
        ["wall", "post"],
    ),
    (
        "SELECT id(s.this) FROM s=(SELECT obj FROM sim WHERE isSensing(eye, this) AS list) AS list;",
        ["wall", "post"],
    ),
    (
        "SELECT id(s.this), n.this FROM s=sim, n=[1] WHERE isSensing(eye, s.this) AS list;",
        ["wall", 1, "post", 1],
    ),
    ("eval('SELECT id FROM sim WHERE isSensing(eye, this) AS list;');", ["wall", "post"]),
    (
        "seen = [isSensing(eye, o.this)]; SELECT id(o.this), seen[0] FROM o=sim WHERE isKinbody(o.this) AS list;",
        ["mast", False, "wall", True, "post", True],
    ),
    (
        "SELECT id(o.this) FROM o=sim WHERE isSensing(eye, o.this) START WITH n = 0 CONNECT BY NO CYCLE n = n + 1 STOP WITH n == 1 LIMIT 4 AS list;",
        [["eye", "wall"], ["eye", "post"], ["mast", "wall"], ["mast", "post"]],
    ),
]


@sampled(("program", "expected"), PROGRAMS, every=4)
@pytest.mark.parametrize("owned", [True, False])
def test_programs_about_sensors(mast, program, expected, owned):
    mast.box("wall", [0.5, 9, 9], [3, 0, 0])
    mast.box("post", [0.1, 0.1, 0.1], [1, 0, 0])
    world = mast.open(owned=owned)
    eye = world.add_sensor("depth_camera", "mast", "eye", **CAMERA)
    for ss in evaluators(world):
        ss.add_variable("eye", eye)
        ss.add_variable("wall", world["wall"])
        assert ss.eval(program) == expected


def test_help_tells_of_the_sensors_relations(mast):
    for ss in evaluators(mast.open()):
        assert ss.help("isSensing").endswith("Usage: isSensing(s, e) -> bool")
        assert ss.help("sensingAmount").endswith("Usage: sensingAmount(s, e) -> float")
        assert ss.help("sensingEnvIDs").endswith("Usage: sensingEnvIDs(s) -> list")
        with pytest.raises(ArgumentError, match="isSensing takes 2 arguments, not 1"):
            ss.eval("SELECT id FROM sim WHERE isSensing(this) AS list;")
        with pytest.raises(ArgumentError, match="s must be a sensor, not a number"):
            ss.eval("SELECT id FROM sim WHERE isSensing(3, this) AS list;")


@pytest.mark.slow
def test_two_worlds_do_not_see_each_other(mast):
    mast.box("wall", [0.5, 9, 9], [2, 0, 0])
    world = mast.open()
    world.add_sensor("range_finder", "mast", "eye", max_range=5)
    other = Stage()
    other.sphere("a", 0.1, [0, 0, 0])
    other.box("b", [0.1, 0.1, 0.1], [9, 9, 9])
    second = other.open()
    try:
        for ss in evaluators(world):
            ss.add_variable("other", second)
            program = "SELECT id(a.this), id(b.this) FROM a={}, b={} WHERE isSensing(a.this, b.this) OR sensingAmount(a.this, b.this) > 0 AS list;"
            assert ss.eval(program.format("sim", "other")) == []
            assert ss.eval(program.format("other", "sim")) == []
            assert ss.eval(program.format("other", "other")) == []
            assert ss.eval(program.format("sim", "sim")) == ["eye", "wall"]
            # A row does not tell which world it is of.
            for relation in ("isSensing(a, b)", "sensingAmount(a, b)", "sensingEnvIDs(a)"):
                with pytest.raises(
                    SelectScriptError, match=r"for one world.*world\.sens|world\.is"
                ):
                    ss.sql(f"SELECT {relation} FROM entities a, entities b")
            assert ss.sql("SELECT count(*) FROM sim.sensings").fetchone() == (1,)
            assert ss.sql("SELECT count(*) FROM other.sensings").fetchone() == (0,)
    finally:
        pybullet.disconnect(other.client)


def test_without_a_world_sql_says_so():
    with (
        ssduck.Interpreter() as ss,
        pytest.raises(SelectScriptError, match="isSensing: in SQL it needs one world"),
    ):
        ss.sql("SELECT isSensing({'id': 1}, {'id': 2})")


# -- a reading is of a tick --------------------------------------------------------------------


@pytest.mark.slow
def test_a_plan_sees_what_is_perceived_now(mast):
    """The table has more or fewer rows from tick to tick; plans are kept all the same."""
    mast.box("wall", [0.5, 9, 9], [2, 0, 0])
    mast.box("post", [0.1, 0.1, 0.1], [1, 0, 0])
    world = mast.open()
    eye = world.add_sensor("depth_camera", "mast", "eye", **CAMERA)
    for ss in evaluators(world):
        ss.sql(
            "CREATE OR REPLACE TEMP VIEW seen AS SELECT e.name FROM entities s, entities e WHERE isSensing(s, e) ORDER BY 1"
        )
        program = ss.compile(
            "SELECT id(b.this) FROM a=sim, b=sim WHERE isSensing(a.this, b.this) ORDER BY id(b.this) AS list;"
        )
        for place, expected in (
            ([1, 0, 0], ["post", "wall"]),
            ([-1, 0, 0], ["wall"]),
            ([1, 0.1, 0], ["post", "wall"]),
            ([4, 0, 0], ["wall"]),
        ):
            world["post"].move(place)
            assert ss.eval(program) == expected
            assert ss.sql("FROM seen").fetchall() == [(name,) for name in expected]
            assert sorted(mast.seen(eye)) == expected


def test_a_reading_stays_what_it_was(mast):
    mast.sphere("ball", 0.1, [1, 0, 0], mass=1)
    pybullet.setGravity(0, 0, -10, mast.client)
    world = mast.open()
    eye = world.add_sensor("planar_laser", "mast", **LASER)
    first = eye.reading
    ranges = first.ranges.copy()
    world.step(240)
    second = eye.reading
    assert isinstance(first, Reading)
    assert (first.time, second.time) == (0.0, pytest.approx(1.0))
    assert first.tick < second.tick == world.snapshot.number
    assert (first.ranges == ranges).all()
    assert first.hits
    assert second.hits == {}
    with pytest.raises(ValueError, match="read-only"):
        first.ranges[0] = 0
    with pytest.raises(AttributeError):
        first.time = 3


def test_a_period_passes_before_a_sensor_is_read_again(mast):
    mast.sphere("ball", 0.1, [1, 0, 0])
    world = mast.open()
    world.add_sensor("planar_laser", "mast", "slow", **LASER, period=0.1)
    world.add_sensor("range_finder", "mast", "quick", max_range=5)
    for ss in evaluators(world):
        assert ss.eval(
            "SELECT id(a.this) FROM a=sim, b=sim WHERE isSensing(a.this, b.this) AS list;"
        ) == ["slow", "quick"]
    mast.casts.clear()
    for _ in range(49):
        world.step()
    # 24 steps of 1/240 s are a tenth of a second.
    assert mast.casts == [361 if n in (24, 48) else 1 for n in range(1, 50)]
    found = dict(
        zip(
            *(world.snapshot.tables["sensings"][c].tolist() for c in ("sensor", "measured")),
            strict=True,
        )
    )
    assert found == {
        world["slow"].id: pytest.approx(0.2),
        world["quick"].id: pytest.approx(49 / 240),
    }
    assert world["slow"].reading.time == pytest.approx(0.2)
    assert world["slow"].reading.tick == world.snapshot.number - 1
    # What is moved by hand is seen at once: no time passed.
    world["ball"].move([-5, 0, 0])
    assert mast.casts[-1] == 361
    assert world["quick"].reading.hits == {}
    # And so is what came or went.
    world.add_sensor("range_finder", "ball", "new", max_range=5)
    assert mast.casts[-1] == 362


def test_in_your_own_client_time_may_pass_unknown(mast):
    """Every tick of the same time is read."""
    ball = mast.sphere("ball", 0.1, [1, 0, 0])
    world = mast.open(owned=False)
    eye = world.add_sensor("range_finder", "mast", max_range=5, period=10)
    assert mast.seen(eye) == ["ball"]
    pybullet.resetBasePositionAndOrientation(ball, [0, 3, 0], [0, 0, 0, 1], mast.client)
    assert mast.seen(eye) == ["ball"]
    assert mast.seen(world.tick(steps=0) and eye) == []
    pybullet.resetBasePositionAndOrientation(ball, [1, 0, 0], [0, 0, 0, 1], mast.client)
    world.step()
    assert mast.seen(eye) == []  # a clock that runs counts
    mast.casts.clear()
    world.step(10)
    assert mast.casts == []


# -- what it costs -----------------------------------------------------------------------------


def test_sensors_cost_nothing_until_they_are_asked_for(mast):
    mast.box("wall", [0.5, 9, 9], [2, 0, 0])
    world = mast.open()
    world.add_sensor("depth_camera", "mast", **CAMERA)
    world.add_sensor("planar_laser", "mast", **LASER)
    for _ in range(3):
        world.step()
    for ss in evaluators(world):
        ss.eval("SELECT id, z FROM sim WHERE isSensor(this);")
        ss.sql("SELECT count(*) FROM entities e WHERE isSensor(e)")
    assert mast.casts == []


@pytest.mark.slow
def test_all_rays_of_a_tick_are_cast_in_one_call(mast, monkeypatch):
    mast.box("wall", [0.5, 9, 9], [2, 0, 0])
    world = mast.open()
    world.add_sensor("depth_camera", "mast", **CAMERA)
    world.add_sensor("planar_laser", "mast", **LASER)
    world.add_sensor("range_finder", "mast", max_range=2)
    off = world.add_sensor("lidar", "mast", max_range=2, powered=False)
    calls = []
    real = pybullet.rayTestBatch

    def counted(starts, ends, **more):
        calls.append((len(starts), more["numThreads"]))
        return real(starts, ends, **more)

    monkeypatch.setattr(pybullet_rays.pybullet, "rayTestBatch", counted)
    all_rays = 64 * 48 + 360 + 1
    for ss in evaluators(world):
        for _ in range(3):
            ss.eval(
                "SELECT id(b.this), sensingAmount(a.this, b.this) FROM a=sim, b=sim WHERE isSensing(a.this, b.this);"
            )
            ss.sql("SELECT isSensing(a, b), sensingEnvIDs(a) FROM entities a, entities b")
    assert calls == [(all_rays, 0)]
    world.step(5)
    assert calls == [(all_rays, 0)] * 2
    off.power(True)
    assert off.rays == 16 * 360
    assert calls[2:] == [(16 * 360 + all_rays, 0)]


def test_one_sensor_is_read_by_itself(mast):
    """An expensive one is not read for the sake of a cheap one; a query reads all."""
    mast.box("wall", [0.5, 9, 9], [2, 0, 0])
    world = mast.open()
    camera = world.add_sensor("depth_camera", "mast", **CAMERA)
    finder = world.add_sensor("range_finder", "mast", max_range=5, period=0.1)
    assert finder.ranges == pytest.approx([1.5], abs=EXACT)
    assert mast.casts == [1]
    world.step(24)
    assert mast.casts == [1, 1]
    assert camera.rays == 64 * 48  # asked for now, in the same tick
    assert mast.casts == [1, 1, 64 * 48]
    assert world.snapshot.tables["sensings"].count == 0
    for ss in evaluators(world):
        assert ss.sql("SELECT count(*) FROM sensings").fetchone() == (2,)
        assert ss.eval("SELECT id FROM sim WHERE count(sensingEnvIDs(this)) > 0 AS list;") == [
            camera.name,
            finder.name,
        ]
    finder.power(False)
    assert finder.reading is None
    finder.power(True)
    assert finder.reading.hits


@pytest.mark.parametrize(("rays", "threads"), [(1, 1), (49, 1), (50, 0), (51, 0)])
def test_few_rays_wake_no_threads(mast, monkeypatch, rays, threads):
    world = mast.open()
    found = []
    real = pybullet.rayTestBatch
    monkeypatch.setattr(
        pybullet_rays.pybullet,
        "rayTestBatch",
        lambda *a, **more: found.append(more["numThreads"]) or real(*a, **more),
    )
    sensor = world.add_sensor(
        "planar_laser", "mast", min_angle=0, max_angle=rays - 1, resolution=1, max_range=1
    )
    assert sensor.rays == rays
    assert found == [threads]


def test_more_rays_than_pybullet_takes_in_one_call(mast):
    mast.box("wall", [0.5, 9, 9], [2, 0, 0])
    world = mast.open()
    camera = world.add_sensor("depth_camera", "mast", width=200, height=150, fov=40, max_range=5)
    assert camera.rays == 30_000 > pybullet_rays.MAX_RAYS
    assert camera.depth == pytest.approx(np.full((150, 200), 1.5), abs=EXACT)


def test_colours_are_drawn_when_they_are_asked_for(mast):
    mast.box("wall", [0.5, 9, 9], [2, 0, 0])
    world = mast.open()
    camera = world.add_sensor("depth_camera", "mast", **CAMERA, period=1.0)
    pictures = []
    real = world._simulator.photograph
    world._simulator.photograph = lambda view: pictures.append(view) or real(view)
    assert camera.depth.shape == (48, 64)
    world.step()
    assert pictures == []
    assert camera.reading.image is None
    image = camera.image
    assert image.shape == (48, 64, 3)
    assert camera.image is image
    assert camera.reading.time == world.time  # its depth is of the same moment
    assert len(pictures) == 1
    world.step(240)
    assert len(pictures) == 2
    # Nobody asks any more.
    for _ in range(260):
        world.step(0)
        world.request_tables(["sensings"])
    world.step(240)
    assert len(pictures) == 2


def test_sensors_that_nobody_asks_for_any_more_are_read_no_more(mast):
    world = mast.open()
    eye = world.add_sensor("range_finder", "mast", max_range=5)
    assert eye.rays == 1
    for _ in range(300):
        world.step()
    assert len(mast.casts) == FORGOTTEN_AFTER
    assert eye.rays == 1
    assert len(mast.casts) == FORGOTTEN_AFTER + 1


# -- on a link ---------------------------------------------------------------------------------

LIMIT = '<limit lower="-3" upper="3" effort="500" velocity="20"/>'
ARM = robot(
    link("base", mass=5, com=(0, 0, 0.1), shapes=collision('<box size="0.4 0.4 0.4"/>')),
    link("arm", com=(0.2, 0.1, 0), rpy=(0.3, 0, 0), shapes=collision('<sphere radius="0.05"/>')),
    joint("turn", "revolute", "base", "arm", xyz=(0, 0, 1), axis=(0, 0, 1), limit=LIMIT),
    name="arm",
)
BALL = robot(link("ball", shapes=collision('<sphere radius="0.25"/>')), name="ball")
SCENE = """
gravity = [0, 0, 0]
[[body]]
name = "arm"
urdf = "arm.urdf"
position = [1, 2, 0]
fixed = true
[[body]]
name = "ahead"
urdf = "ball.urdf"
position = [4, 2, 1]
[[body]]
name = "aside"
urdf = "ball.urdf"
position = [1, 4, 1]
[[sensor]]
name = "eye"
type = "range_finder"
on = "arm"
link = "arm"
position = [0.1, 0, 0]
max_range = 10
"""


@pytest.fixture
def arm(write):
    write("arm.urdf", ARM)
    write("ball.urdf", BALL)
    world = ssduck.World.load(find_scene(write("room.toml", SCENE)))
    yield world
    world.close()


def test_a_sensor_on_a_link_looks_where_the_link_points(arm):
    client = arm._simulator.client
    (handle,) = (
        b.handle for b in (d.body for d in arm._simulator._descriptions.values()) if b.name == "arm"
    )
    eye = arm["eye"]
    assert eye.ranges == pytest.approx([3 - 0.1 - 0.25], abs=EXACT)
    assert [arm.entity(id).name for id in eye.reading.hits] == ["ahead"]
    pybullet.setJointMotorControl2(
        handle,
        0,
        pybullet.POSITION_CONTROL,
        targetPosition=math.pi / 2,
        force=500,
        physicsClientId=client,
    )
    arm.step(480)
    assert arm["arm"].joints[0].position == pytest.approx(math.pi / 2, abs=1e-2)
    assert [arm.entity(id).name for id in eye.reading.hits] == ["aside"]
    assert eye.ranges == pytest.approx([2 - 0.1 - 0.25], abs=5e-3)
    for ss in evaluators(arm):
        assert ss.eval(
            "SELECT id(b.this) FROM a=sim, b=sim WHERE isSensing(a.this, b.this) AS list;"
        ) == ["aside"]


def test_a_sensor_is_added_to_a_link(arm):
    eye = arm.add_sensor(
        "range_finder", "arm", "new", link="arm", position=[0.2, 0, 0], max_range=9
    )
    assert eye.position == pytest.approx([1.2, 2, 1], abs=1e-6)
    assert [e.name for e in arm] == ["eye", "new", "arm", "ahead", "aside"]
    assert eye.ranges == pytest.approx([3 - 0.2 - 0.25], abs=EXACT)
    with pytest.raises(
        ArgumentError, match="add_sensor: link: 'arm' has no link 'amr'; did you mean 'arm'"
    ):
        arm.add_sensor("range_finder", "arm", link="amr", max_range=9)


# -- contact -----------------------------------------------------------------------------------


def standing(stage):
    """A crate on a floor, and a lamp that hangs above it."""
    pybullet.setGravity(0, 0, -10, stage.client)
    stage.box("floor", [5, 5, 0.5], [0, 0, -0.5])
    stage.box("crate", [0.5, 0.5, 0.5], [0, 0, 0.5], mass=2.0)
    stage.box("lamp", [0.5, 0.5, 0.5], [0, 0, 1.6])
    return stage.open()


def test_a_contact_sensor_feels_what_presses(stage):
    world = standing(stage)
    touch = world.add_sensor("contact_sensor", "crate", "touch")
    world.step(240)
    assert stage.seen(touch) == ["floor"]
    assert touch.forces.sum() == pytest.approx(20, rel=0.02)
    assert touch.rays == len(touch.forces) == len(touch.points)
    assert touch.points[:, 2] == pytest.approx(np.zeros(touch.rays), abs=5e-3)
    for ss in evaluators(world):
        program = "SELECT id(b.this), sensingAmount(a.this, b.this) FROM a=sim, b=sim WHERE isSensing(a.this, b.this) AS list;"
        assert ss.eval(program) == ["floor", 1.0]
    touch.power(False)
    for ss in evaluators(world):
        assert ss.eval(program) == []
    touch.power(True)
    world["crate"].move([0, 0, 3])
    world.step()
    assert stage.seen(touch) == []
    assert touch.points.shape == (0, 3)
    assert stage.casts == []  # it casts no rays


def test_what_touches_without_force_does_not_press(stage):
    """Before the first step the solver knows of no forces."""
    stage.box("floor", [5, 5, 0.5], [0, 0, -0.5])
    stage.box("crate", [0.5, 0.5, 0.5], [0, 0, 0.499], mass=2.0)
    world = stage.open()
    pybullet.performCollisionDetection(stage.client)
    touch = world.add_sensor("contact_sensor", "crate")
    world.request_tables(["contacts"])
    assert world.snapshot.tables["contacts"].count > 0
    assert touch.rays == 0


def test_a_contact_sensor_on_a_link_feels_that_link(write):
    """The arm rests on a ball; its base on nothing."""
    write("arm.urdf", ARM)
    write("ball.urdf", BALL)
    scene = (
        SCENE.replace("[0, 0, 0]", "[0, 0, -10]")
        .replace("position = [4, 2, 1]", "position = [1, 2, 1.3]")
        .replace("[1, 4, 1]", "[1, 4, 50]")
    )
    scene += '[[sensor]]\nname = "of_arm"\ntype = "contact_sensor"\non = "arm"\nlink = "arm"\n'
    scene += '[[sensor]]\nname = "of_base"\ntype = "contact_sensor"\non = "arm"\nlink = "base"\n'
    scene += '[[sensor]]\nname = "of_all"\ntype = "contact_sensor"\non = "arm"\n'
    world = ssduck.World.load(find_scene(write("room.toml", scene)))
    try:
        world["of_all"].power(True)
        for _ in range(24):
            world.step()
            found = {name: world[name].reading.rays for name in ("of_arm", "of_base", "of_all")}
            if found["of_all"]:
                break
        assert found["of_all"] == found["of_arm"] > 0
        assert found["of_base"] == 0
        assert [world.entity(id).name for id in world["of_arm"].reading.hits] == ["ahead"]
    finally:
        world.close()


# -- coming and going --------------------------------------------------------------------------


def test_sensors_come_and_go(mast):
    mast.box("wall", [0.5, 9, 9], [2, 0, 0])
    world = mast.open()
    eye = world.add_sensor("range_finder", "mast", max_range=5)
    again = world.add_sensor("range_finder", "mast", max_range=5)
    assert [eye.name, again.name] == ["mast_range_finder", "mast_range_finder_2"]
    assert [eye.kind, eye.spec.on, eye.mass] == ["sensor", "mast", 0.0]
    for ss in evaluators(world):
        assert ss.eval("SELECT id FROM sim WHERE isSensor(this) AS list;") == [eye.name, again.name]
    assert mast.seen(eye) == ["wall"]
    world.remove_sensor(eye)
    assert [e.name for e in world] == [again.name, "mast", "wall"]
    for act in (
        lambda: eye.reading,
        lambda: eye.power(False),
        lambda: eye.powered,
        lambda: world.remove_sensor(eye),
        lambda: eye.ranges,
    ):
        with pytest.raises(RemovedEntityError, match="'mast_range_finder' is no longer in world"):
            act()
    world.remove_sensor(again.name)
    for ss in evaluators(world):
        assert ss.eval("SELECT id FROM sim WHERE isSensor(this) AS list;") == []
        assert ss.sql("FROM sensings").fetchall() == []


def test_what_is_removed_is_perceived_no_more(mast):
    mast.box("wall", [0.5, 9, 9], [2, 0, 0])
    behind = mast.box("behind", [0.5, 9, 9], [4, 0, 0])
    world = mast.open(owned=False)
    eye = world.add_sensor("range_finder", "mast", max_range=5, period=100)
    other = world.add_sensor("range_finder", "behind", "other", max_range=5)
    assert mast.seen(eye) == ["wall"]
    pybullet.removeBody(1, mast.client)
    world.tick()
    assert mast.seen(eye) == ["behind"]
    pybullet.removeBody(behind, mast.client)
    for ss in evaluators(world):
        world.tick()
        assert (
            ss.eval("SELECT id(b.this) FROM a=sim, b=sim WHERE isSensing(a.this, b.this) AS list;")
            == []
        )
    with pytest.raises(RemovedEntityError):
        other.reading  # noqa: B018


def test_a_body_that_the_world_does_not_know_yet_is_in_the_way(mast):
    """It ends rays, and is nothing that could be named before the next tick."""
    mast.box("wall", [0.5, 9, 9], [2, 0, 0])
    world = mast.open()  # ssduck's own: bodies that others add are not looked for
    mast.box("late", [0.1, 1, 1], [1, 0, 0])
    eye = world.add_sensor("range_finder", "mast", max_range=5)
    assert eye.ranges == pytest.approx([0.9], abs=EXACT)
    assert eye.reading.entities.tolist() == [0]
    assert eye.reading.hits == {}


def test_a_sensor_that_is_nowhere_perceives_nothing(mast):
    body = mast.sphere("lost", 0.1, [0, 0, 5], mass=1)
    mast.box("wall", [0.5, 9, 9], [2, 0, 0])
    world = mast.open()
    lost = world.add_sensor("range_finder", "lost", max_range=5)
    found = world.add_sensor("range_finder", "mast", max_range=5)
    pybullet.resetBasePositionAndOrientation(body, [math.nan, 0, 0], [0, 0, 0, 1], mast.client)
    with pytest.warns(UserWarning, match="no number"):
        world.tick()
    assert lost.reading is None
    assert mast.seen(found) == ["wall"]


# (add_sensor's arguments, kind of error, words)
MISTAKES = [
    (("lasr", "mast"), {}, ArgumentError, "add_sensor: type: there is no sensor type 'lasr'"),
    (("planar_lasr", "mast"), {}, ArgumentError, "did you mean 'planar_laser'?"),
    (
        ("range_finder", "mats"),
        {"max_range": 1},
        UnknownNameError,
        "has no body 'mats'; did you mean 'mast'?",
    ),
    (("range_finder", "eye"), {"max_range": 1}, ArgumentError, "on: 'eye' is a sensor, not a body"),
    (
        ("range_finder", "mast", "eye"),
        {"max_range": 1},
        ArgumentError,
        "name: 'eye' is there already",
    ),
    (
        ("range_finder", "mast", ""),
        {"max_range": 1},
        ArgumentError,
        "name: expected a text, found ''",
    ),
    (("range_finder", "mast"), {}, ArgumentError, "add_sensor: max_range: missing"),
    (
        ("range_finder", "mast"),
        {"max_range": math.inf},
        ArgumentError,
        "max_range: expected a finite number",
    ),
    (
        ("range_finder", "mast"),
        {"max_rang": 1},
        ArgumentError,
        "max_range: missing; did you mean 'max_rang'",
    ),
    (
        ("range_finder", "mast"),
        {"max_range": 1, "widht": 3},
        ArgumentError,
        "widht: there is no such key",
    ),
    (
        ("range_finder", "mast"),
        {"max_range": 1, "period": -1},
        ArgumentError,
        "period: -1 is less than 0",
    ),
    (
        ("range_finder", "mast"),
        {"max_range": 1, "powered": 1},
        ArgumentError,
        "powered: expected true or false",
    ),
    (
        ("range_finder", "mast"),
        {"max_range": 1, "position": [0, 0]},
        ArgumentError,
        "position: expected 3 finite numbers",
    ),
    (
        ("range_finder", "mast"),
        {"max_range": 1, "position": [0, 0, math.nan]},
        ArgumentError,
        "position: expected 3",
    ),
    (
        ("range_finder", "mast"),
        {"max_range": 1, "orientation": [1, 1, 0, 0]},
        ArgumentError,
        "orientation: not a rotation",
    ),
    (
        ("depth_camera", "mast"),
        CAMERA | {"width": 3.5},
        ArgumentError,
        "width: 3.5 is no whole number",
    ),
    (("depth_camera", "mast"), CAMERA | {"fov": 180}, ArgumentError, "fov: 180 is not below 180"),
    (
        ("depth_camera", "mast"),
        CAMERA | {"width": 10**4, "height": 10**4},
        ArgumentError,
        "width: that makes more than 1,000,000 rays",
    ),
    (
        ("planar_laser", "mast"),
        LASER | {"resolution": 1e-9},
        ArgumentError,
        "resolution: that makes more than 1,000,000 rays",
    ),
    (
        ("planar_laser", "mast"),
        LASER | {"resolution": 1e-300},
        ArgumentError,
        "resolution: that makes more than",
    ),
    (
        ("planar_laser", "mast"),
        LASER | {"min_angle": -360.1},
        ArgumentError,
        "min_angle: -360.1 is less than -360",
    ),
    (
        ("planar_laser", "mast"),
        LASER | {"min_angle": -181, "max_angle": 180},
        ArgumentError,
        "max_angle: more than a turn from min_angle",
    ),
    (
        ("lidar", "mast"),
        {"max_range": 1, "max_elevation": 91},
        ArgumentError,
        "max_elevation: 91 is more than 90",
    ),
    (
        ("lidar", "mast"),
        {"max_range": 1, "min_elevation": 16},
        ArgumentError,
        "min_elevation: 16 is more than max_elevation, which is 15",
    ),
    (("lidar", "mast"), {"max_range": 1, "layers": 0}, ArgumentError, "layers: 0 is not above 0"),
    (
        ("contact_sensor", "mast"),
        {"max_range": 1},
        ArgumentError,
        "max_range: there is no such key",
    ),
]


@pytest.mark.parametrize(("arguments", "settings", "kind", "words"), MISTAKES)
def test_mistakes_are_told(mast, arguments, settings, kind, words):
    world = mast.open()
    world.add_sensor("range_finder", "mast", "eye", max_range=1)
    before = [e.name for e in world]
    with pytest.raises(kind) as caught:
        world.add_sensor(*arguments, **settings)
    assert words in str(caught.value)
    assert [e.name for e in world] == before


def test_mistakes_of_other_worlds_and_of_others_than_sensors(mast):
    world = mast.open()
    other = Stage()
    other.sphere("mast", 0.1, [0, 0, 0])
    stranger = other.open()["mast"]
    with pytest.raises(ArgumentError, match="'mast' is of another world"):
        world.add_sensor("range_finder", stranger, max_range=1)
    with pytest.raises(ArgumentError, match="'mast' is a kinbody, no sensor"):
        world.remove_sensor("mast")
    with pytest.raises(UnknownNameError, match="no entity 'mats'; did you mean 'mast'"):
        world.remove_sensor("mats")
    pybullet.disconnect(other.client)


def test_sensors_stay_what_they_are_while_a_query_runs(mast):
    mast.box("wall", [0.5, 9, 9], [2, 0, 0])
    world = mast.open()
    eye = world.add_sensor("range_finder", "mast", "eye", max_range=5)
    acts = {
        "off": lambda thing: eye.power(False),
        "mount": lambda thing: world.add_sensor("range_finder", "mast", max_range=5),
        "remove": lambda thing: world.remove_sensor(eye),
    }
    for ss in evaluators(world):
        for name, act in acts.items():
            ss.add_function(name, act)
            with pytest.raises(SelectScriptError, match="a query on 'sim' is running"):
                ss.eval(f"SELECT id FROM sim WHERE {name}(this) AS list;")
        ss.add_function("far", lambda sensor: float(sensor.ranges[0]))
        assert ss.eval("SELECT far(this) FROM sim WHERE isSensor(this) AS value;") == pytest.approx(
            1.5, abs=EXACT
        )
        assert eye.powered


def test_the_greatest_number_of_rays():
    kind = SENSOR_TYPES["depth_camera"]
    assert kind.fault({"width": 1000.0, "height": 1000.0, "fov": 50.0}) is None
    assert MAX_RAYS == 1000 * 1000
    assert kind.fault({"width": 1001.0, "height": 1000.0, "fov": 50.0})[0] == "width"


def test_what_a_scene_need_not_say_of_a_sensor():
    spec = read_sensor({"name": "s", "type": "lidar", "on": "a", "max_range": 3}, ["a"])
    assert spec == SensorSpec(
        "s", "a", None, "lidar", (0, 0, 0), (1, 0, 0, 0), 0.0, 3.0,
        {"min_angle": -180.0, "max_angle": 180.0, "resolution": 1.0, "min_elevation": -15.0, "max_elevation": 15.0, "layers": 16.0},
        powered=True,
    )  # fmt: skip
    touch = read_sensor({"name": "s", "type": "contact_sensor", "on": "a", "powered": False}, ["a"])
    assert (touch.max_range, touch.settings, touch.powered) == (0.0, {}, False)
