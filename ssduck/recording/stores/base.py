"""Declares what a store of recorded ticks does: `TickStore` takes rows, `TickArchive` gives them.

A store in memory or in DuckDB is both. A folder of Parquet files is written by the one and read by
the other, since a file is read when it is complete.

Times and orders. Ticks have numbers that ascend and simulated times, in seconds, that never fall;
several ticks may be of one time. The rows of a tick come together, all of its tables at once, and
the rows of earlier ticks come first. Within a table, the rows of a tick are in any order.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, TypeAlias

import pyarrow as pa

from ssduck.recording.background_writer import WHENEVER, Cut
from ssduck.recording.spec import Recording
from ssduck.recording.static_tables import ShapeNumbers
from ssduck.schema import POSE
from ssduck.world.layout import EntityInfo


class VisibleRows(Protocol):
    """Rows that DuckDB reads from where they are in memory.

    Attributes:
        version: counts up whenever `arrow` becomes another object.
    """

    version: int

    @property
    def arrow(self) -> pa.Table:
        """The rows."""


# Gives the names of the DuckDB views that hold the rows of a table that are not stored.
Waiting: TypeAlias = Callable[[str], Sequence[str]]


@dataclass(frozen=True)
class PairRequest:
    """A request for pairs of entities whose boxes are near, at some ticks.

    Attributes:
        first: the first tick.
        last: the last tick.
        a: the id of the one entity; 0 for any.
        b: the id of the other; 0 for any.
        apart: how far apart their boxes may be along each axis, m.
    """

    first: int
    last: int
    a: int
    b: int
    apart: float


# The columns of the answer: a tick, two entities, and the pose of each.
PAIR_COLUMNS = ("tick", "a", "b", *(f"{side}_{name}" for side in "ab" for name in POSE))


class TickStore(ABC):
    """A store that takes the rows of recorded ticks.

    Threads. At any time one thread writes: that of the `BackgroundWriter`, or the one that flushes.
    `add_members`, `add` and `drop_before` are never called at the same time. Rows are read by other
    threads meanwhile; these hold the lock that `cut` takes, so that no row is read both as waiting
    and as stored, or as neither.

    Attributes:
        recording: what is recorded of each tick.
        tables: the tables whose rows are stored, `ticks` among them.
        is_in_place: whether `add` keeps the given buffers and takes next to no time; rows are then
            stored at once, in the thread that ticks.
        visible_rows: the stored rows that DuckDB reads from memory, by table.
    """

    recording: Recording
    tables: tuple[str, ...]
    is_in_place: bool = False
    visible_rows: tuple[Mapping[str, VisibleRows], ...] = ()

    @abstractmethod
    def add_members(self, members: Collection[EntityInfo], numbers: ShapeNumbers) -> None:
        """Stores the models of entities, all or nothing, before any row of theirs.

        Args:
            members: entities that were not stored before.
            numbers: gives the numbers of their run and of their geometries.

        Raises:
            RecordError: a folder cannot be written.
            SqlError: a database cannot be written.
        """

    @abstractmethod
    def add(self, rows: Mapping[str, pa.Table], cut: Cut = WHENEVER) -> None:
        """Stores the rows of whole ticks, all or nothing.

        When it returns, the rows are as safe as the store makes them: on the disk in a folder,
        committed in a database. When it raises, none of them is stored, and the caller keeps them.

        Args:
            rows: of each of `tables`, ticks ascending, later than all that were stored before.
            cut: is entered for the moment in which the rows become readable.

        Raises:
            RecordError: a folder cannot be written.
            SqlError: a database cannot be written.
        """

    @abstractmethod
    def drop_before(self, tick: int) -> int:
        """Drops rows of ticks before a number, as far as whole parts are older.

        Returns:
            The first tick that is stored still, or any before it: 0 if nothing is ever dropped.
        """


class TickArchive(ABC):
    """Recorded ticks that can be read: the rows that are stored, those that wait left out.

    The caller holds the world that was recorded, so that nothing is dropped meanwhile.

    Attributes:
        recording: what was recorded of each tick.
        tables: the tables that have rows, `ticks` among them.
        unrecorded_run: the number of the run, where the rows of an old record do not have it.
    """

    recording: Recording
    tables: tuple[str, ...]
    unrecorded_run: int | None = None

    @abstractmethod
    def select(self, table: str, waiting: Waiting | None) -> str | None:
        """The SELECT of the view of a table's history; None for a table that is not recorded.

        Args:
            table: a table of a world.
            waiting: names the views of the rows that are not stored; None if there are none.
        """

    @abstractmethod
    def models(self) -> dict[str, str]:
        """The SELECT of the view of each model, by the name of the view."""

    @abstractmethod
    def fetch(self, table: str, first: int, last: int) -> pa.Table:
        """The rows of a table at the ticks from first to last, both included.

        Their columns are `schema.TickColumns.names`, in any order of rows; unknown numbers are
        NULL or NaN. For `links`, those of bodies of one link may be left out.
        """

    @abstractmethod
    def near(self, request: PairRequest, waiting: pa.Table | None) -> pa.Table:
        """The pairs of entities whose boxes are near at a tick, or unknown, by tick.

        Args:
            request: which pairs.
            waiting: rows of `entities` that are not stored; None if there are none.

        Returns:
            `PAIR_COLUMNS`, each pair both ways unless the request says otherwise.
        """

    @abstractmethod
    def close(self, *, forget: bool) -> None:
        """Releases the connection; drops the stored ticks, too, if they are to be forgotten."""


class StoreConnection(Protocol):
    """A connection to DuckDB of a store's own."""

    def run(self, sql: str) -> None:
        """Runs a statement."""

    def insert(self, place: str, rows: pa.Table) -> None:
        """Adds rows to a table, by the names of its columns."""

    def insert_new(self, place: str, rows: pa.Table) -> None:
        """Makes a table of rows."""

    def rows(
        self,
        sql: str,
        parameters: Sequence[Any] = (),
        tables: Mapping[str, pa.Table] | None = None,
    ) -> pa.Table:
        """All rows of a SELECT, which may read the given tables."""

    def fetchall(self, sql: str) -> list[tuple[Any, ...]]:
        """All rows of a SELECT, as tuples."""

    def settle(self) -> None:
        """Tidies up after writing, if there is reason and room to; reading goes on meanwhile."""

    def close(self) -> None:
        """Closes the connection."""
