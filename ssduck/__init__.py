"""ssduck: a robot simulation as a database."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from ssduck.lazy import offer

if TYPE_CHECKING:
    from ssduck.adapters.base import Selection
    from ssduck.adapters.grid_values import OccupancyGrid
    from ssduck.adapters.registry import adapter
    from ssduck.errors import ProgramWarning, SelectScriptError
    from ssduck.geometry.shapes import height_field
    from ssduck.interchange.conversion import import_poses
    from ssduck.interchange.record_writer import RecordWriter, write_record
    from ssduck.interpreter.archives import check, episodes
    from ssduck.interpreter.interpreter import Interpreter
    from ssduck.interpreter.opening import load
    from ssduck.interpreter.opening import open_record as open  # noqa: A004
    from ssduck.interpreter.triggers.conditions import Changed
    from ssduck.interpreter.triggers.trigger import TriggerWarning
    from ssduck.lakes.lake import Lake
    from ssduck.lakes.lake import open_lake as lake
    from ssduck.limits import Limits
    from ssduck.recording.episode import Episode
    from ssduck.recording.folder_check import Damage
    from ssduck.recording.replay.past import Past
    from ssduck.recording.spec import Recording
    from ssduck.world.entities import Entity, KinBody, Robot, Sensor
    from ssduck.world.handles import Link
    from ssduck.world.world import World

__all__ = [
    "Changed",
    "Damage",
    "Entity",
    "Episode",
    "Interpreter",
    "KinBody",
    "Lake",
    "Limits",
    "Link",
    "OccupancyGrid",
    "Past",
    "ProgramWarning",
    "RecordWriter",
    "Recording",
    "Robot",
    "SelectScriptError",
    "Selection",
    "Sensor",
    "TriggerWarning",
    "World",
    "adapter",
    "check",
    "episodes",
    "height_field",
    "import_poses",
    "lake",
    "load",
    "open",
    "write_record",
]

# What a layer below makes: the page of `Interpreter.view`, terms of tasks, batches of worlds, and
# what `Limits.strict()` opens.
offer("page", "ssduck.view.view:view")
offer("batch", "ssduck.world.batches.batch_world:batch_of")
offer("export batch", "ssduck.interpreter.batches.records:export_batch")
offer("step scores", "ssduck.lakes.workers:step_scores")
offer("page answers", "ssduck.view.sealed:AnswersInside")
offer("agent answers", "ssduck.mcp.answers:InterpreterAnswers")
offer("lake", "ssduck.lakes.sealed:SealedLake")
offer("sandboxed interpreter", "ssduck.sandbox.opening:interpreter")
offer("sandboxed load", "ssduck.sandbox.opening:load")
offer("sandboxed open", "ssduck.sandbox.opening:open_record")
offer("spellings", "ssduck.openrave:spellings")
offer("task", "ssduck.gym.tasks:task_env")
offer("terms", "ssduck.gym.batch_terms:BatchTerms")

_HOMES = {
    "Changed": "interpreter.triggers.conditions",
    "Damage": "recording.folder_check",
    "Entity": "world.entities",
    "Episode": "recording.episode",
    "Interpreter": "interpreter.interpreter",
    "KinBody": "world.entities",
    "Lake": "lakes.lake",
    "Limits": "limits",
    "Link": "world.handles",
    "OccupancyGrid": "adapters.grid_values",
    "Past": "recording.replay.past",
    "ProgramWarning": "errors",
    "RecordWriter": "interchange.record_writer",
    "Recording": "recording.spec",
    "Robot": "world.entities",
    "SelectScriptError": "errors",
    "Selection": "adapters.base",
    "Sensor": "world.entities",
    "TriggerWarning": "interpreter.triggers.trigger",
    "World": "world.world",
    "adapter": "adapters.registry",
    "check": "interpreter.archives",
    "episodes": "interpreter.archives",
    "height_field": "geometry.shapes",
    "lake": "lakes.lake",
    "import_poses": "interchange.conversion",
    "load": "interpreter.opening",
    "open": "interpreter.opening",
    "write_record": "interchange.record_writer",
}
# Names that differ in their module, as Python or the package has others of that name.
_ORIGINALS = {"lake": "open_lake", "open": "open_record"}
# What to write for names that are looked for here.
_INSTEAD_OF = {
    **dict.fromkeys(("attach", "connect"), "a world is ssduck.World.attach(client)"),
    "Recorder": "ss.record_to(folder) records, and ssduck.Recording says what is kept",
    "batch": "it is ssduck.World.batch(model, count)",
    **dict.fromkeys(
        ("eval", "sql", "add_variable", "add_function", "add_trigger", "record_to", "export"),
        "it is a method of an interpreter, ss = ssduck.Interpreter()",
    ),
}


def __getattr__(name: str) -> Any:
    """Imports a public name when it is used: the command's help needs none of them."""
    if name not in _HOMES:
        told = f"; {_INSTEAD_OF[name]}" if name in _INSTEAD_OF else ""
        message = f"module {__name__!r} has no attribute {name!r}{told}"
        raise AttributeError(message, name=name, obj=import_module(__name__))
    value = getattr(import_module(f"{__name__}.{_HOMES[name]}"), _ORIGINALS.get(name, name))
    globals()[name] = value
    return value


def load_ipython_extension(shell: Any) -> None:
    """Registers the magics `%%selectscript` and `%%sql`: `%load_ext ssduck` calls it."""
    import_module(f"{__name__}.shell.magics").register_magics(shell)


def __dir__() -> list[str]:
    return sorted(__all__)
