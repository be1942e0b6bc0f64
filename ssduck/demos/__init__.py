"""What `ssduck demo NAME` shows: a registry of demonstrations, a module each.

A module of this package that is named in `NAMES` is a demonstration. The first line of its
docstring tells what it shows, and its `run` shows it:

    def run(folder: Path, say: Callable[[str], None], *, seed: int) -> bool

`folder` is there, and takes the pictures; `say` writes a line, or several; `seed` decides what
is drawn by chance. It returns whether the demonstration found what it is to find, which it has
to check itself.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Protocol

# In the order in which they are listed; each is a module of this package.
NAMES = (
    "kitchen",
    "robots",
    "cleanup",
    "reasoning",
    "chaos",
    "environment",
    "map",
    "prolog",
)


class DemoFunction(Protocol):
    """How a demonstration is run."""

    def __call__(self, folder: Path, say: Callable[[str], None], *, seed: int) -> bool:
        """Show it; whether it found what it is to find."""


def run_of(name: str) -> DemoFunction:
    """What runs the demonstration of that name, one of `NAMES`."""
    run: DemoFunction = import_module(f"{__name__}.{name}").run
    return run


def description_of(name: str) -> str:
    """What the demonstration of that name shows, in a line."""
    return (import_module(f"{__name__}.{name}").__doc__ or "").partition("\n")[0]
