"""Runs programs, records and scenes of strangers in processes that can do no harm.

A *zygote* (`zygote`) has imported ssduck; each *worker* (`worker`) is forked from it and seals
itself (`seal`, by `landlock` and `seccomp`) before it reads anything, and shows by `probes` that
each *effect* is there. `SandboxedInterpreter` (`interpreter`) asks it over a socket (`messages`):
values cross as plain data (`values`), tables as Arrow (`tables`), errors by `reports`.
"""

from typing import TYPE_CHECKING

from ssduck.lazy import exports

if TYPE_CHECKING:
    from ssduck.sandbox.interpreter import SandboxedInterpreter
    from ssduck.sandbox.references import EntityReference

__all__ = ["EntityReference", "SandboxedInterpreter"]

__getattr__, __dir__ = exports(
    __name__,
    {
        "interpreter": ("SandboxedInterpreter",),
        "references": ("EntityReference",),
    },
)
