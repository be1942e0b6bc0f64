"""From a query to DuckDB SQL: `translate` makes a `Plan` of a query's tree.

The translation is the package `ssduck.sql`; `ssduck.language` parses queries.
"""

from ssduck.sql.plan import Plan
from ssduck.sql.translator import translate

__all__ = ["Plan", "translate"]
