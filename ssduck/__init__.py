"""ssduck: a robot simulation as a database."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ssduck.changes import Changed
    from ssduck.entities import Entity, Sensor
    from ssduck.errors import SelectScriptError
    from ssduck.interpreter import Interpreter, load
    from ssduck.limits import Limits
    from ssduck.triggers import TriggerWarning
    from ssduck.world import World

__all__ = [
    "Changed",
    "Entity",
    "Interpreter",
    "Limits",
    "SelectScriptError",
    "Sensor",
    "TriggerWarning",
    "World",
    "load",
]

_HOMES = {
    "Changed": "changes",
    "Entity": "entities",
    "Interpreter": "interpreter",
    "Limits": "limits",
    "SelectScriptError": "errors",
    "Sensor": "entities",
    "TriggerWarning": "triggers",
    "World": "world",
    "load": "interpreter",
}


def __getattr__(name: str) -> Any:
    """Import a public name when it is used: the command's help needs none of them."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
