"""Parsed programs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from ssduck import validation
from ssduck.language.parser import parse
from ssduck.language.tree import Program
from ssduck.limits import Limits


@dataclass(frozen=True, eq=False)
class CompiledProgram:
    """A parsed program; running it parses nothing again.

    Attributes:
        text: the text of the program.
        tree: the syntax tree.
    """

    text: str
    tree: Program
    _sql_of: Callable[[Program, str], str]

    def sql(self, dialect: str = "duckdb") -> str:
        """Returns the SQL of the query that ends the program, with variables' values inserted.

        Args:
            dialect: the name of a dialect of sqlglot: `"duckdb"`, `"postgres"`, `"sqlite"` …

        Raises:
            UnsupportedError: Python evaluates a part of the query, or the dialect lacks it.
        """
        return self._sql_of(self.tree, dialect)


def tree_of(program: str | CompiledProgram, limits: Limits) -> Program:
    """Returns the syntax tree of a program given as text or compiled.

    Raises:
        ArgumentError: the program is neither.
        ParseError: the text is no program; the error has the place.
        LimitError: the text is too long.
    """
    if isinstance(program, CompiledProgram):
        return program.tree
    text = validation.text(program, "a program is a text or a compiled program")
    return parse(text, limits.words)
