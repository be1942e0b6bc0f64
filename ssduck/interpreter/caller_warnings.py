"""Warnings that name the line outside of ssduck that led to them."""

from __future__ import annotations

import sys
import warnings

_PACKAGE = __name__.partition(".")[0]
# Frames of context managers stand between those of the package.
_BETWEEN = frozenset((_PACKAGE, "contextlib"))


def warn(message: str, category: type[Warning] = UserWarning) -> None:
    """Warn of the innermost line that is not ssduck's own.

    Args:
        message: what is told.
        category: the class of the warning.
    """
    frame, level = sys._getframe(), 1  # noqa: SLF001  # warnings counts frames, too
    while frame.f_back is not None and _module(frame.f_globals) in _BETWEEN:
        frame, level = frame.f_back, level + 1
    warnings.warn(message, category, stacklevel=level)


def _module(names: dict[str, object]) -> str:
    return str(names.get("__name__", "")).partition(".")[0]
