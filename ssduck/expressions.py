"""Expressions of a query as SQL, through sqlglot.

A part becomes SQL when its types are known and SQL means the same by it; for everything else
`NotSqlError` is raised, and the part is left to Python.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from sqlglot import exp

from ssduck import tree
from ssduck.errors import ArgumentError, UnknownNameError, nearest
from ssduck.plan import Binding, Names, Shape, Tag
from ssduck.tables import TABLES
from ssduck.tree import (
    Assignment,
    Binary,
    Call,
    Given,
    If,
    Index,
    ListOf,
    Name,
    Node,
    Query,
    Source,
    This,
    Unary,
)
from ssduck.udfs import RELATIONS, Parameter, Relation, ValueType

# Calls that do something: they are made row by row, in order.
IMPURE = frozenset(("print", "eval", "clear", "var", "help", "getTime", "to"))


class NotSqlError(Exception):
    """A part that is left to Python."""


@dataclass(frozen=True)
class SqlValue:
    """A part as SQL, its type, and for an entity how to get at its columns."""

    given: exp.Expr | None
    tag: Tag
    column: Callable[[str], exp.Expr] | None = None
    elements: tuple[SqlValue, ...] | None = None

    @property
    def sql(self) -> exp.Expr:
        """The value; of an entity its id."""
        if self.given is not None:
            return self.given
        assert self.column is not None
        return self.column("id")


_NUMBERS = ("real", "integer")
_COLUMN_TYPES: dict[str, ValueType] = {
    column.name: column.type
    for column in TABLES["entities"]
    if column.type in ("real", "integer", "text", "flag")
}
_COMPARISONS = {"==": exp.EQ, "!=": exp.NEQ, ">=": exp.GTE, ">": exp.GT, "<=": exp.LTE, "<": exp.LT}
_ARITHMETIC = {"+": exp.Add, "-": exp.Sub, "*": exp.Mul}


class Expressions:
    """The expressions of one query, over the columns of its sources.

    Args:
        shapes: what the sources are.
        names: variables, functions, and the types of what is constant in the query.

    Attributes:
        bindings: the parameters that the expressions need.
        constants: what does not depend on rows, with its type.
    """

    def __init__(self, shapes: Sequence[Shape], names: Names) -> None:
        self.shapes = {shape.alias: shape for shape in shapes}
        self.names = names
        self.only = shapes[0].alias if len(shapes) == 1 else None
        self.aliases = _sql_aliases(self.shapes)
        self.bindings: list[Binding] = []
        self.constants: dict[Node, Tag] = {}

    def column(self, alias: str, name: str) -> exp.Expr:
        """A column of a source."""
        return exp.column(name, table=exp.to_identifier(self.aliases[alias]))

    def parameter(self, stem: str, wanted: Binding) -> exp.Expr:
        """A parameter for that binding: the same one for the same."""
        for binding in self.bindings:
            if replace(binding, name="") == wanted:
                return exp.Parameter(this=exp.var(binding.name))
        stem = stem if stem.isidentifier() else "value"
        taken = {binding.name.lower() for binding in self.bindings}
        candidates = (stem if n == 1 else f"{stem}_{n}" for n in range(1, len(taken) + 2))
        name = next(name for name in candidates if name.lower() not in taken)
        self.bindings.append(replace(wanted, name=name))
        return exp.Parameter(this=exp.var(name))

    def is_constant(self, node: Node) -> bool:
        """Whether it is the same for all rows, and can be evaluated without a query of its own.

        A nested query that sees no row of this one is constant; a relation outside it is not:
        it becomes part of the SQL.
        """
        match node:
            case This(alias=alias) if alias is not None and alias not in self.shapes:
                if not self.names.has_source(alias):
                    raise UnknownNameError(
                        f"there is no source {alias!r} here",
                        span=node.span,
                        suggestions=nearest(alias, self.shapes) or list(self.shapes)[:3],
                    )
                return True
            case This():
                return False
            case Query():
                return not free_aliases(node) & {None, *self.shapes} and not _is_impure(node)
            case Call(name=name) if name in RELATIONS or name in IMPURE:
                return False
            case Assignment():
                return False
        return all(self.is_constant(child) for child in node.children())

    def _own(self, node: This) -> bool:
        return node.alias is None or node.alias in self.shapes

    def row(self, alias: str) -> SqlValue:
        """The current element of a source."""
        shape = self.shapes[alias]
        if shape.tag is None or shape.tag.type == "entity":
            schema = shape.schema if shape.tag is None else shape.tag.schema
            return SqlValue(
                self.column(alias, "id"),
                Tag("entity", schema=schema),
                lambda name: self.column(alias, name),
            )
        if shape.tag.type == "any":
            return SqlValue(self.column(alias, "n"), shape.tag)
        return SqlValue(self.column(alias, "value"), shape.tag)

    def value(self, node: Node) -> SqlValue:
        """A part as SQL.

        Raises:
            NotSqlError: it is left to Python.
        """
        match node:
            case This() if self._own(node):
                return self._this(node)
            case tree.Literal():
                return self._literal(node)
        if self.is_constant(node):
            return self._constant(node)
        match node:
            case Call(name=name) if name in RELATIONS:
                return self._relation(RELATIONS[name], node)
            case Call():
                self.names.check_call(node)
                raise NotSqlError
            case Unary(operator="NOT", operand=operand):
                return SqlValue(
                    exp.Not(this=_wrapped(self.truth(self.value(operand)))), Tag("flag")
                )
            case Unary(operator=sign, operand=operand):
                inner = self._number(operand)
                return (
                    SqlValue(exp.Neg(this=_wrapped(inner.sql)), inner.tag) if sign == "-" else inner
                )
            case Binary():
                return self._binary(node)
            case Index(base=base, indices=(tree.Literal(value=int() as index),)):
                elements = self.value(base).elements or ()
                if 0 <= index < len(elements):
                    return elements[index]
            case ListOf(items=items):
                return self._list([self.value(item) for item in items])
            case If(condition=condition, then=(then,), otherwise=(otherwise,)):
                return self._choice(condition, then, otherwise)
        raise NotSqlError

    def _literal(self, node: tree.Literal) -> SqlValue:
        tag = self.names.tag(node)
        match node.value:
            case _ if tag.type == "any":  # a number too large for SQL
                raise NotSqlError
            case float(number):
                text = repr(number)
                # DuckDB takes a number for a DOUBLE, and not for a DECIMAL, by its exponent.
                return SqlValue(exp.Literal.number(text if "e" in text else f"{text}e0"), tag)
            case value:
                return SqlValue(exp.convert(value), tag)

    def _this(self, node: This) -> SqlValue:
        alias = node.alias if node.alias is not None else self.only
        if alias is None:
            raise ArgumentError(
                f"'this' alone is ambiguous here; write one of "
                f"{', '.join(f'{name}.this' for name in self.shapes)}",
                span=node.span,
            )
        value = self.row(alias)
        if value.tag.type == "any":
            raise NotSqlError
        return value

    def _constant(self, node: Node) -> SqlValue:
        tag = self.constants.setdefault(node, self.names.tag(node))
        if tag.type == "any":
            raise NotSqlError
        stem = node.name if isinstance(node, Name | Given) else "value"
        if tag.type != "entity":
            return SqlValue(self.parameter(stem, Binding("", node, type=tag.type)), tag)

        def column(name: str) -> exp.Expr:
            wanted = Binding("", node, name, type=_COLUMN_TYPES[name])
            return self.parameter(f"{stem}_{name}", wanted)

        return SqlValue(None, tag, column)  # its columns become parameters as they are asked for

    def _relation(self, relation: Relation, node: Call) -> SqlValue:
        self.names.check_call(node)
        count = len(node.arguments)
        values = {
            parameter.name: self._argument(parameter, argument)
            for parameter, argument in zip(relation.parameters, node.arguments, strict=False)
        }
        formula = relation.expressions[count]
        if relation.result == "entity":
            (entity,) = values.values()

            def column(name: str) -> exp.Expr:
                return _expanded(formula, values, name)

            return SqlValue(None, replace(entity.tag, nullable=relation.name != "obj"), column)
        sql = _expanded(formula, values)
        if isinstance(sql, exp.Array):
            elements = tuple(SqlValue(part, Tag("real")) for part in sql.expressions)
            return SqlValue(sql, Tag("list", "real", len(elements)), elements=elements)
        return SqlValue(sql, Tag(relation.result, "real" if relation.result == "list" else None))

    def _argument(self, parameter: Parameter, node: Node) -> SqlValue:
        value = self.value(node)
        if value.tag.nullable:
            raise NotSqlError  # in SQL nothing would be unknown, in Python it is an error
        if value.tag.type == parameter.type:
            return value
        if parameter.type == "place" and value.tag.type == "entity":
            return value
        if parameter.type == "place" and value.tag.type == "list" and value.tag.element in _NUMBERS:
            if value.tag.length != 3:
                raise ArgumentError(
                    f"{parameter.name} is to be {parameter.meaning}, not a list of another length",
                    span=node.span,
                )
            index = {"x": 1, "y": 2, "z": 3}
            return SqlValue(
                value.sql,
                value.tag,
                lambda name: exp.func(
                    "list_extract", value.sql.copy(), exp.Literal.number(index[name])
                ),
            )
        raise ArgumentError(
            f"{parameter.name} is to be {parameter.meaning}, not {_worded(value.tag)}",
            span=node.span,
        )

    def _binary(self, node: Binary) -> SqlValue:
        sign = node.operator
        if sign in ("AND", "OR", "XOR"):
            left, right = (self.truth(self.value(side)) for side in (node.left, node.right))
            joined: exp.Expr
            if sign == "XOR":
                joined = exp.NEQ(this=_wrapped(left), expression=_wrapped(right))
            else:
                joined = exp.and_(left, right) if sign == "AND" else exp.or_(left, right)
            return SqlValue(exp.paren(joined), Tag("flag"))
        if sign in _ARITHMETIC:
            return self._arithmetic(_ARITHMETIC[sign], node)
        if sign == "/":
            return self._quotient(node)
        if sign in _COMPARISONS:
            return self._comparison(sign, self.value(node.left), self.value(node.right))
        if sign == "IN":
            return self._membership(self.value(node.left), self.value(node.right))
        raise NotSqlError

    def _arithmetic(self, kind: type[exp.Binary], node: Binary) -> SqlValue:
        left, right = self._number(node.left), self._number(node.right)
        if left.tag.type == right.tag.type == "integer":
            raise NotSqlError  # Python's integers have no end
        sql = kind(this=_wrapped(left.sql), expression=_wrapped(right.sql))
        return SqlValue(exp.paren(sql), Tag("real"))

    def _quotient(self, node: Binary) -> SqlValue:
        """A division whose divisor cannot be 0; DuckDB would yield NULL, Python raises."""
        if not (isinstance(node.right, tree.Literal) and node.right.value):
            raise NotSqlError
        left, right = self._number(node.left), self._number(node.right)
        sql = exp.Div(this=_wrapped(left.sql), expression=right.sql, typed=False, safe=False)
        return SqlValue(exp.paren(sql), Tag("real"))

    def _comparison(self, sign: str, left: SqlValue, right: SqlValue) -> SqlValue:
        if left.tag.nullable or right.tag.nullable:
            raise NotSqlError  # NULL is equal to nothing, not even to NULL
        kinds = left.tag.type, right.tag.type
        alike = (
            all(kind in _NUMBERS for kind in kinds)
            or kinds == ("text", "text")
            or (sign in ("==", "!=") and kinds in (("entity", "entity"), ("flag", "flag")))
            or (sign in ("==", "!=") and kinds == ("list", "list") and _numeric(left, right))
        )
        if not alike or left.tag.schema != right.tag.schema:
            raise NotSqlError
        kind = _COMPARISONS[sign]
        return SqlValue(kind(this=_wrapped(left.sql), expression=_wrapped(right.sql)), Tag("flag"))

    def _membership(self, left: SqlValue, right: SqlValue) -> SqlValue:
        if left.tag.type == right.tag.type == "text":
            return SqlValue(exp.func("contains", right.sql, left.sql), Tag("flag"))
        fits = right.tag.type == "list" and (
            (left.tag.type in _NUMBERS and right.tag.element in _NUMBERS)
            or (left.tag.type == "text" and right.tag.element == "text")
        )
        if not fits:
            raise NotSqlError
        return SqlValue(exp.func("list_contains", right.sql, left.sql), Tag("flag"))

    def _list(self, values: list[SqlValue]) -> SqlValue:
        kinds = {value.tag.type for value in values}
        if len(kinds) != 1 or not kinds <= {"real", "text", "flag", "integer"}:
            raise NotSqlError
        sql = exp.Array(expressions=[value.sql.copy() for value in values])
        return SqlValue(sql, Tag("list", kinds.pop(), len(values)), elements=tuple(values))

    def _choice(self, condition: Node, then: Node, otherwise: Node) -> SqlValue:
        first, second = self.value(then), self.value(otherwise)
        if first.tag != second.tag or first.tag.type == "entity":
            raise NotSqlError
        case = exp.case().when(self.truth(self.value(condition)), first.sql).else_(second.sql)
        return SqlValue(case, first.tag)

    def _number(self, node: Node) -> SqlValue:
        value = self.value(node)
        if value.tag.type not in _NUMBERS:
            raise NotSqlError
        return value

    def truth(self, value: SqlValue) -> exp.Expr:
        """A value as a condition: numbers are true unless 0, texts unless empty."""
        match value.tag.type:
            case "flag":
                return value.sql
            case "real" | "integer":
                return exp.NEQ(this=_wrapped(value.sql), expression=exp.Literal.number(0))
            case "text":
                return exp.NEQ(this=_wrapped(value.sql), expression=exp.Literal.string(""))
            case "entity":
                return exp.Not(this=exp.Is(this=value.sql, expression=exp.Null()))
        raise NotSqlError


def _expanded(
    formula: exp.Expr, values: Mapping[str, SqlValue], name: str | None = None
) -> exp.Expr:
    """A relation's formula with its parameters put in.

    Args:
        formula: over columns of the parameters.
        values: what the parameters stand for.
        name: the column to be taken instead of `name`, for a relation that yields an entity.
    """

    def put_in(part: exp.Expr) -> exp.Expr:
        if not isinstance(part, exp.Column):
            return part
        if not part.table:
            return _wrapped(values[part.name].sql.copy())
        column = values[part.table].column
        assert column is not None, f"{part.table} has no columns"
        return column(name if name is not None and part.name == "name" else part.name)

    expanded: exp.Expr = formula.copy().transform(put_in)
    return exp.paren(expanded) if isinstance(expanded, exp.Connector) else expanded


def _sql_aliases(names: Iterable[str]) -> dict[str, str]:
    """What sources are called in SQL, which does not tell upper from lower case."""
    aliases: dict[str, str] = {}
    for name in names:
        taken = {alias.casefold() for alias in aliases.values()}
        alike = sum(name.casefold() == other.casefold() for other in aliases)
        alias = f"{name} {alike + 1}" if name.casefold() in taken else name
        aliases[name] = alias
    return aliases


def _wrapped(sql: exp.Expr) -> exp.Expr:
    """In parentheses where it is not a single term."""
    return (
        exp.paren(sql)
        if isinstance(sql, exp.Binary | exp.Unary) and not isinstance(sql, exp.Paren)
        else sql
    )


def _numeric(left: SqlValue, right: SqlValue) -> bool:
    return left.tag.element in _NUMBERS and right.tag.element in _NUMBERS


def free_aliases(node: Node) -> set[str | None]:
    """The aliases whose `this` a part mentions, and that no query in it has as a source."""
    if isinstance(node, This):
        return {node.alias}
    found: set[str | None] = set()
    for child in node.children():
        if not (isinstance(node, Query) and isinstance(child, Source)):
            found |= free_aliases(child)
    if isinstance(node, Query):
        found -= {None, *(source.alias for source in node.sources)}
        for source in node.sources:  # a source sees what is around the query
            found |= free_aliases(source)
    return found


def sees_outside(query: Query) -> bool:
    """Whether a nested query sees rows of the queries around it."""
    return bool(free_aliases(query))


def _is_impure(node: Node) -> bool:
    return any(
        isinstance(part, Assignment) or (isinstance(part, Call) and part.name in IMPURE - {"to"})
        for part in node.walk()
    )


def _worded(tag: Tag) -> str:
    words: dict[ValueType, str] = {
        "entity": "an entity",
        "real": "a number",
        "integer": "a number",
        "text": "a text",
        "flag": "True or False",
        "list": "a list",
        "nothing": "nothing",
    }
    return words.get(tag.type, "such a value")
