"""Names the effects of a sandbox, and the error of one that is missing."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

from ssduck.errors import ArgumentError, SandboxError, nearest
from ssduck.formatting import joined_names, short_repr

# What a sandboxed process cannot do, each by whatever mechanism the system gives.
EFFECTS = {
    "files": "read other files than the scene or record and the libraries, or write outside its "
    "scratch folder",
    "network": "open a socket",
    "processes": "start, read or change another process",
    "signals": "send a signal to another process",
    "memory": "take more memory than it may",
    "time": "outlive its host, or run on without end",
}
# How many of an effect's holes a message names.
_MAX_HOLES = 3


def checked_effects(names: Collection[str]) -> frozenset[str]:
    """Returns the names of effects as a set.

    Raises:
        ArgumentError: there is no such effect.
    """
    for name in names:
        if name not in EFFECTS:
            raise ArgumentError(
                f"require: there is no effect {short_repr(name)}; there are "
                f"{joined_names(list(EFFECTS))}",
                suggestions=nearest(name, EFFECTS),
            )
    return frozenset(names)


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
        f"{name} (a program can {EFFECTS[name]}: {', '.join(holes[name][:_MAX_HOLES])})"
        for name in missing
    )
    because = f"; {'; '.join(reasons)}" if reasons else ""
    enough = [name for name in EFFECTS if name in required and name not in missing]
    raise SandboxError(
        f"the sandbox lacks on this system: {told}{because}; use Linux 6.2 or later on x86-64 or "
        f"64-bit ARM, or say which effects are enough: require={enough}"
    )
