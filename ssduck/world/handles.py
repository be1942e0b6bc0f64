"""Defines what the handles of entities and of links have in common: `Handle`."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import (
    TYPE_CHECKING,
    Any,
    ClassVar,
    Protocol,
    Self,
    SupportsIndex,
    TypeVar,
    overload,
)

from ssduck.errors import RemovedEntityError, UnknownNameError, nearest
from ssduck.formatting import first_names, name_path, short_repr
from ssduck.schema import MASSES, TABLES, EntityTable, entity_of
from ssduck.world.public_names import HANDLE_INTERNALS, INSTEAD_IN_HANDLES, PublicNames

if TYPE_CHECKING:
    from ssduck.world.entities import Entity
    from ssduck.world.layout import EntityInfo
    from ssduck.world.world import World


# The error of an unknown name tells so many names.
_MAX_NAMES = 12


class WorldArchive(Protocol):
    """The recorded ticks of a world, as handles and past worlds use them."""

    @property
    def world(self) -> World:
        """The recorded world."""

    @property
    def members(self) -> Mapping[int, EntityInfo]:
        """The recorded entities by id, of all ticks."""

    def at(self, tick: int) -> World:
        """Returns the world at a tick."""

    def entity(self, tick: int, id: int) -> Entity:
        """Returns the handle of an entity at a tick."""

    def handle(self, tick: int, id: int) -> Handle:
        """Returns the handle of an entity or a link at a tick."""

    def warn_of_missing(self, inputs: Collection[str]) -> None:
        """Warns of what an evaluation reads and the record has not as the world had it."""


@dataclass(frozen=True, eq=False)
class RecordedTick:
    """A recorded tick, to which a handle is fixed."""

    record: WorldArchive
    tick: int


class _Named(Protocol):
    @property
    def name(self) -> str: ...


T = TypeVar("T", bound=_Named)


class NamedList(list[T]):
    """A list whose elements can be had by name, too: `arm.joints["elbow"]`."""

    @overload
    def __getitem__(self, key: SupportsIndex | str, /) -> T: ...

    @overload
    def __getitem__(self, key: slice, /) -> list[T]: ...

    def __getitem__(self, key: SupportsIndex | slice | str, /) -> T | list[T]:
        """Returns the element of a number or a name, or a part of the list.

        Raises:
            UnknownNameError: no element has the name; the error suggests the nearest names.
        """
        if not isinstance(key, str):
            return super().__getitem__(key)
        for element in self:
            if element.name == key:
                return element
        names = [element.name for element in self]
        told = f"the names are {first_names(names, _MAX_NAMES)}" if names else "the list is empty"
        raise UnknownNameError(
            f"there is no {short_repr(key)}; {told}", suggestions=nearest(key, names)
        )


class Handle(PublicNames):
    """A handle of an entity or a link: a row of a table of its world.

    Two handles are equal if they stand for the same thing of the same world, at any tick.

    Attributes:
        world: the world.
        id: the number of the row's `id` column.
        name: the name; of a link, as in its model.
        moment: the recorded tick to which the handle is fixed; None for the world's last tick.
    """

    __slots__ = ("id", "moment", "name", "world")

    INTERNAL_NAMES, INSTEAD_OF = HANDLE_INTERNALS, INSTEAD_IN_HANDLES

    kind: str
    # The table of the world that has the row.
    TABLE: ClassVar[EntityTable] = "entities"

    def __init__(
        self, world: World, id: int, name: str, moment: RecordedTick | None = None
    ) -> None:
        self.world = world
        self.id = id
        self.name = name
        self.moment = moment

    def pinned(self, moment: RecordedTick) -> Self:
        """Returns the handle that stays at a recorded tick."""
        raise NotImplementedError

    @property
    def entity(self) -> Entity:
        """The entity itself; of a link, its entity."""
        raise NotImplementedError

    @property
    def full_name(self) -> str:
        """The name that is unique in the world."""
        return self.name

    @property
    def state(self) -> World:
        """The world at the tick of the handle."""
        moment = self.moment
        if moment is None or moment.tick == self.world.snapshot.number:
            return self.world.present
        return moment.record.at(moment.tick)

    @property
    def is_there(self) -> bool:
        """Whether the world has the row at the tick of the handle."""
        raise NotImplementedError

    @property
    def position(self) -> list[float]:
        """The origin of the link frame, [x, y, z], m, world frame."""
        return self._numbers("x", "z")

    @property
    def orientation(self) -> list[float]:
        """The orientation of the link frame, unit quaternion [w, x, y, z], world frame."""
        return self._numbers("qw", "qz")

    @property
    def pose(self) -> list[float]:
        """The orientation, then the position: [w, x, y, z, x, y, z]."""
        return self.orientation + self.position

    @property
    def velocity(self) -> list[float]:
        """The velocity of the link frame's origin, m/s, then the angular velocity, rad/s."""
        return self._numbers("vx", "wz")

    @property
    def aabb(self) -> tuple[list[float], list[float]]:
        """The lower and the upper corner of the exact axis-aligned box, m, world frame."""
        corners = self._numbers("xmin", "zmax")  # of one tick, whoever takes the next one
        return corners[:3], corners[3:]

    @property
    def mass(self) -> float:
        """The mass, kg; 0 for what cannot move."""
        with self.state.lock:
            self.state.request_tables([MASSES])
            return self._numbers("mass", "mass")[0]

    def part_hint(self, key: str) -> str:
        """The hint of an error for a key: what of its world has that name; "" if nothing has."""
        return self.world.part_hint(key)

    def key_hint(self, key: str) -> str:
        """The hint of the error for a program that asks for a value by a key, as in `cup.z`."""
        owner = getattr(self, "owner", None)
        path = name_path(self.world.name, *([] if owner is None else [owner]), self.name)
        key = "z" if key.startswith("_") else key
        told = "functions tell of an entity, a link or a site: "
        return f"{told}{key}({path}), {key}(this) of a row, or k.{key} of a source k"

    def column(self, name: str) -> Any:
        """Returns the value of a column of the row; None if it is unknown."""
        return self.state.snapshot.value(self._row(), name)

    def _row(self) -> int:
        """Returns the number of the row in its table."""
        raise NotImplementedError

    def removed(self) -> RemovedEntityError:
        """Returns the error for an entity that is no longer in its world, or a link of it."""
        told = removal_of(self)
        message = f"{self.full_name!r} is no longer in world {self.world.name!r}"
        return RemovedEntityError(f"{message}; {told}" if told else message)

    def _numbers(self, first: str, last: str) -> list[float]:
        with self.state.lock:
            row = self._row()  # it may take a tick
            table = self.state.snapshot.tables[TABLES[self.TABLE].source]
            column = table.doubles(first, last)[:, row]
            values: list[float] = column.tolist()
        return values

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Handle) and (self.world, self.id) == (other.world, other.id)

    def __hash__(self) -> int:
        return hash((id(self.world), self.id))

    def __deepcopy__(self, _: dict[int, Any]) -> Self:
        """Returns the handle itself, as it is immutable."""
        return self


def place_of(handle: Handle) -> tuple[str, int]:
    """Returns the table that has the row of a handle, and the number of the row."""
    return TABLES[handle.TABLE].source, handle._row()  # noqa: SLF001  # one module


def removal_of(handle: Handle) -> str:
    """Returns when the entity of a handle was removed, for an error; '' if it is there."""
    if entity_of(handle.id) in handle.world.snapshot.rows:
        return ""
    return handle.world.removal_of(getattr(handle, "owner", handle.name))
