"""Stands in for `openravepy`, so that SelectScript's tutorial runs unchanged.

The module has the classes of handles and the occupancy grid of the tutorial's filter plugin.
`RaveCreateModule` makes an OpenRAVE module, which takes commands as texts. The plugin is a part
of ssduck; there is nothing to load.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from ssduck.adapters.base import placed_shapes
from ssduck.adapters.grid_values import MAX_CELLS
from ssduck.errors import ArgumentError, nearest
from ssduck.formatting import short_repr
from ssduck.geometry.rasters.raster import Raster
from ssduck.geometry.rasters.rasterize import Rasterizer
from ssduck.world.entities import KinBody, Robot, Sensor
from ssduck.world.openrave_names import AABB, CLONE_BODIES, SensorCommand
from ssduck.world.world import World

__all__ = [
    "AABB",
    "CLONE_BODIES",
    "MODULES",
    "KinBody",
    "OccupancyGridMap",
    "RaveCreateModule",
    "RaveInitialize",
    "RaveLoadPlugin",
    "Robot",
    "Sensor",
    "SensorCommand",
]


class OccupancyGridMap:
    """A module that computes the cells that the bodies of a world occupy at a height.

    Commands: `SetTranslation x y z` sets the corner and the height of the grid, m;
    `SetSize nx ny size` sets the numbers of cells and their side, m; `Scan` returns a byte for
    each cell, 1 for occupied, with y varying fastest; `SetLineWidth` and `Render` do nothing.

    Args:
        world: the world, read when `Scan` is sent.
    """

    def __init__(self, world: World) -> None:
        self._world = world
        self._corner = (0.0, 0.0, 0.0)
        self._size = (0, 0, 0.0)

    def SendCommand(self, command: str) -> bytes | str:  # noqa: N802  # OpenRAVE's name
        """Runs a command and returns its result, or an empty text.

        Raises:
            ArgumentError: the command does not exist or does not accept the numbers.
        """
        name, *arguments = command.split() or [""]
        commands: dict[str, Callable[..., bytes | str]] = {
            "SetTranslation": self._set_translation,
            "SetSize": self._set_size,
            "SetLineWidth": lambda _: "",
            "Scan": self._scan,
            "Render": lambda: "",
        }
        if name not in commands:
            raise ArgumentError(
                f"occupancygridmap has no command {short_repr(name)}",
                suggestions=nearest(name, commands),
            )
        try:
            return commands[name](*map(float, arguments))
        except (TypeError, ValueError) as error:
            raise ArgumentError(f"occupancygridmap: {short_repr(command)}: {error}") from error

    def _set_translation(self, x: float, y: float, z: float) -> str:
        if not all(map(math.isfinite, (x, y, z))):
            raise ValueError("the coordinates of the corner must be finite")
        self._corner = (x, y, z)
        return ""

    def _set_size(self, nx: float, ny: float, size: float) -> str:
        if not (nx >= 1 and ny >= 1 and 0.0 < size < math.inf):
            raise ValueError("there must be at least one cell, wider than 0 m")
        if not (nx * ny <= MAX_CELLS and nx.is_integer() and ny.is_integer()):
            raise ValueError(
                f"the numbers of cells must be whole, with {MAX_CELLS:,} cells at most"
            )
        self._size = (int(nx), int(ny), size)
        return ""

    def _scan(self) -> bytes:
        (x, y, z), (nx, ny, size) = self._corner, self._size
        if not nx:
            raise ValueError("SetSize must be sent before")
        with self._world.pinned(("shapes",)):
            placed = placed_shapes(self._world, self._world.GetBodies())
        return Rasterizer(placed).cells(Raster((x, y), size, (nx, ny)), z, z).tobytes()


MODULES: dict[str, Callable[[World], OccupancyGridMap]] = {"occupancygridmap": OccupancyGridMap}


def RaveCreateModule(  # noqa: N802  # OpenRAVE's name
    env: World, name: str
) -> OccupancyGridMap | None:
    """Returns a new module for a world; None, as in OpenRAVE, if the name is unknown."""
    module = MODULES.get(name.lower())
    return None if module is None else module(env)


def RaveInitialize() -> None:  # noqa: N802  # OpenRAVE's name
    """Does nothing: ssduck needs no initialization."""


def RaveLoadPlugin(path: str) -> bool:  # noqa: N802  # OpenRAVE's name
    """Checks whether a plugin is available: only `filter` is, as a part of ssduck.

    >>> RaveLoadPlugin("build/filter.so"), RaveLoadPlugin("other.so")
    (True, False)
    """
    return path.replace("\\", "/").rpartition("/")[2].partition(".")[0] == "filter"
