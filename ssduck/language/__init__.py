"""SelectScript: from text to a tree, and what a tree means in Python.

`parser` makes a `tree` of a text. `analysis` tells what a part of a tree depends on. `evaluator` is
the reference for what expressions mean, with `operators` and `builtins`; `clauses` and `hierarchy`
do the same for the rows of a query. SQL is another package: `ssduck.sql`.
"""

from typing import TYPE_CHECKING

from ssduck.lazy import exports

if TYPE_CHECKING:
    from ssduck.language.clauses import Clauses
    from ssduck.language.evaluator import ExpressionCompiler, compiled
    from ssduck.language.intervals import intervals_of
    from ssduck.language.parser import parse
    from ssduck.language.value_history import ValueHistory

__all__ = [
    "Clauses",
    "ExpressionCompiler",
    "ValueHistory",
    "compiled",
    "intervals_of",
    "parse",
]

__getattr__, __dir__ = exports(
    __name__,
    {
        "clauses": ("Clauses",),
        "evaluator": ("ExpressionCompiler", "compiled"),
        "intervals": ("intervals_of",),
        "parser": ("parse",),
        "value_history": ("ValueHistory",),
    },
)
