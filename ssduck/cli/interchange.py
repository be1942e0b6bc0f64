"""Defines the command for other tools: `ssduck macros`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ssduck.adapters.display import print_line


def macros(
    names: Annotated[
        list[str] | None,
        typer.Argument(metavar="NAME", help="A relation to write; all are by default."),
    ] = None,
    record: Annotated[
        Path | None,
        typer.Option(
            "--of",
            metavar="RECORD",
            help="A folder whose tables become views, with relations that look things up in them.",
        ),
    ] = None,
    world: Annotated[
        str | None, typer.Option(metavar="NAME", help="The world of the record.")
    ] = None,
    episode: Annotated[
        int | None,
        typer.Option(
            min=0, metavar="N", help="The number of the episode.", show_default="the last one"
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", "-o", metavar="FILE", help="The file.", show_default="standard output"
        ),
    ] = None,
) -> None:
    """Write relations as macros for plain DuckDB, which needs no ssduck then.

    The comments at the beginning name the relations that are not there, and why.
    """
    from ssduck.interchange.macros import macro_script
    from ssduck.interpreter.archives import folder_run

    if record is None and (world is not None or episode is not None):
        raise typer.BadParameter("--world, --episode: name the record by --of")
    run = None if record is None else folder_run(record, world, episode)
    script = macro_script(tuple(names or ()), run).text
    if output is None:
        print_line(script.rstrip("\n"))
    else:
        output.write_text(script, encoding="utf-8")
