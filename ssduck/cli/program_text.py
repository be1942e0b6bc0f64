"""Reads the text of a program: of an argument, a file or standard input."""

from __future__ import annotations

import sys
from pathlib import Path

import typer

from ssduck.errors import SelectScriptError


def program_text(program: str | None, file: Path | None) -> str:
    """Returns the text of the program: the argument, a file or standard input.

    Raises:
        BadParameter: there is no program, or there are two.
        SelectScriptError: the file cannot be read.
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
