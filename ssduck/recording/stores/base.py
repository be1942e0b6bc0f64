"""Defines the interfaces of stores of recorded ticks: `TickStore` writes rows, `TickArchive` reads.

A store in memory or in DuckDB implements both. A folder of Parquet files has a class for each,
since a file is read only when it is complete.

Times and orders. The numbers of ticks ascend, and their simulated times, in seconds, never fall;
several ticks may have the same time. The rows of a tick are stored together, in all of its tables
at once, after the rows of earlier ticks. Within a table, the rows of a tick are in any order.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, TypeAlias

import pyarrow as pa

from ssduck.recording.background_writer import NO_LOCK, CommitLock
from ssduck.recording.spec import Recording
from ssduck.recording.static_tables import IdProvider
from ssduck.schema import POSE
from ssduck.world.layout import EntityInfo


class VisibleRows(Protocol):
    """Rows in memory that DuckDB reads in place."""

    @property
    def version(self) -> int:
        """A number that changes whenever `arrow` becomes another object; see `new_version`."""

    @property
    def arrow(self) -> pa.Table:
        """The rows."""


# Returns the names of the DuckDB views of the buffered rows of a table.
BufferViews: TypeAlias = Callable[[str], Sequence[str]]


@dataclass(frozen=True)
class PairRequest:
    """A request for pairs of entities whose boxes are near each other, at some ticks.

    Attributes:
        first: the first tick.
        last: the last tick.
        a: the id of the first entity; 0 for any.
        b: the id of the second entity; 0 for any.
        max_gap: the largest gap between their boxes along each axis, m.
    """

    first: int
    last: int
    a: int
    b: int
    max_gap: float


# The columns of the result: a tick, two entities, and the pose of each.
PAIR_COLUMNS = ("tick", "a", "b", *(f"{side}_{name}" for side in "ab" for name in POSE))


class TickStore(ABC):
    """A store that the rows of recorded ticks are written to.

    Threads. One thread writes at a time: that of the `BackgroundWriter`, or the one that flushes.
    `add_members`, `add` and `drop_before` are never called concurrently. Other threads read rows
    meanwhile; they hold the lock that `commit_lock` takes, so that they see each row exactly once,
    either buffered or stored.

    Attributes:
        recording: what is recorded of each tick.
        tables: the tables whose rows are stored, `ticks` among them.
        is_in_place: whether `add` keeps the given buffers, in next to no time; rows are then stored
            at once, in the thread that steps the world.
        visible_rows: the stored rows that DuckDB reads from memory, by table.
    """

    recording: Recording
    tables: tuple[str, ...]
    is_in_place: bool = False
    visible_rows: tuple[Mapping[str, VisibleRows], ...] = ()

    @abstractmethod
    def add_members(self, members: Collection[EntityInfo], id_provider: IdProvider) -> None:
        """Stores the models of entities, all or nothing, before any row of theirs.

        Args:
            members: entities that were not stored before.
            id_provider: gives the numbers of their run and of their geometries.

        Raises:
            RecordError: a folder cannot be written.
            SqlError: a database cannot be written.
        """

    @abstractmethod
    def add(self, rows: Mapping[str, pa.Table], commit_lock: CommitLock = NO_LOCK) -> None:
        """Stores the rows of whole ticks, all or nothing.

        When it returns, the rows are on the disk in a folder, or committed in a database. When it
        raises, none of them is stored, and the caller keeps them.

        Args:
            rows: the rows of each of `tables`, by ascending tick, later than all stored ones.
            commit_lock: is held while the rows become readable.

        Raises:
            RecordError: a folder cannot be written.
            SqlError: a database cannot be written.
        """

    def append(self, rows: Mapping[str, pa.Table], commit_lock: CommitLock = NO_LOCK) -> None:
        """Stores the rows of whole ticks as `add` does, though in a form that few rows may have.

        A folder has them in a log until they are enough for a part.
        """
        self.add(rows, commit_lock)

    def complete(self) -> None:  # noqa: B027  # most stores have one form only
        """Gives appended rows the form of added ones.

        Raises:
            RecordError: a folder cannot be written; the rows remain as they were appended.
        """

    def finish(self) -> None:  # noqa: B027  # a record in memory ends with the process
        """Marks the record as complete: its recorder was not killed.

        Raises:
            RecordError: a folder cannot be written.
            SqlError: a database cannot be written.
        """

    def drop_before(self, tick: int) -> int:  # noqa: ARG002  # a folder keeps all ticks
        """Drops rows of ticks before a number, as far as whole parts are older.

        Drops the oldest parts as well while the rows exceed `recording.max_bytes`.

        Returns:
            The first tick that is still stored, or any before it: 0 if nothing is ever dropped.
        """
        return 0


class TickArchive(ABC):
    """Recorded ticks that can be read: the stored rows, without the buffered ones.

    The caller holds the world that was recorded, so that nothing is dropped meanwhile.

    Attributes:
        recording: what was recorded of each tick.
        tables: the tables that have rows, `ticks` among them.
        visible_rows: the stored rows that DuckDB reads from memory, by table.
        has_single_links: whether bodies of one link have rows in the table of links.
    """

    has_single_links: bool = False
    recording: Recording
    tables: tuple[str, ...]
    visible_rows: tuple[Mapping[str, VisibleRows], ...] = ()
    _connection: StoreConnection

    @abstractmethod
    def select(self, table: str, buffer_views: BufferViews | None) -> str | None:
        """Returns the SELECT of the view of a table's history; None if it is not recorded.

        Args:
            table: a table of a world.
            buffer_views: names the views of the buffered rows; None if there are none.
        """

    def check(self, table: str, ticks: tuple[int, int] | None = None) -> None:  # noqa: B027
        """Checks the bytes of the files that SQL reads of a table, each once.

        Args:
            table: a table of a world.
            ticks: the first and the last tick that a statement reads; None for all.
        """

    def has_groups(self, table: str) -> bool:  # noqa: ARG002
        """Checks whether a statement about some ticks reads some files of a table only."""
        return False

    @abstractmethod
    def models(self) -> dict[str, str]:
        """Returns the SELECT of the view of each model, by the name of the view."""

    @abstractmethod
    def fetch(self, table: str, first: int, last: int) -> pa.Table:
        """Returns the rows of a table at the ticks from first to last, both included.

        Their columns are `schema.TickColumns.names`. The rows are in any order; unknown numbers are
        NULL or NaN. For `links`, those of bodies of one link may be left out.
        """

    @abstractmethod
    def near_pairs(self, request: PairRequest, buffered: pa.Table | None) -> pa.Table:
        """Returns the pairs of entities whose boxes are near at a tick, or unknown.

        Args:
            request: selects the pairs.
            buffered: the buffered rows of `entities`; None if there are none.

        Returns:
            `PAIR_COLUMNS`, sorted by tick; each pair in both orders unless the request selects one.
        """

    def close(self, *, forget: bool) -> None:  # noqa: ARG002  # files are kept
        """Closes the connection; drops the stored ticks first if `forget` is set."""
        self._connection.close()


class StoreConnection(Protocol):
    """A store's own connection to DuckDB."""

    def run(self, sql: str) -> None:
        """Runs a statement."""

    def insert(self, place: str, rows: pa.Table) -> None:
        """Inserts rows into a table, by the names of its columns."""

    def insert_new(self, place: str, rows: pa.Table) -> None:
        """Creates a table from rows."""

    def rows(
        self,
        sql: str,
        parameters: Sequence[Any] = (),
        tables: Mapping[str, pa.Table] | None = None,
    ) -> pa.Table:
        """Returns all rows of a SELECT, which may read the given tables."""

    def fetchall(self, sql: str) -> list[tuple[Any, ...]]:
        """Returns all rows of a SELECT as tuples."""

    def checkpoint(self) -> None:
        """Moves stored rows from the log to the file if there are many; reading goes on."""

    def close(self) -> None:
        """Closes the connection."""
