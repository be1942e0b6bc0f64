"""Stores what entities are in a DuckDB schema of a record: the models of its tables."""

from __future__ import annotations

import json
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict
from datetime import UTC, datetime

import pyarrow as pa

from ssduck.recording.background_writer import WHENEVER, Cut
from ssduck.recording.spec import Recording
from ssduck.recording.static_tables import ShapeNumbers, default_values, model_rows
from ssduck.recording.stores.base import StoreConnection
from ssduck.recording.stores.history_sql import all_columns, create_table, quoted
from ssduck.schema import MODELS
from ssduck.world.layout import EntityInfo

# The version of what is stored, and the table that tells it.
VERSION = 1
ABOUT = "ssduck record"


class ModelTables:
    """The schema of a record in DuckDB, with the models of its tables.

    Args:
        schema: its name.
        connection: a connection of its own.
        catalog: of the attached file that has the schema; None for the database itself.
    """

    def __init__(
        self, schema: str, connection: StoreConnection, catalog: str | None = None
    ) -> None:
        self.schema = schema
        self._catalog = catalog
        self.connection = connection
        self._geometries: set[int] = set()
        self._is_new = False
        # Of an older record: a SELECT of all columns of each model.
        self._completed: dict[str, str] = {}

    def create(self, world: str, recording: Recording) -> None:
        """Makes the schema, a table that tells what is recorded, and empty models."""
        about = {
            "version": VERSION,
            "world": world,
            "started": datetime.now(UTC).isoformat(timespec="seconds"),
            "recording": asdict(recording),
        }
        self._is_new = True
        self.connection.run(f"CREATE SCHEMA {quoted(self.schema)}")
        self.connection.insert_new(self.place(ABOUT), pa.table({"about": [json.dumps(about)]}))
        for table in MODELS.values():
            columns = {column.name: column.sql for column in table.model}
            self.connection.run(create_table(self._place_of(table.name), columns))

    def place(self, name: str) -> str:
        """A table or view of the schema, in SQL."""
        where = (self.schema,) if self._catalog is None else (self._catalog, self.schema)
        return ".".join(map(quoted, (*where, name)))

    def _place_of(self, table: str) -> str:
        return self.place(f"{table} model")

    @contextmanager
    def transaction(self, cut: Cut = WHENEVER) -> Iterator[None]:
        """Stores what is written in it together, or not at all; commits in the cut."""
        self.connection.run("BEGIN")
        try:
            yield
        except BaseException:
            self.connection.run("ROLLBACK")
            raise
        with cut:
            self.connection.run("COMMIT")

    def insert(self, rows: Mapping[str, pa.Table], cut: Cut = WHENEVER) -> None:
        """Adds rows to tables, by their places, all or none of them."""
        with self.transaction(cut):
            for place, own in rows.items():
                if own.num_rows:
                    self.connection.insert(place, own)

    def add_members(self, members: Collection[EntityInfo], numbers: ShapeNumbers) -> None:
        """Stores the models of entities (`ssduck.recording.stores.base.TickStore`)."""
        models = model_rows(members, numbers, self._geometries)
        self.insert({self._place_of(table): rows for table, rows in models.items()})
        self._geometries |= set(models["geometries"]["id"].to_pylist())

    def rows(self) -> dict[str, pa.Table]:
        """The stored rows of each model, with the columns that they have."""
        return {
            table: self.connection.rows(f"SELECT * FROM {self._place_of(table)}")  # noqa: S608
            for table in MODELS
        }

    def source(self, table: str, run: int | None) -> str:
        """The rows of a model, in SQL, with all its columns.

        Args:
            table: the table that it is of.
            run: the number of the run, for an older record that lacks it.
        """
        place = self._place_of(table)
        if self._is_new:
            return place
        if table not in self._completed:
            present = self.connection.rows(f"SELECT * FROM {place} LIMIT 0").column_names  # noqa: S608
            missing = default_values(run, self._place_of("geometries"))
            columns = {column.name: column.sql for column in MODELS[table].model}
            self._completed[table] = f"({all_columns(place, columns, present, missing)})"
        return self._completed[table]

    def close(self, *, forget: bool) -> None:
        """Closes the connection; drops the schema first, if it is to be forgotten."""
        if forget:
            self.connection.run(f"DROP SCHEMA {quoted(self.schema)} CASCADE")
        self.connection.close()
