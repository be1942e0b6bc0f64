"""Defines the commands that list what there is: `ssduck scenes` and `functions`."""

from __future__ import annotations

from typing import Annotated

import typer

from ssduck.adapters.display import DisplayTable, print_line, print_table


def scenes() -> None:
    """List the scenes that come with ssduck."""
    from ssduck.simulators.scenes import read_scene, shipped_scenes

    shipped = [(name, read_scene(path).description) for name, path in shipped_scenes().items()]
    print_table(DisplayTable(["scene", "description"], shipped))


def functions(
    name: Annotated[
        str | None,
        typer.Argument(metavar="NAME", help="The function to describe; all are listed by default."),
    ] = None,
) -> None:
    """List the functions of the language with their usage, or describe one."""
    from ssduck.interpreter.completion import usage_and_summary
    from ssduck.interpreter.interpreter import Interpreter

    with Interpreter() as ss:
        if name is not None:
            print_line(ss.help(name))
            return
        listing = [usage_and_summary(ss.help(known)) for known in ss.help()]
    print_table(DisplayTable(["function", "what it does"], listing))
