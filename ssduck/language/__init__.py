"""SelectScript: the parser, the tree, and its reference evaluation in Python.

`parser` turns a text into a `tree`. `analysis` finds out what a part of a tree depends on.
`evaluator`, with `operators` and `builtins`, defines the value of an expression; `clauses` and
`hierarchy` define the rows of a query. The translation to SQL is `ssduck.sql`.
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
