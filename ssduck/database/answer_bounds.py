"""Bounds the size of a query's answer, before it runs, by the sizes of the tables that it reads."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import prod

from sqlglot import exp

from ssduck.database.kept_plans import RowSource

# Expressions that make several rows of one.
_MULTIPLY = (exp.Unnest, exp.Explode, exp.UDTF)


@dataclass(frozen=True)
class AnswerBound:
    """The greatest size of an answer, which has at most all combinations of its sources' rows.

    Attributes:
        sources: the tables behind FROM.
        columns: what each column of the answer is: the index of a source and the name of a column
            of it, which it has as it is; None for others.
    """

    sources: Sequence[RowSource]
    columns: Sequence[tuple[int, str] | None]

    def size(self, types: Sequence[str], row_size: int) -> int | None:
        """Returns the greatest size at present, bytes; None if it is not known.

        Args:
            types: DuckDB's names of the types of the answer's columns.
            row_size: the size of a row without its texts, bytes.
        """
        if len(types) != len(self.columns):
            return None
        tables = [source.table() for source in self.sources]
        count = prod(max(1, table.count) for table in tables)
        size = count * row_size
        for type_, column in zip(types, self.columns, strict=True):
            if type_ != "VARCHAR":
                continue
            if column is None:
                return None
            index, name = column
            texts: int = tables[index].arrow_with([name]).column(name).nbytes
            size += count // max(1, tables[index].count) * texts
        return size


def answer_bound(select: exp.Select, sources: Mapping[str, RowSource]) -> AnswerBound | None:
    """Returns the bound of a query's answer; None if none is known.

    Args:
        select: the query; its columns name their sources.
        sources: the tables behind FROM, by the names that the query gives them.
    """
    joins = select.args.get("joins") or []
    tables = [join.this for join in joins]
    if from_ := select.args.get("from_"):
        tables.append(from_.this)
    is_simple = (
        len(list(select.find_all(exp.Query, exp.Table))) == 1 + len(tables)
        and not select.find(*_MULTIPLY)
        and not any(join.side for join in joins)
        and len({table.alias_or_name for table in tables} & sources.keys()) == len(tables)
    )
    if not is_simple:
        return None
    indices = {name: index for index, name in enumerate(sources)}
    columns = [_column_of(column.unalias(), sources) for column in select.selects]
    named = [column and (indices[column[0]], column[1]) for column in columns]
    return AnswerBound(list(sources.values()), named)


def _column_of(column: exp.Expr, sources: Mapping[str, RowSource]) -> tuple[str, str] | None:
    """Returns the source of a column and its name there; None if it is no column as it is."""
    if not isinstance(column, exp.Column) or column.table not in sources:
        return None
    source = sources[column.table]
    if source.view is not None:
        return None
    for one in source.columns:
        if column.name in {one.name, one.second_name}:
            return column.table, one.name
    return None
