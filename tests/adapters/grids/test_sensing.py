"""What sensors see as a grid, and sums over a plane."""

import numpy as np
import pybullet
import pytest
from scipy.spatial.transform import Rotation

from ssduck.adapters import grids as forms
from tests.support.grids import BALL, GROUND, TINY, Boxes, centres

# -- what sensors see ----------------------------------------------------------------------------


MAST = ([0.01, 0.01, 0.01], [0, 0, 0])

LIDAR = {"max_range": 4.0, "min_elevation": -90.0, "max_elevation": 90.0, "resolution": 10.0}

SEEN = "SELECT obj FROM sim WHERE isSensor(this) AS sensorgrid({z}, 0.1, [[-3, -3], [3, 3]]);"


def crosses(points, low, high):
    """Whether segments from the origin to points (n, d) meet a box, by slabs."""
    with np.errstate(divide="ignore", invalid="ignore"):
        one, two = low / points, high / points
    enter, leave = np.minimum(one, two).max(axis=1), np.maximum(one, two).min(axis=1)
    return (enter <= leave) & (enter <= 1) & (leave >= 0)


@pytest.mark.parametrize("z", [0.0, 0.4, -0.8])
def test_a_box_casts_a_shadow(z):
    with Boxes(([0.01, 0.01, 0.01], [0, 0, 0]), ([0.1, 0.4, 0.2], [1.0, 0.3, 0.1])) as boxes:
        boxes.world.add_sensor("lidar", "a", **LIDAR)
        grid = boxes.eval(SEEN.format(z=z))
        points = centres(grid, z)
        seen = np.linalg.norm(points, axis=1) <= 4.0
        seen &= ~crosses(points, np.array([0.9, -0.1, -0.1]), np.array([1.1, 0.7, 0.3]))
        assert np.array_equal(grid.cells.ravel(), seen)
        assert (grid.sensors, grid.z) == (("a_lidar",), z)
        assert (~seen).sum() > 0


@pytest.mark.parametrize("kind", ["sphere", "cylinder", "capsule"])
def test_round_things_cast_shadows(kind):
    size = {"radius": 0.3} if kind == "sphere" else {"radius": 0.3, "height": 1.0}
    shape = {"kind": getattr(pybullet, f"GEOM_{kind.upper()}"), "position": [1, 0.2, 0], **size}
    with Boxes(MAST, others=[shape]) as boxes:
        boxes.world.add_sensor("lidar", "a", **LIDAR)
        grid = boxes.eval(SEEN.format(z=0.0))
        points = centres(grid, 0.0)[:, :2]
        share = np.clip(points @ [1, 0.2] / (points**2).sum(axis=1), 0, 1)
        blocked = np.linalg.norm(share[:, None] * points - [1, 0.2], axis=1) <= 0.3
        blocked |= np.linalg.norm(points, axis=1) > 4.0
        assert np.array_equal(grid.cells.ravel() == 0, blocked)


def test_the_ground_hides_what_is_under_it():
    with Boxes(MAST, others=[GROUND]) as boxes:
        boxes.world.add_sensor("lidar", "a", **LIDAR)
        assert boxes.eval(SEEN.format(z=-0.4)).cells.sum() > 3000
        assert boxes.eval(SEEN.format(z=-0.6)).cells.sum() == 0


@pytest.mark.parametrize(("at", "seen"), [(0.5, True), (0.0, False)])
def test_a_box_around_a_sensor_is_not_in_its_way(at, seen):
    """As for rays: what is convex and holds the sensor is not seen."""
    with Boxes(MAST, ([0.5, 0.5, 0.5], [at, 0, 0])) as boxes:
        boxes.world.add_sensor("lidar", "a", position=[0.0 if seen else -0.6, 0, 0], **LIDAR)
        grid = boxes.eval(SEEN.format(z=0.0))
        assert bool(grid.at(2.0, 0.05)) == seen


@pytest.mark.slow
def test_bunches_of_cells_change_nothing(kitchen, monkeypatch):
    query = "SELECT obj FROM kitchen WHERE isSensor(this) AS sensorgrid(0.24, 0.1);"
    whole = kitchen.eval(query)
    monkeypatch.setattr(forms, "_BATCH", 120)
    assert kitchen.eval(query) == whole
    assert whole


@pytest.mark.slow
def test_fields_of_view_and_what_is_off():
    with Boxes(([0.3, 0.3, 0.3], [0, 0, 0])) as boxes:  # the host is in nobody's way
        add = boxes.world.add_sensor
        camera = add("depth_camera", "a", "c", width=40, height=20, fov=60, max_range=2.0)
        points = centres(boxes.eval(SEEN.format(z=0.25)), 0.25)
        x, y, z = points.T
        half = np.tan(np.radians(30))
        in_image = (x > 0) & (x <= 2) & (abs(z) <= half * x) & (abs(y) <= 2 * half * x)
        grid = boxes.eval(SEEN.format(z=0.25))
        assert np.array_equal(grid.cells.ravel(), in_image)
        add("planar_laser", "a", "l", min_angle=-90, max_angle=45, resolution=1, max_range=2.5)
        angle, r = np.degrees(np.arctan2(y, x)), np.linalg.norm(points, axis=1)
        # flat: it sees heights that are at most half a cell off, 0.25 is not
        assert np.array_equal(boxes.eval(SEEN.format(z=0.25)), grid)
        points = centres(grid, 0.04)
        r = np.linalg.norm(points, axis=1)
        flat = boxes.eval(
            "SELECT obj FROM sim WHERE id(this) == 'l' AS sensorgrid(0.04, 0.1, [[-3, -3], [3, 3]]);"
        )
        in_fan = (r <= 2.5) & (angle >= -90) & (angle <= 45 + 1e-9)
        assert np.array_equal(flat.cells.ravel(), in_fan)
        add("range_finder", "a", "r", max_range=1.0)
        line = boxes.eval(
            "SELECT obj FROM sim WHERE id(this) == 'r' AS sensorgrid(0, 0.1, [[-3, -3.05], [3, 2.95]]);"
        )
        assert np.argwhere(line).tolist() == [[i, 30] for i in range(30, 40)]
        both = boxes.eval(SEEN.format(z=0.04))
        assert both.cells.max() >= 2
        camera.power(False)
        assert not boxes.eval("SELECT obj FROM sim WHERE id(this) == 'c' AS sensorgrid(0.25, 0.1);")
        add("contact_sensor", "a", "touch")
        assert not boxes.eval(
            "SELECT obj FROM sim WHERE id(this) == 'touch' AS sensorgrid(0.25, 0.1);"
        )


def test_the_kitchens_sensors_see_what_pybullets_rays_reach(kitchen):
    query = "SELECT obj FROM kitchen WHERE id(this) == 'fridge_webcam' AS sensorgrid(0.5, 0.04);"
    grid = kitchen.eval(query)
    world = kitchen.call_variable("kitchen")
    sensor, client = world["fridge_webcam"], world.simulator.client
    start, points = np.array(sensor.position), centres(grid, 0.5)
    local = (points - start) @ Rotation.from_quat(np.roll(sensor.orientation, -1)).as_matrix()
    half = np.tan(np.radians(sensor.spec.settings["fov"] / 2))
    wide = half * sensor.spec.settings["width"] / sensor.spec.settings["height"]
    x, y, z = local.T
    seen = (x > 0) & (x <= sensor.spec.max_range) & (abs(y) <= wide * x) & (abs(z) <= half * x)
    inside = np.flatnonzero(seen)
    # the fridge, which the camera sits on, is a ball behind it
    hits = pybullet.rayTestBatch([start] * len(inside), points[inside], physicsClientId=client)
    seen[inside] = [hit[0] < 0 for hit in hits]
    assert 200 < seen.sum() < len(inside)
    # Bullet's hulls are 1 mm larger
    assert (grid.cells.ravel() != seen).mean() < 0.005


@pytest.mark.slow
def test_sensors_of_a_recorded_tick_and_of_groups():
    with Boxes(MAST, others=[BALL | {"position": [1, 0, 0]}]) as boxes:
        boxes.world.add_sensor("lidar", "a", "one", **LIDAR)
        boxes.world.add_sensor("lidar", "a", "two", **LIDAR | {"max_range": 1.0})
        query = (
            "SELECT obj FROM {} WHERE isSensor(this) {} AS sensorgrid(0, 0.1, [[-3, -3], [3, 3]]);"
        )
        before = boxes.eval(query.format("sim", ""))
        assert set(np.unique(before)) == {0, 1, 2}
        time = boxes.world.time
        boxes.world.step(240)
        assert boxes.eval(query.format("sim", "")) != before
        assert boxes.eval(query.format(f"sim{{{time}}}", "")) == before
        groups = boxes.eval(query.format(f"sim{{{time}}}", "GROUP BY id"))
        assert set(groups) == {"one", "two"}
        assert np.array_equal(groups["one"].cells + groups["two"].cells, before.cells)


# -- sums over a plane ---------------------------------------------------------------------------


@pytest.mark.slow
def test_masses_over_planes(kitchen):
    world = kitchen.call_variable("kitchen")
    for axes, (i, j) in {"XY": (0, 1), "xz": (0, 2), "YZ": (1, 2)}.items():
        grid = kitchen.eval(
            f"SELECT obj, mass FROM kitchen AS plane('{axes}', [-5,-5], [100,100,0.1]);"
        )
        expected = np.zeros((100, 100))
        for entity in world:
            place = entity.position
            expected[int((place[i] + 5) / 0.1), int((place[j] + 5) / 0.1)] += entity.mass
        assert np.asarray(grid) == pytest.approx(expected)
        assert (grid.axes, grid.shape, grid.origin) == (axes.upper(), (100, 100), (-5.0, -5.0))
        assert expected.sum() > 10


def test_as_in_the_ode_dialect(kitchen):
    """There the position is asked for by the form, and a fourth argument blurs."""
    plain = kitchen.eval("SELECT obj, mass FROM kitchen AS plane('XY', [-5,-5], [100,100,0.1]);")
    named = kitchen.eval("SELECT mass FROM kitchen AS plane('XY', [-5,-5], [100,100,0.1]);")
    assert named == plain
    blurred = kitchen.eval("SELECT mass FROM kitchen AS plane('XY', [-5,-5], [100,100,0.1], 3);")
    assert blurred.cells.sum() == pytest.approx(plain.cells.sum())
    kernel = np.array([[max(0, 4 - abs(i) - abs(j)) for j in range(-2, 3)] for i in range(-2, 3)])
    padded, expected = np.pad(plain.cells, 2), np.zeros((100, 100))
    for i in range(5):
        for j in range(5):
            expected += padded[i : i + 100, j : j + 100] * kernel[i, j] / kernel.sum()
    assert blurred.cells == pytest.approx(expected)


@pytest.mark.parametrize(
    ("place", "cell"),
    [([0, 0], [0, 0]), ([1 - TINY, 0], [0, 0]), ([1, 0], [1, 0]), ([2.999, 1.999], [2, 1])]
    + [([3, 0], None), ([-TINY, 0], None), ([0, 2], None)],
)
def test_cells_have_their_lower_edges(place, cell):
    with Boxes(([0.1, 0.1, 0.1], [*place, 7])) as boxes:
        grid = boxes.eval("SELECT obj, [2, 3.5], 1 FROM sim AS plane('XY', [0, 0], [3, 2, 1]);")
        assert np.argwhere(grid).tolist() == ([cell] if cell else [])
        assert grid.cells.sum() == (6.5 if cell else 0)
