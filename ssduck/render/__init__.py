"""Draws pictures and films of worlds and records: `render`."""

from typing import TYPE_CHECKING

from ssduck.lazy import exports

if TYPE_CHECKING:
    from ssduck.render.rendering import render

__all__ = [
    "render",
]

__getattr__, __dir__ = exports(
    __name__,
    {
        "rendering": ("render",),
    },
)
