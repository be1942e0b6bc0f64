"""Rewrites users' SQL so that relations use all pairs of the tick, found at once.

A statement is changed only where a relation is called for two rows of entities that come from a
world's table unchanged; the rest of its text stays as it is. There are five forms:

- A condition that all rows satisfy becomes a join with the table of pairs.
- In the condition of an outer, SEMI or ANTI join, the table on its right is joined with the pairs
  first, in brackets.
- An EXISTS whose subquery is joined with the pairs says whether the entity is one of theirs.
- Elsewhere (under NOT, in OR, in the selected columns), a call becomes a check whether the pair is
  in the table. The macro answers for an entity whose pose is unknown.
- A call whose pairs cannot be found at once becomes its formula, without the check that the row
  belongs to the tick.

Of a relation of a box and a position (`above`), only a join of two whole tables is rewritten, or of
ranges of them: the macro is a formula, which DuckDB evaluates fast where other conditions leave few
rows.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import count

import sqlglot
from sqlglot import exp
from sqlglot.tokenizer_core import Token, TokenType

from ssduck.database.statement_names import (
    ExistsCondition,
    Scope,
    Source,
    WorldNames,
    exists_condition,
    is_inner,
    is_one_sided,
)
from ssduck.recording.stores.history_sql import quoted
from ssduck.schema import ID_FACTOR
from ssduck.sql.from_clause import pair_table
from ssduck.sql.pair_lookup import JoinedPairs, PairLookup, pair_lookup
from ssduck.sql.relation_calls import expanded
from ssduck.sql.relations.geometry_query import UNKNOWN, PairSearch
from ssduck.sql.relations.registry import RELATIONS
from ssduck.sql.relations.relation import Relation, in_schema
from ssduck.sql.sql_values import SqlValue
from ssduck.sql.types import DOUBLE, SqlType
from ssduck.sql.user_sql import (
    MAX_LENGTH,
    Edit,
    edited,
    statement_trees,
)

_RELATIONS = {
    relation.name.lower(): relation
    for relation in RELATIONS.values()
    if relation.geometry is not None or relation.candidate_pairs is not None
}
# The largest number of calls that are rewritten: the time grows with its square.
MAX_MENTIONS = 40
_RANGES = (exp.LT, exp.LTE, exp.GT, exp.GTE, exp.Between)
_MENTIONED = re.compile(rf"\b({'|'.join(_RELATIONS)})\b", re.IGNORECASE | re.ASCII)


def mentions_relations(sql: str) -> bool:
    """Checks whether a statement may call a relation that can be rewritten."""
    return len(sql) <= MAX_LENGTH and 1 <= len(_MENTIONED.findall(sql)) <= MAX_MENTIONS


def parsed(sql: str) -> exp.Expr | None:
    """Returns the tree of a query; None for other statements, and what sqlglot does not know."""
    statements = statement_trees(sql)
    return statements[0] if len(statements) == 1 and isinstance(statements[0], exp.Query) else None


def rewritten(sql: str, calls: Sequence[RelationCall], *, only_joins: bool) -> str | None:
    """Returns a statement with its relations rewritten; None if there is nothing to rewrite.

    With `only_joins`, calls outside of joins become formulas, as DuckDB does not allow a subquery
    everywhere.
    """
    edits: list[Edit] = []
    numbers = count(1)
    for call in calls:
        if only_joins and not call.is_joined:
            edits.append(Edit(call.start, call.end, call.formula()))
        else:
            edits += call.edits(f"ssduck pairs {next(numbers)}")
    return edited(sql, edits) if edits else None


def number_parameters(calls: Sequence[RelationCall]) -> frozenset[str]:
    """Returns the parameters that are arguments of the relations that `rewritten` rewrites."""
    found = (_parameter(number) for call in calls for number in call.numbers)
    return frozenset(name for name in found if name is not None)


def lookup_of(tree: exp.Expr, calls: Sequence[RelationCall]) -> PairLookup | None:
    """Returns the look-up that replaces a query of all pairs; None if it does more than look up."""
    clauses = {name for name, value in tree.args.items() if value}
    if len(calls) != 1 or not clauses <= {"expressions", "from_", "joins", "where"}:
        return None
    (call,) = calls
    sources = list(call.scope.sources.values())
    is_plain = call.scope.select is tree and len(sources) == 2 and call.join_place() is not None
    is_plain = is_plain and all(isinstance(item, exp.Table) for item in call.scope.items)
    is_plain = is_plain and all(entity in sources for entity in call.entities)
    is_plain = is_plain and all(is_inner(join) for join in call.scope.joins)
    if not is_plain or call.search is None or {*call.entities} != {*sources}:
        return None
    pairs = JoinedPairs(call.schema, call.search, call.distance(), call.node)
    tables = [source.text for source in call.entities]  # in the order of the pairs
    columns = [column.unalias() for column in tree.expressions]
    return pair_lookup(pairs, tables, list(call.scope.conditions()), columns)


@dataclass(frozen=True, eq=False)
class RelationCall:
    """A call of a relation for two rows of entities of one world."""

    sql: str
    tokens: list[Token]
    node: exp.Expr
    start: int
    end: int
    relation: Relation
    entities: tuple[Source, ...]
    numbers: tuple[exp.Expr, ...]
    schema: str
    scope: Scope

    @property
    def search(self) -> PairSearch | None:
        """The search for its pairs; None if a condition leaves few of them, or there is none."""
        pairs = self.relation.candidate_pairs
        if pairs is None or any(entity.is_selected for entity in self.entities):
            return None
        if pairs.search.of_boxes and not self._is_of_whole_tables():
            return None
        return pairs.search

    def _is_of_whole_tables(self) -> bool:
        """Checks whether no condition leaves only few rows of the two sources of its SELECT."""
        sources = self.scope.sources
        if [*sources.values()] not in ([*self.entities], [*self.entities][::-1]):
            return False
        if not all(isinstance(item, exp.Table) for item in self.scope.items):
            return False
        for part in self.scope.conditions():
            columns = list(part.find_all(exp.Column))
            names = {(column.table or column.name).lower() for column in columns}
            is_range = isinstance(part, _RANGES) and names < sources.keys()
            if part.find(exp.Query) is not None or not (names == sources.keys() or is_range):
                return False
        return True

    def edits(self, name: str) -> Iterator[Edit]:
        """Yields the changes of the statement."""
        search, place = self.search, self.join_place()
        if search is None:
            yield Edit(self.start, self.end, self.formula())
        elif (outer := self._outer_table()) is not None:
            yield from self._outer_edits(search, *outer, name)
        elif place is None:
            yield Edit(self.start, self.end, self._membership(search))
        else:
            exists = self._exists(search)
            if exists is not None:
                yield from self._exists_edits(search, exists, name)
                return
            yield Edit(place, place, f" CROSS JOIN {self._pair_table(search, name)}")
            yield from self._expanded_stars()
            yield self._paired(search, name, range(2))

    def _paired(self, search: PairSearch, name: str, places: Iterable[int]) -> Edit:
        """Returns the change of the call to the condition that entities are those of a pair."""
        condition = " AND ".join(self._is_in_pair(place, name) for place in places)
        if not search.is_exact:
            condition += f" AND {self.formula()}"
        return Edit(self.start, self.end, f"({condition})")

    def _exists_edits(
        self, search: PairSearch, exists: ExistsCondition, name: str
    ) -> Iterator[Edit]:
        """Yields the changes of EXISTS to whether the entity around it is one of the pairs'."""
        place = self.join_place()
        assert place is not None
        outer = self._outer_place()
        entity, places = self.entities[outer], [1 - outer]
        joined = f" CROSS JOIN {self._pair_table(search, name)}"
        if exists.reads_outer:  # the subquery gets a row of the entity of its own
            joined += f" CROSS JOIN {quoted(self.schema)}.entities AS {quoted(entity.text)}"
            places.append(outer)
        column = f"{name} {'ab'[outer]}"
        selected = f"{quoted(name)}.{quoted(column)}"
        # Of a row that a LEFT JOIN did not find, the id is NULL, and nothing exists.
        yield Edit(exists.start, exists.list_start, f"COALESCE({_id_of(entity)} IN (")
        yield Edit(exists.list_start, exists.list_end, f"SELECT {selected} ")
        yield Edit(place, place, joined)
        yield self._paired(search, name, places)
        yield Edit(exists.end, exists.end, ", FALSE)")

    def _outer_place(self) -> int:
        """Returns which of the two entities is not of the call's own SELECT; 0 for none."""
        own = self.scope.sources.values()
        return next((n for n, entity in enumerate(self.entities) if entity not in own), 0)

    def _exists(self, search: PairSearch) -> ExistsCondition | None:
        """Returns the EXISTS that needs only the pairs and one of its entities; None for none."""
        scope, outer = self.scope, self.entities[self._outer_place()]
        if outer in scope.sources.values() or outer.columns is None:
            return None
        called = [call.name.lower() for call in scope.select.find_all(exp.Anonymous)]
        called += ["contains" for _ in scope.select.find_all(exp.Contains)]
        if sum(name in _RELATIONS for name in called) > 1:
            return None
        reads = not search.is_exact  # by the formula
        return exists_condition(scope, self.node, self.start, self.tokens, outer, reads=reads)

    def _is_in_pair(self, place: int, name: str) -> str:
        """Returns the condition that an entity is that of a row of a table of pairs."""
        column = quoted(f"{name} {'ab'[place]}")
        return f"{_id_of(self.entities[place])} = {quoted(name)}.{column}"

    @property
    def is_joined(self) -> bool:
        """Whether a table of pairs can be joined in its place."""
        return self.join_place() is not None or self._outer_table() is not None

    def _outer_edits(
        self, search: PairSearch, table: exp.Table, place: int, name: str
    ) -> Iterator[Edit]:
        """Yields the changes of a call in the condition of an outer join."""
        start, end = start_of(table), _end_of(table)
        assert start is not None
        assert end is not None
        pairs, condition = self._pair_table(search, name), self._is_in_pair(place, name)
        yield Edit(start, start, "(")
        yield Edit(end, end, f" JOIN {pairs} ON {condition})")
        yield from self._expanded_stars()
        yield self._paired(search, name, [1 - place])

    def _outer_table(self) -> tuple[exp.Table, int] | None:
        """Returns the table on the right of an outer join on the call, and whose row is of it."""
        parent = self._position().parent
        if self.search is None or not (isinstance(parent, exp.Join) and is_one_sided(parent)):
            return None
        sources, table = self.scope.sources, parent.this
        if _owner(parent) is not self.scope.select or not isinstance(table, exp.Table):
            return None
        right = sources.get(table.alias_or_name.lower())
        is_known = right in self.entities and all(e in sources.values() for e in self.entities)
        if right is None or not is_known or None in (start_of(table), _end_of(table)):
            return None
        if not self._can_expand_stars():
            return None
        return table, self.entities.index(right)

    def _position(self) -> exp.Expr:
        """Returns the condition of which the call is a part that has to hold."""
        position = self.node
        while isinstance(position.parent, exp.Paren | exp.And):
            position = position.parent
        return position

    def join_place(self) -> int | None:
        """Returns the index at which a table of pairs can be joined; None if it cannot be.

        The call is a condition of all rows of its SELECT, and the table follows the first source.
        """
        select, position = self.scope.select, self._position()
        parent = position.parent
        is_condition = (parent is not None and parent is select.args.get("where")) or (
            isinstance(parent, exp.Join) and is_inner(parent) and parent.args.get("on") is position
        )
        owner = None if parent is None else parent.find_ancestor(exp.Select)
        is_own = any(entity in self.scope.sources.values() for entity in self.entities)
        if self.search is None or not (is_condition and owner is select and is_own):
            return None
        if not self._can_expand_stars():
            return None
        return _end_of(self.scope.items[0])

    def _can_expand_stars(self) -> bool:
        """Checks whether no star would include the columns of the table of pairs."""
        select = self.scope.select
        stars = [star for star in select.find_all(exp.Star) if _owner(star) is select]
        if isinstance(select.parent, exp.Exists):  # its columns do not matter
            stars = []
        for star in stars:
            if isinstance(star.parent, exp.Count | exp.Column):
                continue
            is_written = self.sql[star.meta.get("start", 0) :][:1] == "*"
            if star.parent is not select or any(star.args.values()) or not is_written:
                return False
        is_plain = all(is_inner(join) or is_one_sided(join) for join in self.scope.joins)
        is_plain = is_plain and not any(join.args.get("using") for join in self.scope.joins)
        is_plain = is_plain and all(source.text for source in self.scope.sources.values())
        has_columns = any(_owner(part) is select for part in select.find_all(exp.Columns))
        return is_plain and not has_columns

    def _expanded_stars(self) -> Iterator[Edit]:
        """Yields the changes of `*` to the columns of all sources but the table of pairs."""
        select = self.scope.select
        if isinstance(select.parent, exp.Exists):
            return
        hidden = {j.this.alias_or_name for j in self.scope.joins if j.kind in ("SEMI", "ANTI")}
        sources = [s.text for s in self.scope.sources.values() if s.text not in hidden]
        columns = ", ".join(f"{quoted(source)}.*" for source in sources)
        for star in select.expressions:
            if isinstance(star, exp.Star):
                start = star.meta["start"]
                yield Edit(start, start + 1, columns)

    def distance(self) -> exp.Expr:
        """Returns the distance or the depth of its pairs, m."""
        parameters = self.relation.parameters
        names = [parameter.name for parameter in parameters[2 : 2 + len(self.numbers)]]
        values = {
            name: SqlValue(number, DOUBLE) for name, number in zip(names, self.numbers, strict=True)
        }
        return expanded(self.relation.candidate_distance(2 + len(self.numbers)), values)

    def _pair_table(self, search: PairSearch, name: str) -> str:
        """Returns the table of pairs, whose columns have names that no statement has."""
        table = pair_table(search, self.distance(), self.schema, "found").table
        columns = (exp.alias_(exp.column(side), f"{name} {side}", quoted=True) for side in "ab")
        subquery = exp.select(*columns).from_(table).subquery(exp.to_identifier(name, quoted=True))
        return subquery.sql("duckdb")

    def _membership(self, search: PairSearch) -> str:
        """Returns the check whether the pair is among those of the tick."""
        table = pair_table(search, self.distance(), self.schema, "found").table
        numbers = exp.select("n").from_(table).sql("duckdb")
        ids = [_id_of(entity) for entity in self.entities]
        a, b = (f"({id})::BIGINT" for id in ids)
        unknown = exp.Anonymous(
            this=exp.to_identifier(UNKNOWN.name, quoted=True),
            expressions=[exp.Literal.string(self.schema), exp.Literal.string("entities")],
        )
        is_unknown = " OR ".join(
            f"{id} IS NULL OR {id} IN (SELECT unnest({unknown.sql('duckdb')}))" for id in ids
        )
        formula = self.formula()
        holds = "TRUE" if search.is_exact else formula
        return (
            f"(CASE WHEN {is_unknown} THEN {formula} "
            f"WHEN {a} * {ID_FACTOR} + {b} IN ({numbers}) THEN {holds} ELSE FALSE END)"
        )

    def formula(self) -> str:
        """Returns the formula of the relation."""
        relation = self.relation
        names = [parameter.name for parameter in relation.parameters]
        values = {
            name: _entity_value(self.schema, entity.text)
            for name, entity in zip(names, self.entities, strict=False)
        }
        rest = names[len(self.entities) :]
        for name, number in zip(rest, self.numbers, strict=False):
            values[name] = SqlValue(number, DOUBLE)
        count = len(self.entities) + len(self.numbers)
        tree = in_schema(relation.expressions[count], self.schema)
        return f"({expanded(tree, values).sql('duckdb')})"


def relation_calls(sql: str, tree: exp.Expr, names: WorldNames) -> Iterator[RelationCall]:
    """Yields the calls of relations that can be rewritten.

    Their numbers are literals or parameters with names, which may be written several times.
    """
    tokens = sqlglot.tokenize(sql, dialect="duckdb")
    ends = _closing_brackets(tokens)
    for node in tree.find_all(exp.Anonymous, exp.Contains):
        name = "contains" if isinstance(node, exp.Contains) else node.name.lower()
        relation = _RELATIONS.get(name)
        select = _owner(node)
        if relation is None or name in names.hidden or select is None:
            continue
        arguments = [*node.expressions]
        if isinstance(node, exp.Contains):
            arguments = [node.this, node.expression]
        scope = Scope(select, names)
        entity_count = sum(parameter.type == "entity" for parameter in relation.parameters)
        numbers = tuple(arguments[entity_count:])
        entities = [_entity(argument, scope) for argument in arguments[:entity_count]]
        place = _place(sql, node, ends)
        if place is None or len(arguments) not in relation.expressions:
            continue
        if not all(
            (isinstance(number, exp.Literal) and not number.is_string)
            or _parameter(number) is not None
            for number in numbers
        ):
            continue
        outer, start, end = place
        schema = names.only
        if isinstance(outer, exp.Dot):
            schema = _schema_of(outer, scope, names)
        sources = [entity for entity in entities if entity is not None]
        if relation.geometry is None and sources:  # its macro takes rows of any world
            schema = sources[0].schema
        is_of_world = all(source.schema == schema for source in sources)
        is_one_pair = len({source.text.lower() for source in sources}) == entity_count
        if schema is None or len(sources) < entity_count or not (is_of_world and is_one_pair):
            continue
        call = RelationCall(
            sql, tokens, outer, start, end, relation, tuple(sources), numbers, schema, scope
        )
        if relation.geometry is not None or call.is_joined:
            yield call


def _parameter(number: exp.Expr) -> str | None:
    """Returns the name of a parameter, which may be written several times; None for another."""
    is_named = isinstance(number, exp.Placeholder) and number.name not in ("", "?")
    return number.name if is_named else None


def _entity(argument: exp.Expr, scope: Scope) -> Source | None:
    if not isinstance(argument, exp.Column) or argument.table:
        return None
    return scope.entity(argument.name)


def _schema_of(call: exp.Dot, scope: Scope, names: WorldNames) -> str | None:
    """Returns the world before a call; None if the name may be something else."""
    name = call.this.name.lower()
    around: Scope | None = scope
    while around is not None:
        if name in around.sources or any(s.may_have(name) for s in around.sources.values()):
            return None
        around = around.outer
    return names.schemas.get(name)


def _place(sql: str, node: exp.Expr, ends: dict[int, int]) -> tuple[exp.Expr, int, int] | None:
    """Returns a call with the schema before it, and its place; None if that is not known."""
    start = node.meta.get("start")
    if start is None and isinstance(node.this, exp.Identifier):
        start = node.this.meta.get("start")
    if start is None:
        return None
    opening = sql.find("(", start)
    end = ends.get(opening)
    parent = node.parent
    if end is None:
        return None
    if not isinstance(parent, exp.Dot):
        return node, start, end
    if not isinstance(parent.this, exp.Identifier) or isinstance(parent.parent, exp.Dot):
        return None
    start = parent.this.meta.get("start")
    return None if start is None else (parent, start, end)


def _closing_brackets(tokens: list[Token]) -> dict[int, int]:
    """Returns the index after each closing bracket, by that of its opening one."""
    result, opened = {}, []
    for token in tokens:
        if token.token_type == TokenType.L_PAREN:
            opened.append(token.start)
        elif token.token_type == TokenType.R_PAREN and opened:
            result[opened.pop()] = token.end + 1
    return result


def _owner(node: exp.Expr) -> exp.Select | None:
    """Returns the SELECT in whose clauses a node stands."""
    return node.find_ancestor(exp.Select)


def _end_of(source: exp.Expr) -> int | None:
    """Returns the index after a source behind FROM; None if it is not known."""
    alias = source.args.get("alias")
    names = [] if alias is None else [alias.this]
    if isinstance(source, exp.Table):
        names.append(source.this)
    ends = [name.meta.get("end") for name in names]
    return None if not ends or None in ends else max(ends) + 1


def start_of(table: exp.Table) -> int | None:
    """Returns the index of the first character of a table behind FROM; None if it is not known."""
    first = table.args.get("db") or table.this
    start = first.meta.get("start")
    return None if start is None or table.args.get("catalog") else int(start)


def _entity_value(schema: str, alias: str) -> SqlValue:
    def column(name: str) -> exp.Expr:
        return exp.column(name, table=alias, quoted=True)

    return SqlValue(column("id"), SqlType("entity", schema=schema), column)


def _id_of(entity: Source) -> str:
    return f"{quoted(entity.text)}.id"
