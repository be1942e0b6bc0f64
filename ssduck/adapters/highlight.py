"""Pictures of a world in which some entities stand out."""

from __future__ import annotations

import warnings
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from ssduck.world.entities import Entity, Sensor
from ssduck.world.world import World

if TYPE_CHECKING:
    from PIL import Image

OUTLINE = (255, 90, 0)
# How much of a faded pixel is white, and how wide an outline is, pixels.
_FADED = 0.72
_WIDTH = 2


def highlighted(world: World, entities: Iterable[Entity], width: int, height: int) -> Image.Image:
    """A picture by the world's camera: entities in colour and outlined, all else faded.

    Args:
        world: the world; a recorded tick, or a what-if world, is built anew to be drawn.
        entities: of the world; a sensor is shown by the body that it sits on.
        width: pixels.
        height: pixels.

    Raises:
        RemovedEntityError: one is no longer there.
    """
    from PIL import Image

    chosen = {_shown(entity) for entity in entities}
    if not world.is_final:
        return Image.fromarray(_drawn(world, chosen, width, height))
    with warnings.catch_warnings():
        # How fast joints are is nothing that a picture shows.
        warnings.filterwarnings("ignore", message=".*velocities of joints are not recorded")
        twin = world.excerpt(list(world))
    try:
        names = {world.entity(id).name for id in chosen}
        ids = {entity.id for entity in twin if entity.name in names}
        return Image.fromarray(_drawn(twin, ids, width, height))
    finally:
        twin.close()


def _shown(entity: Entity) -> int:
    """The id of the body that shows an entity."""
    if not entity.is_there:
        raise entity.removed()
    return entity.host if isinstance(entity, Sensor) else entity.id


def _drawn(world: World, chosen: set[int], width: int, height: int) -> npt.NDArray[np.uint8]:
    with world.lock:
        picture = world.render(width, height).astype(np.float64)
        shown = np.isin(world.segmentation(width, height), sorted(chosen))
    grey = picture @ (0.299, 0.587, 0.114)
    faded = (1.0 - _FADED) * grey[:, :, None] + _FADED * 255.0
    found = np.where(shown[:, :, None], picture, faded)
    found[_around(shown)] = OUTLINE
    return found.round().astype(np.uint8)


def _around(shown: npt.NDArray[np.bool_]) -> Any:
    """The pixels beside what is shown."""
    from scipy.ndimage import binary_dilation

    return binary_dilation(shown, iterations=_WIDTH) & ~shown
