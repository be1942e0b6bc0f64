"""Parsed programs, and what is displayed of them: a query without rows still has its columns."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from ssduck import validation
from ssduck.adapters.tabular import tabulated
from ssduck.errors import ArgumentError
from ssduck.formatting import short_repr
from ssduck.language import ast
from ssduck.language.parser import parse


@dataclass(frozen=True, eq=False)
class CompiledProgram:
    """A parsed program; running it parses nothing again.

    Attributes:
        text: the text of the program.
        tree: the syntax tree.
    """

    text: str
    tree: ast.Program
    _sql_of: Callable[[ast.Program, str], str]

    def sql(self, dialect: str = "duckdb") -> str:
        """Returns the SQL of the query that ends the program, with variables' values inserted.

        Args:
            dialect: the name of a dialect of sqlglot: `"duckdb"`, `"postgres"`, `"sqlite"` …

        Raises:
            UnsupportedError: Python evaluates a part of the query, or the dialect lacks it.
        """
        return self._sql_of(self.tree, dialect)


def tree_of(program: str | CompiledProgram) -> ast.Program:
    """Returns the syntax tree of a program given as text or compiled.

    Raises:
        ArgumentError: the program is neither.
        ParseError: the text is no program; the error has the place.
    """
    if isinstance(program, CompiledProgram):
        return program.tree
    text = validation.text(program, "a program is a text or a compiled program")
    return parse(text)


def rows_to_show(compiled: CompiledProgram, ss: Any) -> Any:
    """Returns the value of a program; the empty table of its columns if its query has no rows.

    Of a program that begins with WHY it is a `Why`.

    >>> import ssduck
    >>> with ssduck.Interpreter() as ss:
    ...     program = ss.compile("SELECT n.this FROM n=[1, 2] WHERE n.this > 2;")
    ...     rows_to_show(program, ss).columns
    ['n']
    """
    value = ss.why(compiled) if compiled.tree.explain == "WHY" else ss.eval(compiled)
    if not (isinstance(value, list) and not value):
        return value
    query = last_query(compiled)
    if query is None or query.adapter is not None:
        return value
    form, none = ast.AdapterClause(query.span, "table"), ast.Literal(query.span, 0)
    return ss.eval(with_last(compiled, query, form, limit=none, offset=None))


def value_to_show(ss: Any, text: str, language: str) -> Any:
    """Returns what is shown of a program in SelectScript, or of one in SQL, for an interpreter.

    Data frames and arrays are their rows.
    """
    if language == "sql":
        return ss.sql(text)
    program = ss.compile(text)
    is_here = isinstance(program, CompiledProgram)  # else it is in a sandbox
    return tabulated(rows_to_show(program, ss) if is_here else program.shown())


def last_query(compiled: CompiledProgram) -> ast.Query | None:
    """Returns the query whose rows a program yields; None if it yields something else."""
    *_, last = compiled.tree.statements or (None,)
    return last if isinstance(last, ast.Query) and not compiled.tree.explain else None


def with_last(
    compiled: CompiledProgram, query: ast.Query, form: ast.AdapterClause, **changes: Any
) -> CompiledProgram:
    """Returns the program of a query alone, with another result form; the text stays the same."""
    changed = replace(query, adapter=form, **changes)
    return replace(compiled, tree=replace(compiled.tree, statements=(changed,)))


def check_parameters(function: str, parameters: Any, others: Mapping[str, Any]) -> None:
    """Checks that the parameters of a program, or of SQL, are a dict or a list, and no keywords."""
    text = "program" if function == "eval" else "statement"
    for name in others:
        given = ", ".join(f"{key!r}: {short_repr(value)}" for key, value in others.items())
        raise ArgumentError(
            f"{function}: there is no argument {name!r}; parameters are a dict: "
            f"{function}({text}, {{{given}}})"
        )
    is_list = isinstance(parameters, Iterable) and not isinstance(parameters, str | bytes)
    is_list = is_list and function == "sql"
    if parameters is not None and not (isinstance(parameters, Mapping) or is_list):
        advice = f"a list: [{short_repr(parameters)}], or " if function == "sql" else ""
        raise ArgumentError(
            f"{function}: parameters are {advice}a dict by name, {{'limit': 0.5}}, say; "
            f"not {short_repr(parameters)}"
        )
