"""Defines the command `ssduck` and its commands, as `demo`, `query`, `record` and `shell`.

Standard output carries results only; warnings, errors and the output of programs go to standard
error. Modules that are slow to import (the simulator, the database) are imported by the
commands that need them, so that help appears at once.
"""

from __future__ import annotations

import contextlib
import io
import os
import signal
import sys
from contextlib import closing
from pathlib import Path
from typing import Annotated, Any, NoReturn

import typer
from typer.core import TyperGroup

from ssduck.adapters.display import DisplayTable, print_line, print_table, written_warnings
from ssduck.cli.lakes import ask, lake, lint, tag
from ssduck.cli.options import (
    IS_OWN_PROCESS,
    EpisodeNumber,
    FormatOption,
    Location,
    Output,
    Program,
    ProgramFile,
    Rows,
    Strict,
    option,
    program_text,
    strict_limits,
    writer_of_result,
)
from ssduck.cli.records import check, episodes, export, import_, macros, open_or_load, record
from ssduck.cli.viewing import functions, render, scenes, view
from ssduck.errors import SelectScriptError, UnknownNameError, nearest
from ssduck.recording.paths import is_record


class _Commands(TyperGroup):
    """The commands; errors of ssduck, and warnings, become messages and exit codes."""

    def invoke(self, ctx: Any) -> Any:
        try:
            with written_warnings():
                result = super().invoke(ctx)
        except (SelectScriptError, Warning) as error:  # `python -W error` raises warnings
            _write_error(str(error))
            raise typer.Exit(1) from error
        sys.stdout.flush()  # here typer still handles a closed pipe quietly
        return result


app = typer.Typer(
    cls=_Commands,
    invoke_without_command=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def main() -> None:
    """Runs the command `ssduck`; its entry point."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _interrupted)
    _prepare_streams()
    IS_OWN_PROCESS.set(True)
    sys.set_int_max_str_digits(0)  # programs may compute longer integers than 4300 digits
    try:
        app(prog_name="ssduck")
    except OSError as error:
        if error.filename is not None:
            raise
        # Output that cannot be written (a full disk, say) must not be flushed again at exit.
        sys.stdout = io.StringIO()
        _write_error(str(error))
        sys.exit(1)


def _interrupted(*_: object) -> NoReturn:
    """Ends the process at once on Ctrl-C."""
    os._exit(130)


def _prepare_streams() -> None:
    """Redirects closed streams to the null device, and escapes letters that a locale lacks."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, Path(os.devnull).open("w", encoding="utf-8"))  # noqa: SIM115
        elif isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def _write_error(message: str) -> None:
    """Writes an error message unfolded, so that marks stay below the text that they underline."""
    from rich.console import Console

    Console(stderr=True).print("error:", style="bold red", end=" ")
    sys.stderr.write(f"{message}\n")


# -- commands -----------------------------------------------------------------------------


def _show_version(requested: bool) -> None:
    if not requested:
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
    version: Annotated[  # noqa: ARG001  # its callback shows the version
        bool,
        typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version."),
    ] = False,
) -> None:
    """Query a robot simulation in SelectScript or in SQL."""
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())


# Its folders have the names of demonstrations and scenes.
_DEMO_FOLDER = Path("ssduck-demo")

_DemoName = Annotated[
    str,
    typer.Argument(metavar="NAME", help="The name of a demonstration (see --list), or a SCENE."),
]
OutputFolder = Annotated[
    Path | None,
    option(
        "The folder for pictures and files. It is made if necessary; other files in it stay.",
        "FOLDER",
        flags="--out",
        default="ssduck-demo/NAME",
    ),
]
_PictureFile = Annotated[
    Path | None,
    option(
        "For kitchen and scenes: the file of the picture, in the format of its ending. "
        "An existing file is replaced.",
        "FILE",
        flags="--output -o",
        default="NAME.png in the folder, or a free name beside it",
    ),
]


@app.command()
def demo(
    name: _DemoName = "kitchen",
    listed: Annotated[
        bool, option("List the demonstrations instead of running one.", flags="--list")
    ] = False,
    out: OutputFolder = None,
    seed: Annotated[int, option("The seed of random numbers.", "N", flags="--seed", least=0)] = 0,
    output: _PictureFile = None,
    picture: Annotated[
        bool,
        typer.Option(
            "--picture/--no-picture", help="For kitchen and scenes: whether to draw a picture."
        ),
    ] = True,
    sql: Annotated[
        bool,
        typer.Option("--sql/--no-sql", help="For kitchen and scenes: whether to show the SQL."),
    ] = True,
) -> None:
    """Run a demonstration, or general questions about a scene.

    The questions are shown with their programs, SQL and results. Those of the kitchen are from
    SelectScript's tutorial.
    """
    from ssduck.demos import NAMES, description_of, run_of

    if listed:
        rows = [(each, description_of(each)) for each in NAMES]
        print_table(DisplayTable(["demo", "what it shows"], rows))
        return
    if output is not None and (out is not None or not picture):
        other = "--no-picture" if out is None else "--out"
        raise typer.BadParameter(f"--output and {other} exclude each other")
    if name not in NAMES or name == "kitchen":
        _demonstrate_scene(name, out, output, with_picture=picture, with_sql=sql)
        return
    if output is not None or not picture or not sql:
        raise typer.BadParameter("--output, --no-picture and --no-sql are for scenes")
    if not run_of(name)(_created_folder(out or _DEMO_FOLDER / name), print_line, seed=seed):
        raise SelectScriptError(f"the demonstration {name!r} did not succeed: see above")


def _demonstrate_scene(
    name: str, out: Path | None, output: Path | None, *, with_picture: bool, with_sql: bool
) -> None:
    """Demonstrates a scene by queries, with a picture in a folder or a file, if requested."""
    from ssduck.demos import NAMES
    from ssduck.demos.kitchen import ask
    from ssduck.interpreter.opening import with_usable_name
    from ssduck.simulators.scenes import find_scene

    try:
        scene = with_usable_name(find_scene(name))
    except UnknownNameError as error:
        message = f"there is no demonstration {name!r}: {', '.join(NAMES)}; and {error.message}"
        names = dict.fromkeys((*nearest(name, NAMES), *error.suggestions))
        raise UnknownNameError(message, suggestions=tuple(names)) from error
    folder = None
    if with_picture and output is None:
        folder = _created_folder(out or _DEMO_FOLDER / scene.name)
    ask(scene, print_line, folder, picture=output, with_sql=with_sql)


def _created_folder(folder: Path) -> Path:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise SelectScriptError(f"{folder} cannot be created: {error.strerror}") from error
    return folder


_SceneOrRecord = Annotated[
    str, typer.Argument(metavar="SCENE", help="The name or the path of a scene, or a RECORD.")
]
_Seconds = Annotated[
    float | None,
    option("Simulate T seconds first, rounded to whole steps of the scene.", "T", least=0.0),
]


@app.command()
def query(
    scene: _SceneOrRecord,
    program: Program = None,
    file: ProgramFile = None,
    format: FormatOption = None,
    output: Output = None,
    rows: Rows = None,
    sql: Annotated[bool, option("The program is SQL, not SelectScript.", flags="--sql")] = False,
    steps: Annotated[int | None, option("Simulate N steps first.", "N", least=0)] = None,
    seconds: _Seconds = None,
    episode: EpisodeNumber = None,
    strict: Strict = False,
) -> None:
    """Run a program on a scene or a record, and write its result.

    A program that begins with a minus sign follows two of them:
    ssduck query kitchen -- '-1;'
    """
    if steps is not None and seconds is not None:
        raise typer.BadParameter("--steps and --seconds exclude each other")
    if (steps is not None or seconds is not None) and is_record(scene):
        raise typer.BadParameter("--steps and --seconds: a record cannot be simulated further")
    text = program_text(program, file)
    limits = strict_limits() if strict else None
    write = writer_of_result(format, output, rows)

    from ssduck.interpreter.program import value_to_show
    from ssduck.validation import steps_in

    # The output of a program is not its result.
    with open_or_load(scene, episode, limits) as ss, contextlib.redirect_stdout(sys.stderr):
        ss.strict = strict
        if seconds is not None:
            steps = steps_in(seconds, ss.worlds[0].timestep, "--seconds")
        if steps:
            ss.worlds[0].step(steps)
        value = value_to_show(ss, text, "sql" if sql else "selectscript")
    write(value)


for command in (record, export, episodes, check, lake, ask, lint, tag, macros):
    app.command()(command)
app.command("import")(import_)


@app.command()
def mcp(location: Location, seconds: _Seconds = None, episode: EpisodeNumber = None) -> None:
    r"""Answer agents over the Model Context Protocol, on standard input and output.

    Programs run in a sandbox, as with `query --strict`. The extra mcp brings the protocol:
    pip install 'ssduck\[mcp]'
    """
    from ssduck.adapters.optional import library
    from ssduck.limits import Limits

    library("mcp", "mcp")
    from ssduck.mcp.server import create_server
    from ssduck.validation import steps_in

    if seconds is not None and is_record(location):
        raise typer.BadParameter("--seconds: a record cannot be simulated further")
    record = Path(location) if is_record(location) else None
    # An agent's sandbox is no fork of this process, whose environment may have secrets.
    with open_or_load(location, episode, Limits.strict(progress=False)) as ss:
        ss.strict = True
        if seconds is not None:
            ss.worlds[0].step(steps_in(seconds, ss.worlds[0].timestep, "--seconds"))
        create_server(ss, record).run("stdio")


@app.command()
def shell(
    location: Location = "kitchen",
    seconds: _Seconds = None,
    episode: EpisodeNumber = None,
    sql: Annotated[bool, option("Begin with SQL, not SelectScript.", flags="--sql")] = False,
    history: Annotated[
        bool,
        typer.Option("--history/--no-history", help="Whether to keep what is typed for later."),
    ] = True,
    strict: Strict = False,
) -> None:
    r"""Ask a scene or a record at a prompt, in SelectScript or SQL.

    Standard input may also be a file or a pipe; the exit code is 1 if a statement fails. The
    prompt needs an extra: pip install 'ssduck\[shell]'
    """
    if seconds is not None and is_record(location):
        raise typer.BadParameter("--seconds: a record cannot be simulated further")
    limits = strict_limits() if strict else None

    from ssduck.adapters.optional import library
    from ssduck.shell.session import Session, greet, run_lines

    is_terminal = sys.stdin is not None and sys.stdin.isatty()
    if is_terminal:
        library("prompt_toolkit", "shell")
    with open_or_load(location, episode, limits) as ss, closing(Session(ss)) as session:
        ss.strict = strict
        if seconds is not None:
            ss.run(seconds)
        session.language = "sql" if sql else "selectscript"
        if is_terminal:
            from ssduck.shell.terminal import prompt_session, run_terminal

            greet(session)
            run_terminal(session, prompt_session(session, with_history=history))
        elif not run_lines(session, sys.stdin or ()):
            raise typer.Exit(1)


app.command()(view)
app.command()(render)
app.command()(scenes)
app.command()(functions)
