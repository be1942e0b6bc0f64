"""Finds the entities and links in the rows of a result, and renders them standing out."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from ssduck.errors import ProgramWarning, warn
from ssduck.formatting import joined_names, short_repr
from ssduck.schema import LINK_FACTOR, entity_of, link_id, link_of
from ssduck.world.handles import Handle
from ssduck.world.layout import EntityInfo
from ssduck.world.pictures import renderable
from ssduck.world.world import World

if TYPE_CHECKING:
    from PIL import Image

# The number of an entity and of its link; -1 for the whole entity.
Mark = tuple[int, int]


class Marks:
    """Finds the entities and links in the rows of a result."""

    def __init__(self, world: World) -> None:
        entities = world.snapshot.entities
        self._named: dict[str, list[Mark]] = {info.name: [(info.id, -1)] for info in entities}
        names = dict[str, list[Mark]]()
        for info in entities:
            for number, link in enumerate(info.body.links if info.body else ()):
                self._named.setdefault(f"{info.name}.{link.name}", [(info.id, number)])
                names.setdefault(link.name, []).append((info.id, number))
        self._named = names | self._named
        self._names = {info.id: info.name for info in entities}
        # The names in a row that links of several entities have.
        self._shared: dict[str, Sequence[Mark]] = {}
        self._has_told = False

    def of(self, row: Sequence[Any]) -> list[Mark]:
        """Returns what a row has: handles, and texts that are names of entities or links.

        A name is that of an entity first, then the full name of a link, and then the name of the
        links of one entity that are called so. Those of several entities do not stand out, but for
        one that the row names, too; a warning says so, once.
        """
        found = list(dict.fromkeys(mark for cell in row for mark in self._in(cell)))
        if not self._shared:
            return found
        named = {id for id, _ in found}
        for name, links in self._shared.items():
            of_row = [mark for mark in links if mark[0] in named]
            if len({id for id, _ in of_row}) == 1:
                found += [mark for mark in of_row if mark not in found]
            elif not self._has_told:
                self._has_told = True
                owners = [self._names[id] for id in dict(links)]
                warn(
                    f"{short_repr(name)} is a link of {joined_names(owners)}, and stands out in "
                    f"none: select obj, or full_name, as in {f'{owners[0]}.{name}'!r}",
                    ProgramWarning,
                )
        self._shared.clear()
        return found

    def _in(self, value: Any) -> Iterator[Mark]:
        if isinstance(value, Handle):
            is_link = value.id >= LINK_FACTOR
            yield (entity_of(value.id), link_of(value.id)) if is_link else (value.id, -1)
        elif isinstance(value, str):
            marks = self._named.get(value, ())
            if len(dict(marks)) > 1:
                self._shared[value] = marks
            else:
                yield from marks
        elif isinstance(value, dict):
            for part in value.values():
                yield from self._in(part)
        elif isinstance(value, list | tuple):
            for part in value:
                if not isinstance(part, int | float):  # there may be millions
                    yield from self._in(part)


def marks_of(world: World, rows: Iterable[Sequence[Any]]) -> list[Mark]:
    """Returns what the rows of a result have, each entity and link once."""
    marks = Marks(world)
    return list(dict.fromkeys(mark for row in rows for mark in marks.of(row)))


OUTLINE = (255, 90, 0)
# The share of white in a faded pixel, and the width of an outline, pixels.
_FADE = 0.5
_WIDTH = 2


def highlighted(world: World, marks: Iterable[Mark], width: int, height: int) -> Image.Image:
    """Returns a picture by the world's camera with entities and links outlined, the rest faded.

    Of a recorded tick or a what-if world, a copy is built and rendered. A sensor is shown by the
    body that it is mounted on, a site by its link.
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
    from scipy.ndimage import binary_dilation

    whole = [id for id, link in marks if link < 0]
    parts = [link_id(id, link) for id, link in marks if link >= 0]
    with world.lock:
        picture = world.render(width, height).astype(np.float64)
        segments = world.segmentation(width, height, links=True)
    is_highlighted = np.isin(segments % LINK_FACTOR, whole) | np.isin(segments, parts)
    grey = picture @ (0.299, 0.587, 0.114)
    faded = (1.0 - _FADE) * grey[:, :, None] + _FADE * 255.0
    pixels = np.where(is_highlighted[:, :, None], picture, faded)
    pixels[binary_dilation(is_highlighted, iterations=_WIDTH) & ~is_highlighted] = OUTLINE
    return pixels.round().astype(np.uint8)
