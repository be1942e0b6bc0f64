"""Defines handles of the links of entities and of the sites on them: `Link`, `Site`."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Self

from ssduck.errors import UnsupportedError
from ssduck.schema import (
    MAX_LINKS,
    TABLES,
    EntityTable,
    LinkTable,
    entity_of,
    link_id,
    link_of,
)
from ssduck.simulators.interface import Link as LinkInfo
from ssduck.world.handles import Handle, RecordedTick

if TYPE_CHECKING:
    from ssduck.world.entities import Entity
    from ssduck.world.world import World


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
    """Returns the links of an entity at the tick of its handle, the base first, without sites.

    Raises:
        UnsupportedError: the body has too many links.
    """
    return [link for link in links_and_sites_of(entity) if not isinstance(link, Site)]


def sites_of(entity: Entity) -> list[Site]:
    """Returns the sites of an entity at the tick of its handle.

    Raises:
        UnsupportedError: the body has too many links and sites.
    """
    return [link for link in links_and_sites_of(entity) if isinstance(link, Site)]


def links_and_sites_of(entity: Entity) -> list[Link]:
    """Returns the links of an entity at the tick of its handle, then its sites, by their numbers.

    Raises:
        UnsupportedError: the body has too many links.
    """
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
