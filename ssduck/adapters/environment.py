"""Makes a new world of the selected entities."""

from __future__ import annotations

from ssduck.adapters.base import Adapter, Selection
from ssduck.adapters.sizes import WORLD_BYTES
from ssduck.world.world import World


def environment(selection: Selection) -> World:
    """Returns a new, running world of the selected entities, and those of links.

    See `World.excerpt`.
    """
    selection.charge(WORLD_BYTES)
    return selection.world.excerpt([handle.entity for handle in selection.entities])


WORLDS = (
    Adapter(
        ("environment",),
        "A new, running world of the selected entities, in its own simulation.",
        environment,
        needs="entities",
    ),
)
