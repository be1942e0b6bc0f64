"""A shell: its state, its commands, and how it runs what a user types."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ssduck.adapters.display import (
    DisplayTable,
    print_line,
    print_table,
    terminal_rows,
    written_warnings,
)
from ssduck.adapters.formats import FORMATS, print_value, save
from ssduck.errors import ArgumentError, SelectScriptError, UnknownNameError, check_known, nearest
from ssduck.interpreter.additions import ServedPage
from ssduck.interpreter.completion import KEYWORDS, Language, delimited_parts, usage_and_summary
from ssduck.interpreter.interpreter import Interpreter
from ssduck.interpreter.program import value_to_show
from ssduck.schema import HISTORIES, TABLES
from ssduck.world.world import World


class Session:
    """A shell's interpreter, its language and format, and its last result.

    Attributes:
        format: the format of results, a text format of `FORMATS`.
        result: the last result; None before the first one.
        pages: the pages that are served until the session ends.
        is_over: whether the user has left.
    """

    def __init__(self, ss: Interpreter) -> None:
        self.ss = ss
        self.language: Language = "selectscript"
        self.format = FORMATS["table"]
        self.result: Any = None
        self.pages: list[ServedPage] = []
        self.is_over = False

    @property
    def prompt(self) -> str:
        """What stands before what is typed: the first world, and the language if it is SQL."""
        name = next((world.name for world in self.ss.worlds), "ssduck")
        return f"{name} sql> " if self.language == "sql" else f"{name}> "

    def close(self) -> None:
        """Ends what the session serves."""
        while self.pages:
            self.pages.pop().close()

    def is_complete(self, text: str) -> bool:
        """Checks whether a text can run: it is a command, empty, or ends with a semicolon."""
        if not text.strip() or is_command(text):
            return True
        return self._without_end(text).endswith(";")

    def _without_end(self, text: str) -> str:
        """Returns a text up to its last sign that is not in a comment; "" in an open text."""
        for part in reversed(list(delimited_parts(text, self.language))):
            is_text = part.opening in ("'", '"')
            if is_text and not part.is_closed:
                return ""
            if not is_text and not text[part.end :].strip():
                is_open = part.opening == "/*" and not part.is_closed
                text = "" if is_open else text[: part.start]
        return text.rstrip()


def is_command(text: str) -> bool:
    """Checks whether a text is a command of the shell: a full stop and a letter begin it."""
    stripped = text.lstrip()
    return stripped[:1] == "." and stripped[1:2].isalpha()


# -- commands ---------------------------------------------------------------------------------


Run = Callable[[Session, str], None]


@dataclass(frozen=True)
class Command:
    """A command of the shell.

    Attributes:
        arguments: its arguments, as its help shows them; those in brackets may be missing.
        run: runs it, with the rest of its line.
    """

    name: str
    arguments: str
    about: str
    run: Run

    @property
    def usage(self) -> str:
        """`.name ARGUMENTS`."""
        return f".{self.name} {self.arguments}".rstrip()


COMMANDS: dict[str, Command] = {}


def command(arguments: str = "") -> Callable[[Run], Run]:
    """Returns a decorator that registers a command; the docstring is its help."""

    def register(run: Run) -> Run:
        name = run.__name__.strip("_")
        COMMANDS[name] = Command(name, arguments, (run.__doc__ or "").strip(), run)
        return run

    return register


def run_command(session: Session, line: str) -> None:
    """Runs the command of a line."""
    name, _, rest = line.strip().removesuffix(";")[1:].partition(" ")
    if name not in COMMANDS:
        names = tuple(f".{near}" for near in nearest(name, COMMANDS))
        message = f"there is no command .{name}; .help lists all"
        raise UnknownNameError(message, suggestions=names)
    chosen, argument = COMMANDS[name], rest.strip()
    if argument and not chosen.arguments:
        raise ArgumentError(f".{name} takes no argument")
    if not argument and chosen.arguments and not chosen.arguments.startswith("["):
        raise ArgumentError(f".{name} needs an argument: {chosen.usage}")
    chosen.run(session, argument)


@command("[NAME]")
def _help(session: Session, name: str) -> None:
    """Lists the commands, or describes a function, a relation, or the result forms: AS."""
    if name:
        print_line(session.ss.help(name))
        return
    rows = [(each.usage, each.about) for each in COMMANDS.values()]
    print_table(DisplayTable(["command", "what it does"], rows))


@command()
def _tables(_session: Session, _: str) -> None:
    """Lists the tables of each world and the views of their recorded ticks."""
    rows = [
        (name, HISTORIES[name].history_view if name in HISTORIES else "", table.row)
        for name, table in TABLES.items()
    ]
    print_table(DisplayTable(["table", "at all ticks", "a row is"], rows))


@command("[TABLE]")
def _schema(_session: Session, name: str) -> None:
    """Lists the columns of a table, or of all tables."""
    table = name.removesuffix("_history")
    if name:
        check_known(table, TABLES, f"there is no table {name!r}")
    rows = [
        (known.name, column.name, column.sql, column.comment)
        for known in (TABLES.values() if not name else [TABLES[table]])
        for column in known.shown_columns
    ]
    print_table(DisplayTable(["table", "column", "type", "meaning"], rows))


@command("[PART]")
def _relations(session: Session, part: str) -> None:
    """Lists functions and relations, all or those with a part of a name."""
    rows = [
        usage_and_summary(session.ss.help(name))
        for name in session.ss.help()
        if part.casefold() in name.casefold()
    ]
    print_table(DisplayTable(["function", "what it does"], rows))


@command("[WORLD]")
def _entities(session: Session, name: str) -> None:
    """Lists the entities of a world, or of all, with their kinds and positions."""
    rows = [
        (world.name, entity.name, entity.kind, *entity.position)
        for world in ([_world(session, name)] if name else session.ss.worlds)
        for entity in world
    ]
    print_table(DisplayTable(["world", "entity", "kind", "x", "y", "z"], rows))


@command("[N]")
def _step(session: Session, count: str) -> None:
    """Steps each world once, or N times."""
    if not (count or "1").isdecimal():
        raise ArgumentError(f".step: {count!r} is no whole number")
    steps = int(count or "1")
    for world in session.ss.worlds:
        world.step(steps)
    _time(session, "")


@command("SECONDS")
def _run(session: Session, seconds: str) -> None:
    """Runs all worlds for a simulated time, s."""
    try:
        duration = float(seconds)
    except ValueError as error:
        raise ArgumentError(f".run: {seconds!r} is no number of seconds") from error
    session.ss.run(duration)
    _time(session, "")


@command()
def _time(session: Session, _: str) -> None:
    """Shows the simulated time, s, and the number of the tick of each world."""
    rows = [(world.name, world.time, world.tick_number) for world in session.ss.worlds]
    print_table(DisplayTable(["world", "time", "tick"], rows))


@command("[LANGUAGE] [FORMAT]")
def _mode(session: Session, names: str) -> None:
    """Chooses selectscript or sql, or the format of results: table, csv, json, markdown."""
    formats = {key: format for key, format in FORMATS.items() if not format.is_binary}
    chosen = names.split()
    known = (*KEYWORDS, *formats)
    for name in chosen:
        check_known(name, known, f"there is no mode {name!r}: {', '.join(known)}")
    for name in chosen:
        if name in formats:
            session.format = formats[name]
        else:
            session.language = "sql" if name == "sql" else "selectscript"
    if not chosen:
        print_line(f"{session.language}, {session.format.name}")


@command("FILE")
def _export(session: Session, name: str) -> None:
    """Writes the whole last result to a file, in the format of its ending; replaces the file."""
    if session.result is None:
        raise ArgumentError("there is no result to write; run a query first")
    print_line(f"{save(session.result, Path(name))}")


@command("[WORLD]")
def _view(session: Session, name: str) -> None:
    """Serves a page that shows a world in 3-D while the shell runs, and prints its address."""
    page = session.ss.view(name or None)
    session.pages.append(page)
    print_line(page.url)


@command()
def _quit(session: Session, _: str) -> None:
    """Leaves the shell, as Ctrl-D does."""
    session.is_over = True


def _world(session: Session, name: str) -> World:
    worlds = {world.name: world for world in session.ss.worlds}
    check_known(name, worlds, f"there is no world {name!r}")
    return worlds[name]


def run(session: Session, text: str) -> bool:
    """Runs a command or a program, and prints its result or its error.

    Returns whether it succeeded. What failed or was interrupted leaves everything as it was.
    """
    if not text.strip():
        return True
    try:
        with written_warnings():
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
        session.result = value_to_show(session.ss, text, session.language)
    print_value(session.result, session.format, terminal_rows())


def greet(session: Session) -> None:
    """Prints what a user has to know at the beginning."""
    names = ", ".join(f"{w.name} ({len(w)} entities)" for w in session.ss.worlds)
    print_line(f"{names}. Statements end with ; and commands begin with a full stop: .help, .quit")


def run_lines(session: Session, lines: Iterable[str]) -> bool:
    """Runs the commands and statements in lines; returns whether all of them succeeded."""
    succeeded, text = True, ""
    for line in lines:
        text += line
        if session.is_complete(text):
            succeeded = run(session, text) and succeeded
            text = ""
        if session.is_over:
            return succeeded
    return run(session, text) and succeeded
