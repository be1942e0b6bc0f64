"""Demonstrations for `ssduck demo NAME`: a registry, with a module for each.

A module of this package that is named in `NAMES` is a demonstration. The first line of its
docstring describes it, and its function `run` runs it:

    def run(folder: Path, say: Callable[[str], None], *, seed: int) -> bool

`folder` is an existing folder for the pictures; `say` writes one or several lines; `seed` seeds
the random numbers. `run` checks its own results and returns whether they are as expected.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Protocol

# The modules of the demonstrations, in the order of `ssduck demo --list`.
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
    """The function that runs a demonstration."""

    def __call__(self, folder: Path, say: Callable[[str], None], *, seed: int) -> bool:
        """Runs the demonstration; returns whether its results are as expected."""


def run_of(name: str) -> DemoFunction:
    """Returns the function that runs a demonstration.

    Args:
        name: one of `NAMES`.
    """
    run: DemoFunction = import_module(f"{__name__}.{name}").run
    return run


def description_of(name: str) -> str:
    """Returns a line that describes a demonstration.

    >>> description_of("map")
    'Maps of the kitchen for its vacuum cleaner: of everything, and of everything near it.'
    """
    return (import_module(f"{__name__}.{name}").__doc__ or "").partition("\n")[0]
