"""Magics of notebooks: `%%selectscript` and `%%sql`, after `%load_ext ssduck`."""

from __future__ import annotations

from typing import Any

from ssduck.errors import ArgumentError, UnknownNameError, check_known
from ssduck.interpreter.interpreter import Interpreter
from ssduck.interpreter.program import rows_to_show


def register_magics(shell: Any) -> None:
    """Registers the magics in a shell of IPython."""
    from IPython.core.magic import no_var_expand

    def selectscript(line: str, cell: str | None = None) -> Any:
        """Runs a SelectScript program, and returns its result.

        `%%selectscript` begins a cell with a program, `%selectscript PROGRAM` is a line. The
        interpreter is the only one among the variables; `%%selectscript ss` names one of several.
        """
        ss, program = _interpreter_and_program(shell.user_ns, line, cell)
        return rows_to_show(ss.compile(program), ss)

    def sql(line: str, cell: str | None = None) -> Any:
        """Runs an SQL statement, and returns its rows; as `%%selectscript` otherwise."""
        ss, statement = _interpreter_and_program(shell.user_ns, line, cell)
        return ss.sql(statement)

    for magic in (selectscript, sql):
        # IPython would run what is in braces as Python, and replace it.
        shell.register_magic_function(no_var_expand(magic), "line_cell", magic.__name__)


def _interpreter_and_program(
    names: dict[str, Any], line: str, cell: str | None
) -> tuple[Interpreter, str]:
    """Returns the interpreter that a magic uses, and the text that it runs."""
    # IPython keeps results in _, __ and so on.
    known = {
        name: value
        for name, value in names.items()
        if isinstance(value, Interpreter) and not name.startswith("_")
    }
    if cell is not None and line.strip():
        name = line.strip()
        check_known(name, known, f"no interpreter has the name {name!r}")
        return known[name], cell
    if not known:
        raise UnknownNameError("there is no interpreter; make one: ss = ssduck.load('kitchen')")
    if len({id(value) for value in known.values()}) > 1:
        raise ArgumentError(
            f"there are several interpreters: {', '.join(known)}; begin the cell with one of them, "
            f"as in %%selectscript {next(iter(known))}"
        )
    return next(iter(known.values())), line if cell is None else cell
