"""Reads the users' views and macros that DuckDB files have from before."""

from __future__ import annotations

from ssduck.database.connection import Connection
from ssduck.schema import HISTORIES, MODELS

# The views that ssduck leaves in a file.
_OWN_VIEWS = [
    *(table.history_view for table in HISTORIES.values()),
    *(table.model_view for table in MODELS.values()),
]
_TEXTS = (
    "SELECT sql FROM duckdb_views() WHERE NOT internal AND NOT temporary "
    "AND (database_name <> current_database()) = $1 AND NOT list_contains($2, view_name) "
    "UNION ALL SELECT macro_definition FROM duckdb_functions() "
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
    return [text for (text,) in connection.internal_rows(_TEXTS, [of_attached, _OWN_VIEWS])]
