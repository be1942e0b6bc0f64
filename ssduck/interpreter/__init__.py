"""What users call: variables, programs, queries, recording, triggers.

An `Interpreter` runs programs (`execution`) with its variables and functions (`namespace`).
`planner` finds the plan of a query and `query_runner` runs it: SQL first, then the parts that are
left to Python. `output` turns the rows into the form that the query names. `opening` makes
interpreters.
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
