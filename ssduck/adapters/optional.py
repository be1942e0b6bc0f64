"""Libraries that ssduck does without, unless a form is asked for that needs one."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from ssduck.errors import UnsupportedError


def library(name: str, extra: str) -> Any:
    """A library that one of ssduck's extras brings.

    Raises:
        UnsupportedError: it is not installed, with the command that does it.
    """
    try:
        return import_module(name)
    except ModuleNotFoundError as error:
        if error.name != name:
            raise
        raise UnsupportedError(
            f"{name} is not installed; pip install 'ssduck[{extra}]' does it"
        ) from error
