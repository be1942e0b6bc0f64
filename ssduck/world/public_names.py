"""Lists only public names in `dir`, and so in completions; explains unknown ones."""

from __future__ import annotations

from abc import ABCMeta
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any, ClassVar, NoReturn


class _PublicNamesType(ABCMeta):
    """The type of these classes: their own `dir` is that of their objects."""

    INTERNAL_NAMES: frozenset[str]

    def __dir__(cls) -> Iterable[str]:
        return [name for name in super().__dir__() if name not in cls.INTERNAL_NAMES]


class PublicNames(metaclass=_PublicNamesType):
    """A base class whose `dir` leaves out the names that only other packages of ssduck use.

    If the object contains an item of the name of an unknown attribute, the error shows how to
    get it.
    """

    __slots__ = ()

    INTERNAL_NAMES: ClassVar[frozenset[str]] = frozenset(("INTERNAL_NAMES", "INSTEAD_OF"))
    # What there is in place of a name that users of other libraries look for.
    INSTEAD_OF: ClassVar[Mapping[str, str]] = {}

    def __dir__(self) -> Iterable[str]:
        return [name for name in super().__dir__() if name not in self.INTERNAL_NAMES]

    if not TYPE_CHECKING:  # type checkers would allow any attribute

        def __getattr__(self, name: str) -> NoReturn:
            kind: Any = type(self)
            message = f"{kind.__name__!r} object has no attribute {name!r}"
            # An attribute of the class is here if its property raised an AttributeError.
            is_unknown = not name.startswith("_") and not hasattr(kind, name)
            if is_unknown and hasattr(kind, "__contains__") and name in self:
                message += f"; write [{name!r}] instead of .{name}"
            elif is_unknown and name in self.INSTEAD_OF:
                message += f"; {self.INSTEAD_OF[name]}"
            raise AttributeError(message, name=name, obj=self)


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
        *("INTERNAL_NAMES", "TABLE", "body_of", "column", "info", "key_hint", "moment"),
        *("pinned", "removed", "state"),
    )
)
