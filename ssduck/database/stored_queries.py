"""Reads the users' views and macros that DuckDB files have from before."""

from __future__ import annotations

from ssduck.database.connection import Connection
from ssduck.schema import HISTORIES, MODELS

# The views that ssduck leaves in a file.
_OWN_VIEWS = [
    *(table.history_view for table in HISTORIES.values()),
    *(table.model_view for table in MODELS.values()),
]
_OF_VIEWS = (
    "FROM duckdb_views() WHERE NOT internal AND NOT temporary "
    "AND (database_name <> current_database()) = $1 AND NOT list_contains($2, view_name)"
)
# DuckDB writes the texts of all views for any of them, and each episode has some of ssduck's.
_HAS_VIEWS = f"SELECT view_name {_OF_VIEWS} LIMIT 1"
_VIEWS = f"SELECT sql {_OF_VIEWS}"
_MACROS = (
    "SELECT macro_definition FROM duckdb_functions() "
    "WHERE NOT internal AND macro_definition IS NOT NULL AND database_name <> 'temp' "
    "AND (database_name <> current_database()) = $1"
)


def stored_queries(connection: Connection, *, of_attached: bool = False) -> list[str]:
    """Returns the texts of the users' views and macros.

    Args:
        connection: the connection to the database.
        of_attached: whether those of attached databases are returned, instead of those of the
            connection's own.
    """
    rows = connection.internal_rows(_MACROS, [of_attached])
    if connection.internal_rows(_HAS_VIEWS, [of_attached, _OWN_VIEWS]):
        rows += connection.internal_rows(_VIEWS, [of_attached, _OWN_VIEWS])
    return [text for (text,) in rows]
