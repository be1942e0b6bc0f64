"""What is drawn of bodies, in the records of worlds: visual shapes and the camera, as JSON."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from ssduck.geometry.shapes import Geometry
from ssduck.simulators.interface import VisualShape
from ssduck.simulators.scenes import Camera


def visuals_text(visuals: Sequence[VisualShape], geometry_id: Callable[[Geometry], int]) -> str:
    """Returns visual shapes as JSON: a list of their numbers.

    These are link, geometry, x y z, qw qx qy qz in the frame of the link, and red, green, blue,
    alpha from 0 to 1, which a shape without a colour lacks.
    """
    rows = [
        [
            visual.link,
            geometry_id(visual.geometry),
            *np.asarray(visual.position, dtype=float).tolist(),
            *np.asarray(visual.orientation, dtype=float).tolist(),
            *_shares(visual.colour),
        ]
        for visual in visuals
    ]
    return json.dumps(rows, separators=(",", ":"))


def _shares(colour: Sequence[float] | None) -> list[float]:
    """Returns the shares of a colour; none of one that is not finite, which nothing can draw."""
    shares = np.clip(colour or (), 0.0, 1.0)
    return shares.tolist() if np.isfinite(shares).all() else []


def visuals_of(
    text: str | None, geometries: Mapping[int, Geometry]
) -> tuple[VisualShape, ...] | None:
    """Returns the visual shapes of a text of a record; None if they are unknown."""
    if text is None:
        return None
    return tuple(
        VisualShape(
            row[0],
            geometries[row[1]],
            np.array(row[2:5], dtype=float),
            np.array(row[5:9], dtype=float),
            tuple(row[9:]) or None,
        )
        for row in json.loads(text)
    )


def _is_finite(number: Any) -> bool:
    return type(number) in (int, float) and abs(number) < 1e300


def camera_text(camera: Camera) -> dict[str, Any]:
    """Returns a camera for the description of a record."""
    return {"eye": list(camera.eye), "target": list(camera.target), "fov": camera.fov}


def is_camera(value: Any) -> bool:
    """Checks a camera in the description of a record: it sees something."""
    if not isinstance(value, dict):
        return False
    eye, target, fov = (value.get(name) for name in ("eye", "target", "fov"))
    points = all(
        isinstance(point, list) and len(point) == 3 and all(map(_is_finite, point))
        for point in (eye, target)
    )
    is_angle = isinstance(fov, int | float) and not isinstance(fov, bool) and 0.0 < fov < 180.0
    return points and eye != target and is_angle


def camera_of(description: Mapping[str, Any]) -> Camera:
    """Returns the camera of a description that was checked; that of any scene if it has none."""
    if "camera" not in description:
        return Camera()
    values = description["camera"]
    return Camera(tuple(values["eye"]), tuple(values["target"]), values["fov"])
