"""Expressions of a query as SQL, through sqlglot.

A part becomes SQL when its types are known and SQL means the same by it; for everything else
`NotSqlError` is raised, and the part is left to Python. What SQL could fail at (an overflow, a
division by zero, an index out of range) is SQL unless the plan is to be cautious; if it does
fail, the query runs again by a cautious plan, and Python has the last word.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from sqlglot import exp

from ssduck import subqueries, tree
from ssduck.arithmetic import arithmetic, double_of
from ssduck.dependencies import IMPURE, OVER_TIME, free_aliases, is_impure
from ssduck.elements import Follower, Span, follower, pairs_then
from ssduck.errors import ArgumentError, UnknownNameError, nearest
from ssduck.formulas import expanded, looked_up
from ssduck.messages import shown
from ssduck.plan import Binding
from ssduck.relations import Parameter, Relation
from ssduck.sqlvalues import (
    Context,
    Extent,
    NotSqlError,
    SqlValue,
    column_tag,
    copied,
    failure,
    literal,
    or_failure,
    wrapped,
)
from ssduck.tree import (
    Aged,
    Assignment,
    Bare,
    Binary,
    Call,
    Given,
    If,
    Index,
    ListOf,
    Name,
    Node,
    Query,
    This,
    Unary,
)
from ssduck.types import ANY, EXACT, FLAG, INTEGER, REAL, TEXT, Tag, merged
from ssduck.udfs import RELATIONS

_COMPARISONS = {"==": exp.EQ, "!=": exp.NEQ, ">=": exp.GTE, ">": exp.GT, "<=": exp.LTE, "<": exp.LT}
# Of these values none is equal to one of another kind.
_APART = ("text", "list", "number")
# Functions of reals that C has, so that SQL and Python agree to the last digit.
_OF_REALS = ("sin", "cos", "tan", "atan")
# Longer lists of literals are parameters.
MOST_WRITTEN = 32


class Expressions:
    """The expressions of one query, over the elements of its sources.

    Args:
        context: what all expressions of the statement share.
        around: the expressions of the query around this one.

    Attributes:
        rows: the current element of each source, by alias.
        only: the alias of the only source.
        locals: the state variables of a hierarchical query.
    """

    def __init__(self, context: Context, around: Expressions | None = None) -> None:
        self.context = context
        self.names = context.names
        self.around = around
        self.rows: dict[str, SqlValue] = {}
        self.only: str | None = None
        self.locals: Mapping[str, SqlValue] = around.locals if around else {}
        self._are_constant: dict[Node, bool] = {}
        # Handles at the ticks of rows of the past, by both.
        self.followers: dict[tuple[str, ...], Follower] = {}
        self._parameters: dict[str, exp.Expr] = {}
        # Of sources that are several ticks, which ones, by the tick of the current row.
        self.spans: dict[str, Span] = {}

    def inside(self) -> Expressions:
        """The expressions of a query nested in this one."""
        return Expressions(self.context, self)

    def certain(self, value: SqlValue) -> SqlValue:
        """A value that is a number where it is used; what is none is left to Python."""
        if value.extent < Extent.NAN:
            return value
        self.context.risk()
        is_none = exp.func("isnan", copied(value.sql))
        case = exp.case().when(is_none, failure(value.tag)).else_(value.sql)
        return replace(value, given=case, extent=Extent.INFINITE)

    # -- what does not depend on rows -------------------------------------------------------

    def element(self, alias: str | None) -> SqlValue | None:
        """The current element of a source of this query or of one around it in SQL."""
        name = self.only if alias is None else alias
        if name is not None and name in self.rows:
            return self.rows[name]
        # `this` alone is never that of a query further out.
        return self.around.element(alias) if self.around and alias is not None else None

    def is_constant(self, node: Node) -> bool:
        """Whether it is the same for all rows of the statement."""
        if node not in self._are_constant:  # each part is asked about, and all that it is in
            self._are_constant[node] = self._is_constant(node)
        return self._are_constant[node]

    def _is_constant(self, node: Node) -> bool:
        match node:
            case This():
                return self._is_outside(node)
            case Bare() | Assignment():
                return False
            case Name(name=name):
                deferred = self.context.list_in(name)
                if deferred is not None:
                    return self.is_constant(deferred)
                return name not in self.context.changing
            case Aged(name=name) if name in self.context.changing:
                return False
            case Query():
                return (
                    all(self._sees_nothing(alias) for alias in free_aliases(node))
                    and not is_impure(node)
                    and not any(self._is_changing(part) for part in node.walk())
                )
            case Call(name=name) if name in RELATIONS or name in IMPURE or name in OVER_TIME:
                return False
        return all(self.is_constant(child) for child in node.children())

    def _is_outside(self, node: This) -> bool:
        if node.alias is None or self.element(node.alias) is not None:
            return False
        if not self.names.has_source(node.alias):
            known = list(self.rows)
            raise UnknownNameError(
                f"there is no source {shown(node.alias)} here",
                span=node.span,
                suggestions=nearest(node.alias, known) or known[:3],
            )
        return True

    def _sees_nothing(self, alias: str | None) -> bool:
        return alias is not None and self.element(alias) is None

    def _is_changing(self, node: Node) -> bool:
        if not isinstance(node, Name | Aged):
            return False
        return node.name in self.context.changing or self.context.list_in(node.name) is not None

    # -- values -----------------------------------------------------------------------------

    def value(self, node: Node) -> SqlValue:
        """A part as SQL.

        Raises:
            NotSqlError: it is left to Python.
        """
        before = self.context.risks
        value = self._value(node)
        if self.context.risks == before or value.risky:
            return value
        if isinstance(value.given, exp.Boolean):
            raise NotSqlError  # what could fail would not be evaluated
        return replace(value, risky=True)

    def _value(self, node: Node) -> SqlValue:
        match node:
            case This() if node.alias is None or self.element(node.alias) is not None:
                return self._this(node)
            case tree.Literal():
                return self._literal(node)
            case Name(name=name) if name in self.locals:
                return self.locals[name]
            case Name(name=name) if (deferred := self.context.list_in(name)) is not None:
                return self.value(deferred)
            case Query():
                return self._query(node)
            case ListOf(items=items) if _is_short(items):
                return self.list_of([self.value(item) for item in items])
        if self.is_constant(node):
            return self._constant(node)
        match node:
            case Call():
                return self._call(node)
            case Unary(operator="NOT", operand=operand):
                return SqlValue(exp.Not(this=wrapped(self.truth(self.value(operand)))), FLAG)
            case Unary(operator=sign, operand=operand):
                inner = self._number(operand)
                if sign == "+":
                    return inner
                return replace(inner, given=exp.Neg(this=wrapped(inner.sql)), elements=None)
            case Binary():
                return self._binary(node)
            case Index():
                return self._index(node)
            case ListOf(items=items):
                return self.list_of([self.value(item) for item in items])
            case If(condition=condition, then=(then,), otherwise=(otherwise,)):
                return self._choice(condition, then, otherwise)
        raise NotSqlError

    def _query(self, node: Query) -> SqlValue:
        """A nested query: a part of the statement, else a constant if it sees no row of it."""
        try:
            if is_impure(node):
                raise NotSqlError
            return subqueries.value(self, node)
        except NotSqlError:
            if not self.is_constant(node):
                raise
        return self._constant(node)

    def _literal(self, node: tree.Literal) -> SqlValue:
        tag = self.names.tag(node)
        match node.value:
            case _ if not tag.is_sql:  # a number too large for SQL
                raise NotSqlError
            case value:
                return SqlValue(literal(value), tag)

    def _this(self, node: This) -> SqlValue:
        value = self.element(node.alias)
        if value is None:
            told = ", ".join(f"{name}.this" for name in self.rows)
            raise ArgumentError(
                f"'this' alone is ambiguous here; write one of {told}", span=node.span
            )
        if value.tag.type == "any":
            raise NotSqlError
        return value

    def _constant(self, node: Node) -> SqlValue:
        tag = self.context.constants.setdefault(node, self.names.tag(node))
        if not tag.is_sql or tag.type == "record":
            raise NotSqlError
        stem = node.name if isinstance(node, Name | Given) else "value"
        if tag.type != "entity":
            parameter = self.context.parameter(stem, Binding("", node, tag=tag))
            if tag.type == "list":
                parameter = exp.cast(parameter, tag.sql_type, dialect="duckdb")
            return SqlValue(parameter, tag)

        def column(name: str) -> exp.Expr:
            wanted = Binding("", node, name, tag=column_tag(name))
            return self.context.parameter(f"{stem}_{name}", wanted)

        return SqlValue(None, tag, column)  # its columns become parameters as they are asked for

    # -- calls ------------------------------------------------------------------------------

    def _call(self, node: Call) -> SqlValue:
        self.names.check_call(node)
        if node.name in IMPURE or node.name in OVER_TIME:
            raise NotSqlError
        if node.name in RELATIONS:
            return self._relation(RELATIONS[node.name], node)
        if node.name == "count" and isinstance(node.arguments[0], Query):
            return subqueries.counted(self, node.arguments[0])
        values = [self.value(argument) for argument in node.arguments]
        builtin = self._builtin(node.name, values)
        if builtin is not None:
            return builtin
        signature = self.names.signature(node.name, tuple(value.tag for value in values))
        if signature is None or any(value.tag.nullable or value.wide for value in values):
            raise NotSqlError
        self.context.risk()
        self.context.signatures.add(signature)
        arguments = [
            exp.cast(value.sql.copy(), tag.sql_type, dialect="duckdb")
            for value, tag in zip(values, signature.parameters, strict=True)
        ]
        return SqlValue(
            exp.Anonymous(
                this=exp.to_identifier(signature.name, quoted=True), expressions=arguments
            ),
            signature.result,
        )

    def _builtin(self, name: str, values: list[SqlValue]) -> SqlValue | None:
        """A function of the language that SQL has too."""
        match name, values:
            case "count", [SqlValue(tag=Tag(type="list")) as value]:
                return SqlValue(exp.func("len", value.sql.copy()), INTEGER)
            case "abs", [SqlValue(tag=Tag(type="real" | "integer")) as value] if not value.wide:
                return SqlValue(exp.func("abs", value.sql.copy()), value.tag, extent=value.extent)
            case name, [value] if name in _OF_REALS and value.tag.is_number and not value.wide:
                return self._of_real(name, value)
            case "floor" | "ceil", [SqlValue(tag=Tag(type="real")) as value]:
                self.context.risk()
                whole = exp.Anonymous(this=name, expressions=[value.sql.copy()])
                return SqlValue(exp.cast(whole, "BIGINT"), INTEGER, wide=True)
            case "str", [SqlValue(tag=Tag(type="text")) as value]:
                return value
            case "str", [SqlValue(tag=Tag(type="integer")) as value]:
                return SqlValue(exp.cast(value.sql.copy(), "VARCHAR"), TEXT)
            case "sum", [SqlValue(tag=Tag(type="list", element=Tag(type="integer"))) as value]:
                self.context.risk()
                total = exp.cast(_of_list("sum", value), "BIGINT")
                nothing = exp.Literal.number(0)
                return SqlValue(exp.Coalesce(this=total, expressions=[nothing]), INTEGER, wide=True)
            case "sum", [SqlValue(tag=Tag(type="list", element=Tag(type="real"))) as value]:
                zero = exp.cast(exp.Literal.number(0), "DOUBLE")
                found = exp.Coalesce(this=_of_list("sum", value), expressions=[zero])
                # The sum of nothing is an integer.
                extent = Extent.NAN if value.extent else Extent.INFINITE
                return SqlValue(found, Tag("number"), extent=extent)
            case "min" | "max", [SqlValue(tag=Tag(type="list", element=Tag() as element)) as v] if (
                element.type in ("real", "integer", "text")
            ):
                self.context.risk()
                return SqlValue(or_failure(_of_list(name, v), element), element, extent=v.extent)
        return None

    def _of_real(self, name: str, value: SqlValue) -> SqlValue:
        """Where it is infinite, Python has no value and SQL has one that is no number."""
        self.context.risk()
        sql: exp.Expr = exp.Anonymous(this=name, expressions=[double_of(value)])
        if value.extent:
            finite = exp.func("isfinite", copied(double_of(value)))
            sql = exp.case().when(finite, sql).else_(failure(REAL))
        return SqlValue(sql, REAL)

    def _relation(self, relation: Relation, node: Call) -> SqlValue:
        count = len(node.arguments)
        values = {
            parameter.name: self._argument(parameter, argument)
            for parameter, argument in zip(relation.parameters, node.arguments, strict=False)
        }
        self._follow(values)
        then = self._at_all_ticks(relation, values, count)
        if then is not None:
            return then
        formula = relation.expressions[count]
        if relation.result == "entity":
            (entity,) = values.values()

            def column(name: str) -> exp.Expr:
                return expanded(formula, values, name)

            return SqlValue(None, replace(entity.tag, nullable=relation.name != "obj"), column)
        if relation.tables:
            formula = looked_up(relation, formula, values)
        sql = expanded(formula, values)
        extent = Extent.INFINITE if relation.is_unbounded else Extent.FINITE
        if isinstance(sql, exp.Array):
            elements = tuple(SqlValue(part, REAL, extent=extent) for part in sql.expressions)
            length = 3 if len(elements) == 3 else None
            return SqlValue(sql, Tag("list", REAL, length), elements=elements, extent=extent)
        tag = Tag(relation.yields(count))
        if tag.type == "list":
            element = Tag(relation.element)
            tag = Tag("list", Tag("list", REAL) if relation.element == "list" else element)
        return SqlValue(sql, tag, extent=extent)

    def _follow(self, values: dict[str, SqlValue]) -> None:
        """Take entities as they were at the tick of those that are of a recorded one.

        A handle goes with its world; in a query of the past it goes with that.
        """
        entities = {name: value for name, value in values.items() if value.tag.type == "entity"}
        rows = [value for value in entities.values() if value.tag.past]
        handles = {name: value for name, value in entities.items() if not value.tag.past}
        if not handles:
            return
        if not rows:
            schemas = {handle.tag.schema for handle in handles.values()}
            rows = [v for v in self._all_rows() if v.tag.past and v.tag.schema in schemas]
        if not rows:
            return
        row = rows[0]
        for name, handle in handles.items():
            if handle.tag.schema != row.tag.schema:
                continue
            if row.column is None or handle.column is None or handle.tag.nullable:
                raise NotSqlError
            tick, id = row.column("tick"), handle.column("id")
            is_constant = isinstance(id, exp.Parameter)
            if not is_constant or not self._is_of_own_row(tick):
                raise NotSqlError
            values[name] = self._follower(str(row.tag.schema), tick, id).value

    def _at_all_ticks(
        self, relation: Relation, values: Mapping[str, SqlValue], count: int
    ) -> SqlValue | None:
        """A relation of shapes at all ticks of a window at once; None where there are none."""
        candidates = relation.candidates
        if candidates is None or not candidates.are_exact:
            return None
        a, b, *others = values.values()
        if not (a.tag.past and b.tag.past):
            return None
        if a.column is None or b.column is None or self.around is not None:
            return None
        span = self.spans.get(self._leading(a.column("tick")))
        other = self.spans.get(self._leading(b.column("tick")))
        if span is None or other is None or span.schema != other.schema:
            return None
        if any(not isinstance(value.sql, exp.Parameter | exp.Literal) for value in others):
            return None
        known = dict(zip(list(values)[2:], others, strict=True))
        apart = expanded(relation.apart_of(count), known)
        ids = self._id_of(a), self._id_of(b)
        key = (relation.name, apart.sql(), span.tick.sql(), *(id.sql() for id in ids))
        if key not in self.followers:
            name = self.context.alias("pairs then")
            self.followers[key] = pairs_then(candidates, apart, span, ids, name)
        return self.followers[key].value

    def _leading(self, tick: exp.Expr) -> str:
        """The tick of the source that a handle goes with; of a source its own."""
        for (row, *_), known in self.followers.items():
            column = known.value.column
            if column is not None and column("tick").sql() == tick.sql():
                return row
        return tick.sql()

    def _id_of(self, value: SqlValue) -> exp.Expr:
        """The id of an entity: a parameter where it is the same at each tick."""
        assert value.column is not None
        for (_, id, *_), known in self.followers.items():
            if known.value is value:
                return self._parameters[id]
        span = self.spans.get(value.column("tick").sql())
        return value.column("id") if span is None or span.id is None else span.id

    def note_only(self, row: This, other: Node) -> None:
        """Note that a source's element is one entity: a constant, or one of a constant name."""
        value = self.rows.get(row.alias or self.only or "")
        if value is None or value.column is None or not value.tag.past:
            return
        span = self.spans.get(value.column("tick").sql())
        known = self.value(other) if span is not None and span.id is None else None
        if span is None or known is None:
            return
        id: exp.Expr | None = None
        if known.tag.type == "entity" and known.tag.schema == span.schema and known.column:
            id = known.column("id")
        elif known.tag.type == "text":
            models = exp.table_("entities_model", db=span.schema)
            of_name = exp.EQ(this=exp.column("name"), expression=known.sql.copy())
            id = exp.select("id").from_(models).where(of_name).subquery()
        if id is not None:
            self.spans[span.tick.sql()] = replace(span, id=id)

    def _all_rows(self) -> list[SqlValue]:
        """The current elements of all sources, those of the queries around this one first."""
        around = self.around._all_rows() if self.around is not None else []  # noqa: SLF001
        return [*around, *self.rows.values()]

    def _is_of_own_row(self, tick: exp.Expr) -> bool:
        """Whether a tick is that of a source of this query, and not of one around it."""
        own = {
            value.column("tick").sql()
            for value in self.rows.values()
            if value.tag.past and value.column
        }
        return self.around is None and tick.sql() in own

    def _follower(self, schema: str, tick: exp.Expr, id: exp.Expr) -> Follower:
        key = tick.sql(), id.sql()
        if key not in self.followers:
            name = self.context.alias("handle then")
            self.followers[key] = follower(schema, name, tick, id)
            self._parameters[id.sql()] = id
        return self.followers[key]

    def _argument(self, parameter: Parameter, node: Node) -> SqlValue:
        value = self.value(node)
        if value.tag.nullable:
            raise NotSqlError  # in SQL nothing would be unknown, in Python it is an error
        if value.extent and parameter.type == "real":
            value = self.certain(value)  # a distance may be infinite
        elif value.extent:
            raise NotSqlError  # of what is infinite, a formula may be no number
        if value.risky:
            raise NotSqlError
        if value.tag.type == parameter.type or (parameter.type == "real" and value.tag.is_number):
            return value
        if parameter.type == "place" and value.tag.type == "entity":
            return value
        element = value.tag.element
        if parameter.type == "place" and value.tag.type == "list" and element and element.is_number:
            if value.tag.length != 3:
                raise self._wrong(parameter, "a list of another length", node)
            index = {"x": 1, "y": 2, "z": 3}
            return replace(value, column=lambda name: _element_at(value, index[name]))
        raise self._wrong(parameter, value.tag.words, node)

    def _wrong(self, parameter: Parameter, found: str, node: Node) -> Exception:
        """What to raise of an argument: in a query it is wrong only if a row comes to it."""
        if self.rows or self.around is not None:
            return NotSqlError()
        message = f"{parameter.name} is to be {parameter.meaning}, not {found}"
        return ArgumentError(message, span=node.span)

    # -- operators --------------------------------------------------------------------------

    def _binary(self, node: Binary) -> SqlValue:
        sign = node.operator
        if sign in ("AND", "OR", "XOR"):
            left, right = (self.truth(self.value(side)) for side in (node.left, node.right))
            joined: exp.Expr
            if sign == "XOR":
                joined = exp.NEQ(this=wrapped(left), expression=wrapped(right))
            else:
                joined = exp.and_(left, right) if sign == "AND" else exp.or_(left, right)
            return SqlValue(exp.paren(joined), FLAG)
        if sign in ("==", "!="):
            found = subqueries.emptiness(self, node) or subqueries.equality(self, node)
            if found is not None:
                return SqlValue(found, FLAG)
        if sign == "IN" and isinstance(node.right, Query):
            found = subqueries.membership(self, node.left, node.right)
            if found is not None:
                return SqlValue(found, FLAG)
        left_value, right_value = self.value(node.left), self.value(node.right)
        if sign in _COMPARISONS:
            return self.comparison(sign, left_value, right_value)
        if sign == "IN":
            return self._membership(left_value, right_value)
        if sign == "+" and left_value.tag.type == right_value.tag.type == "text":
            joined = exp.DPipe(this=wrapped(left_value.sql), expression=wrapped(right_value.sql))
            return SqlValue(exp.paren(joined), TEXT)
        if sign == "+" and left_value.tag.type == right_value.tag.type == "list":
            return self._concatenation(left_value, right_value)
        return arithmetic(self.context, node, left_value, right_value)

    def _concatenation(self, left: SqlValue, right: SqlValue) -> SqlValue:
        tag = merged((left.tag, right.tag))
        if tag is None or not tag.comes_back:
            raise NotSqlError
        sql = exp.Anonymous(this="list_concat", expressions=[left.sql.copy(), right.sql.copy()])
        elements = None
        if left.elements is not None and right.elements is not None:
            elements = left.elements + right.elements
        extent = max(left.extent, right.extent)
        return SqlValue(sql, replace(tag, length=None), elements=elements, extent=extent)

    def comparison(self, sign: str, left: SqlValue, right: SqlValue) -> SqlValue:
        """One of the six comparisons."""
        if left.tag.nullable or right.tag.nullable:
            raise NotSqlError  # NULL is equal to nothing, not even to NULL
        kinds = tuple("number" if v.tag.is_number else v.tag.type for v in (left, right))
        equality = sign in ("==", "!=")
        if equality and kinds[0] != kinds[1] and all(kind in _APART for kind in kinds):
            return SqlValue(exp.convert(sign == "!="), FLAG)
        alike = kinds in (("number", "number"), ("text", "text")) or (
            equality and self._may_be_equal(left.tag, right.tag)
        )
        if kinds == ("number", "number") and (left.wide or right.wide):
            alike = left.tag.type == right.tag.type == "integer"
        if not alike:
            raise NotSqlError
        kind = _COMPARISONS[sign]
        if kinds == ("entity", "entity"):
            return SqlValue(kind(this=left.identity, expression=right.identity), FLAG)
        sides = (wrapped(self.certain(value).sql) for value in (left, right))
        return SqlValue(kind(this=next(sides), expression=next(sides)), FLAG)

    def _may_be_equal(self, left: Tag, right: Tag) -> bool:
        if left.type == right.type == "entity" and left.schema == right.schema:
            return True
        both = merged((left, right))
        if any(tag.element and tag.element.past for tag in (left, right)):
            return False  # equal are those of one entity, their keys or not
        return both is not None and both.type in ("entity", "flag", "list") and both.is_sql

    def _membership(self, left: SqlValue, right: SqlValue) -> SqlValue:
        if left.tag.nullable or right.tag.nullable:
            raise NotSqlError
        if left.tag.type == right.tag.type == "text":
            return SqlValue(exp.func("contains", right.sql, left.sql), FLAG)
        if right.tag.type != "list":
            raise NotSqlError
        if right.tag.element is None:
            return SqlValue(exp.false(), FLAG)
        if right.elements is not None:
            if right.risky:
                raise NotSqlError  # behind an equal one no other would be evaluated
            found = [self.comparison("==", left, element).sql for element in right.elements]
            return SqlValue(exp.paren(exp.or_(*found)), FLAG)
        both = merged((left.tag, right.tag.element))
        if both is None or not both.is_sql or left.wide or both.past:
            raise NotSqlError
        if left.tag.is_number != right.tag.element.is_number:
            raise NotSqlError
        return SqlValue(exp.func("list_contains", right.sql, self.certain(left).sql), FLAG)

    # -- lists ------------------------------------------------------------------------------

    def list_of(self, values: Sequence[SqlValue]) -> SqlValue:
        """A list that is written out."""
        tag = merged(value.tag for value in values)
        if any(value.tag.nullable or value.wide for value in values):
            raise NotSqlError
        elements = tuple(map(self.certain, values))
        extent = max((value.extent for value in elements), default=Extent.FINITE)
        if tag is None:
            return SqlValue(
                exp.cast(exp.Array(expressions=[]), "INTEGER[]"), Tag("list"), elements=()
            )
        length = 3 if len(values) == 3 else None
        if not tag.is_sql or tag.type == "record":
            if all(value.tag.is_sql for value in values):  # its elements can be reached
                return SqlValue(None, Tag("list", ANY, length), elements=elements, extent=extent)
            raise NotSqlError
        sql: exp.Expr = exp.Array(expressions=[value.sql.copy() for value in elements])
        if tag.type == "list":
            sql = exp.cast(sql, f"{tag.sql_type}[]", dialect="duckdb")
        return SqlValue(sql, Tag("list", tag, length), elements=elements, extent=extent)

    def _index(self, node: Index) -> SqlValue:
        value = self.value(node.base)
        for index in node.indices:
            value = self._at(value, index)
        return value

    def _at(self, value: SqlValue, index: Node) -> SqlValue:
        match index:
            case tree.Literal(value=str() as key) if key in value.fields:
                return value.fields[key]
            case tree.Literal(value=number) if type(number) is int and value.elements is not None:
                if value.risky:
                    raise NotSqlError  # nor would be the other elements
                if -len(value.elements) <= number < len(value.elements):
                    return value.elements[number]
        element = value.tag.element
        if value.tag.type != "list" or element is None or value.tag.nullable:
            raise NotSqlError
        if not element.is_sql:
            raise NotSqlError
        self.context.risk()
        found = exp.Anonymous(
            this="list_extract", expressions=[value.sql.copy(), self._place(index)]
        )
        return SqlValue(or_failure(found, element), element, extent=value.extent)

    def _place(self, index: Node) -> exp.Expr:
        """An index as SQL counts: from 1, or from the end."""
        match index:
            case tree.Literal(value=number) if type(number) is int and number < EXACT:
                return exp.Literal.number(number + 1)
        place = self._number(index)
        if place.tag.type != "integer":
            raise NotSqlError
        negative = exp.LT(this=wrapped(place.sql), expression=exp.Literal.number(0))
        behind = exp.Add(this=wrapped(place.sql), expression=exp.Literal.number(1))
        return exp.case().when(negative, copied(place.sql)).else_(behind)

    def _choice(self, condition: Node, then: Node, otherwise: Node) -> SqlValue:
        first, second = self.value(then), self.value(otherwise)
        if first.tag != second.tag or first.tag.type == "entity":
            raise NotSqlError
        case = exp.case().when(self.truth(self.value(condition)), first.sql).else_(second.sql)
        extent = max(first.extent, second.extent)
        return SqlValue(case, first.tag, wide=first.wide or second.wide, extent=extent)

    def _number(self, node: Node) -> SqlValue:
        value = self.value(node)
        if not value.tag.is_number or value.tag.nullable:
            raise NotSqlError
        return value

    def truth(self, value: SqlValue) -> exp.Expr:
        """A value as a condition: numbers are true unless 0, texts and lists unless empty."""
        zero = exp.Literal.number(0)
        match value.tag.type:
            case "flag":
                return value.sql
            case "real" | "integer" | "number" if not value.tag.nullable:
                return exp.NEQ(this=wrapped(value.sql), expression=zero)
            case "text" if not value.tag.nullable:
                return exp.NEQ(this=wrapped(value.sql), expression=exp.Literal.string(""))
            case "list" if not value.tag.nullable:
                if value.elements is not None:
                    if value.risky:
                        raise NotSqlError
                    return exp.convert(bool(value.elements))
                return exp.GT(this=exp.func("len", value.sql.copy()), expression=zero)
            case "entity":
                return exp.Not(this=exp.Is(this=value.sql, expression=exp.Null()))
        raise NotSqlError


def _is_short(items: Sequence[Node]) -> bool:
    """Whether a list is so short that it is written out."""
    return 0 < len(items) <= MOST_WRITTEN and all(isinstance(i, tree.Literal) for i in items)


def _of_list(function: str, value: SqlValue) -> exp.Expr:
    return exp.Anonymous(this=f"list_{function}", expressions=[value.sql.copy()])


def _element_at(value: SqlValue, place: int) -> exp.Expr:
    if value.elements is not None:
        return value.elements[place - 1].sql
    return exp.func("list_extract", value.sql.copy(), exp.Literal.number(place))
