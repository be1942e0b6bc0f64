"""What users' statements name: tables, worlds and rows of entities."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import pairwise

from sqlglot import exp
from sqlglot.tokenizer_core import Token, TokenType

from ssduck.database.binding import BoundWorld
from ssduck.database.schemas import TABLE_MACROS
from ssduck.schema import HISTORIES, MARGINS, MASSES, TABLES, Table
from ssduck.sql.relations.registry import RELATIONS

# The data that a simulator is asked for on behalf of one column, by the column.
_READ = {"mass": MASSES, "margin": MARGINS}


def _with_read_columns(table: str) -> frozenset[str]:
    """Returns a table, and the tables read for its columns."""
    read = (_READ[name] for name in TABLES[table].names if name in _READ)
    return frozenset((TABLES[table].source, *read))


# The tables of worlds by the names that statements use, in small letters.
_LIVE_TABLES = {table.name.lower(): table for table in TABLES.values()}
_PAIR_TABLES = frozenset(table.name for table in TABLE_MACROS)
_RELATIONS = {relation.name.lower(): relation for relation in RELATIONS.values()}
_WORD = re.compile(r"\w+", re.ASCII)
# Words with no schema before them.
_UNQUALIFIED = re.compile(r'(?<!\.)(?<!\.")\b\w+', re.ASCII)
_OF_RECORDS = re.compile(r"_(?:history|model)$")
_STORES_A_QUERY = re.compile(r"\b(CREATE|PREPARE)\b", re.IGNORECASE)
_SEMI_JOINS = re.compile(r"\b(SEMI|ANTI)\b", re.IGNORECASE)
_MASS_TABLES = [name for name in TABLES if MASSES in _with_read_columns(name)]
_MASS_HISTORIES = re.compile(
    rf"\b({'|'.join(_MASS_TABLES)})_(history|model)\b", re.IGNORECASE | re.ASCII
)
# The column, or all columns: a star outside count(*), or FROM without SELECT.
_MASS_OR_ALL = re.compile(
    r"\bmass\b|(?<!count\()\*|(^|\()\s*FROM\b", re.IGNORECASE | re.ASCII | re.MULTILINE
)
# What reads the catalog, or runs a text that an expression makes.
_READS_CATALOG = re.compile(
    r"\b(?:duckdb_\w+|pg_\w+|pragma_\w+|sqlite_\w+|information_schema|show|describe|summarize|query|"
    r"query_table|sql_auto_complete|json_execute_serialized_sql)\b|(?:^|[(/\n])\s*desc\b",
    re.IGNORECASE,
)
# The words by which the schema of another world than the first may be omitted.
_CHANGES_SEARCH_PATH = re.compile(r"\b(USE|search_path|schema)\b", re.IGNORECASE)
COMMENT = re.compile(r"/\*.*?\*/|--[^\n]*", re.DOTALL)


def _tables_of(word: str) -> frozenset[str]:
    """Returns the tables that a word refers to: a table's name, or a relation that reads tables."""
    if word in _LIVE_TABLES:
        return _with_read_columns(_LIVE_TABLES[word].name)
    if word in _PAIR_TABLES:
        return frozenset(("shapes",))
    relation = _RELATIONS.get(word)
    return relation.macro_inputs if relation is not None and relation.tables else frozenset()


@dataclass(frozen=True)
class StatementWords:
    """What the words in a user's statement say."""

    words: frozenset[str]  # the words, in small letters
    tables: frozenset[str]  # the tables that they refer to
    stores_a_query: bool  # whether it makes a view, a macro or a prepared statement
    changes_search_path: bool  # whether it may change the schemas that may be omitted
    reads_recorded_masses: bool  # whether it reads recorded masses: the column, or all columns
    reads_catalog: bool  # whether it may read the catalog, or names that its text does not have
    omits_schema: bool  # whether a table has no schema before it
    has_semi_joins: bool  # whether it may have SEMI or ANTI joins
    folded: str  # its text in small letters


@lru_cache(maxsize=256)
def words_of(sql: str) -> StatementWords:
    """Returns what the words in a statement say."""
    words = frozenset(word.lower() for word in _WORD.findall(sql))
    unqualified = {_OF_RECORDS.sub("", word.lower()) for word in _UNQUALIFIED.findall(sql)}
    return StatementWords(
        words=words,
        tables=frozenset(table for word in words for table in _tables_of(word)),
        stores_a_query=_STORES_A_QUERY.search(sql) is not None,
        changes_search_path=_CHANGES_SEARCH_PATH.search(sql) is not None,
        reads_recorded_masses=_MASS_HISTORIES.search(sql) is not None
        and _MASS_OR_ALL.search(sql) is not None,
        reads_catalog=_READS_CATALOG.search(sql) is not None,
        omits_schema=any(map(_tables_of, unqualified)),
        has_semi_joins=_SEMI_JOINS.search(sql) is not None,
        folded=sql.casefold(),
    )


@dataclass(frozen=True)
class ReadData:
    """The data that a statement may read."""

    tables: AbstractSet[str]  # the tables
    worlds: Collection[int] | None  # the serial numbers of the worlds; None for all


def named_worlds(words: StatementWords, bound: Sequence[BoundWorld]) -> list[int]:
    """Returns the serial numbers of the worlds whose tables a statement may name.

    The schema of the first world may be omitted: it is read if a table has no schema.
    """
    return [
        world.serial
        for number, entry in enumerate(bound)
        if (world := entry.reference()) is not None
        and (
            (number == 0 and words.omits_schema)
            or any(schema.casefold() in words.folded for schema in entry.schemas)
        )
    ]


_HISTORIES = {table.history_view.lower(): table for table in HISTORIES.values()}


@dataclass(frozen=True)
class WorldNames:
    """The names of the worlds in a database."""

    # The schema that ssduck's own statements use, by each schema of a world in small letters.
    schemas: Mapping[str, str]
    first: str | None  # the schema of the first world, whose tables need no schema before them
    only: str | None  # the schema of the only world; None if there are several
    # The names in small letters of tables and relations that have another meaning here, because the
    # user has defined them.
    hidden: frozenset[str] = frozenset()
    own: frozenset[str] = frozenset()  # all names in small letters that the user has defined

    def live_table(self, table: exp.Table) -> Table | None:
        """Returns the table of a world that a name in FROM refers to; None for any other."""
        return self._table(table, _LIVE_TABLES)

    def history(self, table: exp.Table) -> Table | None:
        """Returns the table whose recorded rows a name in FROM refers to; None for any other."""
        return self._table(table, _HISTORIES)

    def schema(self, table: exp.Table) -> str | None:
        """Returns the schema of the world that a name in FROM refers to."""
        return self.schemas.get(table.db.lower()) if table.db else self.first

    def _table(self, table: exp.Table, tables: Mapping[str, Table]) -> Table | None:
        name = table.name.lower()
        is_plain = isinstance(table.this, exp.Identifier) and not table.args.get("catalog")
        if not is_plain or name in self.hidden or self.schema(table) is None:
            return None
        return tables.get(name)


@dataclass(frozen=True)
class Source:
    """A source behind FROM."""

    columns: frozenset[str] | None = None  # its columns, in small letters; None if they are unknown
    # The world whose entities its rows are, unchanged and of the current tick.
    schema: str | None = None
    is_selected: bool = False  # whether a condition selects its rows by name or id
    text: str = ""  # its name as the statement has it

    def may_have(self, column: str) -> bool:
        """Checks whether a column may have that name, in small letters."""
        return self.columns is None or column in self.columns


@dataclass(frozen=True, eq=False)
class Scope:
    """The names that a SELECT sees."""

    select: exp.Select
    names: WorldNames

    @cached_property
    def items(self) -> list[exp.Expr]:
        """The sources behind FROM, in their order."""
        clause = self.select.args.get("from_")
        return [] if clause is None else [clause.this, *(join.this for join in self.joins)]

    @cached_property
    def joins(self) -> list[exp.Join]:
        """The joins behind FROM, which are its first table's if FROM comes first."""
        clause = self.select.args.get("from_")
        first = [] if clause is None else clause.this.args.get("joins") or []
        return [*first, *(self.select.args.get("joins") or ())]

    @cached_property
    def sources(self) -> dict[str, Source]:
        """The sources by name in small letters; a name that is there twice is unknown."""
        result: dict[str, Source] = {}
        for number, item in enumerate(self.items):
            alias = item.alias_or_name
            name = alias.lower() or f" {number}"
            source = Source() if name in result else self._source(item, is_first=number == 0)
            result[name] = replace(
                source, is_selected=source.is_selected or self._selects(name), text=alias
            )
        return result

    @cached_property
    def outer(self) -> Scope | None:
        """The scope around a subquery; None for a source behind FROM, which sees no other."""
        child: exp.Expr = self.select
        parent = child.parent
        while parent is not None and not isinstance(parent, exp.Select):
            is_source = isinstance(parent, exp.Join) and parent.this is child
            if is_source or isinstance(parent, exp.From | exp.CTE | exp.Lateral):
                return None
            child, parent = parent, parent.parent
        return None if parent is None else Scope(parent, self.names)

    def entity(self, name: str) -> Source | None:
        """Returns the source whose row a name is; None if it may be a column, or is none."""
        wanted = name.lower()
        if any(source.may_have(wanted) for source in self.sources.values()):
            return None
        if wanted in self.sources:
            return self.sources[wanted]
        return None if self.outer is None else self.outer.entity(name)

    def conditions(self) -> Iterator[exp.Expr]:
        """Yields the parts of WHERE and of the inner joins' ON that all rows satisfy."""
        where = self.select.args.get("where")
        if where is not None:
            yield from _conjuncts(where.this)
        for join in self.joins:
            if is_inner(join) and join.args.get("on") is not None:
                yield from _conjuncts(join.args["on"])

    def _selects(self, source: str) -> bool:
        """Checks whether a condition compares the name or the id of a source with a constant."""
        for part in self.conditions():
            sides = [part.this, part.args.get("expression"), *part.expressions]
            if not isinstance(part, exp.EQ | exp.In) or part.args.get("query") is not None:
                continue
            columns = [side for side in sides if isinstance(side, exp.Column)]
            if len(columns) == 1 and columns[0].name.lower() in ("name", "id"):
                table = columns[0].table.lower()
                if table == source or (not table and len(self.items) == 1):
                    return True
        return False

    def _source(self, item: exp.Expr, *, is_first: bool) -> Source:
        alias = item.args.get("alias")
        changed = ["sample", "pivots", "laterals", "when", "version"]
        if not (is_first and isinstance(item, exp.Table)):
            changed.append("joins")
        if any(item.args.get(part) for part in changed) or (alias is not None and alias.columns):
            return Source()
        if isinstance(item, exp.Subquery):
            return self._source_of_query(item.this)
        if not isinstance(item, exp.Table):
            return Source()
        cte = None if item.db else _visible_cte(self.select, item.name)
        if cte is not None:
            clause = cte.parent
            is_recursive = clause is None or clause.args.get("recursive")
            is_plain = not cte.args["alias"].columns and not is_recursive
            return self._source_of_query(cte.this) if is_plain else Source()
        table = self.names.live_table(item) or self.names.history(item)
        if table is None:
            return Source()
        columns = {column.name for column in table.shown_columns}
        columns |= set(table.second_names.values())
        is_entities = table.name == "entities" and self.names.live_table(item) is not None
        schema = self.names.schema(item) if is_entities else None
        return Source(frozenset(name.lower() for name in columns), schema)

    def _source_of_query(self, query: exp.Expr) -> Source:
        """Returns the rows of a subquery: those of its source, if it selects whole rows."""
        if not isinstance(query, exp.Select):
            return Source()
        scope, selected = Scope(query, self.names), query.expressions
        if len(selected) != 1 or query.args.get("distinct") or query.args.get("group"):
            return Source(_names_of(query))
        name = _name_of_star(selected[0])
        if name == "" and len(scope.sources) == 1:
            return next(iter(scope.sources.values()))
        return scope.sources.get(name or " ", Source(_names_of(query)))


def _name_of_star(column: exp.Expr) -> str | None:
    """Returns the name before the star of `a.*`, an empty one of `*`, None for other columns."""
    star = column.this if isinstance(column, exp.Column) else column
    if not isinstance(star, exp.Star) or any(star.args.values()):
        return None
    return column.table.lower() if isinstance(column, exp.Column) else ""


def _names_of(query: exp.Select) -> frozenset[str] | None:
    """Returns the names of the selected columns in small letters; None if they are unknown."""
    names = [column.alias_or_name.lower() for column in query.expressions]
    is_known = all(names) and not any(column.is_star for column in query.expressions)
    is_known = is_known and not any(query.find_all(exp.Columns))
    return frozenset(names) if is_known else None


def is_inner(join: exp.Join) -> bool:
    """Checks whether a join keeps exactly the pairs of rows for which its condition holds."""
    return not join.side and not join.method and join.kind in ("", "INNER", "CROSS")


def is_one_sided(join: exp.Join) -> bool:
    """Checks whether a join is a LEFT, SEMI or ANTI one."""
    if join.method:
        return False
    return (join.side, join.kind) in (("LEFT", ""), ("LEFT", "OUTER"), ("", "SEMI"), ("", "ANTI"))


def _conjuncts(condition: exp.Expr) -> Iterator[exp.Expr]:
    condition = condition.unnest()
    if isinstance(condition, exp.And):
        yield from _conjuncts(condition.left)
        yield from _conjuncts(condition.right)
    else:
        yield condition


def _visible_cte(place: exp.Expr, name: str) -> exp.CTE | None:
    """Returns the common table expression of a name that a SELECT sees."""
    child: exp.Expr | None = None
    parent: exp.Expr | None = place
    while parent is not None:
        clause, visible = parent.args.get("with_"), []
        if isinstance(parent, exp.With):
            visible = parent.expressions
            if not parent.args.get("recursive"):  # an expression sees those before it
                visible = visible[: _index_of(visible, child)]
        elif clause is not None and clause is not child:
            visible = clause.expressions
        for cte in visible:
            if cte.alias.lower() == name.lower():
                return cte  # type: ignore[no-any-return]
        child, parent = parent, parent.parent
    return None


def _index_of(parts: list[exp.Expr], part: exp.Expr | None) -> int:
    return next(number for number, other in enumerate(parts) if other is part)


def source_tables(statement: exp.Expr) -> Iterator[exp.Table]:
    """Yields the names behind FROM that are no common table expressions of the statement."""
    for table in statement.find_all(exp.Table):
        select = table.find_ancestor(exp.Select)
        if select is None or table.db or _visible_cte(select, table.name) is None:
            yield table


def reads_only_live_tables(statement: exp.Expr, names: WorldNames) -> bool:
    """Checks whether all tables behind FROM are those of worlds at their current tick."""
    return all(names.live_table(table) is not None for table in source_tables(statement))


def unread_columns(statement: exp.Expr, sql: str) -> frozenset[str]:
    """Returns the data of `_READ` that a statement does not read."""
    words = set(map(str.lower, _WORD.findall(sql)))
    inputs = [_RELATIONS[word].macro_inputs for word in words if word in _RELATIONS]
    if may_read_unnamed(statement, sql):
        return frozenset()
    return frozenset(
        data
        for column, data in _READ.items()
        if column not in words and not any(data in read for read in inputs)
    )


def may_read_unnamed(statement: exp.Expr, sql: str, hidden: Collection[str] = ()) -> bool:
    """Checks whether a statement may depend on columns that its text and its plan do not name."""
    # A column may be named by its position: `#3`, `entities AS e(a, b)`.
    if "#" in sql or any(alias.columns for alias in statement.find_all(exp.TableAlias)):
        return True
    if any(join.method for join in statement.find_all(exp.Join)):
        return True
    stars = statement.find_all(exp.Star, exp.Columns)
    if any(not isinstance(star.parent, exp.Count) for star in stars):
        return True
    names = {table.alias_or_name.lower() for table in statement.find_all(exp.Table, exp.Subquery)}
    return any(
        not column.table and column.name.lower() in names and (hidden or not _is_argument(column))
        for column in statement.find_all(exp.Column)
    )


def _is_argument(column: exp.Column) -> bool:
    """Checks whether a row is the argument of a relation, whose formula reads its columns."""
    call = column.parent
    return isinstance(call, exp.Anonymous) and call.name.lower() in _RELATIONS


# The parts of a subquery that do nothing but choose rows.
_PARTS = frozenset(("expressions", "from_", "joins", "where"))


@dataclass(frozen=True)
class ExistsCondition:
    """An EXISTS in a statement."""

    start: int  # the index of its first character
    list_start: int  # the index at which its subquery begins
    list_end: int  # the index of the subquery's FROM
    end: int  # the index after its closing bracket
    reads_outer: bool  # whether the subquery reads columns of the entity around it


def exists_condition(
    scope: Scope, call: exp.Expr, place: int, tokens: Sequence[Token], outer: Source, *, reads: bool
) -> ExistsCondition | None:
    """Returns the EXISTS of a subquery; None if it needs more of what is around it.

    Args:
        scope: the names that the subquery sees.
        call: the call of a relation in it.
        place: where that is written.
        tokens: the tokens of the statement.
        outer: the entity around it.
        reads: whether the relation itself reads columns of that entity.
    """
    select = scope.select
    if not isinstance(select.parent, exp.Exists) or select.parent.find_ancestor(exp.Join):
        return None
    parts = {name for name, value in select.args.items() if value}
    is_plain = parts <= _PARTS and all(map(_is_plain, select.expressions))
    if not is_plain or sum(1 for _ in select.find_all(exp.Query)) > 1:
        return None
    reads_outer = _reads_outer(_columns_of_conditions(select, call), scope, outer, reads=reads)
    written = _written(tokens, place)
    return (
        None if reads_outer is None or written is None else ExistsCondition(*written, reads_outer)
    )


def _is_plain(selected: exp.Expr) -> bool:
    """Checks whether a selected value neither adds nor removes rows, as an aggregate does."""
    return isinstance(selected, exp.Literal | exp.Column | exp.Star)


def _columns_of_conditions(select: exp.Select, call: exp.Expr) -> Iterator[exp.Column]:
    """Yields the columns in a subquery, but for those that are selected or arguments of a call."""
    for column in select.find_all(exp.Column):
        around: exp.Expr | None = column
        while around is not None and around is not call and around.parent is not select:
            around = around.parent
        if around is not call and not any(around is selected for selected in select.expressions):
            yield column


def _reads_outer(
    columns: Iterable[exp.Column], scope: Scope, outer: Source, *, reads: bool
) -> bool | None:
    """Checks whether columns are of the entity around a subquery; None if one may be of others."""
    sources, reads_outer, has_bare = scope.sources, reads, False
    for column in columns:
        table, name = column.table.lower(), column.name.lower()
        if column.args.get("db"):
            return None
        is_outer = table == outer.text.lower() and table not in sources
        if is_outer and name in (outer.columns or ()):
            reads_outer = True
        elif not table and any(name in (source.columns or ()) for source in sources.values()):
            has_bare = True
        elif (table or name) not in sources:
            return None
    # That entity becomes a source of the subquery: columns without a table would be ambiguous.
    return None if reads_outer and has_bare else reads_outer


def _written(tokens: Sequence[Token], place: int) -> tuple[int, int, int, int] | None:
    """Returns where EXISTS around a place, its subquery and its FROM start, and where it ends."""
    found = None
    opened: list[tuple[bool, int]] = []
    for number, (before, token) in enumerate(pairwise(tokens)):
        if token.token_type == TokenType.L_PAREN:
            opened.append((before.token_type == TokenType.EXISTS, number))
        elif token.token_type == TokenType.R_PAREN and opened:
            is_exists, first = opened.pop()
            if is_exists and tokens[first].start < place < token.start:
                found = first, number + 1
                break
    if found is None:
        return None
    first, last = found
    inside = tokens[first + 2 : last]
    clauses = [t for t in inside if t.token_type in (TokenType.SELECT, TokenType.FROM)]
    kinds = [clause.token_type for clause in clauses]
    if kinds not in ([TokenType.FROM], [TokenType.SELECT, TokenType.FROM]):
        return None
    return tokens[first].start, inside[0].start, clauses[-1].start, tokens[last].end + 1
