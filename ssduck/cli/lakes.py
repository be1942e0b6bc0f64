"""Defines the commands about many records: `ssduck lake`, `ask` and `tag`."""

from __future__ import annotations

import sys
from contextlib import redirect_stdout
from pathlib import Path
from typing import Annotated, Literal, TypeAlias

import typer

from ssduck.adapters.display import print_line
from ssduck.cli.options import (
    FormatOption,
    Output,
    Program,
    ProgramFile,
    Rows,
    program_text,
    write_text,
    writer_of_result,
)
from ssduck.errors import ArgumentError, warn
from ssduck.formatting import count_of

Engine: TypeAlias = Literal["local", "ray", "spark"]
Dialect: TypeAlias = Literal["duckdb", "spark"]
Lake = Annotated[
    str,
    typer.Argument(
        metavar="LAKE", help="A folder with records at any depth, a record, or a pattern of paths."
    ),
]
Where = Annotated[
    str | None,
    typer.Option(
        "--where",
        "-w",
        metavar="CONDITION",
        help="Only episodes for which it holds, in SQL: \"task = 'pick' AND NOT success\".",
        show_default="all",
    ),
]
EngineOption = Annotated[
    Engine,
    typer.Option(
        "--engine", "-e", metavar="local|ray|spark", help="What runs the program: see the guide."
    ),
]
Processes = Annotated[
    int | None,
    typer.Option(
        min=1,
        metavar="N",
        help="The number of processes of this machine.",
        show_default="one a core",
    ),
]
Batch = Annotated[
    int | None,
    typer.Option(
        min=1,
        metavar="N",
        help="The number of episodes that are asked together.",
        show_default="at most 100",
    ),
]
Resume = Annotated[
    Path | None,
    typer.Option(
        metavar="FOLDER",
        help="Keep the answers of finished batches there, and go on from them.",
        show_default="keep nothing",
    ),
]
SqlOption = Annotated[
    Dialect | None,
    typer.Option(
        "--sql",
        metavar="duckdb|spark",
        help="Write the statement that answers a program of formulas without ssduck; ask nothing.",
        show_default="ask",
    ),
]
Strict = Annotated[
    bool,
    typer.Option(
        "--strict",
        help="For programs from elsewhere: limit time, memory and rows, and refuse probable "
        "mistakes instead of warning.",
    ),
]
ForgetMissing = Annotated[
    bool,
    typer.Option("--forget-missing", help="List episodes whose files are gone no longer."),
]


# The columns of episodes that a table on standard output leaves out.
_NOT_IN_TABLES = ["id", "version", "first_tick", "last_tick", "every", "tables", "entities", "size"]


def lake(
    path: Lake,
    where: Where = None,
    format: FormatOption = None,
    output: Output = None,
    rows: Rows = None,
    forget_missing: ForgetMissing = False,
) -> None:
    """List the episodes of all records below a path, with their tags.

    A table leaves out some of the columns; other formats and files have all.
    """
    from ssduck.adapters.result import Result
    from ssduck.lakes.lake import Lake as Episodes
    from ssduck.lakes.where import no_episode

    write = writer_of_result(format, output, rows)
    lake = Episodes(path)
    if forget_missing:
        lake.refresh(forget_missing=True)
    episodes = lake.select(where)
    if where is not None and not episodes.num_rows:
        warn(no_episode(where, lake.episodes))
    is_whole = output is not None or format not in (None, "table")
    write(Result(episodes if is_whole else episodes.drop_columns(_NOT_IN_TABLES)))


def ask(
    path: Lake,
    program: Program = None,
    file: ProgramFile = None,
    where: Where = None,
    engine: EngineOption = "local",
    processes: Processes = None,
    batch: Batch = None,
    resume: Resume = None,
    format: FormatOption = None,
    output: Output = None,
    rows: Rows = None,
    strict: Strict = False,
    sql: SqlOption = None,
) -> None:
    """Ask all episodes below a path one question, and write their answers."""
    from ssduck.adapters.result import Result
    from ssduck.lakes.lake import Lake as Episodes
    from ssduck.limits import Limits

    limits = Limits.strict() if strict else None
    if sql is not None:
        text = program_text(program, file)
        write_text(Episodes(path).sql(text, where, sql, limits=limits), output)
        return
    write = writer_of_result(format, output, rows)
    text, lake = program_text(program, file), Episodes(path)
    with redirect_stdout(sys.stderr):  # the output of a program is not its result
        answers = lake.ask(
            text,
            where,
            engine,
            limits=limits,
            strict=strict,
            processes=processes,
            batch=batch,
            resume=resume,
        )
    write(Result(answers))
    failed = answers.num_rows - answers["error"].null_count
    if failed:
        sys.stderr.write(f"{count_of(failed, 'episode')} without an answer: see the column error\n")
        raise typer.Exit(1)


def tag(
    path: Lake,
    tags: Annotated[
        list[str] | None,
        typer.Argument(metavar="NAME=VALUE", help="A tag, such as task=pick; may be repeated."),
    ] = None,
    program: Annotated[
        list[str] | None,
        typer.Option(
            "--program",
            "-p",
            metavar="NAME=PROGRAM",
            help="A tag whose value is the answer of each episode to a program; may be repeated.",
            show_default="none",
        ),
    ] = None,
    where: Where = None,
    processes: Processes = None,
) -> None:
    """Tag episodes: with values, or with their answers to programs.

    ssduck tag runs task=pick --program "success=on(sim.table, sim.cup);"
    """
    from ssduck.lakes.lake import Lake as Episodes
    from ssduck.recording.tags import parsed_tag

    if not tags and not program:
        raise typer.BadParameter("there is no tag: give NAME=VALUE, or --program NAME=PROGRAM")

    values = dict(map(parsed_tag, tags or ()))
    programs = []
    for text in program or ():
        name, separator, source = text.partition("=")
        if not (separator and name.strip()):
            raise ArgumentError(f"--program: {text!r} has no name; write NAME=PROGRAM")
        programs.append((name.strip(), source))
    lake = Episodes(path)
    if values:
        count = lake.set_tags(values, where)
        print_line(f"{', '.join(values)}: {count_of(count, 'episode')}")
    for name, source in programs:
        answers = lake.tag(name, source, where, processes=processes)
        failed = answers.num_rows - answers["error"].null_count
        print_line(f"{name}: {count_of(answers.num_rows - failed, 'episode')}")
        if failed:
            sys.stderr.write(f"{count_of(failed, 'episode')} without an answer\n")
