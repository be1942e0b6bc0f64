"""Checks the SQL of strangers: one SELECT, of tables and functions that are named here.

The check walks the tree of DuckDB's own parser, so that both read the text in the same way.
"""

from __future__ import annotations

import json
import re
from collections import OrderedDict
from collections.abc import Collection, Iterator, Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass
from typing import Any, TypeAlias

from ssduck.database.binding import BoundWorld
from ssduck.database.connection import Connection
from ssduck.database.folding import folded
from ssduck.database.macros import TABLE_MACROS
from ssduck.database.referenced_tables import COMMENT
from ssduck.database.strict.expression_size import expression_size
from ssduck.database.strict.permitted_functions import (
    AGGREGATING,
    FUNCTIONS,
    HASHING,
    HASHING_FRAMES,
    HASHING_SHORTER,
    INSTEAD,
    JOINING,
    LIKES,
    MAX_EXPRESSION,
    MAX_FRACTIONS,
    OPERATORS,
    PATHS,
    QUANTILES,
    READING_TIMES,
    REGULAR,
    TABLE_FUNCTIONS,
    UNBOUNDED_TYPES,
    WILDCARDS,
    ZONED_WORDS,
    ZONES,
)
from ssduck.database.strict.statement_size import check_statement_size
from ssduck.errors import LimitError, SourceSpan, nearest
from ssduck.language.intervals import RELATIONS_OF_INTERVALS
from ssduck.schema import HISTORIES, MODELS, TABLES
from ssduck.sql.relations.registry import RELATIONS

Node: TypeAlias = Mapping[str, Any]

# The number of texts that are known to be permitted.
_MAX_TEXTS = 256
_TREE = "SELECT system.main.json_serialize_sql($1)"
_TABLES = frozenset(
    folded(name)
    for name in (
        *TABLES,
        *(table.history_view for table in HISTORIES.values()),
        *(table.model_view for table in MODELS.values()),
    )
)
_INTERVALS = "intervals"
_TABLE_MACROS = frozenset((*(macro.name for macro in TABLE_MACROS), _INTERVALS))
_RELATIONS = frozenset(folded(name) for name in (*RELATIONS, *RELATIONS_OF_INTERVALS))
_SCALARS = frozenset(map(folded, FUNCTIONS)) | _RELATIONS
_IN_FROM = TABLE_FUNCTIONS | _TABLE_MACROS
# The tables that users have made in a file.
_OWN_TABLES = (
    "SELECT table_name FROM duckdb_tables() WHERE NOT internal AND schema_name = 'main' "
    "AND database_name = current_database()"
)
_OF_LISTS = FUNCTIONS - JOINING - HASHING
_WITH_CHECKED_ARGUMENTS = (
    REGULAR | LIKES.keys() | READING_TIMES | AGGREGATING | PATHS | HASHING_SHORTER | QUANTILES
) | {"map"}
# The kinds of parts of a SELECT that changes nothing, as DuckDB's trees name them. A query of WITH
# may be an INSERT or a COPY, and the next DuckDB may have others.
_KINDS = frozenset(("SELECT_NODE", "SET_OPERATION_NODE", "RECURSIVE_CTE_NODE", "CTE_NODE")).union(
    ("BASE_TABLE", "EMPTY", "EXPRESSION_LIST", "JOIN", "PIVOT", "SHOW_REF", "SUBQUERY"),
    ("TABLE_FUNCTION", "DISTINCT_MODIFIER", "LIMIT_MODIFIER", "LIMIT_PERCENT_MODIFIER"),
    ("ORDER_MODIFIER", "ASCENDING", "DESCENDING", "ORDER_DEFAULT"),
)
_CLASSES = frozenset(("BETWEEN", "CASE", "CAST", "COLLATE", "COLUMN_REF", "COMPARISON")).union(
    ("CONJUNCTION", "CONSTANT", "DEFAULT", "FUNCTION", "LAMBDA", "OPERATOR", "PARAMETER"),
    ("POSITIONAL_REFERENCE", "STAR", "SUBQUERY", "TYPE", "WINDOW"),
)
# DuckDB's place of a part that the text does not have.
_NOWHERE = 2**64 - 1


class SelectCheck:
    """Checks that users' statements are permitted under `Limits(select_only=True)`.

    Args:
        connection: the connection to the database.
        worlds: the worlds of the database by name, up to date.
    """

    def __init__(self, connection: Connection, worlds: Mapping[str, BoundWorld]) -> None:
        self._connection = connection
        self._worlds = worlds
        # Permitted texts, and the names of the worlds that they are permitted with.
        self._permitted: OrderedDict[str, tuple[str, ...]] = OrderedDict()

    def check(self, sql: str) -> None:
        """Checks a statement.

        Raises:
            LimitError: it is not permitted. DuckDB refuses a text that it cannot parse.
        """
        key = tuple(self._worlds)
        if self._permitted.get(sql) == key:
            return
        tree = self._tree(sql)
        if tree is None:
            return
        own_tables: frozenset[str] = frozenset()
        if self._connection.is_file:
            rows = self._connection.internal_rows(_OWN_TABLES)
            own_tables = frozenset(folded(name) for (name,) in rows)
        names = _Names(
            schemas=frozenset(map(folded, self._worlds)),
            database=folded(self._connection.name),
            own_tables=own_tables,
        )
        _Walk(sql, names).check(tree)
        check_statement_size(tree)
        self._permitted[sql] = key
        if len(self._permitted) > _MAX_TEXTS:
            self._permitted.popitem(last=False)

    def _tree(self, sql: str) -> Node | None:
        """Returns DuckDB's tree of a statement; None if it cannot parse the text."""
        statements = self._connection.statements(sql)
        if statements is None:
            return None
        if len(statements) != 1:
            count = f"and the text has {len(statements)} statements"
            raise LimitError(f"SQL is one SELECT here, {count} (Limits: select_only)")
        kind = statements[0][0]
        if kind == "MULTI":
            example = "PIVOT t ON x IN ('a', 'b') USING count(*)"
            raise LimitError(f"PIVOT needs its values here: {example} (Limits: select_only)")
        if kind not in ("SELECT", "WITH"):  # the tree tells what is in WITH
            word = _first_word(statements[0][1])
            what = kind if word in ("", "WITH") else word
            raise LimitError(f"SQL is one SELECT here, not {what} (Limits: select_only)")
        ((text,),) = self._connection.internal_rows(_TREE, [sql])
        try:
            tree = json.loads(text)
        except RecursionError:
            raise LimitError("the SQL is nested too deeply to be checked") from None
        if tree["error"]:
            raise LimitError(f"the SQL cannot be checked: {tree['error_message']}")
        node: Node = tree["statements"][0]["node"]
        return node


@dataclass(frozen=True)
class _Names:
    """The names that a statement may use, besides those that are fixed, in small letters.

    Attributes:
        schemas: the names of the worlds.
        database: the name of the database.
        own_tables: the users' own tables.
    """

    schemas: frozenset[str]
    database: str
    own_tables: frozenset[str]


class _Walk:
    """Walks the tree of a statement and checks the tables and functions that it names.

    Args:
        sql: the statement.
        names: the names that it may use.
    """

    def __init__(self, sql: str, names: _Names) -> None:
        self._sql = sql
        self._names = names
        # The parts that are still to be checked, with the queries of WITH that each may name.
        self._waiting: list[tuple[Any, frozenset[str]]] = []

    def check(self, tree: Node) -> None:
        """Checks all parts of a tree."""
        self._waiting.append((tree, frozenset()))
        while self._waiting:
            part, queries = self._waiting.pop()
            if isinstance(part, list):
                self._waiting += [(item, queries) for item in part]
            elif isinstance(part, dict):
                self._waiting += self._parts_of(part, queries)

    def _parts_of(
        self, node: Node, queries: frozenset[str]
    ) -> Iterator[tuple[Any, frozenset[str]]]:
        """Checks a node, and yields its parts that are to be checked.

        Args:
            node: the node.
            queries: the queries of WITH that it may name.
        """
        kind = node.get("type")
        self._check_kind(node)
        if "cte_map" in node:
            for item in node["cte_map"]["map"]:
                yield item["value"], queries
                queries |= {folded(item["key"])}
        if kind == "BASE_TABLE":
            self._check_table(node, queries)
        elif kind == "SHOW_REF" and node["query"] is None:
            names = ", ".join(sorted(_TABLES))
            self._refuse(node, f"SHOW: use DESCRIBE and the name of a table, one of {names}")
        elif kind == "TABLE_FUNCTION":
            self._check_table_function(node, queries)
            yield node["function"]["arguments"], queries
            return
        elif "function_name" in node:
            self._check_function(node)
        elif node.get("syntax_type") == "SINGLE_ARROW":
            self._check_path(node, "->", node["expr"])
        elif node.get("class") == "STAR" and (node["expr"] or {}).get("class") == "LAMBDA":
            yield node["expr"]["expr"], queries  # the arrow of COLUMNS(c -> …) begins no path
            node = {**node, "expr": None}
        if node.get("class") == "STAR":
            self._check_star(node)
        for key, part in node.items():
            if key == "right" and kind == "RECURSIVE_CTE_NODE":
                yield part, queries | {folded(node["cte_name"])}
            elif key != "cte_map":
                yield part, queries

    def _check_star(self, node: Node) -> None:
        """Checks that the regular expression of COLUMNS is short."""
        expression = node["expr"] or {}
        text = (expression.get("literal") or {}).get("text")
        # A list of names, or what a function finds of all names.
        is_list = expression.get("function_name") in ("list_value", "list_filter")
        is_short = (
            isinstance(text, str)
            and len(text) <= MAX_EXPRESSION
            and expression_size(text) <= MAX_EXPRESSION
        )
        if expression and not is_list and not is_short:
            what = f"a text of at most {MAX_EXPRESSION} letters"
            self._refuse(node, f"COLUMNS takes {what}, a list or a function here")

    def _check_kind(self, node: Node) -> None:
        """Checks that a part is of a kind that changes nothing."""
        is_expression = "class" in node
        kind = node["class"] if is_expression else node.get("type")
        if isinstance(kind, str) and kind not in (_CLASSES if is_expression else _KINDS):
            words = kind.removesuffix("_NODE").removesuffix("_QUERY").replace("_", " ")
            self._refuse(node, f"SQL is one SELECT here, without {words}")
        if kind == "TYPE" and (instead := UNBOUNDED_TYPES.get(folded(node["type_name"]))):
            self._refuse(node, f"there is no type {node['type_name']} here: use {instead}")
        if kind == "COLUMN_REF" and len(names := node["column_names"]) == 1:
            name = folded(names[0])
            if name in ZONED_WORDS:  # a function, unless a column is called so
                local = name.replace("current_", "local")
                self._refuse(node, f"{name} is no function that SQL may call: use {local}")

    def _check_table(self, node: Node, queries: AbstractSet[str]) -> None:
        name, schema = folded(node["table_name"]), folded(node["schema_name"])
        path = ".".join(node["qualified_name"]["path"])
        if not self._is_table(folded(node["catalog_name"]), schema, name, queries):
            known = sorted(_TABLES | queries | self._names.own_tables)
            self._refuse(node, f"there is no table {path!r} that SQL may read", name, known)

    def _is_table(
        self, database: str, schema: str, name: str, queries: AbstractSet[str] = frozenset()
    ) -> bool:
        names = self._names
        if database not in ("", names.database):
            return False
        if not schema:
            return name in queries or name in _TABLES or name in names.own_tables
        if schema == "main":
            return name in names.own_tables
        return schema in names.schemas and name in _TABLES

    def _check_table_function(self, node: Node, queries: AbstractSet[str]) -> None:
        function = node["function"]
        name = folded(function["function_name"])
        if name not in _IN_FROM:
            message = f"{name} is no function that SQL may call in FROM"
            self._refuse(node, message, name, _IN_FROM)
        if name == _INTERVALS:
            literals = [item["expression"].get("literal") for item in function["arguments"]]
            texts = [literal.get("text") for literal in literals if isinstance(literal, dict)]
            names = [folded(text) for text in texts if isinstance(text, str)]
            if len(names) != 1 or not self._is_table("", *_split(names[0]), queries):
                self._refuse(node, "intervals takes the name of a table that SQL may read")

    def _check_function(self, node: Node) -> None:
        name = folded(node["function_name"])
        if name not in OPERATORS and name not in _SCALARS:
            message = f"{name} is no function that SQL may call"
            if instead := INSTEAD.get(name):
                self._refuse(node, f"{message}: {instead}")
            self._refuse(node, message, name, _SCALARS)
        if node.get("class") == "WINDOW":
            self._check_window(node, name)
        if name in _WITH_CHECKED_ARGUMENTS:
            self._check_order_of_arguments(node, name)
        if name in REGULAR:
            self._check_expression(node, f"the regular expression of {name}")
            self._check_repeats(node, name)
        if name in LIKES:
            self._check_expression(node, f"the pattern of {LIKES[name]}")
        if name in READING_TIMES:
            self._check_expression(node, f"the format of {name}", without=ZONES)
        if name in AGGREGATING:
            for argument in node["arguments"][1:2]:
                literal = argument["expression"].get("literal") or {}
                aggregate = folded(str(literal.get("text")))
                if aggregate not in _OF_LISTS:
                    message = f"{name} takes the name of an aggregate that SQL may call"
                    self._refuse(node, message, aggregate, _OF_LISTS)
                if aggregate in QUANTILES:
                    self._check_fractions(node, aggregate)
        if name in QUANTILES:
            self._check_fractions(node, name)
        if name in PATHS and len(node["arguments"]) > 1:
            self._check_path(node, name, node["arguments"][1]["expression"])
        if name == "map" and not all(map(_is_written_out, node["arguments"])):
            self._refuse(node, "map takes lists that are written out here: MAP {'a': 1}")
        if name in HASHING_SHORTER and not any(map(_is_written_out, node["arguments"])):
            self._refuse(node, f"one of the lists of {name} is written out here: ['a', 'b']")

    def _check_window(self, node: Node, name: str) -> None:
        """Checks that DuckDB computes an aggregate of each row's frame by those of other frames."""
        if name in HASHING_FRAMES:
            self._refuse(node, f"{name} has no OVER here")
        if node.get("distinct") and node.get("exclude_clause") != "NO_OTHER":
            self._refuse(node, "DISTINCT and EXCLUDE are not together in OVER here")

    def _check_order_of_arguments(self, node: Node, name: str) -> None:
        """Checks that the arguments stand where they are looked for: `v.f(x)` may be `f(v, x)`."""
        if node["schema"] or any(argument["name"] for argument in node["arguments"]):
            self._refuse(node, f"{name} is written as {name}(…) here, without names of arguments")

    def _check_fractions(self, node: Node, name: str) -> None:
        """Checks that the last argument is a number, or a list of some that is written out."""
        numbers: Sequence[Node] = node["arguments"][-1:]
        if numbers and _is_written_out(numbers[0]):
            numbers = numbers[0]["expression"]["arguments"]
        if len(numbers) > MAX_FRACTIONS or not all(map(_is_number, numbers)):
            what = f"a number, or a list of at most {MAX_FRACTIONS} that is written out: [0.5, 0.9]"
            self._refuse(node, f"{name} takes {what}")

    def _check_path(self, node: Node, name: str, path: Node) -> None:
        """Checks that a path in JSON is known, or one without wildcards: that of a column."""
        text = (path.get("literal") or {}).get("text")
        if path["class"] not in ("CONSTANT", "COLUMN_REF", "PARAMETER"):
            hint = "; a function is written lambda x: …" if name == "->" else ""
            self._refuse(node, f"the path of {name} is a text or a column here{hint}")
        if isinstance(text, str) and sum(map(text.count, WILDCARDS)) > 1:
            self._refuse(node, f"the path of {name} has at most one of * and .. here")

    def _check_expression(self, node: Node, what: str, without: Collection[str] = ()) -> None:
        """Checks that an expression or a pattern is short, and known before the statement runs.

        Args:
            node: the call.
            what: what its second argument is, in words.
            without: what it may not contain.
        """
        for argument in node["arguments"][1:2]:
            literal = argument["expression"].get("literal")
            text = literal.get("text") if isinstance(literal, dict) else None
            if not isinstance(text, str) or len(text) > MAX_EXPRESSION:
                self._refuse(node, f"{what} is a text of at most {MAX_EXPRESSION} letters here")
            for part in without:
                if isinstance(text, str) and part in text:
                    self._refuse(node, f"{what} has no {part} here")

    def _check_repeats(self, node: Node, name: str) -> None:
        """Checks that a regular expression is short as DuckDB compiles it, which repeats parts."""
        for argument in node["arguments"][1:2]:
            if expression_size(argument["expression"]["literal"]["text"]) > MAX_EXPRESSION:
                self._refuse(
                    node,
                    f"the regular expression of {name} has at most {MAX_EXPRESSION} letters here "
                    "when its repeats are written out, as aaa is for a{3}",
                )

    def _refuse(
        self, node: Node, message: str, name: str | None = None, known: Collection[str] = ()
    ) -> None:
        place, length = node.get("query_location", _NOWHERE), node.get("query_location_length", 0)
        letters = self._sql.encode()
        span = None
        if place < len(letters):
            start = len(letters[:place].decode(errors="ignore"))
            end = len(letters[: place + max(length, 1)].decode(errors="ignore"))
            span = SourceSpan(start, max(end, start + 1))
        raise LimitError(
            f"{message} (Limits: select_only)",
            text=self._sql if span is not None else None,
            span=span,
            suggestions=nearest(name, known),
        )


def _first_word(text: str) -> str:
    """Returns the first word of a statement, in capitals; empty if it begins with none."""
    match = re.match(r"\W*(\w+)", COMMENT.sub(" ", text))
    return "" if match is None else match.group(1).upper()


def _is_written_out(argument: Node) -> bool:
    expression = argument["expression"]
    return expression.get("function_name") in ("list_value", "array_value", "list_pack")


def _is_number(argument: Node) -> bool:
    literal = argument["expression"].get("literal") or {}
    return literal.get("kind") in ("INTEGER", "NUMERIC")


def _split(name: str) -> tuple[str, str]:
    """Returns the schema, which may be empty, and the name of a table."""
    schema, _, table = name.rpartition(".")
    return schema, table
