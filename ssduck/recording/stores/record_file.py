"""Reads records in a DuckDB file, as data: from base tables only.

A file may come from a stranger. A view in the place of a table would run what it says, and so would
a column that is computed; one with a collation may be equal to texts that it does not have. So each
table is checked before it is read.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import pyarrow as pa
from sqlglot import exp

from ssduck.errors import RecordError
from ssduck.limits import check_opening
from ssduck.recording.stores.base import StoreConnection
from ssduck.recording.stores.history_sql import quoted
from ssduck.recording.stores.stored_columns import check_columns
from ssduck.schema import SQL_TYPES, ColumnType

# What the text of a table has that computes a column, or has texts compared in another way.
_OF_STRANGERS = re.compile(r"\bGENERATED\s+ALWAYS\b|\bCOLLATE\b", re.IGNORECASE)
# Names and texts in it, which may have any words.
_QUOTED = re.compile(r'"(?:[^"]|"")*"|\'(?:[^\']|\'\')*\'')
# The types of columns by DuckDB's names: those of texts are not all compared as texts.
_TYPES: dict[str, str] = {name: type for type, name in SQL_TYPES.items()}
# So much of the name of another type is shown: that of an enumeration has all of its values.
_LONGEST = 60


@dataclass(frozen=True, eq=False)
class RecordFile:
    """A DuckDB file with records, which is attached to be read.

    Attributes:
        path: the file.
        catalog: the name under which it is attached.
        tables: the base tables whose columns are all stored and have no collation, by their schemas
            and names.
    """

    path: Path
    catalog: str
    tables: Collection[tuple[str, str]]
    _checked: set[tuple[str, str]] = field(default_factory=set)

    @classmethod
    def of(cls, path: Path, catalog: str, connection: StoreConnection) -> RecordFile:
        """Returns an attached file."""
        file = exp.Literal.string(catalog).sql("duckdb")
        tables = connection.fetchall(
            "SELECT schema_name, table_name, sql FROM duckdb_tables() "  # noqa: S608
            f"WHERE database_name = {file}"
        )
        stored = {
            (schema, table): None
            for schema, table, text in tables
            if _OF_STRANGERS.search(_QUOTED.sub("", str(text))) is None
        }
        return cls(path, catalog, stored)

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
        """Checks a table, once."""
        key = schema, table
        if key not in self._checked:
            check_opening()
            place, source = self.place(schema, table), f"{self.path}: {schema}.{table!r}"
            if key not in self.tables:
                raise RecordError(
                    f"{source} is damaged: it is missing, or no table whose columns are stored and "
                    "have no collation"
                )
            described = connection.fetchall(f"DESCRIBE {place}")
            types = {name: _TYPES.get(kind, kind[:_LONGEST]) for name, kind, *_ in described}
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
