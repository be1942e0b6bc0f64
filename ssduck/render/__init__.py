"""Draws pictures and films of worlds and records: `render` and `filmed`."""

from typing import TYPE_CHECKING

from ssduck.lazy import exports

if TYPE_CHECKING:
    from ssduck.render.rendering import Film, filmed, render

__all__ = [
    "Film",
    "filmed",
    "render",
]

__getattr__, __dir__ = exports(
    __name__,
    {
        "rendering": ("Film", "filmed", "render"),
    },
)
