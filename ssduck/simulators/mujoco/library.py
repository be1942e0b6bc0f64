"""Imports MuJoCo, which is optional."""

from __future__ import annotations

from ssduck.errors import UnsupportedError

try:
    import mujoco
except ImportError as error:
    raise UnsupportedError(
        "MuJoCo is not installed: pip install 'ssduck[mujoco]' installs it"
    ) from error

__all__ = ["mujoco"]
