"""The warnings of a call."""

import warnings
from contextlib import contextmanager

from ssduck.errors import ProgramWarning


def told(ask, *arguments):
    """What a call warns of, all of them warnings of programs."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        ask(*arguments)
    assert all(one.category is ProgramWarning for one in caught)
    return [str(one.message) for one in caught]


def heard(ask, words=""):
    """Returns what a call returns, and the texts of its warnings that have some words."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        answer = ask()
    return answer, [text for one in caught if words in (text := str(one.message))]


@contextmanager
def silent():
    """Any warning is an error."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield
