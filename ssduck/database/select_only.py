"""Checks that a statement is one SELECT that changes nothing: `Limits(select_only=True)`.

The check walks the tree of DuckDB's own parser, so that both read the text in the same way. What a
SELECT may read is limited by DuckDB's settings (`Connection.seal`), and by a sandbox.
"""

from __future__ import annotations

import json
import re
from typing import Any

from ssduck.database.connection import Connection
from ssduck.database.referenced_tables import COMMENT
from ssduck.errors import LimitError

# The number of texts that are known to be one SELECT.
_MAX_TEXTS = 256
_TREE = "SELECT system.main.json_serialize_sql($1)"
# The kinds of queries that change nothing, as DuckDB's trees name them. A query of WITH may be an
# INSERT or a COPY, and the next DuckDB may have others.
_QUERIES = frozenset(("SELECT_NODE", "SET_OPERATION_NODE", "RECURSIVE_CTE_NODE", "CTE_NODE"))


class SelectCheck:
    """Checks that users' statements are SELECTs.

    Args:
        connection: the connection to the database.
    """

    def __init__(self, connection: Connection) -> None:
        self._connection = connection
        self._known: dict[str, None] = {}

    def check(self, sql: str) -> None:
        """Checks a statement.

        Raises:
            LimitError: it is something else. DuckDB refuses a text that it cannot parse.
        """
        if sql in self._known:
            return
        statements = self._connection.statements(sql)
        if statements is None:
            return
        if len(statements) != 1:
            raise _refusal(f", and the text has {len(statements)} statements")
        ((kind, text),) = statements
        if kind == "MULTI":
            raise _refusal("; PIVOT needs its values: PIVOT t ON x IN ('a', 'b') USING count(*)")
        if kind not in ("SELECT", "WITH"):  # the tree tells what is in WITH
            raise _refusal(f", not {_first_word(text) or kind}")
        ((serialized,),) = self._connection.internal_rows(_TREE, [sql])
        try:
            tree = json.loads(serialized)
        except RecursionError:
            raise LimitError("the SQL is nested too deeply to be checked") from None
        if tree["error"]:
            raise LimitError(f"the SQL cannot be checked: {tree['error_message']}")
        _check_queries(tree["statements"][0]["node"])
        if len(self._known) >= _MAX_TEXTS:
            self._known.clear()
        self._known[sql] = None


def _check_queries(tree: Any) -> None:
    """Checks that all queries in a tree change nothing."""
    waiting = [tree]
    while waiting:
        part = waiting.pop()
        if isinstance(part, list):
            waiting += part
        elif isinstance(part, dict):
            kind = str(part.get("type"))
            if kind.endswith("_NODE") and kind not in _QUERIES:
                what = kind.removesuffix("_NODE").removesuffix("_QUERY").replace("_", " ")
                raise _refusal(f", without {what}")
            waiting += part.values()


def _refusal(told: str) -> LimitError:
    return LimitError(f"SQL is one SELECT here{told} (Limits: select_only)")


def _first_word(text: str) -> str:
    """Returns the first word of a statement, in capitals; empty if it begins with none."""
    match = re.match(r"\W*(\w+)", COMMENT.sub(" ", text))
    return "" if match is None else match.group(1).upper()
