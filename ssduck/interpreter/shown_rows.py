"""Evaluates programs for display: a query without rows still has its columns."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from ssduck.interpreter.program import CompiledProgram
from ssduck.language.tree import AdapterClause, Literal, Query


def rows_to_show(compiled: CompiledProgram, evaluate: Callable[[CompiledProgram], Any]) -> Any:
    """Returns the value of a program; the empty table of its columns if its query has no rows.

    Args:
        compiled: the program.
        evaluate: `Interpreter.eval`.

    Raises:
        SelectScriptError: as `Interpreter.eval` does.

    >>> import ssduck
    >>> with ssduck.Interpreter() as ss:
    ...     program = ss.compile("SELECT n.this FROM n=[1, 2] WHERE n.this > 2;")
    ...     rows_to_show(program, ss.eval).columns
    ['n']
    """
    value = evaluate(compiled)
    if not (isinstance(value, list) and not value):
        return value
    query = compiled.tree.statements[-1]
    if not isinstance(query, Query) or query.adapter is not None:
        return value
    form, none = AdapterClause(query.span, "table"), Literal(query.span, 0)
    only_columns = replace(query, adapter=form, limit=none, offset=None)
    tree = replace(compiled.tree, statements=(only_columns,))
    return evaluate(replace(compiled, tree=tree))
