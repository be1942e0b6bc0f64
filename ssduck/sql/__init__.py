"""Translates a query's tree to DuckDB SQL. This package knows no world and no database.

`translator` turns a query into a `plan`, through sqlglot: `expressions` translates what the query
selects and its conditions, `from_clause` its sources. A part that SQL cannot express raises
`NotSqlError`; `ssduck.language` evaluates it. `relations` defines the relations between entities.
"""

from typing import TYPE_CHECKING

from ssduck.lazy import exports

if TYPE_CHECKING:
    from ssduck.sql.plan import Plan
    from ssduck.sql.relations.registry import RELATIONS
    from ssduck.sql.relations.relation import Relation
    from ssduck.sql.translator import translate
    from ssduck.sql.types import SqlType

__all__ = [
    "RELATIONS",
    "Plan",
    "Relation",
    "SqlType",
    "translate",
]

__getattr__, __dir__ = exports(
    __name__,
    {
        "plan": ("Plan",),
        "relations.registry": ("RELATIONS",),
        "relations.relation": ("Relation",),
        "translator": ("translate",),
        "types": ("SqlType",),
    },
)
