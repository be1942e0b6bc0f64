"""Runs what a user types, and prints its result or its error."""

from __future__ import annotations

import contextlib
import sys
import warnings
from collections.abc import Iterable, Iterator
from typing import Any

from ssduck.adapters.display import print_line, terminal_width
from ssduck.adapters.formats import print_value
from ssduck.errors import SelectScriptError
from ssduck.interpreter.program import rows_to_show
from ssduck.shell.commands import run_command
from ssduck.shell.session import Session, is_command

# The number of rows of a table on a terminal.
_TERMINAL_ROWS = 40


def run(session: Session, text: str) -> bool:
    """Runs a command or a program, and prints its result or its error.

    Returns:
        Whether it succeeded. What failed or was interrupted leaves everything as it was.
    """
    if not text.strip():
        return True
    try:
        with _printed_warnings():
            if is_command(text):
                run_command(session, text)
            else:
                _evaluate(session, text)
    except (SelectScriptError, Warning) as error:  # `python -W error` raises warnings
        sys.stderr.write(f"error: {error}\n")
        return False
    except KeyboardInterrupt:
        sys.stderr.write("interrupted\n")
        return False
    return True


def _evaluate(session: Session, text: str) -> None:
    with contextlib.redirect_stdout(sys.stderr):  # what a program prints is not its result
        if session.language == "sql":
            result: Any = session.ss.sql(text)
        else:
            result = rows_to_show(session.ss.compile(text), session.ss.eval)
    session.result = result
    rows = _TERMINAL_ROWS if terminal_width() is not None else None
    print_value(result, session.format, rows)


@contextlib.contextmanager
def _printed_warnings() -> Iterator[None]:
    """Prints the message of each warning once."""
    printed: set[str] = set()

    def write(message: Warning | str, *_: Any, **__: Any) -> None:
        if str(message) not in printed:
            printed.add(str(message))
            sys.stderr.write(f"warning: {message}\n")

    with warnings.catch_warnings():
        warnings.showwarning = write
        yield


def greet(session: Session) -> None:
    """Prints what a user has to know at the beginning."""
    names = ", ".join(f"{w.name} ({len(w)} entities)" for w in session.ss.worlds)
    print_line(f"{names}. Statements end with ; and commands begin with a full stop: .help, .quit")


def run_lines(session: Session, lines: Iterable[str]) -> bool:
    """Runs the commands and statements in lines.

    Returns:
        Whether all of them succeeded.
    """
    succeeded, text = True, ""
    for line in lines:
        text += line
        if session.is_complete(text):
            succeeded = run(session, text) and succeeded
            text = ""
        if session.is_over:
            return succeeded
    return run(session, text) and succeeded
