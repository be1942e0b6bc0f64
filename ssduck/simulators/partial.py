"""The base class of simulators that lack some methods of `Simulator`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NoReturn

from ssduck.errors import UnsupportedError


def _unsupported(action: str) -> Callable[..., Any]:
    def refuse(self: object, *_: Any, **__: Any) -> NoReturn:
        raise UnsupportedError(f"{type(self).__name__} cannot {action}")

    return refuse


class PartialSimulator:
    """The methods of `Simulator` that ticks do not need; each raises `UnsupportedError`.

    A simulator derives from it and overrides the methods that it supports.

    >>> PartialSimulator().remove(None)
    Traceback (most recent call last):
    ssduck.errors.UnsupportedError: PartialSimulator cannot remove bodies
    """

    keeps_time = False
    episode = 0

    begin_episode = _unsupported("begin an episode")
    set_clock = _unsupported("follow the clock of an external simulation")
    cast_rays = _unsupported("cast the rays of sensors")
    photograph = render = segment = _unsupported("draw images")
    place = _unsupported("move bodies")
    set_joints = _unsupported("set joints")
    drive = _unsupported("drive joints")
    has_constraint = add_constraint = remove_constraint = _unsupported("connect bodies")
    enable = _unsupported("switch collisions on or off")
    show = _unsupported("show or hide bodies")
    remove = _unsupported("remove bodies")
