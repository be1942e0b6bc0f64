"""The numbers by which rows tell which run of a world they are of."""

from __future__ import annotations

import secrets

# As many bits as a double has: readers that make a double of an integer lose nothing.
_BITS = 53


def new_run() -> int:
    """A number for a run: random, so that no two runs have the same, whoever records them."""
    return secrets.randbits(_BITS) or 1
