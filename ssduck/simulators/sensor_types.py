"""The types of sensors: their settings, their rays and their fields of view.

A sensor looks along its own +x axis, with +y to its left and +z up. Its rays begin at its origin.
The pixels of a camera are rays through the pixels' centres. A ray ends on the nearest collision
shape. It passes through the body that the sensor is mounted on, and through a convex shape in which
it begins. Sensors have no shape, so that no sensor senses another.

To add a type, add an entry to `SENSOR_TYPES`. `ssduck.world.sensor_readings` takes the readings.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from ssduck.geometry.arrays import Array, Flags

Settings: TypeAlias = Mapping[str, float]

# A sensor with more rays is probably a mistake; it needs a renderer.
MAX_RAYS = 1_000_000
# The rounding error of angles, degrees or relative to the angle between two rays.
_ANGLE_TOLERANCE = 1e-9


@dataclass(frozen=True)
class SensorSetting:
    """A numeric setting of a sensor."""

    name: str  # its name in scene files and in Python
    unit: str  # m, degrees or pixels; empty for a count
    about: str  # its meaning
    default: float | None = None  # the default; None if it is required
    above: float = -math.inf  # an exclusive lower bound
    at_least: float = -math.inf  # an inclusive lower bound
    below: float = math.inf  # an exclusive upper bound
    at_most: float = math.inf  # an inclusive upper bound
    whole: bool = False  # whether it is an integer


@dataclass(frozen=True)
class SensorType:
    """A type of sensor."""

    name: str  # its name in scene files and in Python
    about: str  # a sentence about what it measures
    settings: tuple[SensorSetting, ...] = ()  # its settings, except its maximum range
    # The ends of its rays, (n, 3) in its own frame, from its maximum range and its settings; None
    # for a sensor without rays and range.
    rays: Callable[[float, Settings], Array] | None = None
    # The number of its rays, (n,) or (height, width), before they are made.
    shape: Callable[[Settings], tuple[int, ...]] = lambda _: (1,)
    has_picture: bool = False  # whether it has a colour image
    # Tests which points (n, 3) in its own frame are in its field of view, from its maximum range,
    # its settings, and the tolerance for points beside a flat field of view, m.
    view: Callable[[Array, float, Settings, float], Flags] | None = None

    @property
    def has_range(self) -> bool:
        """Whether it has a maximum range."""
        return self.rays is not None

    def fault(self, settings: Settings) -> tuple[str, str] | None:
        """Returns a setting that contradicts the others, and the reason; None if none does."""
        for low, high in (("min_angle", "max_angle"), ("min_elevation", "max_elevation")):
            if high not in settings:
                continue
            if settings[low] > settings[high]:
                return low, f"{settings[low]:g} is more than {high}, which is {settings[high]:g}"
            if settings[high] - settings[low] > 360:
                return high, f"more than a turn from {low}, which is {settings[low]:g}"
        if self.rays is not None and math.prod(self.shape(settings)) > MAX_RAYS:
            finest = "resolution" if "resolution" in settings else "width"
            return finest, f"that makes more than {MAX_RAYS:,} rays"
        return None


# -- rays -----------------------------------------------------------------------------------------


def _steps(settings: Settings) -> int:
    """Returns the number of rays of a sweep, with both ends unless they are the same direction."""
    span = settings["max_angle"] - settings["min_angle"]
    count = int(min(span / settings["resolution"] + _ANGLE_TOLERANCE, 10.0 * MAX_RAYS)) + 1
    covered = (count - 1) * settings["resolution"]
    return count - 1 if count > 1 and covered >= 360 - _ANGLE_TOLERANCE else count


def _sweep(settings: Settings) -> Array:
    """Returns the angles of a sweep, to the left, radians."""
    steps = np.arange(_steps(settings))
    angles: Array = np.radians(settings["min_angle"] + settings["resolution"] * steps)
    return angles


def _directions(azimuths: Array, elevations: Array) -> Array:
    """Returns unit vectors (n, 3) from azimuths to the left and elevations."""
    level = np.cos(elevations)
    x, y = level * np.cos(azimuths), level * np.sin(azimuths)
    return np.stack([x, y, np.sin(elevations)], axis=-1)


def _single_ray(reach: float, _: Settings) -> Array:
    return np.array([[reach, 0.0, 0.0]])


def _plane(reach: float, settings: Settings) -> Array:
    angles = _sweep(settings)
    return reach * _directions(angles, np.zeros_like(angles))


def _layers(reach: float, settings: Settings) -> Array:
    """Returns rays layer by layer, from the lowest to the highest, each a sweep."""
    low, high = settings["min_elevation"], settings["max_elevation"]
    layers = np.radians(np.linspace(low, high, int(settings["layers"])))
    elevations, azimuths = np.meshgrid(layers, _sweep(settings), indexing="ij")
    return reach * _directions(azimuths, elevations).reshape(-1, 3)


def _pixels(reach: float, settings: Settings) -> Array:
    """Returns rays row by row from the upper left, all to the same depth."""
    height, width = _image_shape(settings)
    half = math.tan(math.radians(settings["fov"]) / 2)
    z = half * (1 - (2 * np.arange(height) + 1) / height)
    y = half * width / height * (1 - (2 * np.arange(width) + 1) / width)
    z_grid, y_grid = np.meshgrid(z, y, indexing="ij")
    ends: Array = reach * np.stack([np.ones_like(z_grid), y_grid, z_grid], axis=-1)
    return ends.reshape(-1, 3)


def _image_shape(settings: Settings) -> tuple[int, int]:
    return int(settings["height"]), int(settings["width"])


# -- the field of view ----------------------------------------------------------------------------


def _on_ray(points: Array, reach: float, _: Settings, tolerance: float) -> Flags:
    """Tests points against the view of a single ray: within a distance from it."""
    x, y, z = points.T
    visible: Flags = (x > 0.0) & (x <= reach) & (np.hypot(y, z) <= tolerance)
    return visible


def _in_image(points: Array, reach: float, settings: Settings, _: float) -> Flags:
    """Tests points against the view of a camera: the pyramid of its image, up to a depth."""
    x, y, z = points.T
    height, width = _image_shape(settings)
    half = math.tan(math.radians(settings["fov"]) / 2) * (1 + _ANGLE_TOLERANCE)
    inside = (abs(z) <= half * x) & (abs(y) <= half * width / height * x)
    visible: Flags = inside & (x > 0.0) & (x <= reach)
    return visible


def _in_sweep(points: Array, reach: float, settings: Settings, tolerance: float) -> Flags:
    """Tests points against the view of fans: between the outer rays, or near a single fan."""
    x, y, z = points.T
    distance = np.linalg.norm(points, axis=1)
    azimuth = np.degrees(np.arctan2(y, x)) - settings["min_angle"] + _ANGLE_TOLERANCE
    visible: Flags = (distance > 0.0) & (distance <= reach)
    visible &= (
        azimuth % 360.0 <= settings["max_angle"] - settings["min_angle"] + 2 * _ANGLE_TOLERANCE
    )
    low, high = (settings.get(f"{side}_elevation", 0.0) for side in ("min", "max"))
    if low == high or settings.get("layers") == 1:  # a single layer is the lowest
        elevation = np.arctan2(z, np.hypot(x, y)) - math.radians(low)
        visible &= abs(distance * np.sin(elevation)) <= tolerance
        return visible
    elevation = np.degrees(np.arctan2(z, np.hypot(x, y)))
    visible &= (elevation >= low - _ANGLE_TOLERANCE) & (elevation <= high + _ANGLE_TOLERANCE)
    return visible


# -- the registry ---------------------------------------------------------------------------------


def _angle(
    name: str, about: str, default: float | None = None, maximum: float = 360.0
) -> SensorSetting:
    return SensorSetting(name, "degrees", about, default, at_least=-maximum, at_most=maximum)


def _count(name: str, unit: str, about: str, default: float | None = None) -> SensorSetting:
    return SensorSetting(name, unit, about, default, above=0.0, whole=True)


_TYPES = (
    SensorType(
        "depth_camera",
        "A pinhole camera: for each pixel what it sees, how deep, and its colour.",
        (
            _count("width", "pixels", "of the image"),
            _count("height", "pixels", "of the image"),
            SensorSetting("fov", "degrees", "the vertical angle of view", above=0.0, below=180.0),
        ),
        rays=_pixels,
        shape=_image_shape,
        has_picture=True,
        view=_in_image,
    ),
    SensorType(
        "planar_laser",
        "A fan of rays in the sensor's xy plane, from the right to the left.",
        (
            _angle("min_angle", "of the first ray, to the left of +x"),
            _angle("max_angle", "that the last ray does not pass"),
            SensorSetting("resolution", "degrees", "between two neighbouring rays", above=0.0),
        ),
        rays=_plane,
        shape=lambda settings: (_steps(settings),),
        view=_in_sweep,
    ),
    SensorType(
        "lidar",
        "Fans of rays one above the other, from the lowest to the highest.",
        (
            _angle("min_angle", "of the first ray of a layer, to the left of +x", -180.0),
            _angle("max_angle", "that the last ray of a layer does not pass", 180.0),
            SensorSetting("resolution", "degrees", "between two rays of a layer", 1.0, above=0.0),
            _angle("min_elevation", "of the lowest layer, up from the xy plane", -15.0, 90.0),
            _angle("max_elevation", "of the highest layer", 15.0, 90.0),
            _count("layers", "", "how many fans", 16.0),
        ),
        rays=_layers,
        shape=lambda settings: (int(settings["layers"]) * _steps(settings),),
        view=_in_sweep,
    ),
    SensorType("range_finder", "One ray along the sensor's +x.", rays=_single_ray, view=_on_ray),
    SensorType(
        "contact_sensor",
        "Contacts of the link that the sensor is mounted on, or of the whole body if no link is "
        "given: those of the solver whose normal force is above 0. The sensor's pose does not "
        "matter.",
    ),
)

SENSOR_TYPES: dict[str, SensorType] = {kind.name: kind for kind in _TYPES}
