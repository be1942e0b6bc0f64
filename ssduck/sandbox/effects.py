"""Tells which effects of a sandbox are missing."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

from ssduck.errors import SandboxError
from ssduck.limits import EFFECTS


def check_present(
    required: Collection[str], holes: Mapping[str, Sequence[str]], reasons: Sequence[str]
) -> None:
    """Checks that the required effects are there.

    Args:
        required: the names of the effects.
        holes: what a worker could do although an effect forbids it, by the effect.
        reasons: what the system lacks.

    Raises:
        SandboxError: one is missing; the message names it, what got through, and what to do.
    """
    missing = [name for name in EFFECTS if name in required and holes.get(name)]
    if not missing:
        return
    told = "; ".join(
        f"{name} (a program can {EFFECTS[name]}: {', '.join(holes[name])})" for name in missing
    )
    because = f"; {'; '.join(reasons)}" if reasons else ""
    enough = [name for name in EFFECTS if name in required and name not in missing]
    raise SandboxError(
        f"the sandbox lacks on this system: {told}{because}; use Linux 6.2 or later on x86-64 or "
        f"64-bit ARM, or say which effects are enough: require={enough}"
    )
