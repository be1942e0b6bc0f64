"""The warnings of a call."""

import warnings

from ssduck.errors import ProgramWarning


def told(ask, *arguments):
    """What a call warns of, all of them warnings of programs."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        ask(*arguments)
    assert all(one.category is ProgramWarning for one in caught)
    return [str(one.message) for one in caught]
