"""The base class of simulators that lack some methods of `Simulator`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NoReturn

from ssduck.errors import UnsupportedError


def unsupported(action: str, instead: str = "") -> Callable[..., Any]:
    """Returns a method that raises `UnsupportedError`.

    Args:
        action: what the simulator cannot do, to follow "cannot".
        instead: what the user can do instead, for the end of the message.
    """

    def refuse(self: object, *_: Any, **__: Any) -> NoReturn:
        advice = f"; {instead}" if instead else ""
        raise UnsupportedError(f"{type(self).__name__} cannot {action}{advice}")

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

    begin_episode = unsupported("begin an episode")
    set_clock = unsupported("follow the clock of an external simulation")
    cast_rays = unsupported("cast the rays of sensors")
    photograph = render = segment = unsupported("draw images")
    place = unsupported("move bodies")
    set_joints = unsupported("set joints")
    drive = unsupported("drive joints")
    has_constraint = add_constraint = remove_constraint = unsupported("connect bodies")
    enable = unsupported("switch collisions on or off")
    show = unsupported("show or hide bodies")
    remove = unsupported("remove bodies")

    def has_moved_on(self, sample: Sequence[Any]) -> bool:  # noqa: ARG002
        """Returns False: nothing changes between two ticks."""
        return False
