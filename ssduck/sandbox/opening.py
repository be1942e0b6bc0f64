"""Opens what `Limits.strict()` puts into a sandbox: `load`, `open` and `Interpreter` call these."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ssduck.errors import UnsupportedError
from ssduck.limits import Limits
from ssduck.sandbox.interpreter import SandboxedInterpreter
from ssduck.sandbox.processes import Zygote
from ssduck.sandbox.sources import Source

_MEMORY = ":memory:"


def interpreter(
    database: str | Path = _MEMORY, *, limits: Limits, strict: bool = False, **options: Any
) -> SandboxedInterpreter:
    """Returns an interpreter without a world; for the arguments see `Interpreter`."""
    _check_memory(database)
    options = {name: value for name, value in options.items() if value not in (None, False)}
    if options.pop("recording", "default") != "default" or options:
        raise UnsupportedError(
            f"Interpreter: {', '.join(options) or 'recording'}: not in a sandbox; leave it out"
        )
    return SandboxedInterpreter(limits=limits, strict=strict)


def load(
    scene: str | Path,
    database: str | Path = _MEMORY,
    limits: Limits | None = None,
    *,
    zygote: Zygote | None = None,
    **options: Any,
) -> SandboxedInterpreter:
    """Returns an interpreter with the world of a scene; for the arguments see `ssduck.load`."""
    _check_memory(database)
    source = Source.of_scene(scene, **options)
    return SandboxedInterpreter(source, limits=limits, zygote=zygote)


def open_record(
    path: str | Path,
    world: str | None = None,
    episode: int | None = None,
    limits: Limits | None = None,
    *,
    partial: bool = False,
    strict: bool = False,
    zygote: Zygote | None = None,
) -> SandboxedInterpreter:
    """Returns an interpreter on a record; for the arguments see `ssduck.open`."""
    source = Source.of_record(path, world, episode, partial=partial)
    return SandboxedInterpreter(source, limits=limits, strict=strict, zygote=zygote)


def _check_memory(database: str | Path) -> None:
    """Checks that no file is to be written."""
    if str(database) != _MEMORY:
        raise UnsupportedError(f"a sandbox writes no database, and {database} is one: leave it out")
