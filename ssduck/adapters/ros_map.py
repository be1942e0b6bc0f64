"""Maps as ROS's map_server has them: a picture (PGM, P5) and a YAML file that says what it shows.

http://wiki.ros.org/map_server: a pixel x is occupied if (255 - x) / 255 is above `occupied_thresh`,
free if it is below `free_thresh`, else unknown; with `negate` x / 255 counts. The lower left pixel
is at `origin`. The key `z` is ssduck's own, and of no account to others.
"""

from __future__ import annotations

import ast
import json
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ssduck.errors import ArgumentError
from ssduck.formatting import reason

FREE, OCCUPIED = 254, 0
OCCUPIED_THRESH, FREE_THRESH = 0.65, 0.196
# What YAML reads as a text without quotes.
_PLAIN = re.compile(r"\w[\w.-]*\.pgm", re.ASCII)
_NEEDED = ("image", "resolution", "origin", "negate", "occupied_thresh", "free_thresh")


def save(
    path: Path,
    cells: npt.NDArray[np.bool_],
    origin: tuple[float, ...],
    resolution: float,
    z: float | tuple[float, float],
) -> Path:
    """Write both files; gives the path of the YAML file."""
    from PIL import Image

    path = path if path.suffix else path.with_suffix(".yaml")
    picture = path.with_suffix(".pgm")
    if picture == path:
        raise ArgumentError(f"{path} is where the picture goes; name the YAML file, map.yaml say")
    pixels = np.where(cells.T[::-1], OCCUPIED, FREE).astype(np.uint8)
    told = {
        "image": _text(picture.name),
        "resolution": resolution,
        "origin": [*origin, 0.0],
        "negate": 0,
        "occupied_thresh": OCCUPIED_THRESH,
        "free_thresh": FREE_THRESH,
        "z": list(z) if isinstance(z, tuple) else z,
    }
    lines = [f"{key}: {value}\n" for key, value in told.items()]
    try:
        text = "".join(lines).encode()  # before anything is written: not all names can be told
        Image.fromarray(pixels).save(picture, "PPM")
        path.write_bytes(text)
    except (OSError, ValueError) as error:  # a null character is a ValueError
        raise ArgumentError(f"{path} cannot be written: {reason(error)}") from error
    return path


def _text(name: str) -> str:
    """A file's name as YAML has it: in quotes where it would be read as something else."""
    if _PLAIN.fullmatch(name):
        return name
    quoted = json.dumps(name, ensure_ascii=False)
    # YAML takes these for ends of lines, or refuses them; JSON does not.
    return re.sub("[\x7f-\x9f\u2028\u2029\ufeff]", lambda m: f"\\u{ord(m[0]):04x}", quoted)


def load(
    path: Path, *, unknown: bool | None
) -> tuple[npt.NDArray[np.bool_], tuple[float, ...], float, float | tuple[float, float]]:
    """The cells, the origin, the resolution and the height, 0 if it is not said.

    Raises:
        ArgumentError: it is no such map, or is turned, or has cells that are unknown.
    """
    from PIL import Image

    told = _told(path)
    try:
        with Image.open(path.parent / str(told["image"])) as picture:
            shade = np.asarray(picture.convert("L"), dtype=np.float64).T[:, ::-1] / 255.0
        x, y, turn = map(float, told["origin"])
        resolution = float(told["resolution"])
        thresholds = float(told["occupied_thresh"]), float(told["free_thresh"])
        height = told.get("z", 0.0)
        z = tuple(map(float, height)) if isinstance(height, list) else float(height)
    except (OSError, TypeError, ValueError) as error:
        raise ArgumentError(f"{path} cannot be read as a map: {reason(error)}") from error
    if not (math.isfinite(resolution) and resolution > 0.0 and math.isfinite(x + y)):
        raise ArgumentError(
            f"{path} cannot be read as a map: resolution {resolution:g}, origin {x:g}, {y:g}"
        )
    if told.get("mode") == "raw":
        raise ArgumentError(f"{path}: the mode is raw; trinary and scale can be read")
    if turn != 0.0:
        raise ArgumentError(f"{path}: the map is turned by {turn:g} rad; grids are along the axes")
    if told["negate"] not in (1, "true", "True"):
        shade = 1.0 - shade
    occupied, free = shade > thresholds[0], shade < thresholds[1]
    lost = int((~occupied & ~free).sum())
    if lost and unknown is None:
        raise ArgumentError(
            f"{path}: {lost} cells are unknown; load(path, unknown=True) takes them for occupied, "
            "unknown=False for free"
        )
    return (~free if unknown else occupied), (x, y), resolution, z  # type: ignore[return-value]


def _told(path: Path) -> dict[str, Any]:
    """The keys and values of the YAML file: the part of YAML that such files are written in."""
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ArgumentError(f"{path} cannot be read: {reason(error)}") from error
    found: dict[str, Any] = {}
    for line in text.splitlines():
        key, _, value = map(str.strip, line.partition(":"))
        if key.startswith("#") or not value or value.startswith("#"):
            continue
        try:
            found[key] = ast.literal_eval(value)  # passes over a comment, too
        except (ValueError, SyntaxError):
            found[key] = value.partition(" #")[0].rstrip()
    missing = [key for key in _NEEDED if key not in found]
    if missing:
        raise ArgumentError(f"{path} is no map of ROS's map_server: it has no {missing[0]}")
    return found
