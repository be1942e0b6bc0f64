"""Defines the commands about many records: `ssduck lake`, `ask`, `lint` and `tag`."""

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
    Strict,
    option,
    program_text,
    strict_limits,
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
        metavar="LAKE",
        help="A folder with records at any depth, a record, a pattern of paths, or s3://BUCKET/PATH.",
    ),
]
Where = Annotated[
    str | None,
    option(
        "Only episodes for which it holds, in SQL: \"task = 'pick' AND NOT success\".",
        "CONDITION",
        flags="--where -w",
        default="all",
    ),
]
EngineOption = Annotated[
    Engine, option("What runs the program: see the guide.", "local|ray|spark", flags="--engine -e")
]
Processes = Annotated[
    int | None,
    option("The number of processes of this machine.", "N", default="one a core", least=1),
]
Batch = Annotated[
    int | None,
    option("The number of episodes that are asked together.", "N", default="at most 100", least=1),
]
Resume = Annotated[
    Path | None,
    option(
        "Keep the answers of finished batches there, and go on from them.",
        "FOLDER",
        default="keep nothing",
    ),
]
SqlOption = Annotated[
    Dialect | None,
    option(
        "Write the statement that answers a program of formulas without ssduck; ask nothing.",
        "duckdb|spark",
        flags="--sql",
        default="ask",
    ),
]
ForgetMissing = Annotated[
    bool, option("List episodes whose files are gone no longer.", flags="--forget-missing")
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
    limits = strict_limits() if strict else None

    from ssduck.adapters.result import Result
    from ssduck.lakes.lake import open_lake

    if sql is not None:
        text = program_text(program, file)
        write_text(open_lake(path, limits=limits).sql(text, where, sql), output)
        return
    write = writer_of_result(format, output, rows)
    text, lake = program_text(program, file), open_lake(path, limits=limits)
    with redirect_stdout(sys.stderr):  # the output of a program is not its result
        answers = lake.ask(
            text,
            where,
            engine=engine,
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


def lint(
    path: Lake, program: Program = None, file: ProgramFile = None, where: Where = None
) -> None:
    """Tell of a condition that holds never, always, or at the first tick of each episode."""
    from ssduck.lakes.lake import Lake as Episodes

    told = Episodes(path).lint(program_text(program, file), where)
    for sentence in told:
        print_line(sentence)
    raise typer.Exit(1 if told else 0)


def tag(
    path: Lake,
    tags: Annotated[
        list[str] | None,
        typer.Argument(metavar="NAME=VALUE", help="A tag, such as task=pick; may be repeated."),
    ] = None,
    program: Annotated[
        list[str] | None,
        option(
            "A tag whose value is the answer of each episode to a program; may be repeated.",
            "NAME=PROGRAM",
            flags="--program -p",
            default="none",
        ),
    ] = None,
    where: Where = None,
    processes: Processes = None,
) -> None:
    """Tag episodes: with values, or with their answers to programs.

    ssduck tag runs task=pick --program "success=on(sim.table, sim.cup);"
    """
    from ssduck.lakes.lake import Lake as Episodes
    from ssduck.recording.episode import parsed_tag

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
