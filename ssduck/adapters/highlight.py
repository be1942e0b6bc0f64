"""Renders pictures of a world in which some entities stand out."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from ssduck.world.entities import Sensor
from ssduck.world.handles import Handle
from ssduck.world.pictures import renderable
from ssduck.world.world import World

if TYPE_CHECKING:
    from PIL import Image

OUTLINE = (255, 90, 0)
# The share of white in a faded pixel, and the width of an outline, pixels.
_FADE = 0.5
_WIDTH = 2


def highlighted(world: World, entities: Iterable[Handle], width: int, height: int) -> Image.Image:
    """Returns a picture by the world's camera with entities outlined and all else faded.

    Args:
        world: the world; of a recorded tick or a what-if world, a copy is built and rendered.
        entities: entities of the world; a sensor is shown by the body that it is mounted on.
        width: pixels.
        height: pixels.

    Raises:
        RemovedEntityError: an entity has been removed.
    """
    from PIL import Image

    body_ids = {_visible_body(entity) for entity in entities}
    names = {world.entity(id).name for id in body_ids}
    with renderable(world) as rendered:
        ids = body_ids
        if rendered is not world:
            ids = {entity.id for entity in rendered if entity.name in names}
        return Image.fromarray(_render_highlighted(rendered, ids, width, height))


def _visible_body(entity: Handle) -> int:
    """Returns the id of the body that represents an entity in the picture."""
    if not entity.is_there:
        raise entity.removed()
    return entity.host if isinstance(entity, Sensor) else entity.entity.id


def _render_highlighted(
    world: World, body_ids: set[int], width: int, height: int
) -> npt.NDArray[np.uint8]:
    with world.lock:
        picture = world.render(width, height).astype(np.float64)
        is_highlighted = np.isin(world.segmentation(width, height), sorted(body_ids))
    grey = picture @ (0.299, 0.587, 0.114)
    faded = (1.0 - _FADE) * grey[:, :, None] + _FADE * 255.0
    pixels = np.where(is_highlighted[:, :, None], picture, faded)
    pixels[_outline(is_highlighted)] = OUTLINE
    return pixels.round().astype(np.uint8)


def _outline(is_highlighted: npt.NDArray[np.bool_]) -> Any:
    """Returns the pixels around those of the highlighted bodies."""
    from scipy.ndimage import binary_dilation

    return binary_dilation(is_highlighted, iterations=_WIDTH) & ~is_highlighted
