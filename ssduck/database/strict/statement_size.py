"""Estimates how large the plan of a statement, and the values of its columns, may become.

DuckDB puts what a name stands for in the place of the name: of an alias in the same SELECT, of a
column of a nested query, of `*`. If each level names the one before twice, forty lines describe a
plan, a type or a text of terabytes. PIVOT makes a column of each combination of its values, and
ROLLUP and CUBE group as often. Neither planning nor a step of a plan can be interrupted, so the
check comes first. It takes every name for the largest column of that name.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import prod
from typing import Any, TypeAlias

from ssduck.database.folding import folded
from ssduck.database.strict.expression_size import expression_size
from ssduck.database.strict.permitted_functions import REGULAR
from ssduck.errors import LimitError

Node: TypeAlias = Mapping[str, Any]

# The largest size of the columns of a query, in parts of expressions.
MAX_SIZE = 200_000
# The largest number of tables in its plan, and of those that one SELECT joins, nested queries among
# them: the time to find their order grows with the cube of their number.
MAX_TABLES, MAX_JOINED = 300, 100
# The largest number of columns that the stars of a SELECT stand for.
MAX_COLUMNS = 10_000
# So many columns of a PIVOT, which has all combinations of its values, are planned in the time of a
# table; so is each grouping set (ROLLUP, CUBE).
_PIVOTED = 100
# The number of columns of a table; none has more. The number of letters that count as a part.
_COLUMNS, _LETTERS = 40, 100
# Functions whose text is so many times as long as that of their argument.
_FACTORS = {"bin": 8, "to_binary": 8} | dict.fromkeys(
    ("hex", "to_hex", "base64", "to_base64", "regexp_escape", "encode", "strftime"), 2
)
_JSON_FACTOR, _CAST_FACTOR = 2, 2
# DuckDB binds a lambda twice, and those in it four times, as copies.
_LAMBDA_FACTOR = 3
# A macro measures the text in which a regular expression is looked for, which is there twice then.
_BOUNDED_FACTOR = 2
# A letter of a regular expression is compiled in the time of so many parts.
_REGULAR_FACTOR = 10
# Types whose values do not grow with those that they are made of.
_FIXED_TYPES = frozenset(
    ("bigint", "boolean", "date", "decimal", "double", "float", "hugeint", "integer", "interval")
).union(("smallint", "time", "timestamp", "tinyint", "uuid"))


def check_statement_size(tree: Node) -> None:
    """Checks that the plan and the values of a statement cannot become far larger than its text.

    Args:
        tree: DuckDB's tree of the statement.

    Raises:
        LimitError: they can.
    """
    try:
        _columns(tree, {}, {})
    except RecursionError:
        raise LimitError("the SQL is nested too deeply to be checked") from None


@dataclass(frozen=True)
class _Columns:
    """The columns of a query or of the tables behind FROM.

    Attributes:
        sizes: the size of each by name, in small letters, as far as it is more than 1.
        total: the size of all together.
        tables: the number of tables in the plan.
        joined: the largest number of them that are joined.
        bare: 1 for a SELECT without FROM, which a SELECT around it joins as well; else 0.
        is_inlined: whether each mention of the query repeats its plan.
    """

    sizes: dict[str, int] = field(default_factory=dict)
    total: int = 1
    tables: int = 1
    joined: int = 1
    bare: int = 0
    is_inlined: bool = False

    @property
    def nested(self) -> _Columns:
        """The columns of the query as a part of another one."""
        return replace(self, joined=self.joined + self.bare, bare=0)


_Queries: TypeAlias = Mapping[str, _Columns]


def _checked(columns: _Columns) -> _Columns:
    if columns.joined > MAX_JOINED:
        raise LimitError(
            f"a SELECT joins at most {MAX_JOINED} tables and nested queries here "
            "(Limits: select_only)"
        )
    if columns.total > MAX_SIZE or columns.tables > MAX_TABLES:
        raise _too_large()
    return columns


def _too_large() -> LimitError:
    return LimitError(
        "the plan of the SQL or its values would be too large: names stand for others, or values "
        "of PIVOT and grouping sets are combined, too often (Limits: select_only)"
    )


def _columns(node: Node, queries: _Queries, outer: Mapping[str, int]) -> _Columns:
    """Returns the columns of a query.

    Args:
        node: the query.
        queries: the queries of WITH that it may name.
        outer: the sizes of the columns around it.
    """
    queries = dict(queries)
    for item in node["cte_map"]["map"] if node.get("cte_map") else ():
        inner = _columns(item["value"]["query_node"], queries, outer)
        is_inlined = item["value"].get("materialized") == "CTE_MATERIALIZE_NEVER"
        inner = replace(inner, is_inlined=is_inlined)
        queries[folded(item["key"])] = _renamed(inner, item["value"].get("aliases") or ())
    match node["type"]:
        case "SELECT_NODE":
            return _selected(node, queries, outer)
        case "SET_OPERATION_NODE":
            parts = [_columns(child, queries, outer) for child in node["children"]]
        case "RECURSIVE_CTE_NODE":
            first = _columns(node["left"], queries, outer)
            name = folded(node["cte_name"])
            parts = [first, _columns(node["right"], {**queries, name: first}, outer)]
        case _:
            parts = [_columns(part, queries, outer) for part in _queries_in(node)]
    largest = max((part.total for part in parts), default=1)
    names = parts[0].sizes if parts else {}
    tables = sum(part.tables for part in parts)
    joined = max((part.joined for part in parts), default=1)
    bare = max((part.bare for part in parts), default=0)
    return _checked(_Columns(dict.fromkeys(names, largest), largest, tables, joined, bare))


def _queries_in(node: Node) -> list[Node]:
    """Returns the queries that are parts of one of another kind."""
    parts = [part for part in node.values() if isinstance(part, dict)]
    return [part for part in parts if str(part.get("type")).endswith("_NODE")]


def _selected(node: Node, queries: _Queries, outer: Mapping[str, int]) -> _Columns:
    """Returns the columns of a SELECT."""
    source = _source(node["from_table"], queries, outer)
    names = {**outer, **source.sizes}
    walk = _Expressions(names, source.total, queries)
    sizes: dict[str, int] = {}
    total = stars = 0
    for item in node["select_list"]:
        size = walk.size(item)
        total += size
        # A column is planned in the time of many parts of an expression.
        stars += size if item.get("class") == "STAR" else 0
        if stars > MAX_COLUMNS:
            raise _too_large()
        _checked(_Columns(total=total))
        if item.get("class") == "STAR":
            sizes |= source.sizes
        name = folded(item.get("alias") or _last_name(item))
        if size > 1 and name:
            sizes[name] = max(size, sizes.get(name, 1))
            names.setdefault(name, size)
    rest = [
        part for key, part in node.items() if key not in ("select_list", "from_table", "cte_map")
    ]
    _checked(_Columns(total=walk.size(rest)))
    bare = int(node["from_table"]["type"] == "EMPTY")
    sets = max(0, len(node["group_sets"]) - 1)
    tables, joined = source.tables + walk.tables + sets, source.joined + walk.joined - bare
    return _checked(_Columns(sizes, max(total, 1), tables, joined, bare))


def _source(node: Node, queries: _Queries, outer: Mapping[str, int]) -> _Columns:
    """Returns the columns of the tables behind FROM."""
    kind = node["type"]
    if kind == "BASE_TABLE":
        name = folded(node["table_name"])
        columns = _Columns(total=_COLUMNS)
        if not node.get("schema_name") and name in queries:
            query = queries[name]
            columns = query.nested if query.is_inlined else _Columns(query.sizes, query.total)
        alias = node.get("alias") or name
    elif kind == "SUBQUERY":
        columns = _columns(node["subquery"]["node"], queries, outer).nested
        alias = node.get("alias") or ""
    elif kind == "JOIN":
        left = _source(node["left"], queries, outer)
        right = _source(node["right"], queries, {**outer, **left.sizes})
        sizes = {**left.sizes}
        for name, size in right.sizes.items():
            sizes[name] = max(size, sizes.get(name, 1))
        columns = _Columns(
            sizes, left.total + right.total, left.tables + right.tables, left.joined + right.joined
        )
        condition = _Expressions({**outer, **sizes}, columns.total, queries)
        condition.size([part for key, part in node.items() if key not in ("left", "right")])
        return _checked(columns)
    else:
        walk = _Expressions(outer, 1, queries)
        inner = node.get("source")
        columns = _source(inner, queries, outer) if isinstance(inner, dict) else _Columns()
        size = walk.size([part for key, part in node.items() if key != "source"])
        pivoted = _pivoted_columns(node)
        columns = _Columns(
            columns.sizes,
            columns.total + size + pivoted,
            columns.tables + walk.tables + pivoted // _PIVOTED,
            columns.joined + walk.joined,
        )
        alias = node.get("alias") or ""
    columns = _renamed(columns, node.get("column_name_alias") or ())
    # The name of a table stands for all of its columns.
    sizes = {folded(alias): columns.total, **columns.sizes}
    return _checked(replace(columns, sizes=sizes, is_inlined=False))


def _pivoted_columns(node: Node) -> int:
    """Returns the number of columns that a PIVOT makes."""
    if node["type"] != "PIVOT":
        return 0
    values = (max(1, len(pivot["entries"])) for pivot in node.get("pivots") or ())
    return prod(values) * max(1, len(node.get("aggregates") or ()))


def _renamed(columns: _Columns, names: Iterable[str]) -> _Columns:
    """Returns the columns of a table that has a list of their names."""
    sizes = columns.sizes | dict.fromkeys(map(folded, names), columns.total)
    return replace(columns, sizes=sizes)


def _last_name(item: Node) -> str:
    names: Sequence[str] = item.get("column_names") or ("",)
    return names[-1]


class _Expressions:
    """Measures expressions.

    Args:
        names: the sizes of columns by name, as far as they are more than 1.
        total: the size of all columns together, which `*` stands for.
        queries: the queries of WITH that nested queries may name.

    Attributes:
        tables: the number of tables in nested queries.
        joined: how many of them are joined with those around them.
    """

    def __init__(self, names: Mapping[str, int], total: int, queries: _Queries) -> None:
        self._names = names
        self._total = total
        self._queries = queries
        self.tables = self.joined = 0

    def size(self, part: Any) -> int:
        """Returns the size of an expression, or of several."""
        if isinstance(part, list):
            return sum(map(self.size, part))
        if not isinstance(part, dict):
            return 0
        if str(part.get("type")).endswith("_NODE"):  # the query of DESCRIBE
            columns = _columns(part, self._queries, self._names).nested
            self._count(columns.tables, columns.joined)
            return columns.total
        match part.get("class"):
            case "COLUMN_REF":
                return self._names.get(folded(_last_name(part)), 1)
            case "STAR":
                expression = _expression_size(part.get("expr") or {})
                return self._total + self._size_of_parts(part) + expression
            case "CONSTANT":
                return 1 + len(str((part.get("literal") or {}).get("text"))) // _LETTERS
            case "SUBQUERY":
                return self._size_of_parts(part)
            case "CAST":
                name = folded(str((part.get("type_expr") or {}).get("type_name")))
                factor = 1 if name in _FIXED_TYPES else _CAST_FACTOR
                return factor * self._size_of_parts(part)
            case "FUNCTION":
                return self._checked(self._size_of_call(part))
        is_expression = "class" in part
        return is_expression + self._size_of_parts(part)

    def _size_of_parts(self, node: Node) -> int:
        return self._checked(sum(map(self.size, node.values())))

    def _size_of_call(self, call: Node) -> int:
        arguments = [item["expression"] for item in call["arguments"]]
        values = [one for one in arguments if one.get("class") != "LAMBDA"]
        size = self.size(values) or 1
        for function in arguments:
            if function.get("class") == "LAMBDA":  # a parameter stands for an element
                inner = dict.fromkeys(_parameters(function["lhs"]), size)
                walk = _Expressions({**self._names, **inner}, self._total, self._queries)
                size = self._checked(max(size, _LAMBDA_FACTOR * walk.size(function["expr"])))
                self._count(walk.tables, walk.joined)
        rest = [part for key, part in call.items() if key != "arguments"]
        name = folded(call["function_name"])
        is_json = "json" in name
        factor = _JSON_FACTOR if is_json else _FACTORS.get(name, 1)
        if name in REGULAR:  # it is compiled for each column that a star stands for
            copies = self._total if any(map(_has_star, values)) else 1
            size = _BOUNDED_FACTOR * size + copies * sum(map(_expression_size, values[1:2]))
        return factor * size + self.size(rest) + (not call.get("is_operator"))

    def _count(self, tables: int, joined: int) -> None:
        self.tables += tables
        self.joined += joined

    @staticmethod
    def _checked(size: int) -> int:
        _checked(_Columns(total=size))
        return size


def _expression_size(node: Node) -> int:
    """Returns the size of a regular expression that is written out; 0 for another node."""
    text = (node.get("literal") or {}).get("text")
    return _REGULAR_FACTOR * expression_size(text) if isinstance(text, str) else 0


def _has_star(part: Any) -> bool:
    if isinstance(part, list):
        return any(map(_has_star, part))
    return isinstance(part, dict) and (
        part.get("class") == "STAR" or any(map(_has_star, part.values()))
    )


def _parameters(left: Node) -> list[str]:
    """Returns the names of the parameters of a lambda."""
    parts = left.get("arguments")
    if parts:
        return [folded(_last_name(item["expression"])) for item in parts]
    return [folded(_last_name(left))]
