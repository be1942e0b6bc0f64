"""Tells of a condition that holds never, always, or at the first tick of each episode."""

from __future__ import annotations

from collections.abc import Sequence

from ssduck.errors import ArgumentError, SelectScriptError
from ssduck.formatting import count_of
from ssduck.lakes.answers import AnsweredEpisode


def told_of(condition: str, answered: Sequence[AnsweredEpisode]) -> list[str]:
    """Returns what is told of a condition with such values; raises the error if there are none."""
    values = [one.value for one in answered if one.error is None]
    errors = [one.error for one in answered if one.error is not None]
    if errors and not values:
        raise SelectScriptError(errors[0])
    known = [value for one in values for value in one if value is not None]
    if any(type(value) is not bool for value in known):
        raise ArgumentError(f"lint: {condition!r} is not True or False: compare it with something")
    told = [f"{count_of(len(errors), 'episode')} failed: {errors[0]}"] if errors else []
    count = count_of(len(values), "episode")
    if values and not known:
        told.append(f"it is unknown at all ticks of {count}")
    elif values and not any(known):
        told.append(f"it never holds: at no tick of {count}")
    elif values and all(map(all, values)):
        told.append(f"it always holds: at all ticks of {count}")
    elif values and all(one[0] for one in values):
        told.append(f"it holds at the first tick of each of {count}, before anything is done")
    return told
