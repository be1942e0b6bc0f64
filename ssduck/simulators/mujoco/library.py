"""Imports MuJoCo, which is optional, and evens out its versions."""

from __future__ import annotations

import copy
import ctypes
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from ssduck.errors import UnsupportedError

# The libraries that draw without a screen, by the value of the variable that chooses one.
_OFFSCREEN = {"egl": "libEGL.so.1", "osmesa": "libOSMesa.so.8"}


def _choose_opengl() -> None:
    """Lets MuJoCo draw without a screen, unless the user chose: it decides when it is imported."""
    if sys.platform != "linux" or {"MUJOCO_GL", "DISPLAY", "WAYLAND_DISPLAY"} & os.environ.keys():
        return
    for name, library in _OFFSCREEN.items():
        try:
            ctypes.CDLL(library)
        except OSError:
            continue
        os.environ["MUJOCO_GL"] = name
        return


_choose_opengl()
try:
    import mujoco
except ImportError as error:
    raise UnsupportedError(
        "MuJoCo is not installed: pip install 'ssduck[mujoco]' installs it"
    ) from error

__all__ = ["all_digits", "copied_data", "mujoco"]
# The digits by which a double is the same when it is read again.
_ALL_DIGITS = 17


@contextmanager
def all_digits() -> Iterator[None]:
    """Lets MuJoCo write numbers in XML with all digits; by itself it writes six."""
    names = ("libmujoco.", "mujoco.dll")
    folder = Path(mujoco.__file__).parent
    library = ctypes.CDLL(
        str(next(file for file in folder.iterdir() if file.name.startswith(names)))
    )
    get, put = (getattr(library, f"_mjPRIVATE__{verb}_xml_precision") for verb in ("get", "set"))
    before = get()
    put(_ALL_DIGITS)
    try:
        yield
    finally:
        put(before)


def copied_data(model: Any, data: Any, target: Any) -> Any:
    """Returns data with the whole state of other data: the target, or new data in old versions."""
    if not hasattr(mujoco, "mj_copyData"):  # MuJoCo 3.3.0
        return copy.copy(data)
    mujoco.mj_copyData(target, model, data)
    return target
