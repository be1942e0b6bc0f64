"""Exports `translate`, which translates the tree of a query to a `Plan` with DuckDB SQL.

The package `ssduck.sql` translates queries; `ssduck.language` parses them.
"""

from ssduck.sql.plan import Plan
from ssduck.sql.translator import translate

__all__ = ["Plan", "translate"]
