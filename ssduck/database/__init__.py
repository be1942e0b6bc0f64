"""The one door to DuckDB: connections, schemas, prepared statements.

A `Database` has a schema for each world (`worlds`, `schemas`), with a view of each table and a
macro for each relation (`macros`). A statement runs on one tick (`statement`, `connection`).
`functions` are the Python functions that SQL calls; `values` converts values to SQL and back.
"""

from typing import TYPE_CHECKING

from ssduck.lazy import exports

if TYPE_CHECKING:
    from ssduck.database.database import Database
    from ssduck.database.statement import Statement
    from ssduck.database.values import sql_type_of, to_sql

__all__ = [
    "Database",
    "Statement",
    "sql_type_of",
    "to_sql",
]

__getattr__, __dir__ = exports(
    __name__,
    {
        "database": ("Database",),
        "statement": ("Statement",),
        "values": ("sql_type_of", "to_sql"),
    },
)
