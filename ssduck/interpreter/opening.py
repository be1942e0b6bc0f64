"""Opens interpreters: `load` on a scene, `open_record` on a record."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Literal

from ssduck import validation
from ssduck.errors import ArgumentError, RecordError, record_errors, warn
from ssduck.interpreter.archives import recorded_runs, replayed_world, select_runs
from ssduck.interpreter.interpreter import Interpreter
from ssduck.interpreter.namespace import check_name
from ssduck.lazy import service
from ssduck.limits import Limits
from ssduck.recording.folder_check import partial_run
from ssduck.recording.paths import expand_path
from ssduck.recording.spec import Recording
from ssduck.recording.stores.parquet_layout import FolderRun
from ssduck.simulators.scenes import Scene, find_scene
from ssduck.world.world import World


def load(
    scene: str | Path,
    database: str | Path = ":memory:",
    *,
    recording: Recording | Literal["default"] | None = "default",
    limits: Limits | None = None,
    simulator: str | None = None,
    name: str | None = None,
) -> Interpreter:
    """Returns an interpreter with the world of a scene, bound to the name of the scene.

    Args:
        scene: the name of a shipped scene, or the path of a scene file or of a model (URDF, SDF or
            MJCF).
        database: the path of a DuckDB file, or `":memory:"`.
        recording: the recording of the world; see `Interpreter`.
        limits: the limits of programs and SQL; with `Limits.strict()`, for a scene or programs
            from elsewhere, the interpreter is a `SandboxedInterpreter`, and the scene reads its
            own folder only.
        simulator: `"mujoco"` or `"pybullet"`; by default MuJoCo, if it is installed, for an MJCF
            file, and PyBullet for everything else.
        name: the name of the world; by default that of the scene or the file. Where this is a word
            of the language or of SQL, as that of `main.xml`, it is `world_main`, with a warning.

    Raises:
        ArgumentError: no world can have the name.
        UnknownNameError: no scene has that name; the error suggests the nearest names.
        SceneError: the scene cannot be loaded; the error names file, key and reason.
        LimitError: in a sandbox, loading takes too long, or too much memory.

    >>> import ssduck
    >>> with ssduck.load("kitchen") as ss:
    ...     ss.eval("SELECT id(this) FROM kitchen WHERE id(this) == 'fridge' AS list;")
    ['fridge']
    """
    validation.instance(limits, Limits, "load: limits")
    if limits is not None and limits.is_sandboxed:
        options = {"recording": recording, "simulator": simulator, "name": name}
        sandboxed: Interpreter = service("sandboxed load")(scene, database, limits, **options)
        return sandboxed
    description = with_usable_name(find_scene(scene), name)
    interpreter = Interpreter(database, recording=recording, limits=limits)
    try:
        world = World.load(description, simulator=simulator)
        interpreter._owned_worlds.append(world)  # noqa: SLF001  # `close` closes it
        interpreter.add_variable(description.name, world)
    except BaseException:
        interpreter.close()
        raise
    return interpreter


def with_usable_name(scene: Scene, name: str | None = None) -> Scene:
    """Returns a scene with a usable name: a given one, its own or, with a warning, one like it."""
    if name is not None:
        _check_world_name(name)
        return replace(scene, name=name)
    try:
        _check_world_name(scene.name)
    except ArgumentError as error:
        name = f"world_{scene.name}"
        reason = error.message.partition("; choose")[0]
        warn(
            f"{scene.path}: {reason}; the world is {name!r}; load(…, name=…) gives it another name"
        )
        return replace(scene, name=name)
    return scene


def _check_world_name(name: str) -> None:
    check_name(name, "a world")
    validation.world_name(name)


def open_record(
    path: str | Path,
    world: str | None = None,
    episode: int | None = None,
    *,
    limits: Limits | None = None,
    partial: bool = False,
) -> Interpreter:
    """Returns an interpreter on a record, without a simulation; it runs the same programs.

    Each world is bound to its name, at its last tick. `kitchen{12.5}` and the tables of its history
    give the other ticks.

    A DuckDB file is opened to read, so that any number of processes can open it at once, as long as
    no process records into it.

    Args:
        path: a folder that `Interpreter.export` or `ssduck record` wrote, or a DuckDB file with a
            record.
        world: the name of the world to open; None for all worlds.
        episode: the number of the episode; None for the last episode with ticks of each world.
        limits: the limits of programs and SQL; with `Limits.strict()`, for a record or programs
            from elsewhere, the interpreter is a `SandboxedInterpreter`. With `files=False`, SQL is
            one SELECT, since the record's own files can be reached.
        partial: whether parts of a folder that are damaged or missing are left out, with a warning
            for each of their files, in place of an error. All files are read first.

    Raises:
        RecordError: there is no such record, or it is damaged, of a newer version, or in use by
            another process.
        LimitError: in a sandbox, opening takes longer than `seconds`, and than 10 s.
        NumberError: the episode is not a whole number ≥ 0.
    """
    validation.boolean(partial, "open: partial")
    if episode is not None:
        episode = validation.integer(episode, "open: episode", minimum=0)
    validation.instance(limits, Limits, "open: limits")
    if limits is not None and limits.is_sandboxed:
        places = path, world, episode
        sandboxed: Interpreter = service("sandboxed open")(*places, limits, partial=partial)
        return sandboxed
    if limits is not None and not limits.files:
        limits = replace(limits, select_only=True)
    return opened_record(path, world, episode, limits=limits, partial=partial)


@record_errors()
def opened_record(
    path: str | Path,
    world: str | None,
    episode: int | None,
    *,
    limits: Limits | None,
    partial: bool,
) -> Interpreter:
    """Returns an interpreter on a record in this process, with any SQL that the limits allow.

    For the arguments see `open_record`.
    """
    path = expand_path(path).absolute()  # the working directory may change
    interpreter = Interpreter(recording=None, limits=limits)
    database = interpreter._database  # noqa: SLF001  # it reads the record
    try:
        if path.is_dir():
            database.raw_sql.record_folders.append(path.absolute())
        runs = select_runs(recorded_runs(path, database), world, episode)
        if partial:
            runs = [partial_run(run) if isinstance(run, FolderRun) else run for run in runs]
        worlds = [replayed_world(run, database) for run in runs]
        try:
            for replayed in worlds:
                interpreter.add_variable(replayed.name, replayed)
        except ArgumentError as error:
            raise RecordError(f"{path} cannot be opened: {error.message}") from error
    except BaseException:
        interpreter.close()
        raise
    return interpreter
