"""Defines what handles have in common, `Handle`, and those of links and sites: `Link`, `Site`."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
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

from ssduck.errors import RemovedEntityError, UnknownNameError, UnsupportedError, nearest
from ssduck.formatting import joined_names, name_path, short_repr
from ssduck.schema import (
    MASSES,
    MAX_LINKS,
    TABLES,
    EntityTable,
    LinkTable,
    entity_of,
    link_id,
    link_of,
)
from ssduck.simulators.interface import Link as LinkInfo
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

    def numbers(self, tick: int, id: int, first: str, last: str) -> list[float]:
        """Returns recorded doubles of an entity or a link at a tick; [] if there are none."""

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
        told = f"the names are {joined_names(names, _MAX_NAMES)}" if names else "the list is empty"
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
        moment, recorded = self.moment, list[float]()
        if moment is not None and moment.tick != self.world.snapshot.number:
            recorded = moment.record.numbers(moment.tick, self.id, first, last)
        if recorded:
            return recorded
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
    return handle.world.ticker.removal_of(getattr(handle, "owner", handle.name))


class Link(Handle):
    """A handle of a link of an entity; its properties are those at its world's last tick.

    A handle from a query of the past is fixed to that tick, as that of an entity is.

    Attributes:
        world: the world of the entity.
        id: the number of the link in the world: (link number + 1) * 2**19 + id of the entity.
        name: the name as in the model.
        owner: the name of the entity.
        moment: the recorded tick to which the handle is fixed; None for the world's last tick.
    """

    __slots__ = ("owner",)

    TABLE: ClassVar[EntityTable] = "links"
    kind = "link"

    def __init__(
        self, world: World, id: int, name: str, owner: str, moment: RecordedTick | None = None
    ) -> None:
        super().__init__(world, id, name, moment)
        self.owner = owner

    def pinned(self, moment: RecordedTick) -> Self:
        """Returns the handle that stays at a recorded tick."""
        return type(self)(self.world, self.id, self.name, self.owner, moment)

    @property
    def full_name(self) -> str:
        """The names of entity and link, `panda.panda_hand`."""
        return f"{self.owner}.{self.name}"

    @property
    def number(self) -> int:
        """The number of the link in its entity; the base is 0."""
        return link_of(self.id)

    @property
    def entity(self) -> Entity:
        """The entity that has the link.

        Raises:
            RemovedEntityError: the world does not have the entity any more.
        """
        id, moment = entity_of(self.id), self.moment
        if moment is None and id not in self.world.snapshot.rows:
            raise self.removed()
        return self.world.entity(id) if moment is None else moment.record.entity(moment.tick, id)

    @property
    def parent(self) -> Link | None:
        """The parent link; None for the base."""
        number: int | None = self.column("parent")
        return None if number is None else self.entity.links[number]

    @property
    def is_there(self) -> bool:
        """Whether the world has the entity at the tick of the handle."""
        return entity_of(self.id) in self.state.snapshot.rows

    def column(self, name: str) -> Any:
        """Returns the value of a column of the view of links; None if it is unknown."""
        match name:
            case "id":
                return self.id
            case "kind":
                return self.kind
            case "full_name":
                return self.full_name
            case "enabled" | "visible" | "run":
                return self.entity.column(name)
        return self.state.snapshot.value(self._row(), name, TABLES[self.TABLE].source)

    def _row(self) -> int:
        state = self.state
        state.request_tables([TABLES[self.TABLE].source])
        row = state.snapshot.layout.link_rows.get(entity_of(self.id))
        if row is None:
            raise self.removed()
        return row + self.number

    def __repr__(self) -> str:
        return f"<{self.kind} {self.full_name!r}>"


class Site(Link):
    """A handle of a site: a named frame that is fixed to a link, with a region around it.

    Models of MuJoCo have sites. Their regions have no mass, and nothing collides with them. The
    id is that of a link, with a number after those of the links of its entity.
    """

    __slots__ = ()

    TABLE = "sites"
    kind = "site"

    @property
    def parent(self) -> Link:
        """The link that the site is fixed to."""
        number: int = self.column("parent")
        return self.entity.links[number]


def links_of(entity: Entity) -> list[Link]:
    """Returns the links of an entity at the tick of its handle, the base first, without sites."""
    return [link for link in links_and_sites_of(entity) if not isinstance(link, Site)]


def sites_of(entity: Entity) -> list[Site]:
    """Returns the sites of an entity at the tick of its handle."""
    return [link for link in links_and_sites_of(entity) if isinstance(link, Site)]


def links_and_sites_of(entity: Entity) -> list[Link]:
    """Returns the links of an entity at the tick of its handle, by number, then its sites."""
    info = entity.info
    links = () if info.body is None else info.body.links
    if len(links) > MAX_LINKS:
        raise UnsupportedError(
            f"{entity.name!r} has {len(links)} links and sites; only those of bodies with at most "
            f"{MAX_LINKS} are values"
        )
    return [
        handle_of(link)(
            entity.world, link_id(entity.id, number), link.name, entity.name, entity.moment
        )
        for number, link in enumerate(links)
    ]


def handle_of(link: LinkInfo) -> type[Link]:
    """Returns the class of handles of a link, or of a site."""
    return Link if link.region is None else Site


@dataclass(frozen=True)
class Links:
    """The links of all entities of a world, or their sites: a source of queries.

    Attributes:
        world: the world.
        table: the table that has them.
    """

    world: World
    table: LinkTable = "links"

    def __iter__(self) -> Iterator[Link]:
        """Yields them, those of each body together, in the order of the bodies."""
        for entity in self.world:
            yield from links_of(entity) if self.table == "links" else sites_of(entity)

    def __repr__(self) -> str:
        return f"<{self.table.capitalize()} of {self.world.name!r}>"
