"""Reads and writes maps of ROS's map_server: a picture (PGM, P5) and its YAML file.

The format is described at http://wiki.ros.org/map_server. A pixel x is occupied if
(255 - x) / 255 is above `occupied_thresh`, free if it is below `free_thresh`, otherwise unknown;
with `negate`, x / 255 is compared instead. The lower left pixel is at `origin`. The key `z` is an
addition of ssduck, which other programs ignore.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ssduck.errors import ArgumentError
from ssduck.formatting import error_text

FREE, OCCUPIED = 254, 0
OCCUPIED_THRESH, FREE_THRESH = 0.65, 0.196
_REQUIRED = ("image", "resolution", "origin", "negate", "occupied_thresh", "free_thresh")


def save(
    path: Path,
    cells: npt.NDArray[np.bool_],
    origin: tuple[float, ...],
    resolution: float,
    z: float | tuple[float, float],
) -> Path:
    """Writes both files and returns the path of the YAML file."""
    import yaml
    from PIL import Image

    path = path if path.suffix else path.with_suffix(".yaml")
    picture = path.with_suffix(".pgm")
    if picture == path:
        raise ArgumentError(f"{path} is the name of the picture; name the YAML file, map.yaml say")
    pixels = np.where(cells.T[::-1], OCCUPIED, FREE).astype(np.uint8)
    values = {
        "image": picture.name,
        "resolution": resolution,
        "origin": [*origin, 0.0],
        "negate": 0,
        "occupied_thresh": OCCUPIED_THRESH,
        "free_thresh": FREE_THRESH,
        "z": list(z) if isinstance(z, tuple) else z,
    }
    try:
        str(path).encode()  # fails before anything is written if the name cannot be encoded
        Image.fromarray(pixels).save(picture, "PPM")
        with path.open("w", encoding="utf-8", newline="\n") as file:
            yaml.safe_dump(values, file, sort_keys=False, default_flow_style=None, width=math.inf)
    except (OSError, ValueError) as error:  # a null character is a ValueError
        raise ArgumentError(f"{path} cannot be written: {error_text(error)}") from error
    return path


def load(
    path: Path, *, unknown: bool | None
) -> tuple[npt.NDArray[np.bool_], tuple[float, ...], float, float | tuple[float, float]]:
    """Returns the cells, the origin, the resolution and the height (0 if the file has none).

    Raises:
        ArgumentError: the file is not such a map; the map is rotated; or it has unknown cells.
    """
    from PIL import Image

    values = _values(path)
    try:
        with Image.open(path.parent / str(values["image"])) as picture:
            shade = np.asarray(picture.convert("L"), dtype=np.float64).T[:, ::-1] / 255.0
        x, y, yaw = map(float, values["origin"])
        resolution = float(values["resolution"])
        thresholds = float(values["occupied_thresh"]), float(values["free_thresh"])
        height = values.get("z", 0.0)
        z = tuple(map(float, height)) if isinstance(height, list) else float(height)
    except (OSError, TypeError, ValueError) as error:
        raise ArgumentError(f"{path} cannot be read as a map: {error_text(error)}") from error
    if not (math.isfinite(resolution) and resolution > 0.0 and math.isfinite(x + y)):
        raise ArgumentError(
            f"{path} cannot be read as a map: resolution {resolution:g}, origin {x:g}, {y:g}"
        )
    if values.get("mode") == "raw":
        raise ArgumentError(f"{path}: the mode is raw; trinary and scale can be read")
    if yaw != 0.0:
        raise ArgumentError(f"{path}: the map is rotated by {yaw:g} rad; grids are axis-aligned")
    if values["negate"] not in (1, "true", "True"):
        shade = 1.0 - shade
    occupied, free = shade > thresholds[0], shade < thresholds[1]
    unknown_count = int((~occupied & ~free).sum())
    if unknown_count and unknown is None:
        raise ArgumentError(
            f"{path}: {unknown_count} cells are unknown; load(path, unknown=True) counts them as "
            "occupied, unknown=False for free"
        )
    return (~free if unknown else occupied), (x, y), resolution, z  # type: ignore[return-value]


def _values(path: Path) -> dict[str, Any]:
    """Returns the keys and values of the YAML file."""
    import yaml

    try:
        values = yaml.safe_load(path.read_text(encoding="utf-8"))
    except yaml.MarkedYAMLError as error:
        line = f"line {error.problem_mark.line + 1}: " if error.problem_mark else ""
        raise ArgumentError(f"{path} cannot be read: {line}{error.problem}") from error
    except (OSError, ValueError, yaml.YAMLError) as error:
        raise ArgumentError(f"{path} cannot be read: {error_text(error)}") from error
    entries: dict[str, Any] = values if isinstance(values, dict) else {}
    missing = [key for key in _REQUIRED if key not in entries]
    if missing:
        raise ArgumentError(f"{path} is no map of ROS's map_server: it has no {missing[0]}")
    return entries
