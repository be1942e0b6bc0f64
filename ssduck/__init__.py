"""ssduck: a robot simulation as a database."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ssduck.changes import Changed
    from ssduck.entities import Entity, Sensor
    from ssduck.errors import SelectScriptError
    from ssduck.folder import Episode, episodes
    from ssduck.interpreter import Interpreter, load
    from ssduck.interpreter import open_record as open  # noqa: A004
    from ssduck.limits import Limits
    from ssduck.past import Past
    from ssduck.recording import Recording
    from ssduck.triggers import TriggerWarning
    from ssduck.world import World

__all__ = [
    "Changed",
    "Entity",
    "Episode",
    "Interpreter",
    "Limits",
    "Past",
    "Recording",
    "SelectScriptError",
    "Sensor",
    "TriggerWarning",
    "World",
    "episodes",
    "load",
    "open",
]

_HOMES = {
    "Changed": "changes",
    "Entity": "entities",
    "Episode": "folder",
    "Interpreter": "interpreter",
    "Limits": "limits",
    "Past": "past",
    "Recording": "recording",
    "SelectScriptError": "errors",
    "Sensor": "entities",
    "TriggerWarning": "triggers",
    "World": "world",
    "episodes": "folder",
    "load": "interpreter",
    "open": "interpreter",
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
