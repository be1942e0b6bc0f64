"""Evaluates programs for display: a query without rows still has its columns."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

from ssduck.interpreter.program import CompiledProgram
from ssduck.language.tree import AdapterClause, Literal, Query

if TYPE_CHECKING:
    from ssduck.interpreter.interpreter import Interpreter


def rows_to_show(interpreter: Interpreter, program: str | CompiledProgram) -> Any:
    """Returns the value of a program; the empty table of its columns if its query has no rows.

    Raises:
        SelectScriptError: as `Interpreter.eval` does.

    >>> import ssduck
    >>> with ssduck.Interpreter() as ss:
    ...     rows_to_show(ss, "SELECT n.this FROM n=[1, 2] WHERE n.this > 2;").columns
    ['n']
    """
    compiled = interpreter.compile(program) if isinstance(program, str) else program
    value = interpreter.eval(compiled)
    if not (isinstance(value, list) and not value):
        return value
    query = compiled.tree.statements[-1]
    if not isinstance(query, Query) or query.adapter is not None:
        return value
    form, none = AdapterClause(query.span, "table"), Literal(query.span, 0)
    only_columns = replace(query, adapter=form, limit=none, offset=None)
    tree = replace(compiled.tree, statements=(only_columns,))
    return interpreter.eval(replace(compiled, tree=tree))
