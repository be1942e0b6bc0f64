"""Programs that were parsed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from ssduck import validation
from ssduck.language.parser import parse
from ssduck.language.tree import Program


@dataclass(frozen=True, eq=False)
class CompiledProgram:
    """A program that was parsed; running it again parses nothing.

    Attributes:
        text: how it was written.
        tree: what it means.
    """

    text: str
    tree: Program
    _sql_of: Callable[[Program, str], str]

    def sql(self, dialect: str = "duckdb") -> str:
        """The SQL of the query that the program ends with, the values of variables put in.

        Args:
            dialect: one of sqlglot's: `"duckdb"`, `"postgres"`, `"sqlite"` …

        Raises:
            UnsupportedError: a part is left to Python, or is nothing that dialect has.
        """
        return self._sql_of(self.tree, dialect)


def tree_of(program: str | CompiledProgram) -> Program:
    """What a program means that is given as text or was parsed before.

    Raises:
        ArgumentError: it is neither.
        ParseError: with the place of the first thing that is wrong.
    """
    if isinstance(program, CompiledProgram):
        return program.tree
    return parse(validation.text(program, "a program is a text or what compile gave"))
