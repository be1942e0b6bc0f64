"""Result forms: the names after AS in a query, and the values that they make of the rows.

`registry` finds a form by its name. Each other module defines the forms of one topic, on top of
`base`. `result` holds the rows of raw SQL; `display` and `table_view` show values to people.
"""

from typing import TYPE_CHECKING

from ssduck.lazy import exports

if TYPE_CHECKING:
    from ssduck.adapters.base import Adapter, Selection
    from ssduck.adapters.registry import adapter, find
    from ssduck.adapters.result import Result
    from ssduck.adapters.table_view import TableView

__all__ = [
    "Adapter",
    "Result",
    "Selection",
    "TableView",
    "adapter",
    "find",
]

__getattr__, __dir__ = exports(
    __name__,
    {
        "base": ("Adapter", "Selection"),
        "registry": ("adapter", "find"),
        "result": ("Result",),
        "table_view": ("TableView",),
    },
)
