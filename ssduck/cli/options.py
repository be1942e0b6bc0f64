"""Options that several commands have: the program, and the format and the place of a result."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from contextvars import ContextVar
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeAlias

import typer

from ssduck.adapters.display import print_line, terminal_rows
from ssduck.errors import SelectScriptError
from ssduck.lazy import ONE_THREAD

if TYPE_CHECKING:
    from ssduck.limits import Limits


def option(
    help: str,
    metavar: str | None = None,
    *,
    flags: str = "",
    default: str | bool = True,
    least: float | None = None,
) -> Any:
    """Returns what describes an option; `default` tells in its help what it is by default."""
    return typer.Option(*flags.split(), metavar=metavar, min=least, help=help, show_default=default)


Format: TypeAlias = Literal["table", "csv", "json", "parquet", "markdown"]
Location = Annotated[
    str, typer.Argument(metavar="SCENE|RECORD", help="A scene, or the path of a record.")
]
RecordPath = Annotated[Path, typer.Argument(metavar="RECORD", help="The record.")]
EpisodeNumber = Annotated[
    int | None,
    option("The number of the episode of a record.", "N", default="the last one", least=0),
]
Strict = Annotated[
    bool,
    option(
        "For programs, scenes and records from elsewhere: run them in a sandbox, limit time, "
        "memory and rows, and refuse probable mistakes instead of warning.",
        flags="--strict",
    ),
]
Program = Annotated[
    str | None,
    typer.Argument(
        metavar="PROGRAM", help="The program; it comes from standard input if it is - or missing."
    ),
]
ProgramFile = Annotated[
    Path | None, option("Read the program from a file.", "FILE", flags="--file -f")
]
FormatOption = Annotated[
    Format | None,
    option(
        "The format of the result.",
        "table|csv|json|parquet|markdown",
        flags="--format -F",
        default="that of the ending of --output, or table",
    ),
]
Output = Annotated[
    Path | None,
    option(
        "Write the whole result to a file; an existing one is replaced.",
        "FILE",
        flags="--output -o",
        default="standard output",
    ),
]
Rows = Annotated[
    int | None,
    option(
        "Print at most N rows of a table: the first and the last ones.",
        "N",
        default="40 on a terminal, otherwise all",
        least=0,
    ),
]


def writer_of_result(
    name: Format | None, output: Path | None, rows: int | None
) -> Callable[[Any], object]:
    """Returns the function that writes a result to standard output or a file."""
    from ssduck.adapters.formats import FORMATS, format_of, print_value, save

    if name is None:
        format = FORMATS["table"] if output is None else format_of(output)
    else:
        format = FORMATS[name]
    if rows is not None and (output is not None or format.name != "table"):
        raise typer.BadParameter("--rows is for tables on standard output")
    if output is not None:
        return partial(save, path=output, format=format)
    if format.is_binary:
        raise typer.BadParameter(f"--format {format.name}: name a file, as in -o result.parquet")
    return partial(print_value, format=format, max_rows=terminal_rows() if rows is None else rows)


def write_text(text: str, output: Path | None) -> None:
    """Writes a text to standard output or a file, with a line end."""
    if output is None:
        print_line(text)
    else:
        output.write_text(f"{text}\n", encoding="utf-8")


def program_text(program: str | None, file: Path | None) -> str:
    """Returns the text of the program: the argument, a file or standard input."""
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


# Tells commands that the whole process is theirs; in tests, it is not.
IS_OWN_PROCESS = ContextVar("IS_OWN_PROCESS", default=False)


def strict_limits() -> Limits:
    """Returns the limits of `--strict`, whose sandbox is a fork of the process of a command.

    It comes before imports of libraries that may start threads, which a fork must not have.
    """
    if IS_OWN_PROCESS.get():
        os.environ.update(ONE_THREAD)
        from ssduck.sandbox.processes import fork_zygote

        fork_zygote()
    from ssduck.limits import Limits

    return Limits.strict()
