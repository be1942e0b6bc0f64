"""ssduck: a robot simulation as a database."""

from ssduck.errors import SelectScriptError
from ssduck.interpreter import Interpreter, load
from ssduck.world import Entity, Sensor, World

__all__ = ["Entity", "Interpreter", "SelectScriptError", "Sensor", "World", "load"]
