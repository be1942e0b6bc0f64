"""ssduck: a robot simulation as a database."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ssduck.adapters import Selection, adapter
    from ssduck.changes import Changed
    from ssduck.entities import Entity, KinBody, Robot, Sensor
    from ssduck.episode import Episode
    from ssduck.errors import ProgramWarning, SelectScriptError
    from ssduck.grids import OccupancyGrid
    from ssduck.height_fields import height_field
    from ssduck.interpreter import Interpreter
    from ssduck.limits import Limits
    from ssduck.opened import episodes
    from ssduck.opening import load
    from ssduck.opening import open_record as open  # noqa: A004
    from ssduck.past import Past
    from ssduck.recording import Recording
    from ssduck.trigger import TriggerWarning
    from ssduck.world import World

__all__ = [
    "Changed",
    "Entity",
    "Episode",
    "Interpreter",
    "KinBody",
    "Limits",
    "OccupancyGrid",
    "Past",
    "ProgramWarning",
    "Recording",
    "Robot",
    "SelectScriptError",
    "Selection",
    "Sensor",
    "TriggerWarning",
    "World",
    "adapter",
    "episodes",
    "height_field",
    "load",
    "open",
]

_HOMES = {
    "Changed": "changes",
    "Entity": "entities",
    "Episode": "episode",
    "Interpreter": "interpreter",
    "KinBody": "entities",
    "Limits": "limits",
    "OccupancyGrid": "grids",
    "Past": "past",
    "ProgramWarning": "errors",
    "Recording": "recording",
    "Robot": "entities",
    "SelectScriptError": "errors",
    "Selection": "adapters",
    "Sensor": "entities",
    "TriggerWarning": "trigger",
    "World": "world",
    "adapter": "adapters",
    "episodes": "opened",
    "height_field": "height_fields",
    "load": "opening",
    "open": "opening",
}
# What is called otherwise there: Python has a function of that name.
_ORIGINALS = {"open": "open_record"}


def __getattr__(name: str) -> Any:
    """Import a public name when it is used: the command's help needs none of them."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f"{__name__}.{_HOMES[name]}"), _ORIGINALS.get(name, name))
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
