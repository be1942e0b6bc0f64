"""Imports optional libraries, which only some result forms need."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from ssduck.errors import UnsupportedError


def axes_of(ax: Any, **settings: Any) -> Any:
    """Returns axes of matplotlib: those that are given, or those of a new figure."""
    if ax is not None:
        return ax
    library("matplotlib", "plot")
    from matplotlib.figure import Figure

    return Figure().add_subplot(**settings)


def library(name: str, extra: str) -> Any:
    """Returns a library that an extra of ssduck installs."""
    try:
        return import_module(name)
    except ModuleNotFoundError as error:
        if error.name != name:
            raise
        raise UnsupportedError(
            f"{name} is not installed; pip install 'ssduck[{extra}]' does it"
        ) from error
