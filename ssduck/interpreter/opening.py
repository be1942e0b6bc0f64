"""Interpreters on worlds: `load` makes one on a scene, `open_record` on what was recorded."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from ssduck import validation
from ssduck.interpreter.archives import chosen_runs, runs, world_of
from ssduck.interpreter.interpreter import Interpreter
from ssduck.recording.paths import given_path
from ssduck.recording.spec import Recording
from ssduck.simulators.scenes import find_scene
from ssduck.world.world import World


def load(
    scene: str | Path,
    database: str | Path = ":memory:",
    *,
    recording: Recording | Literal["default"] | None = "default",
) -> Interpreter:
    """An interpreter with a scene's world bound to the scene's name.

    Args:
        scene: the name of a shipped scene, or the path of a scene file, or of a model
            (URDF, SDF or MJCF).
        database: a DuckDB file, or `":memory:"`.
        recording: what is kept of the ticks; see `Interpreter`.

    Raises:
        UnknownNameError: there is no such scene, with the nearest names.
        SceneError: it cannot be loaded: file, key and reason.
    """
    description = find_scene(scene)
    interpreter = Interpreter(database, recording=recording)
    try:
        world = World.load(description)
        interpreter._own.append(world)  # noqa: SLF001  # it closes what is made here
        interpreter.add_variable(description.name, world)
    except BaseException:
        interpreter.close()
        raise
    return interpreter


def open_record(
    path: str | Path, world: str | None = None, episode: int | None = None
) -> Interpreter:
    """An interpreter on what was recorded, without a simulation: the same programs run.

    Each world is bound to its name, as it was at its last tick; `kitchen{12.5}` and the tables
    of its history tell of the others.

    A DuckDB file is only read, so that any number of processes can open it together, as long as
    none records into it.

    Args:
        path: a folder that `Interpreter.export` or `ssduck record` wrote, or a DuckDB file that
            was recorded into.
        world: the world that is opened; None for all.
        episode: the number of the run; None for the last one of each world that holds any tick.

    Raises:
        RecordError: there is no such record, it is damaged, of a newer version, or in use by
            another process.
        NumberError: the episode is no whole number, 0 or more.
    """
    if episode is not None:
        episode = validation.integer(episode, "open: episode", minimum=0)
    interpreter = Interpreter(recording=None)
    database = interpreter._database  # noqa: SLF001  # records are read in it
    try:
        found = [
            world_of(run, database)
            for run in chosen_runs(runs(given_path(path), database), world, episode)
        ]
        for recorded in found:
            interpreter.add_variable(recorded.name, recorded)
    except BaseException:
        interpreter.close()
        raise
    return interpreter
