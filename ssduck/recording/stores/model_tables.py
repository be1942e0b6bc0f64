"""The DuckDB schema of a record: its description and the models of its entities."""

from __future__ import annotations

import json
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pyarrow as pa
from sqlglot import exp

from ssduck.errors import RecordError
from ssduck.recording.background_writer import NO_LOCK, CommitLock
from ssduck.recording.episode import Tags, new_id
from ssduck.recording.spec import Recording, description_of
from ssduck.recording.static_tables import model_rows
from ssduck.recording.stores.base import StoreConnection
from ssduck.recording.stores.descriptions import camera_text
from ssduck.recording.stores.history_sql import all_columns, create_table, quoted
from ssduck.recording.stores.stored_columns import check_columns, types_of, with_nulls
from ssduck.schema import MODELS, SQL_TYPES, ColumnType
from ssduck.simulators.scenes import Camera
from ssduck.world.layout import EntityInfo
from ssduck.world.snapshot import Snapshot

# The version of the format, and the table that has it.
VERSION = 1
ABOUT = "ssduck record"
# What is between the name of the world and the number of the episode in the name of a schema.
RUN_SCHEMA = "_record_"
# The types of columns by DuckDB's names.
_TYPES: dict[str, str] = {name: type for type, name in SQL_TYPES.items()}


@dataclass(frozen=True, eq=False)
class RecordFile:
    """A DuckDB file with records, which is attached to be read."""

    path: Path  # the file
    catalog: str  # the name under which it is attached
    tables: Collection[tuple[str, str]]  # the tables by their schemas and names; no view is one
    _checked: set[tuple[str, str]] = field(default_factory=set)

    @classmethod
    def of(cls, path: Path, catalog: str, connection: StoreConnection) -> RecordFile:
        """Returns an attached file."""
        file = exp.Literal.string(catalog).sql("duckdb")
        tables = connection.fetchall(
            "SELECT schema_name, table_name FROM duckdb_tables() "  # noqa: S608
            f"WHERE database_name = {file}"
        )
        return cls(path, catalog, dict.fromkeys((schema, table) for schema, table in tables))

    def schemas_with(self, table: str) -> list[str]:
        """Returns the schemas that have a table."""
        return [schema for schema, name in self.tables if name == table]

    def place(self, schema: str, table: str) -> str:
        """Returns a table in SQL."""
        return ".".join(map(quoted, (self.catalog, schema, table)))

    def check(
        self,
        connection: StoreConnection,
        schema: str,
        table: str,
        expected: Mapping[str, ColumnType],
    ) -> None:
        """Checks that a table is there and has its columns, once."""
        key = schema, table
        if key in self._checked:
            return
        source = f"{self.path}: {schema}.{table!r}"
        if key not in self.tables:
            raise RecordError(f"{source} is damaged: it is missing, or no table")
        described = connection.fetchall(f"DESCRIBE {self.place(schema, table)}")
        types = {name: _TYPES.get(kind, kind) for name, kind, *_ in described}
        check_columns(source, types.items(), expected)
        self._checked.add(key)

    def read(
        self,
        connection: StoreConnection,
        schema: str,
        table: str,
        expected: Mapping[str, ColumnType],
    ) -> pa.Table:
        """Returns the rows of a table with the columns that it is to have."""
        self.check(connection, schema, table, expected)
        listed = ", ".join(map(quoted, expected))
        return connection.rows(f"SELECT {listed} FROM {self.place(schema, table)}")  # noqa: S608


class ModelTables:
    """The schema of a record in DuckDB, with the models of its tables."""

    def __init__(
        self, schema: str, connection: StoreConnection, file: RecordFile | None = None
    ) -> None:
        self.schema = schema
        self._file = file
        self.connection = connection
        self._geometries: set[int] = set()
        self._about: dict[str, Any] = {}

    def create(
        self,
        world: str,
        recording: Recording,
        tags: Tags | None = None,
        camera: Camera | None = None,
        order: int = 0,
    ) -> None:
        """Creates the schema, a table that describes the record, and empty models."""
        about = {
            "version": VERSION,
            "world": world,
            "id": new_id(),
            "started": datetime.now(UTC).isoformat(timespec="seconds"),
            "recording": description_of(recording),
            "tags": dict(tags or {}),
            "order": order,
            "complete": False,
        }
        if camera is not None:
            about["camera"] = camera_text(camera)
        self._about = about
        self.connection.run(f"CREATE SCHEMA {quoted(self.schema)}")
        self.connection.insert_new(self.place(ABOUT), pa.table({"about": [json.dumps(about)]}))
        for table in MODELS.values():
            columns = {column.name: column.sql for column in table.model}
            self.connection.run(create_table(self._model_place(table.name), columns))

    def mark_as_complete(self) -> None:
        """Stores in the description of a new record that it is complete."""
        about, place = self._about | {"complete": True}, self.place(ABOUT)
        with self.transaction():
            self.connection.run(f"DELETE FROM {place}")  # noqa: S608
            self.connection.insert(place, pa.table({"about": [json.dumps(about)]}))

    def place(self, name: str) -> str:
        """Returns a table or view of the schema, in SQL."""
        if self._file is not None:
            return self._file.place(self.schema, name)
        return f"{quoted(self.schema)}.{quoted(name)}"

    def _model_place(self, table: str) -> str:
        return self.place(f"{table} model")

    @contextmanager
    def transaction(self, commit_lock: CommitLock = NO_LOCK) -> Iterator[None]:
        """Stores all of what is written in the context, or nothing; commits under the lock."""
        self.connection.run("BEGIN")
        try:
            yield
        except BaseException:
            self.connection.run("ROLLBACK")
            raise
        with commit_lock:
            self.connection.run("COMMIT")

    def insert(self, rows: Mapping[str, pa.Table], commit_lock: CommitLock = NO_LOCK) -> None:
        """Inserts rows into tables, by their names in SQL, all or nothing."""
        with self.transaction(commit_lock):
            for place, added in rows.items():
                if added.num_rows:
                    self.connection.insert(place, added)

    def add_members(
        self,
        members: Collection[EntityInfo],
        snapshot: Snapshot,
        *,
        with_visuals: bool = True,
    ) -> None:
        """Stores the models of entities (`ssduck.recording.stores.base.TickStore`)."""
        models = model_rows(members, snapshot, self._geometries, with_visuals=with_visuals)
        self.insert({self._model_place(table): rows for table, rows in models.items()})
        self._geometries |= set(models["geometries"]["id"].to_pylist())

    def rows(self) -> dict[str, pa.Table]:
        """Returns the stored rows of each model in a file."""
        file = self._file
        assert file is not None
        return {
            name: with_nulls(
                file.read(self.connection, self.schema, f"{name} model", types_of(table.model))
            )
            for name, table in MODELS.items()
        }

    def source(self, table: str) -> str:
        """Returns the rows of the model of a table, in SQL, after a check of those of a file."""
        place, model = self._model_place(table), MODELS[table].model
        if self._file is None:
            return place
        self._file.check(self.connection, self.schema, f"{table} model", types_of(model))
        return f"({all_columns(place, {column.name: column.sql for column in model})})"

    def views(self) -> dict[str, str]:
        """Returns the SELECT of the view of each model, by the name of the view."""
        return {
            table.model_view: f"SELECT * FROM {self.source(table.name)}"  # noqa: S608
            for table in MODELS.values()
        }

    def close(self, *, forget: bool) -> None:
        """Closes the connection; drops the schema first if `forget` is set."""
        if forget:
            self.connection.run(f"DROP SCHEMA {quoted(self.schema)} CASCADE")
        self.connection.close()
