"""The types of sensors, in one registry: what each is set by, and where its rays go.

A sensor looks along its own +x, with +y to its left and +z up. Its rays begin at its origin; the
pixels of a camera are rays, too, each through its pixel's centre. A ray ends on the nearest
collision shape. It passes through the body that the sensor sits on, wherever it begins, and does
not see a convex shape that it begins in; a sensor is no shape, so that none senses another.

A new type is one entry of `SENSOR_TYPES`. What sensors perceive is read in
`ssduck.world.sensor_readings`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from ssduck.geometry.arrays import Array, Flags

Settings: TypeAlias = Mapping[str, float]

# A finer sensor is a mistake, or a matter for a renderer.
MOST_RAYS = 1_000_000
# Angles that differ by less are the same, in steps between two rays.
_SAME = 1e-9


@dataclass(frozen=True)
class SensorSetting:
    """A number that a sensor is set by.

    Attributes:
        name: in scene files and in Python.
        unit: m, degrees or pixels; empty for a count.
        about: what it means.
        default: what it is if it is not given; None if it has to be.
        above: it is more than that,
        at_least: at least that,
        below: less than that,
        at_most: and at most that.
        whole: whether it is a whole number.
    """

    name: str
    unit: str
    about: str
    default: float | None = None
    above: float = -math.inf
    at_least: float = -math.inf
    below: float = math.inf
    at_most: float = math.inf
    whole: bool = False


@dataclass(frozen=True)
class SensorType:
    """A kind of sensor.

    Attributes:
        name: in scene files and in Python.
        about: what it measures, in a sentence.
        settings: what it is set by, its greatest range aside.
        rays: where its rays end at their longest, (n, 3) in its own frame, by its greatest range
            and its settings; None for one that has no rays, and so no range.
        shape: how many rays it has, (n,) or (height, width), worked out before they are made.
        has_picture: whether it has colours.
        view: which points (n, 3) in its own frame are in its field of view, by its greatest range,
            its settings, and how far off what is flat still counts as in it, m.
    """

    name: str
    about: str
    settings: tuple[SensorSetting, ...] = ()
    rays: Callable[[float, Settings], Array] | None = None
    shape: Callable[[Settings], tuple[int, ...]] = lambda _: (1,)
    has_picture: bool = False
    view: Callable[[Array, float, Settings, float], Flags] | None = None

    @property
    def has_range(self) -> bool:
        """Whether it sees as far as a `max_range`."""
        return self.rays is not None

    def fault(self, settings: Settings) -> tuple[str, str] | None:
        """The setting that does not go with the others, and why; None if all is well."""
        for low, high in (("min_angle", "max_angle"), ("min_elevation", "max_elevation")):
            if high not in settings:
                continue
            if settings[low] > settings[high]:
                return low, f"{settings[low]:g} is more than {high}, which is {settings[high]:g}"
            if settings[high] - settings[low] > 360:
                return high, f"more than a turn from {low}, which is {settings[low]:g}"
        if self.rays is not None and math.prod(self.shape(settings)) > MOST_RAYS:
            finest = "resolution" if "resolution" in settings else "width"
            return finest, f"that makes more than {MOST_RAYS:,} rays"
        return None


# -- where rays go --------------------------------------------------------------------------------


def _steps(settings: Settings) -> int:
    """How many rays a sweep has: both ends, but one of the two that are the same direction."""
    span = settings["max_angle"] - settings["min_angle"]
    count = int(min(span / settings["resolution"] + _SAME, 10.0 * MOST_RAYS)) + 1
    turned = (count - 1) * settings["resolution"]
    return count - 1 if count > 1 and turned >= 360 - _SAME else count


def _sweep(settings: Settings) -> Array:
    """The angles of a sweep to the left, radians."""
    steps = np.arange(_steps(settings))
    angles: Array = np.radians(settings["min_angle"] + settings["resolution"] * steps)
    return angles


def _directions(azimuths: Array, elevations: Array) -> Array:
    """Unit vectors (n, 3) to the left by an azimuth, and up by an elevation."""
    flat = np.cos(elevations)
    return np.stack([flat * np.cos(azimuths), flat * np.sin(azimuths), np.sin(elevations)], axis=-1)


def _one(reach: float, _: Settings) -> Array:
    return np.array([[reach, 0.0, 0.0]])


def _plane(reach: float, settings: Settings) -> Array:
    angles = _sweep(settings)
    return reach * _directions(angles, np.zeros_like(angles))


def _layers(reach: float, settings: Settings) -> Array:
    """Layer by layer from the lowest, each a sweep."""
    low, high = settings["min_elevation"], settings["max_elevation"]
    layers = np.radians(np.linspace(low, high, int(settings["layers"])))
    elevations, azimuths = np.meshgrid(layers, _sweep(settings), indexing="ij")
    return reach * _directions(azimuths, elevations).reshape(-1, 3)


def _pixels(reach: float, settings: Settings) -> Array:
    """Row by row from the upper left; all end at a depth of the greatest range."""
    height, width = _image(settings)
    half = math.tan(math.radians(settings["fov"]) / 2)
    up = half * (1 - (2 * np.arange(height) + 1) / height)
    left = half * width / height * (1 - (2 * np.arange(width) + 1) / width)
    upward, leftward = np.meshgrid(up, left, indexing="ij")
    ends: Array = reach * np.stack([np.ones_like(upward), leftward, upward], axis=-1)
    return ends.reshape(-1, 3)


def _image(settings: Settings) -> tuple[int, int]:
    return int(settings["height"]), int(settings["width"])


# -- the field of view ----------------------------------------------------------------------------


def _on_ray(points: Array, reach: float, _: Settings, off: float) -> Flags:
    """Of a single ray: what is at most that far off it."""
    x, y, z = points.T
    seen: Flags = (x > 0.0) & (x <= reach) & (np.hypot(y, z) <= off)
    return seen


def _in_image(points: Array, reach: float, settings: Settings, _: float) -> Flags:
    """Of a camera: the pyramid of its image, to a depth of the greatest range."""
    x, y, z = points.T
    height, width = _image(settings)
    half = math.tan(math.radians(settings["fov"]) / 2) * (1 + _SAME)
    inside = (abs(z) <= half * x) & (abs(y) <= half * width / height * x)
    seen: Flags = inside & (x > 0.0) & (x <= reach)
    return seen


def _in_sweep(points: Array, reach: float, settings: Settings, off: float) -> Flags:
    """Of fans: between the outermost rays; of one, which is flat, what is at most that far off."""
    x, y, z = points.T
    distance = np.linalg.norm(points, axis=1)
    turn = np.degrees(np.arctan2(y, x)) - settings["min_angle"] + _SAME
    seen: Flags = (distance > 0.0) & (distance <= reach)
    seen &= turn % 360.0 <= settings["max_angle"] - settings["min_angle"] + 2 * _SAME
    low, high = (settings.get(f"{side}_elevation", 0.0) for side in ("min", "max"))
    if low == high or settings.get("layers") == 1:  # which is the lowest
        up = np.arctan2(z, np.hypot(x, y)) - math.radians(low)
        seen &= abs(distance * np.sin(up)) <= off
        return seen
    up = np.degrees(np.arctan2(z, np.hypot(x, y)))
    seen &= (up >= low - _SAME) & (up <= high + _SAME)
    return seen


# -- the registry ---------------------------------------------------------------------------------


def _angle(
    name: str, about: str, default: float | None = None, most: float = 360.0
) -> SensorSetting:
    return SensorSetting(name, "degrees", about, default, at_least=-most, at_most=most)


def _count(name: str, unit: str, about: str, default: float | None = None) -> SensorSetting:
    return SensorSetting(name, unit, about, default, above=0.0, whole=True)


_LISTED = (
    SensorType(
        "depth_camera",
        "A pinhole camera: for each pixel what it sees, how deep, and its colour.",
        (
            _count("width", "pixels", "of the image"),
            _count("height", "pixels", "of the image"),
            SensorSetting("fov", "degrees", "the vertical angle of view", above=0.0, below=180.0),
        ),
        rays=_pixels,
        shape=_image,
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
    SensorType("range_finder", "One ray along the sensor's +x.", rays=_one, view=_on_ray),
    SensorType(
        "contact_sensor",
        "What presses on the link that the sensor sits on, or on the whole body if no link is "
        "given: the solver's contacts whose normal force is above 0. Where it sits does not "
        "matter.",
    ),
)

SENSOR_TYPES: dict[str, SensorType] = {kind.name: kind for kind in _LISTED}
