"""What users call: variables, programs, queries, recording, triggers.

An `Interpreter` runs programs (`execution`) over its variables and functions (`namespace`). For a
query, `planner` finds a plan and `query_runner` runs it: SQL first, then what is left to Python.
`output` gives the rows the form that the query names. `opening` makes interpreters on worlds.
"""

from typing import TYPE_CHECKING

from ssduck.lazy import exports

if TYPE_CHECKING:
    from ssduck.interpreter.interpreter import Interpreter
    from ssduck.interpreter.opening import load, open_record
    from ssduck.interpreter.program import CompiledProgram

__all__ = [
    "CompiledProgram",
    "Interpreter",
    "load",
    "open_record",
]

__getattr__, __dir__ = exports(
    __name__,
    {
        "interpreter": ("Interpreter",),
        "opening": ("load", "open_record"),
        "program": ("CompiledProgram",),
    },
)
