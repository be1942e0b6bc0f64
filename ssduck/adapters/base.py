"""What an adapter is and what it is given: `Adapter`, `Selection`."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

from ssduck.errors import ArgumentError
from ssduck.language.clauses import Rows
from ssduck.language.tree import Query
from ssduck.world.entities import Entity

if TYPE_CHECKING:
    from ssduck.world.world import World

_ANY_NUMBER = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)
# What an adapter reads: rows; columns by their names; entities; the query, and rows if it asks.
Need: TypeAlias = Literal["rows", "columns", "entities", "query"]


class Selection:
    """What a query selected, as an adapter sees it: all of one tick, unless it is a window.

    With GROUP BY or CONNECT BY, an adapter is given a selection for each group or path.

    Args:
        read: gives so many rows at most; all for None.
        query: the query.
        worlds: gives the worlds that the query is about, at their ticks.
    """

    def __init__(
        self,
        read: Callable[[int | None], Rows],
        query: Query,
        worlds: Callable[[], Sequence[World]],
    ) -> None:
        self._read = read
        self._worlds = worlds
        self._rows: Rows | None = None
        self.query = query

    def read(self) -> Rows:
        """The rows with their columns' names; the query runs when they are first asked for."""
        if self._rows is None:
            self._rows = self._read(None)
        return self._rows

    def end(self) -> None:
        """The query is over: what was not read yet would be of another tick."""
        self._read = _ended

    @property
    def rows(self) -> list[tuple[Any, ...]]:
        """A tuple a row, in order: one value a column."""
        return self.read().values

    def head(self, count: int) -> list[tuple[Any, ...]]:
        """The first rows, at most that many; no others are worked out if none were before."""
        return (self._read(count) if self._rows is None else self._rows).values[:count]

    @property
    def columns(self) -> tuple[str, ...]:
        """The columns' names.

        Raises:
            ArgumentError: `to` gives a column another name from row to row.
        """
        names = self.read().names
        if not isinstance(names, list):
            return names
        if len(set(names)) > 1:
            raise ArgumentError(f"the columns' names differ from row to row: {names[0]}, …")
        return names[0] if names else ()

    @cached_property
    def entities(self) -> list[Entity]:
        """The entities in the rows, lists in them included, each once, as they first appear.

        Of a window, one is there for each tick.
        """
        found: dict[tuple[Entity, int | None], Entity] = {}
        for row in self.rows:
            _gather(row, found)
        return list(found.values())

    @property
    def worlds(self) -> list[World]:
        """The worlds that the query is about, each as it is at the tick of the query.

        Raises:
            ArgumentError: the entities are of several ticks of a world.
        """
        states: dict[World, World] = {}
        for entity in self.entities:
            state = entity.state
            if states.setdefault(entity.world, state).snapshot.number != state.snapshot.number:
                raise ArgumentError(
                    f"the entities are of several ticks of {entity.world.name!r}; "
                    "AS needs those of one, as FROM world{12.5} gives them"
                )
        return list(states.values()) or list(self._worlds())

    @property
    def world(self) -> World:
        """The one world that the query is about, as it is at the tick of the query.

        Raises:
            ArgumentError: it is about none, about several, or about several ticks.
        """
        worlds = self.worlds
        if len(worlds) != 1:
            told = ", ".join(world.name for world in worlds) or "none"
            raise ArgumentError(f"this needs entities of one world; those of the query: {told}")
        return worlds[0]

    @property
    def tick(self) -> int:
        """The number of the tick that `world` is at."""
        return self.world.snapshot.number

    @property
    def time(self) -> float:
        """The simulated time that `world` is at, s."""
        return self.world.time


@dataclass(frozen=True)
class Adapter:
    """A form of the result: what follows AS.

    Attributes:
        names: what programs call it.
        help: what it makes of the rows, in a sentence or two.
        make: selection and the arguments behind AS to value.
        needs: what it reads. `"rows"`: all rows; `"columns"`: the same, and the columns' names
            must differ; `"entities"`: there must be some, or no rows; `"query"`: what it asks
            the selection for, and nothing runs before.
        select: the query that is run in the place of the one that was asked; None for the same.
        writes: whether it writes a file, which `Limits` may forbid.
        tables: what it reads of the tick beside the entities, so that the tick has it.
    """

    names: tuple[str, ...]
    help: str
    make: Callable[..., Any]
    needs: Need = "rows"
    select: Callable[[Query], Query] | None = None
    writes: bool = False
    tables: frozenset[str] = frozenset()

    @cached_property
    def signature(self) -> inspect.Signature:
        """What `make` takes; the selection first."""
        return inspect.signature(self.make)

    @cached_property
    def is_plain(self) -> bool:
        """Whether it needs no arguments."""
        _, *parameters = self.signature.parameters.values()
        return all(p.default is not p.empty or p.kind in _ANY_NUMBER for p in parameters)

    @property
    def usage(self) -> str:
        """`AS name(arguments)`, as in its help."""
        _, *parameters = self.signature.parameters.values()
        plain = [p.replace(annotation=inspect.Parameter.empty) for p in parameters]
        listed = ", ".join(map(str, plain))
        return f"AS {' | '.join(self.names)}" + (f"({listed})" if listed else "")


def _ended(_: int | None) -> Rows:
    raise ArgumentError("the query is over; a form reads its rows before it returns")


def _gather(value: Any, found: dict[tuple[Entity, int | None], Entity]) -> None:
    if isinstance(value, Entity):
        tick = None if value.moment is None else value.moment.tick
        found.setdefault((value, tick), value)
    elif isinstance(value, list | tuple):
        for part in value:
            _gather(part, found)
