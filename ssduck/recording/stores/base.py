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
from ssduck.schema import POSE
from ssduck.world.layout import EntityInfo
from ssduck.world.snapshot import Snapshot


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
    """A request for pairs of entities whose boxes are near each other, at some ticks."""

    first: int  # the first tick
    last: int  # the last tick
    a: int  # the id of the first entity; 0 for any
    b: int  # the id of the second entity; 0 for any
    max_gap: float  # the largest gap between their boxes along each axis, m


# The columns of the result: a tick, two entities, and the pose of each.
PAIR_COLUMNS = ("tick", "a", "b", *(f"{side}_{name}" for side in "ab" for name in POSE))


class TickStore(ABC):
    """A store that the rows of recorded ticks are written to.

    Threads. One thread writes at a time: that of the `BackgroundWriter`, or the one that flushes.
    `add_members`, `add` and `drop_before` are never called concurrently. Other threads read rows
    meanwhile; they hold the lock that `commit_lock` takes, so that they see each row exactly once,
    either buffered or stored. What cannot be written is a RecordError of a folder, or a SqlError of
    a database.
    """

    recording: Recording  # what is recorded of each tick
    tables: tuple[str, ...]  # the tables whose rows are stored, `ticks` among them
    # whether `add` keeps the given buffers, in next to no time; rows are then stored at once, in
    # the thread that steps the world
    is_in_place: bool = False
    # the stored rows that DuckDB reads from memory, by table
    visible_rows: tuple[Mapping[str, VisibleRows], ...] = ()

    @abstractmethod
    def add_members(self, members: Collection[EntityInfo], snapshot: Snapshot) -> None:
        """Stores the models of new entities, all or nothing, before any row of theirs."""

    @abstractmethod
    def add(self, rows: Mapping[str, pa.Table], commit_lock: CommitLock = NO_LOCK) -> None:
        """Stores the rows of whole ticks, all or nothing.

        When it returns, the rows are on the disk in a folder, or committed in a database. When it
        raises, none of them is stored, and the caller keeps them.

        Args:
            rows: the rows of each of `tables`, by ascending tick, later than all stored ones.
            commit_lock: is held while the rows become readable.
        """

    def append(self, rows: Mapping[str, pa.Table], commit_lock: CommitLock = NO_LOCK) -> None:
        """Stores the rows of whole ticks as `add` does, though in a form that few rows may have.

        A folder has them in a log until they are enough for a part.
        """
        self.add(rows, commit_lock)

    def complete(self) -> None:  # noqa: B027  # most stores have one form only
        """Gives appended rows the form of added ones."""

    def finish(self) -> None:  # noqa: B027  # a record in memory ends with the process
        """Marks the record as complete: its recorder was not killed."""

    def drop_before(self, tick: int) -> int:  # noqa: ARG002  # a folder keeps all ticks
        """Drops rows of ticks before a number, as far as whole parts are older.

        Drops the oldest parts as well while the rows exceed `recording.max_bytes`. Returns the
        first tick that is still stored, or any before it: 0 if nothing is ever dropped.
        """
        return 0


class TickArchive(ABC):
    """Recorded ticks that can be read: the stored rows, without the buffered ones.

    The caller holds the world that was recorded, so that nothing is dropped meanwhile.
    """

    recording: Recording  # what was recorded of each tick
    tables: tuple[str, ...]  # the tables that have rows, `ticks` among them
    # the stored rows that DuckDB reads from memory, by table
    visible_rows: tuple[Mapping[str, VisibleRows], ...] = ()
    _connection: StoreConnection

    @abstractmethod
    def select(self, table: str, buffer_views: BufferViews | None) -> str | None:
        """Returns the SELECT of the view of a table's history; None if it is not recorded."""

    def check(self, table: str, ticks: tuple[int, int] | None = None) -> None:  # noqa: B027
        """Checks the bytes of the files that SQL reads of a table at some ticks, each once."""

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

        These are `PAIR_COLUMNS`, sorted by tick; each pair in both orders unless the request
        selects one. The buffered rows of `entities` are in memory.
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
