"""Lists only the public names of worlds and handles in `dir`, and so in completions."""

from __future__ import annotations

from abc import ABCMeta
from collections.abc import Iterable
from typing import ClassVar


class _PublicNamesType(ABCMeta):
    """The type of these classes: their own `dir` is that of their objects."""

    INTERNAL_NAMES: frozenset[str]

    def __dir__(cls) -> Iterable[str]:
        return [name for name in super().__dir__() if name not in cls.INTERNAL_NAMES]


class PublicNames(metaclass=_PublicNamesType):
    """A base class whose `dir` leaves out the names that only other packages of ssduck use."""

    __slots__ = ()

    INTERNAL_NAMES: ClassVar[frozenset[str]] = frozenset()

    def __dir__(self) -> Iterable[str]:
        return [name for name in super().__dir__() if name not in self.INTERNAL_NAMES]


WORLD_INTERNALS = frozenset(
    (
        *("INTERNAL_NAMES", "add_recorder", "advance", "drive", "enable", "handle", "hold"),
        *(
            "is_attached",
            "is_final",
            "is_observed",
            "is_watched",
            "lock",
            "notify_observers",
            "origin",
        ),
        *("owning", "pinned", "place", "reading", "release", "remove_recorder"),
        *("request_tables", "serial", "slack", "steps_to_due", "steps_to_tick", "switch"),
        "warn_of_unrecorded_start",
    )
)
HANDLE_INTERNALS = frozenset(
    (
        *("INTERNAL_NAMES", "KEY_HINT", "TABLE", "body_of", "column", "info", "moment"),
        *("pinned", "removed", "state"),
    )
)
