"""The commands of the shell: a new one is a function with the decorator `command`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from ssduck.adapters.display import DisplayTable, print_line, print_table
from ssduck.adapters.formats import FORMATS, save
from ssduck.errors import ArgumentError, UnknownNameError, nearest
from ssduck.interpreter.completion import KEYWORDS, usage_and_summary
from ssduck.schema import HISTORIES, TABLES
from ssduck.shell.session import Session
from ssduck.world.world import World

Run = Callable[[Session, str], None]


@dataclass(frozen=True)
class Command:
    """A command of the shell.

    Attributes:
        name: its name without the full stop.
        arguments: its arguments, as its help shows them; those in brackets may be missing.
        about: what it does, in a sentence.
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
    """Runs the command of a line.

    Raises:
        UnknownNameError: there is no such command; the error suggests the nearest ones.
        ArgumentError: an argument is missing, or there is one too many.
        SelectScriptError: the command failed.
    """
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
    if name and table not in TABLES:
        message = f"there is no table {name!r}"
        raise UnknownNameError(message, suggestions=nearest(name, TABLES))
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
    rows = [(world.name, world.time, world.snapshot.number) for world in session.ss.worlds]
    print_table(DisplayTable(["world", "time", "tick"], rows))


@command("[LANGUAGE] [FORMAT]")
def _mode(session: Session, names: str) -> None:
    """Chooses selectscript or sql, or the format of results: table, csv, json, markdown."""
    formats = {key: format for key, format in FORMATS.items() if not format.is_binary}
    chosen = names.split()
    known = (*KEYWORDS, *formats)
    for name in chosen:
        if name not in known:
            message = f"there is no mode {name!r}: {', '.join(known)}"
            raise UnknownNameError(message, suggestions=nearest(name, known))
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
    """Returns the world of a name.

    Raises:
        UnknownNameError: there is none; the error suggests the nearest names.
    """
    worlds = {world.name: world for world in session.ss.worlds}
    if name not in worlds:
        raise UnknownNameError(f"there is no world {name!r}", suggestions=nearest(name, worlds))
    return worlds[name]
