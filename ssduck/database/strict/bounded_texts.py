"""Bounds the texts in which strangers' statements look for regular expressions.

DuckDB looks through 2,048 texts before it checks the time, and through some letters in a
microsecond only, for some expressions. So a macro of the session stands for each such function,
which makes an error of a longer text; DuckDB's parser makes calls of them of the operators.
"""

from __future__ import annotations

import re
from collections.abc import Iterator

from sqlglot import exp

# The longest text, bytes.
MAX_TEXT = 1_000
# Ends the message of an error of a limit.
MARK = "(Limits: select_only)"
# What a statement has that may look for a regular expression.
_LOOKS = re.compile(r"regexp|~|similar", re.IGNORECASE)
# The functions, and the numbers of their arguments.
_FORMS = {"regexp_matches": (2, 3), "regexp_full_match": (2, 3), "regexp_extract": (2, 3, 4)}
_PARAMETERS = ("looked_through", "looked_for", "third", "fourth")


def has_expressions(sql: str) -> bool:
    """Checks whether a statement may look for a regular expression."""
    return _LOOKS.search(sql) is not None


def bounding_statements() -> Iterator[str]:
    """Yields the statements that make the macros of a session."""
    message = f"regular expressions are looked for in texts of at most {MAX_TEXT:,} bytes here"
    error = exp.Literal.string(f"{message} {MARK}").sql("duckdb")
    text = _PARAMETERS[0]
    bounded = f"CASE WHEN strlen({text}) > {MAX_TEXT} THEN error({error}) ELSE {text} END"
    for name, counts in _FORMS.items():
        forms = []
        for count in counts:
            rest = _PARAMETERS[1:count]
            call = f"system.main.{name}({', '.join((bounded, *rest))})"
            forms.append(f"({', '.join((text, *rest))}) AS {call}")
        yield f"CREATE OR REPLACE TEMP MACRO {name}{', '.join(forms)}"
