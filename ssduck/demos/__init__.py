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

# The modules of the demonstrations, in the order of `ssduck demo --list`.
NAMES = ("kitchen", "robots", "cleanup", "reasoning", "chaos", "environment", "map", "prolog")


def run_of(name: str) -> Callable[..., bool]:
    """Returns the function `run` of a demonstration, one of `NAMES`."""
    run: Callable[..., bool] = import_module(f"{__name__}.{name}").run
    return run


def description_of(name: str) -> str:
    """Returns a line that describes a demonstration.

    >>> description_of("map")
    'Maps of the kitchen for its vacuum cleaner: of everything, and of everything near it.'
    """
    return (import_module(f"{__name__}.{name}").__doc__ or "").partition("\n")[0]
