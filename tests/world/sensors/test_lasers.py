"""Range finders and lasers in a room of known size."""

import math
from pathlib import Path

import numpy as np
import pytest

from ssduck.simulators.sensor_types import SENSOR_TYPES
from tests.support.sensing import EXACT, LASER, POSES, turned

ROOT = Path(__file__).resolve().parents[3]

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
