"""Renders pictures of a world in which some entities stand out."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from ssduck.adapters.marks import Mark
from ssduck.schema import LINK_FACTOR, link_id
from ssduck.world.layout import EntityInfo
from ssduck.world.pictures import renderable
from ssduck.world.world import World

if TYPE_CHECKING:
    from PIL import Image

OUTLINE = (255, 90, 0)
# The share of white in a faded pixel, and the width of an outline, pixels.
_FADE = 0.5
_WIDTH = 2


def highlighted(world: World, marks: Iterable[Mark], width: int, height: int) -> Image.Image:
    """Returns a picture by the world's camera with entities and links outlined, the rest faded.

    Args:
        world: the world; of a recorded tick or a what-if world, a copy is built and rendered.
        marks: entities and links of the world; a sensor is shown by the body that it is mounted
            on, a site by its link.
        width: pixels.
        height: pixels.
    """
    from PIL import Image

    infos = {info.id: info for info in world.snapshot.entities}
    seen = {_seen(infos[id], link) for id, link in marks}
    with renderable(world) as rendered:
        if rendered is not world:
            copies = {entity.name: entity.id for entity in rendered}
            seen = {(copies[infos[id].name], link) for id, link in seen if infos[id].name in copies}
        return Image.fromarray(_render_highlighted(rendered, seen, width, height))


def _seen(info: EntityInfo, link: int) -> Mark:
    """Returns what represents an entity or a link in the picture."""
    if info.body is None:
        return info.mount[0], -1
    if link >= 0 and info.body.links[link].region is not None:
        return info.id, info.body.links[link].parent
    return info.id, link


def _render_highlighted(
    world: World, marks: set[Mark], width: int, height: int
) -> npt.NDArray[np.uint8]:
    whole = [id for id, link in marks if link < 0]
    parts = [link_id(id, link) for id, link in marks if link >= 0]
    with world.lock:
        picture = world.render(width, height).astype(np.float64)
        segments = world.segmentation(width, height, links=True)
    is_highlighted = np.isin(segments % LINK_FACTOR, whole) | np.isin(segments, parts)
    grey = picture @ (0.299, 0.587, 0.114)
    faded = (1.0 - _FADE) * grey[:, :, None] + _FADE * 255.0
    pixels = np.where(is_highlighted[:, :, None], picture, faded)
    pixels[_outline(is_highlighted)] = OUTLINE
    return pixels.round().astype(np.uint8)


def _outline(is_highlighted: npt.NDArray[np.bool_]) -> Any:
    """Returns the pixels around those of the highlighted bodies."""
    from scipy.ndimage import binary_dilation

    return binary_dilation(is_highlighted, iterations=_WIDTH) & ~is_highlighted
