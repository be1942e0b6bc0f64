"""Random queries of SQL on the columns of a world, which SelectScript takes as they are.

Nothing of it is SelectScript's own. The columns are those of `COLUMNS`.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from tests.support.choices import Choices

NUMBERS = ("z", "x", "y", "mass")
TEXTS = ("id", "kind", "name", "type")
FLAGS = ("isRobot", "isKinbody")
COLUMNS = (*TEXTS, *FLAGS, *NUMBERS)
_VALUES = ("0.5", "0.25", "0.85", "2", "0", "1", "0.3", "-0.25", "4")
_NAMES = ("'can'", "'robot'", "'cup'", "'kinbody'", "'table'", "'nothing'", "'lamp'")
_PATTERNS = ("'c%'", "'%a%'", "'_a_'", "'%body'", "'robot'", "'%'")
_AGGREGATES = ("max", "min", "avg", "sum")


@dataclass(frozen=True)
class _Scope:
    """The columns that are visible: the aliases of the sources, the inner ones first."""

    aliases: tuple[str, ...]
    outer: tuple[str, ...] = ()
    depth: int = 0

    def inside(self, alias):
        return _Scope((alias,), (*self.aliases, *self.outer), self.depth + 1)


@dataclass
class SqlQuery:
    """A query.

    Attributes:
        text: its text.
        is_ordered: whether the order of its rows is given.
    """

    text: str
    is_ordered: bool = False


@dataclass
class _Writer:
    choices: Choices
    count: int = 0
    is_outer_visible: bool = True
    columns: list[str] = field(default_factory=list)

    # -- values ---------------------------------------------------------------------------------

    def column(self, scope, names):
        name = self.choices.pick(names)
        outer = [alias for alias in scope.outer if alias]
        if outer and self.is_outer_visible and self.choices.chance(30):
            return f"{self.choices.pick(outer)}.{name}"
        alias = self.choices.pick(scope.aliases)
        if len(scope.aliases) == 1 and (not alias or self.choices.chance(50)):
            return name
        return f"{alias}.{name}"

    def number(self, scope, depth=2):
        kind = self.choices.below(14) if depth else self.choices.below(4)
        if kind < 3:
            return self.column(scope, NUMBERS)
        if kind == 3:
            return self.choices.pick(_VALUES)
        if kind < 8:
            sign = self.choices.pick(("+", "-", "*"))
            return f"{self.number(scope, depth - 1)} {sign} {self.number(scope, depth - 1)}"
        if kind == 8:
            return f"({self.number(scope, depth - 1)}) / {self.choices.pick(('2', '4', '0.5'))}"
        if kind == 9:
            return f"ABS({self.number(scope, depth - 1)})"
        if kind == 10:
            return f"-({self.number(scope, depth - 1)})"
        if kind == 11 and scope.depth < 2:
            return self.scalar(scope)
        condition = self.condition(scope, depth - 1)
        values = [self.number(scope, depth - 1) for _ in range(2)]
        return f"CASE WHEN {condition} THEN {values[0]} ELSE {values[1]} END"

    def text(self, scope):
        return self.column(scope, TEXTS) if self.choices.chance(85) else self.choices.pick(_NAMES)

    def scalar(self, scope):
        """A nested query of one value."""
        inner = scope.inside(self.alias())
        where = f" WHERE {self.condition(inner, 1)}" if self.choices.chance(60) else ""
        return f"(SELECT {self.aggregate(inner, 1)} FROM {self.table(inner.aliases[0])}{where})"

    def aggregate(self, scope, depth=2):
        before, self.is_outer_visible = self.is_outer_visible, False  # or it is of the outer rows
        text = self.aggregate_of_rows(scope, depth)
        self.is_outer_visible = before
        return text

    def aggregate_of_rows(self, scope, depth):
        kind = self.choices.below(8)
        if kind < 2:
            return "count(*)"
        if kind == 2:
            return f"count({self.column(scope, COLUMNS)})"
        if kind == 3:
            return f"COUNT(DISTINCT {self.column(scope, COLUMNS)})"
        name = self.choices.pick(_AGGREGATES)
        name = name.upper() if self.choices.chance(30) else name
        return f"{name}({self.number(scope, depth - 1)})"

    # -- conditions -----------------------------------------------------------------------------

    def condition(self, scope, depth=2):
        kind = self.choices.below(20) if depth else self.choices.below(9)
        sign = self.choices.pick(("=", "<", ">", "<>", "<=", ">=", "!="))
        if kind < 3:
            numbers = [self.number(scope, min(depth, 1)) for _ in range(2)]
            return f"{numbers[0]} {sign} {numbers[1]}"
        if kind < 5:
            return f"{self.column(scope, TEXTS)} {sign} {self.text(scope)}"
        if kind == 5:
            return f"{self.column(scope, TEXTS)} {self.no()}LIKE {self.choices.pick(_PATTERNS)}"
        if kind == 6:
            names = self.choices.pick(("'can'", "'can', 'cup'", "'robot', 'table'"))
            return f"{self.column(scope, TEXTS)} {self.no()}IN ({names})"
        if kind == 7:
            low, high = self.choices.pick((("0.25", "1"), ("0", "0.5"), ("1", "0")))
            return f"{self.column(scope, NUMBERS)} {self.no()}BETWEEN {low} AND {high}"
        if kind == 8:
            flag = self.column(scope, FLAGS)
            return flag if self.choices.chance(60) else f"{flag} = TRUE"
        if kind < 12:
            word = self.choices.pick(("AND", "OR"))
            return f"{self.condition(scope, depth - 1)} {word} {self.condition(scope, depth - 1)}"
        if kind == 12:
            return f"({self.condition(scope, depth - 1)})"
        if kind == 13:
            return f"NOT {self.condition(scope, 0)}"
        if kind == 14:
            return f"NOT ({self.condition(scope, depth - 1)})"
        if kind == 15:
            return f"{self.column(scope, COLUMNS)} IS {self.no()}NULL"
        if kind == 16:
            numbers = ", ".join(self.choices.pick(_VALUES) for _ in range(1 + depth))
            return f"{self.number(scope, depth - 1)} {self.no()}IN ({numbers})"
        if scope.depth >= 2:
            return f"{self.column(scope, NUMBERS)} > 0.5"
        if kind == 17:
            inner = scope.inside(self.alias())
            item = self.choices.pick(("1", "*", "count(*)"))
            where = f" WHERE {self.condition(inner, depth - 1)}"
            return f"{self.no()}EXISTS (SELECT {item} FROM {self.table(inner.aliases[0])}{where})"
        if kind == 18:
            return f"{self.column(scope, NUMBERS)} {sign} {self.scalar(scope)}"
        inner = scope.inside(self.alias())
        names = self.choices.pick((TEXTS, NUMBERS))
        column = self.column(scope, names)
        where = f" WHERE {self.condition(inner, depth - 1)}"
        item, group = self.choices.pick(names), ""
        if names is NUMBERS and self.choices.chance(30):
            item, group = f"max({item})", f" GROUP BY {self.choices.pick(TEXTS)}"
        elif self.choices.chance(20):
            group = f" GROUP BY {item}"
        table = self.table(inner.aliases[0])
        return f"{column} {self.no()}IN (SELECT {item} FROM {table}{where}{group})"

    def no(self):
        return "NOT " if self.choices.chance(30) else ""

    # -- queries --------------------------------------------------------------------------------

    def alias(self):
        self.count += 1
        return f"t{self.count}"

    def table(self, alias):
        return f"room {alias}" if alias else "room"

    def item(self, value):
        name = f"c{len(self.columns) + 1}"
        self.columns.append(name)
        return f"{value} AS {name}"

    def plain(self):
        """Rows of one source or of two."""
        source, scope, where = self.sources()
        values = []
        for _ in range(1 + self.choices.below(3)):
            kind = self.choices.below(6)
            if kind < 2:
                values.append(self.number(scope))
            elif kind < 4:
                values.append(self.column(scope, TEXTS))
            elif kind == 4:
                values.append(self.condition(scope, 1))
            else:
                values.append(self.column(scope, FLAGS))
        distinct = "DISTINCT " if self.choices.chance(15) else ""
        items = ", ".join(map(self.item, values))
        text = f"SELECT {distinct}{items} FROM {source}{self.where(scope, where)}"
        if not self.choices.chance(40):
            return SqlQuery(text)
        return SqlQuery(text + self.order(values, scope, is_total=not distinct), is_ordered=True)

    def order(self, values, scope, *, is_total):
        if is_total:
            index = self.choices.below(len(values))
            key = self.choices.pick((self.columns[index], values[index], str(index + 1)))
            key = self.columns[index] if key in _VALUES else key
            words = [f"{key}{self.choices.pick(('', ' DESC', ' ASC'))}"]
            names = [f"{alias}.id" if alias else "id" for alias in scope.aliases]
            words += names if len(scope.aliases) > 1 else [self.choices.pick((*names, "id"))]
        else:
            words = [f"{name}{self.choices.pick(('', ' DESC'))}" for name in self.columns]
        limit = f" LIMIT {self.choices.below(4)}" if self.choices.chance(50) else ""
        offset = f" OFFSET {self.choices.below(3)}" if self.choices.chance(20) else ""
        return f" ORDER BY {', '.join(words)}{limit}{offset}"

    def sources(self):
        kind = self.choices.below(10)
        if kind < 4:
            return "room", _Scope(("",)), ""
        if kind < 6:
            alias = self.alias()
            return self.table(alias), _Scope((alias,)), ""
        if kind < 7:
            alias = self.alias()
            inner = (
                f"SELECT {', '.join(COLUMNS)} FROM room WHERE {self.condition(_Scope(('',)), 1)}"
            )
            return f"({inner}) {alias}", _Scope((alias,)), ""
        first, second = self.alias(), self.alias()
        scope = _Scope((first, second))
        if kind < 9:
            word = self.choices.pick(("JOIN", "INNER JOIN"))
            condition = self.condition(scope, 1)
            return f"room {first} {word} room {second} ON {condition}", scope, ""
        return f"room {first}, room {second}", scope, f"{first}.z > {second}.z"

    def where(self, scope, where=""):
        conditions = [where] if where else []
        if self.choices.chance(60):
            condition = self.condition(scope)
            conditions.append(f"({condition})" if where else condition)
        return f" WHERE {' AND '.join(conditions)}" if conditions else ""

    def aggregated(self):
        """Aggregates of all rows."""
        source, scope, where = self.sources()
        items = ", ".join(self.item(self.computed(scope)) for _ in range(1 + self.choices.below(2)))
        having = f" HAVING {self.having(scope)}" if self.choices.chance(20) else ""
        return SqlQuery(f"SELECT {items} FROM {source}{self.where(scope, where)}{having}")

    def computed(self, scope):
        value = self.aggregate(scope)
        if self.choices.chance(25):
            value = f"{value} {self.choices.pick(('+', '-', '*'))} {self.aggregate(scope)}"
        return value

    def having(self, scope):
        bound = self.choices.pick(("1.37", "0.13", "2.9"))
        return f"{self.aggregate(scope)} {self.choices.pick(('>', '<'))} {bound}"

    def grouped(self):
        """Aggregates of groups."""
        source, scope, where = self.sources()
        keys = [self.key(scope) for _ in range(1 + self.choices.below(2))]
        keys = list(dict.fromkeys(keys))
        values = [*keys, *(self.computed(scope) for _ in range(1 + self.choices.below(2)))]
        items = ", ".join(map(self.item, values))
        written = [
            self.choices.pick((key, str(index + 1), self.columns[index]))
            for index, key in enumerate(keys)
        ]
        text = (
            f"SELECT {items} FROM {source}{self.where(scope, where)} GROUP BY {', '.join(written)}"
        )
        if self.choices.chance(40):
            name = self.columns[len(keys)]
            condition = f"{name} > 0.13" if self.choices.chance(40) else self.having(scope)
            text += f" HAVING {condition}"
        if not self.choices.chance(40):
            return SqlQuery(text)
        order = [self.columns[len(keys)], *self.columns[: len(keys)]]
        order[0] = self.choices.pick((order[0], values[len(keys)], str(len(keys) + 1)))
        descending = self.choices.pick(("", " DESC"))
        limit = f" LIMIT {self.choices.below(3)}" if self.choices.chance(40) else ""
        text += f" ORDER BY {order[0]}{descending}, {', '.join(order[1:])}{limit}"
        return SqlQuery(text, is_ordered=True)

    def key(self, scope):
        kind = self.choices.below(5)
        if kind < 3:
            return self.column(scope, (*TEXTS, *FLAGS))
        if kind == 3:
            return f"{self.column(scope, NUMBERS)} > 0.5"
        condition = self.condition(scope, 0)
        return f"CASE WHEN {condition} THEN 'yes' ELSE 'no' END"


def sql_query(choices):
    """Returns a query that choices determine."""
    writer = _Writer(choices)
    kind = choices.below(10)
    if kind < 5:
        return writer.plain()
    return writer.aggregated() if kind < 7 else writer.grouped()
