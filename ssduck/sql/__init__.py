"""A query's tree as DuckDB SQL; it knows no world and no database.

`translator` makes a `plan` of a query, through sqlglot: `expressions` becomes what it selects and
asks for, `from_clause` its sources. What SQL has no equal of raises `NotSqlError` and is left to
`ssduck.language`. `relations` is the registry of relations: what each one means.
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
