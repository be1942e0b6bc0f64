"""Tells of a condition that holds never, always, or at the first tick of each episode."""

from __future__ import annotations

import pyarrow as pa

from ssduck import validation
from ssduck.errors import ArgumentError
from ssduck.formatting import count_of
from ssduck.language.parser import parse


def values_of(condition: str) -> str:
    """Returns the program for the value of a condition at the first tick, and at each change."""
    text = validation.text(condition, "lint takes a condition").strip().removesuffix(";")
    tree = parse(f"{text};")
    if len(tree.statements) != 1 or tree.explain:
        raise ArgumentError(f"lint: {text!r} is to be one expression")
    # An error shows the line of the condition.
    return f"SELECT change.this[1] FROM change=changes(\n{text}\n) AS list;"  # noqa: S608


def told_of(condition: str, answers: pa.Table) -> list[str]:
    """Returns what is told of a condition with such values."""
    values = [one for one in answers["answer"].to_pylist() if one is not None]
    if any(type(value) is not bool for one in values for value in one if value is not None):
        raise ArgumentError(f"lint: {condition!r} is not True or False: compare it with something")
    told = [error.splitlines()[0] for error in answers["error"].to_pylist() if error][:1]
    count = count_of(len(values), "episode")
    if values and not any(map(any, values)):
        told.append(f"it never holds: at no tick of {count}")
    elif values and all(map(all, values)):
        told.append(f"it always holds: at all ticks of {count}")
    elif values and all(one[0] for one in values):
        told.append(f"it holds at the first tick of each of {count}, before anything is done")
    return told
