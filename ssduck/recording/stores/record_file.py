"""Reads records in a DuckDB file, as data: from base tables only.

A file may come from a stranger. A view in the place of a table would run what it says, and so would
a column that is computed; one with a collation may be equal to texts that it does not have. A table
may have any columns, and a file of a few bytes any number of rows. So each table is checked before
it is read.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import pyarrow as pa
from sqlglot import exp

from ssduck.errors import RecordError
from ssduck.limits import check_opening
from ssduck.recording.stores.base import StoreConnection
from ssduck.recording.stores.history_sql import quoted
from ssduck.recording.stores.stored_columns import MAX_VALUES, check_columns
from ssduck.schema import SQL_TYPES, ColumnType

# What the text of a table has that computes a column, or has texts compared in another way.
_OF_STRANGERS = re.compile(r"\bGENERATED\s+ALWAYS\b|\bCOLLATE\b", re.IGNORECASE)
# Names and texts in it, which may have any words.
_QUOTED = re.compile(r'"(?:[^"]|"")*"|\'(?:[^\']|\'\')*\'')
# The types of columns by DuckDB's names: those of texts are not all compared as texts.
_TYPES: dict[str, str] = {name: type for type, name in SQL_TYPES.items()}
# So much of the name of another type is shown: that of an enumeration has all of its values.
_LONGEST = 60
# The largest number of rows that rows stand for which are not stored again while they are equal.
_MAX_REPEATED = 1 << 36


@dataclass(frozen=True, eq=False)
class RecordFile:
    """A DuckDB file with records, which is attached to be read.

    Attributes:
        path: the file.
        catalog: the name under which it is attached.
        rows: the number of rows of each base table whose columns are all stored and have no
            collation, by its schema and its name.
    """

    path: Path
    catalog: str
    rows: Mapping[tuple[str, str], int]
    _checked: set[tuple[str, str]] = field(default_factory=set)

    @classmethod
    def of(cls, path: Path, catalog: str, connection: StoreConnection) -> RecordFile:
        """Returns an attached file."""
        file = exp.Literal.string(catalog).sql("duckdb")
        tables = connection.fetchall(
            "SELECT schema_name, table_name, estimated_size, sql FROM duckdb_tables() "  # noqa: S608
            f"WHERE database_name = {file}"
        )
        rows = {
            (schema, table): size
            for schema, table, size, text in tables
            if _OF_STRANGERS.search(_QUOTED.sub("", str(text))) is None
        }
        return cls(path, catalog, rows)

    def schemas_with(self, table: str) -> list[str]:
        """Returns the schemas that have a table."""
        return [schema for schema, name in self.rows if name == table]

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
            if key not in self.rows:
                raise RecordError(
                    f"{source} is damaged: it is missing, or no table whose columns are stored and "
                    "have no collation"
                )
            described = connection.fetchall(f"DESCRIBE {place}")
            types = {name: _TYPES.get(kind, kind[:_LONGEST]) for name, kind, *_ in described}
            check_columns(source, types.items(), expected)
            if "until" in expected:
                self._check_repeated(connection, place, source)
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
        place = self.place(schema, table)
        values = self.rows[schema, table] * len(expected)
        lists = [quoted(name) for name in expected if expected[name] in ("points", "triples")]
        if lists and values <= MAX_VALUES:
            lengths = " + ".join(f"coalesce(sum(len({name})), 0)" for name in lists)
            ((count,),) = connection.fetchall(f"SELECT {lengths} FROM {place}")  # noqa: S608
            values += 3 * count
        self.check_size(f"{self.path}: {schema}.{table!r}", values)
        listed = ", ".join(map(quoted, expected))
        return connection.rows(f"SELECT {listed} FROM {place}")  # noqa: S608

    def check_size(self, source: str, values: int) -> None:
        """Checks that a number of values fits into memory."""
        if values > MAX_VALUES:
            raise RecordError(f"{source} is damaged: it has {values:,} values, too many to be read")

    def _check_repeated(self, connection: StoreConnection, place: str, source: str) -> None:
        """Checks until when the rows of a table hold."""
        ((least, count),) = connection.fetchall(
            'SELECT coalesce(min("until"::HUGEINT - tick), 0), '  # noqa: S608
            f'coalesce(sum("until"::HUGEINT - tick + 1), 0) FROM {place}'
        )
        if least < 0 or count > _MAX_REPEATED:
            raise RecordError(f"{source} is damaged: the ticks until which its rows hold are wrong")
