"""The command `ssduck`: demo, query, scenes, functions.

Standard output carries answers only; warnings, errors and what programs print go to standard
error. What is slow to import (the simulator, the database) is imported by the commands that
need it, so that help is there at once.
"""

from __future__ import annotations

import contextlib
import csv
import datetime as dt
import inspect
import io
import json
import math
import os
import re
import signal
import sys
import time
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from decimal import Decimal
from enum import StrEnum
from itertools import zip_longest
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import typer
from typer.core import TyperGroup

from ssduck.errors import SelectScriptError

if TYPE_CHECKING:
    from rich.console import Console, RenderableType
    from rich.text import Text

    from ssduck.demo import Question
    from ssduck.interpreter import Interpreter
    from ssduck.world import World

# How wide the output is at least where there is no terminal to tell.
WIDTH = 100

# Of both languages, and of Python's as far as the demonstration uses them.
_KEYWORDS = (
    r"(?i)\b(SELECT|FROM|WHERE|ORDER BY|LIMIT|DESC|AS|AND|OR|NOT|TRUE|FALSE|def|if|return)\b"
)


class Format(StrEnum):
    """How `ssduck query` writes an answer."""

    TABLE = "table"
    JSON = "json"
    CSV = "csv"


class _Commands(TyperGroup):
    """The commands; what they raise on purpose becomes a message and an exit code."""

    def invoke(self, ctx: Any) -> Any:
        try:
            with _warnings_in_one_line():
                result = super().invoke(ctx)
        except SelectScriptError as error:
            _complain(str(error))
            raise typer.Exit(1) from error
        sys.stdout.flush()  # here typer still sees that the reader has gone, and ends quietly
        return result


app = typer.Typer(
    cls=_Commands,
    add_completion=False,
    invoke_without_command=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def main() -> None:
    """The entry point of the command `ssduck`."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _interrupted)
    _prepare_streams()
    sys.set_int_max_str_digits(0)  # an integer of the language may be longer than 4300 digits
    try:
        app(prog_name="ssduck")
    except OSError as error:
        if error.filename is not None:
            raise
        # The output cannot be written (a full disk, say), and must not be tried again at the end.
        sys.stdout = io.StringIO()
        _complain(str(error))
        sys.exit(1)


def _interrupted(*_: object) -> NoReturn:
    """End at once on Ctrl-C.

    Python's KeyboardInterrupt does not always arrive: libraries that are being imported swallow
    it, and DuckDB turns it into another exception.
    """
    os._exit(130)


def _prepare_streams() -> None:
    """Closed streams lead nowhere; names are shown in any locale, if need be as escapes."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, Path(os.devnull).open("w", encoding="utf-8"))  # noqa: SIM115
        elif isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def _complain(message: str) -> None:
    """Tell of an error; what it underlines stays above its mark: nothing is folded."""
    from rich.console import Console

    Console(stderr=True).print("error:", style="bold red", end=" ")
    sys.stderr.write(f"{message}\n")


@contextlib.contextmanager
def _warnings_in_one_line() -> Iterator[None]:
    """Warnings as one line each, and each once."""
    told: set[str] = set()

    def tell(message: Warning | str, *_: Any, **__: Any) -> None:
        text = " ".join(str(message).split())
        if text not in told:
            told.add(text)
            sys.stderr.write(f"warning: {text}\n")

    with warnings.catch_warnings():
        warnings.showwarning = tell
        yield


# -- commands -----------------------------------------------------------------------------


def _version(asked: bool) -> None:
    if not asked:
        return
    from importlib.metadata import PackageNotFoundError, version

    try:
        typer.echo(f"ssduck {version('ssduck')}")
    except PackageNotFoundError:
        typer.echo("ssduck (not installed, run from its source)")
    raise typer.Exit


@app.callback()
def _ssduck(
    context: typer.Context,
    version: Annotated[  # noqa: ARG001  # its callback answers
        bool,
        typer.Option("--version", callback=_version, is_eager=True, help="Show the version."),
    ] = False,
) -> None:
    """Ask a robot simulation questions, in SelectScript or in SQL.

    SCENE is the name of a scene that comes with ssduck (see: ssduck scenes),
    or the path of a scene file (.toml) or of a model (.urdf, .sdf, .mjcf, .xml).
    """
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())


@app.command()
def demo(
    scene: Annotated[
        str, typer.Argument(metavar="SCENE", help="The scene that is asked: a name or a path.")
    ] = "kitchen",
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            help="Where the picture of the scene goes.",
            show_default="SCENE.png here",
        ),
    ] = None,
    picture: Annotated[
        bool, typer.Option("--picture/--no-picture", help="Whether to draw the scene.")
    ] = True,
    sql: Annotated[
        bool, typer.Option("--sql/--no-sql", help="Whether to show the SQL that programs become.")
    ] = True,
) -> None:
    """Walk through the tutorial's questions: the program, its SQL, the answer; draw the scene."""
    from ssduck.demo import questions
    from ssduck.interpreter import load
    from ssduck.scenes import find_scene

    if output is not None and not picture:
        raise typer.BadParameter("--output and --no-picture exclude each other")
    description = find_scene(scene)
    console = _console()
    with load(scene) as ss:
        asked = questions(description)
        taken = 0.0
        for number, question in enumerate(asked, 1):
            console.print(f"{number}. {question.asks}", style="bold")
            taken += _demonstrate(ss, question, console, sql)
        console.print(f"{len(asked)} questions in {taken:.2f} s")
        if picture:
            target = output or Path(f"{description.name}.png")
            _draw(ss.call_variable(description.name), target)
            console.print(f"The scene is drawn in {target}", soft_wrap=True)


@app.command()
def query(
    scene: Annotated[
        str, typer.Argument(metavar="SCENE", help="The scene that is asked: a name or a path.")
    ],
    program: Annotated[
        str | None,
        typer.Argument(
            metavar="PROGRAM", help="What is asked; standard input if it is - or missing."
        ),
    ] = None,
    file: Annotated[
        Path | None, typer.Option("--file", "-f", help="Read the program from a file.")
    ] = None,
    format: Annotated[
        Format, typer.Option("--format", "-F", help="How the answer is written.")
    ] = Format.TABLE,
    sql: Annotated[bool, typer.Option("--sql", help="The program is SQL.")] = False,
    steps: Annotated[
        int | None, typer.Option(min=0, help="Simulate that many steps first.")
    ] = None,
    seconds: Annotated[
        float | None,
        typer.Option(min=0.0, help="Simulate that long first, in whole steps of the scene."),
    ] = None,
) -> None:
    """Run a program on a scene and write its answer to standard output.

    A program that begins with a minus goes behind two of them:
    ssduck query kitchen -- '-1;'
    """
    if steps is not None and seconds is not None:
        raise typer.BadParameter("--steps and --seconds exclude each other")
    text = _program(program, file)

    from ssduck.interpreter import load
    from ssduck.scenes import find_scene

    description = find_scene(scene)
    if seconds is not None:
        steps = _whole_steps(seconds / description.timestep)
    # What a program prints is not its answer.
    with load(scene) as ss, contextlib.redirect_stdout(sys.stderr):
        ss.sql("SET enable_progress_bar = false")  # DuckDB's goes to standard output
        if steps:
            ss.call_variable(description.name).step(steps)
        value = ss.sql(text) if sql else ss.eval(text)
    _WRITERS[format](value)


def _whole_steps(count: float) -> int:
    if not math.isfinite(count):
        raise typer.BadParameter("--seconds: that is too long")
    return round(count)


@app.command()
def scenes() -> None:
    """List the scenes that come with ssduck."""
    from ssduck.scenes import read_scene, shipped_scenes

    shipped = [(name, read_scene(path).description) for name, path in shipped_scenes().items()]
    _print_table(_Answer(["scene", "description"], shipped))


@app.command()
def functions(
    name: Annotated[
        str | None,
        typer.Argument(metavar="NAME", help="The function to tell about; by default all."),
    ] = None,
) -> None:
    """List the functions of the language, or tell what one does."""
    from ssduck.interpreter import Interpreter

    with Interpreter() as ss:
        if name is not None:
            _line(ss.help(name))
            return
        listed = [_usage_and_gist(ss.help(known)) for known in ss.help()]
    _print_table(_Answer(["function", "what it does"], listed))


def _usage_and_gist(text: str) -> tuple[str, str]:
    """The usage and the first sentence of a function's help."""
    name, *lines = text.splitlines()
    usage = next((line for line in lines if line.startswith("Usage: ")), name)
    about = " ".join(line for line in lines if line != usage)
    return usage.removeprefix("Usage: "), re.split(r"(?<=\.) ", about, maxsplit=1)[0]


def _draw(world: World, target: Path) -> None:
    """Write a picture of a scene.

    Raises:
        SelectScriptError: the file cannot be written.
    """
    from PIL import Image

    picture = Image.fromarray(world.render())
    try:
        picture.save(target)
    except (OSError, ValueError) as error:  # a ValueError: no format has such an ending
        reason = error.strerror if isinstance(error, OSError) else error
        raise SelectScriptError(f"{target} cannot be written: {reason}") from error


# -- the program --------------------------------------------------------------------------


def _program(program: str | None, file: Path | None) -> str:
    """The program's text: the argument, the file's, or that of standard input.

    Raises:
        BadParameter: there is none, or there are two.
        SelectScriptError: it cannot be read.
    """
    if program is not None and file is not None:
        raise typer.BadParameter("the program is given twice: as an argument, and by --file")
    if file is not None and str(file) != "-":
        text = _decoded(_content(file), str(file))
    elif program is not None and program != "-":
        text = _decoded(program.encode(errors="surrogateescape"), "the program")
    elif sys.stdin is None or (program is None and file is None and sys.stdin.isatty()):
        raise typer.BadParameter("there is no program: give one, or --file, or standard input")
    else:
        text = _decoded(sys.stdin.buffer.read(), "standard input")
    if not text.strip():
        raise typer.BadParameter("the program is empty")
    return text


def _content(file: Path) -> bytes:
    try:
        return file.read_bytes()
    except OSError as error:
        raise SelectScriptError(f"{file} cannot be read: {error.strerror}") from error


def _decoded(content: bytes, source: str) -> str:
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise SelectScriptError(
            f"{source} is not UTF-8: byte {error.start} is 0x{content[error.start]:02x}"
        ) from error


# -- answers ------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Answer:
    """An answer as rows.

    Attributes:
        columns: their names, none if the rows are lists.
        rows: may differ in length if there are no columns.
        named: whether the answer itself names the columns.
    """

    columns: Sequence[str]
    rows: Sequence[Sequence[Any]]
    named: bool = True


def _answer(value: Any) -> _Answer:
    """A value as rows: lists of dicts and of lists row by row, else a row a value."""
    from ssduck.result import Result

    if isinstance(value, Result):
        return _Answer(_distinct(value.columns), value.fetchall())
    if isinstance(value, dict):
        return _Answer(["key", "value"], list(value.items()))
    if value is None:
        return _Answer(["value"], [], named=False)
    if not isinstance(value, list):
        return _Answer(["value"], [[value]], named=False)
    if value and all(isinstance(row, dict) for row in value):
        names = list(dict.fromkeys(name for row in value for name in row))
        return _Answer([_key(name) for name in names], [[*map(row.get, names)] for row in value])
    if value and all(isinstance(row, list) for row in value):
        return _Answer([], value, named=False)
    return _Answer(["value"], [[element] for element in value], named=False)


def _distinct(names: Sequence[str]) -> list[str]:
    """Columns of the same name are told apart by a number."""
    found: list[str] = []
    for name in names:
        numbered = (f"{name}_{number}" for number in range(2, 2 + len(names)))
        found.append(next(n for n in (name, *numbered) if n not in found))
    return found


def _write_table(value: Any) -> None:
    answer = _answer(value)
    if answer.columns and not answer.named:
        for row in answer.rows:
            _line(_shown(row[0]))
    elif answer.columns or answer.rows:
        _print_table(answer)
    if answer.columns and not answer.rows and value is not None:
        _line("(no rows)")


def _write_json(value: Any) -> None:
    from ssduck.result import Result

    if isinstance(value, Result):
        columns = _distinct(value.columns)
        value = [dict(zip(columns, row, strict=True)) for row in value.fetchall()]
    ascii_only = (sys.stdout.encoding or "").lower() not in ("utf-8", "utf8")
    if not (isinstance(value, list) and any(isinstance(row, list | dict) for row in value)):
        _line(json.dumps(_plain(value), ensure_ascii=ascii_only))
        return
    start = "[\n"
    for row in value:  # a row a line can be read by people too
        sys.stdout.write(start + json.dumps(_plain(row), ensure_ascii=ascii_only))
        start = ",\n"
    _line("\n]")


def _write_csv(value: Any) -> None:
    answer = _answer(value)
    writer = csv.writer(sys.stdout, lineterminator="\n")
    if answer.columns:
        writer.writerow(answer.columns)
    writer.writerows([[_cell(element) for element in row] for row in answer.rows])


_WRITERS = {Format.TABLE: _write_table, Format.JSON: _write_json, Format.CSV: _write_csv}


def _plain(value: Any) -> Any:
    """A value as JSON has it: entities and worlds by name, numbers that are none as null."""
    match value:
        case None | bool() | int() | str():
            return value
        case float():
            return value if math.isfinite(value) else None
        case list() | tuple():
            return [_plain(element) for element in value]
        case dict():
            return {_key(key): _plain(element) for key, element in value.items()}
        case bytes():
            return value.hex()
    return _of_other_type(value)


def _of_other_type(value: Any) -> Any:
    from ssduck.world import Entity, World

    match value:
        case Entity() | World():
            return value.name
        case Decimal():
            return float(value)
        case dt.date() | dt.time():
            return value.isoformat()
    return str(value)


def _key(key: Any) -> str:
    return key if isinstance(key, str) else _cell(key)


def _cell(value: Any) -> str:
    """A value in a CSV file: a text, or JSON; an unknown value is empty."""
    plain = _plain(value)
    if plain is None:
        return ""
    return plain if isinstance(plain, str) else json.dumps(plain, ensure_ascii=False)


def _shown(value: Any, *, inside: bool = False) -> str:
    """A value for people: numbers rounded to six digits, entities by name."""
    match value:
        case float():
            return f"{value + 0.0:.{6 if abs(value) < 1e6 else 15}g}"  # -0.0 + 0.0 is 0.0
        case str():
            return repr(value) if inside else value
        case list() | tuple():
            return f"[{', '.join(_shown(element, inside=True) for element in value)}]"
        case dict():
            items = (
                f"{_shown(k, inside=True)}: {_shown(v, inside=True)}" for k, v in value.items()
            )
            return f"{{{', '.join(items)}}}"
        case None:
            return "NULL"
        case bool():
            return str(value)
    return str(_plain(value))


# -- on the terminal ----------------------------------------------------------------------


def _line(text: str) -> None:
    sys.stdout.write(f"{text}\n")


def _console() -> Console:
    """Where text is printed as it is: square brackets are no markup, numbers not coloured."""
    from rich.console import Console

    console = Console(markup=False, highlight=False, emoji=False)
    if not console.is_terminal:
        console.width = WIDTH
    return console


def _print_table(answer: _Answer) -> None:
    """A table, folded to fit a terminal; elsewhere it is as wide as it is."""
    console = _console()
    if console.is_terminal:
        console.print(_table(answer))
    else:
        sys.stdout.writelines(f"{line}\n" for line in _aligned(answer))


def _table(answer: _Answer) -> RenderableType:
    """A table for rich, which takes its time: half a second for a thousand rows."""
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, show_edge=False, pad_edge=False, show_header=answer.named)
    for name, numeric in zip(_names(answer), _numeric(answer), strict=True):
        table.add_column(name, justify="right" if numeric else "left", overflow="fold")
    for row in answer.rows:
        table.add_row(*map(_on_one_line, row))
    return table


def _aligned(answer: _Answer) -> Iterator[str]:
    """The lines of a table that is read by programs, or kept."""
    from rich.cells import cell_len

    lines = [[_on_one_line(value) for value in row] for row in answer.rows]
    if answer.named:
        lines.insert(0, [_on_one_line(name) for name in answer.columns])
    widths = [max(map(cell_len, cells)) for cells in zip_longest(*lines, fillvalue="")]
    if answer.named:
        lines.insert(1, ["-" * width for width in widths])
    numeric = _numeric(answer)
    for line in lines:
        padded = (
            " " * (width - cell_len(text)) + text
            if right
            else text + " " * (width - cell_len(text))
            for text, width, right in zip(line, widths, numeric, strict=False)
        )
        yield "  ".join(padded).rstrip()


def _names(answer: _Answer) -> Sequence[str]:
    width = max(map(len, answer.rows), default=0)
    return [_on_one_line(name) for name in answer.columns] if answer.named else [""] * width


def _numeric(answer: _Answer) -> list[bool]:
    """Which columns hold numbers only; they are aligned at the right."""
    columns = zip_longest(*answer.rows)
    found = [all(map(_is_number, column)) for column in columns]
    return found or [False] * len(answer.columns)


def _is_number(value: Any) -> bool:
    return value is None or (
        isinstance(value, int | float | Decimal) and not isinstance(value, bool)
    )


def _on_one_line(value: Any) -> str:
    """As `_shown`; line ends and what else would upset a terminal are escaped."""
    text = _shown(value)
    return text if text.isprintable() else repr(text)[1:-1]


# -- the demonstration --------------------------------------------------------------------


def _demonstrate(ss: Interpreter, question: Question, console: Console, with_sql: bool) -> float:
    """Ask a question and show all of it; how long the answer took, in seconds."""
    from rich.table import Table

    added = question.addition
    if added is not None:
        ss.add_function(added.name, added.function, added.help)
    start = time.perf_counter()
    value = ss.sql(question.program) if question.sql else ss.eval(question.program)
    taken = time.perf_counter() - start
    answer = _answer(value)

    shown = Table.grid(padding=(0, 2, 1, 0))
    shown.add_column(style="dim", min_width=9)
    shown.add_column(overflow="fold")
    if added is not None:
        shown.add_row("  Python", _highlighted(inspect.getsource(added.function)))
    shown.add_row("  SQL" if question.sql else "  program", _highlighted(question.program))
    if with_sql and not question.sql and (sql := ss.explain(question.program)):
        shown.add_row("  as SQL", _compact(sql), style="dim")
    shown.add_row("  answer", _table(answer) if answer.named else _shown(value))
    with console.capture() as captured:
        console.print(shown)
        console.line()
    # Padding at the ends of lines is in the way of those who copy or compare them.
    sys.stdout.write(re.sub(r" +$", "", captured.get(), flags=re.MULTILINE))
    return taken


def _highlighted(code: str) -> Text:
    from rich.text import Text

    text = Text(code.strip())
    text.highlight_regex(_KEYWORDS, "cyan")
    text.highlight_regex(r"'[^']*'|\"[^\"]*\"", "green")
    return text


def _compact(sql: str) -> str:
    """SQL with a line a clause; what is indented continues the clause before it."""
    joined = re.sub(r"\n\s+(?=\S)", " ", re.sub(r"\n\s+(?=\))", "", sql))
    return joined.replace("( ", "(")
