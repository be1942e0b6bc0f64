"""Defines result forms: an `Adapter` makes the value after AS of a `Selection` of rows.

What several forms need is here, too: the sizes of values, the shapes of entities, and files.
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, BinaryIO, Literal, TypeAlias

from ssduck.errors import ArgumentError, LimitError
from ssduck.formatting import short_repr
from ssduck.geometry.solids import PlacedSolids
from ssduck.language import ast
from ssduck.language.clauses import Rows
from ssduck.language.operators import size_of
from ssduck.limits import Limits, UsageMeter
from ssduck.recording.stores.files import write_atomically
from ssduck.world.entities import Sensor
from ssduck.world.handles import Handle
from ssduck.world.world import World

_VARIADIC = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)
# The types of numbers, which a table does not make larger.
_NUMBERS = frozenset((bool, int, float, type(None)))
# The input of an adapter; `Adapter.needs` describes each.
Need: TypeAlias = Literal["rows", "columns", "entities", "query"]


class Selection:
    """The rows that a query selects, as an adapter sees them.

    All rows are of one tick, unless the query reads a range of ticks. With GROUP BY or CONNECT
    BY, an adapter gets one selection for each group or path, unless it joins groups.

    Args:
        read: returns at most the given number of rows, all of them for None.
        query: the query.
        worlds: returns the worlds of the query, each at its tick.
        meter: the use of the program's limits.
    """

    def __init__(
        self,
        read: Callable[[int | None], Rows],
        query: ast.Query,
        worlds: Callable[[], Sequence[World]],
        meter: UsageMeter,
    ) -> None:
        self._meter = meter
        self._read = read
        self._worlds = worlds
        self._rows: Rows | None = None
        self.query = query

    def read(self) -> Rows:
        """Returns the rows with the names of their columns; the first call runs the query."""
        if self._rows is None:
            self._rows = self._read(None)
        return self._rows

    def close(self) -> None:
        """Refuses further reading: rows read later would be of another tick."""
        self._read = _refuse_reading

    @property
    def limits(self) -> Limits:
        """The limits of the program."""
        return self._meter.limits

    def check_time(self) -> None:
        """Checks that the program has time left; an adapter that takes long calls it now and then.

        Raises:
            LimitError: the time is up.
        """
        self._meter.check_time()

    def charge(self, size: int) -> None:
        """Counts the size of what the form makes beside its rows.

        Args:
            size: bytes, roughly.

        Raises:
            LimitError: all values that the program has made take too much memory.
        """
        self._meter.charge(size)

    def check_size(self, count: float, what: str, *, per_second: float, bytes_each: float) -> None:
        """Checks that a form of so many parts can be made within the limits of time and memory.

        Args:
            count: the number of parts.
            what: how many and what they are, for the message.
            per_second: how many are made in a second on a slow machine.
            bytes_each: the memory of each while they are made.

        Raises:
            LimitError: there are too many.
        """
        limits, most = self.limits, math.inf
        if limits.seconds is not None:
            most = limits.seconds * per_second
        if limits.memory is not None:
            most = min(most, limits.memory / bytes_each)
        if count > most:
            raise LimitError(
                f"{what} are more than {most:,.0f}, which the limits of time and memory allow"
            )

    @property
    def timed_rows(self) -> list[tuple[Any, ...]]:
        """The rows for a text: going through them checks the time, and counts their texts."""
        limits = self.limits
        if limits.seconds is None and limits.memory is None:
            return self.rows
        return _TimedRows(self.rows, self._meter)

    @property
    def copied_rows(self) -> list[tuple[Any, ...]]:
        """The rows for a table that copies their values, which are counted."""
        if self.limits.memory is not None:
            for column in zip(*self.rows, strict=True):
                if not _NUMBERS.issuperset(map(type, column)):
                    self._meter.charge(sum(map(size_of, column)))
        return self.rows

    @property
    def rows(self) -> list[tuple[Any, ...]]:
        """The rows in order, each a tuple with a value for each column."""
        return self.read().values

    def head(self, count: int) -> list[tuple[Any, ...]]:
        """Returns at most `count` rows from the beginning; further rows are not computed for it."""
        return (self._read(count) if self._rows is None else self._rows).values[:count]

    @property
    def columns(self) -> tuple[str, ...]:
        """The names of the columns.

        Raises:
            ArgumentError: `to` gives a column different names in different rows.
        """
        names = self.read().names
        if not isinstance(names, list):
            return names
        if len(set(names)) > 1:
            raise ArgumentError(f"the columns' names differ from row to row: {names[0]}, …")
        return names[0] if names else ()

    @cached_property
    def entities(self) -> list[Handle]:
        """The entities in the rows and in lists in them, each once, in order of appearance.

        If the query reads a range of ticks, each entity appears once for each tick.
        """
        entities: dict[tuple[Handle, int | None], Handle] = {}
        for row in self.rows:
            _collect_entities(row, entities)
        return list(entities.values())

    @property
    def worlds(self) -> list[World]:
        """The worlds of the query, each at the tick of the query.

        Raises:
            ArgumentError: the entities belong to several ticks of a world.
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
        """The only world of the query, at the tick of the query.

        Raises:
            ArgumentError: the query has no world, several worlds, or several ticks of one.
        """
        worlds = self.worlds
        if len(worlds) != 1:
            names = ", ".join(world.name for world in worlds) or "none"
            raise ArgumentError(f"this needs entities of one world; those of the query: {names}")
        return worlds[0]

    @property
    def tick(self) -> int:
        """The tick number of `world`."""
        return self.world.snapshot.number

    @property
    def time(self) -> float:
        """The simulated time of `world`, s."""
        return self.world.time


class _TimedRows(list[tuple[Any, ...]]):
    """Rows that check the time while one iterates over them, and count the sizes of values."""

    def __init__(self, rows: list[tuple[Any, ...]], meter: UsageMeter) -> None:
        super().__init__(rows)
        self._meter = meter

    def __iter__(self) -> Iterator[tuple[Any, ...]]:
        for row in super().__iter__():
            self._meter.charge(sum(map(size_of, row)))
            yield row


@dataclass(frozen=True)
class Adapter:
    """A result form: the name after AS and the function that makes a value of the rows.

    Attributes:
        names: the names of the form in programs.
        help: a description of the value in one or two sentences.
        make: a function of the selection and the arguments after AS; returns the value.
        needs: the input. `"rows"`: all rows; `"columns"`: all rows, and column names that
            differ; `"entities"`: all rows, with at least one entity if there are rows;
            `"query"`: nothing in advance, rows are read when `make` asks for them.
        select: replaces the query by another one before it runs; None runs the query itself.
        writes: whether the form writes a file, which `Limits` may forbid.
        tables: the tables of a tick, beside `entities`, that the form reads.
        joins_groups: whether GROUP BY gives one value of the rows of all groups, instead of a dict.
    """

    names: tuple[str, ...]
    help: str
    make: Callable[..., Any]
    needs: Need = "rows"
    select: Callable[[ast.Query], ast.Query] | None = None
    writes: bool = False
    tables: frozenset[str] = frozenset()
    joins_groups: bool = False

    @cached_property
    def signature(self) -> inspect.Signature:
        """The signature of `make`; the first parameter is the selection."""
        return inspect.signature(self.make)

    @cached_property
    def is_plain(self) -> bool:
        """Whether the form can do without arguments."""
        _, *parameters = self.signature.parameters.values()
        return all(p.default is not p.empty or p.kind in _VARIADIC for p in parameters)

    @property
    def usage(self) -> str:
        """The usage line of the help: `AS name(arguments)`."""
        _, *parameters = self.signature.parameters.values()
        plain = [p.replace(annotation=inspect.Parameter.empty) for p in parameters]
        arguments = ", ".join(map(str, plain))
        return f"AS {' | '.join(self.names)}" + (f"({arguments})" if arguments else "")


def form(*names: str, help: str = "", **settings: Any) -> Callable[[Callable[..., Any]], Adapter]:
    """Makes a function a built-in form of some names; the docstring is its help by default."""
    return lambda make: Adapter(names, help or inspect.getdoc(make) or "", make, **settings)


def _refuse_reading(_: int | None) -> Rows:
    raise ArgumentError("the query has ended; a form must read its rows before it returns")


def _collect_entities(value: Any, entities: dict[tuple[Handle, int | None], Handle]) -> None:
    if isinstance(value, Handle):
        tick = None if value.moment is None else value.moment.tick
        entities.setdefault((value, tick), value)
    elif isinstance(value, list | tuple):
        for part in value:
            _collect_entities(part, entities)


# A simulation of its own takes so much at least, bytes.
WORLD_BYTES = 10_000_000
# A node or an edge of a graph, with its attributes, and a pixel of a picture, bytes.
_NODE_BYTES, _PIXEL_BYTES = 500, 4
# The types of values that are counted elsewhere.
_COUNTED = (type(None), str, int, float, list, tuple, dict, Handle)


def made_bytes(value: Any) -> int:
    """Returns the memory of a world, array, table, grid, mesh, picture or graph, bytes, roughly.

    Of other values, whose texts and lists are counted elsewhere, it is 0.
    """
    if isinstance(value, _COUNTED):
        return 0
    if isinstance(value, World):
        return WORLD_BYTES
    arrays = [getattr(value, name, None) for name in ("cells", "points", "normals", "owners")]
    if isinstance(geometry := getattr(value, "geometry", None), dict):  # of trimesh
        arrays += [getattr(mesh, name, None) for mesh in geometry.values() for name in _OF_MESH]
    size = sum(int(getattr(array, "nbytes", 0)) for array in [value, *arrays])
    if callable(measure := getattr(value, "memory_usage", None)):  # of pandas
        size += int(measure().sum())
    if callable(measure := getattr(value, "estimated_size", None)):  # of polars
        size += int(measure())
    if callable(count := getattr(value, "number_of_nodes", None)):  # of networkx
        size += _NODE_BYTES * (count() + value.number_of_edges())
    if isinstance(width := getattr(value, "width", None), int):  # of Pillow
        size += _PIXEL_BYTES * width * int(getattr(value, "height", 0))
    return size


_OF_MESH = ("vertices", "faces")


# The table that these result forms read.
SHAPES = frozenset(("shapes",))


def shapes_of(selection: Selection) -> PlacedSolids:
    """Returns the shapes of the selected entities at the tick of the query; sensors have none."""
    entities = [entity for entity in selection.entities if not isinstance(entity, Sensor)]
    if not entities:
        return PlacedSolids.empty()
    return placed_shapes(selection.world, entities)


def placed_shapes(world: World, entities: Sequence[Handle]) -> PlacedSolids:
    """Returns the shapes of entities at the tick of their world."""
    for entity in entities:
        if not entity.is_there:
            raise entity.removed()
    world.request_tables(("shapes",))
    shapes = world.snapshot.shapes()
    ids = [entity.id for entity in entities]
    for id in shapes.unknown(ids)[:1]:
        name = world.handle(id).full_name
        raise ArgumentError(f"{name!r}: the pose is not a number; exclude the entity by WHERE")
    return shapes.placed(ids)


def check_file(selection: Selection, file: Any) -> Path:
    """Returns the path of the file that a query writes."""
    query = selection.query
    if query.group or query.recursion is not None:
        raise ArgumentError(
            "each group or path would replace the file of the previous one; select without "
            "GROUP BY or CONNECT BY"
        )
    if not isinstance(file, str) or not _is_path(file):
        raise ArgumentError(f"the file must be a path in quotes, not {short_repr(file)}")
    return Path(file)


def _is_path(file: str) -> bool:
    """Checks whether a file can have the path."""
    try:
        file.encode()
    except UnicodeEncodeError:
        return False
    return "\0" not in file and bool(Path(file).name)


def replace_file(path: Path, write: Callable[[BinaryIO], object]) -> None:
    """Writes a file, all or nothing, in place of one that exists."""

    def write_to(temporary: Path) -> None:
        with temporary.open("wb") as stream:
            write(stream)

    try:
        write_atomically(path, write_to)
    except OSError as error:
        raise ArgumentError(f"{path}: {error.strerror or error}") from error
