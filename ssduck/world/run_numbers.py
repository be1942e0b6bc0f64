"""Makes the numbers that distinguish the runs of a world in recorded rows."""

from __future__ import annotations

import secrets

# The bits of a double's significand: readers may convert the number to a double without loss.
_BITS = 53


def new_run() -> int:
    """Returns a random number for a run, above 0, which no other run has in practice."""
    return secrets.randbits(_BITS) or 1
