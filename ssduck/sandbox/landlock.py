"""Leaves a process some files, no TCP and no signals to others (Linux's Landlock)."""

from __future__ import annotations

import os
import struct
import sys
from collections.abc import Iterable
from pathlib import Path

from ssduck.sandbox.kernel import forbid_new_privileges, system_call
from ssduck.sandbox.system_calls import MACHINES

# The bits of rights: to read files and folders, and to write, cut, make and remove them.
_WRITE_FILE, _READ_FILE, _READ_DIR, _TRUNCATE = 1 << 1, 1 << 2, 1 << 3, 1 << 14
_READ = _READ_FILE | _READ_DIR
_WRITE = _WRITE_FILE | _TRUNCATE | sum(1 << bit for bit in (4, 5, 7, 8))
_OF_FILES = _WRITE_FILE | _READ_FILE | _TRUNCATE
# How many rights there are by the version of Landlock; the first that can forbid to cut files, to
# use TCP and to send signals.
_RIGHTS = {3: 15, 4: 15, 5: 16}
_CUTTING, _TCP, _SIGNALS = 3, 4, 6
_FLAG_VERSION, _RULE_OF_PATH = 1, 1


def version() -> int:
    """Returns the version of Landlock; 0 if the kernel has none."""
    if sys.platform != "linux" or os.uname().machine not in MACHINES:
        return 0
    try:
        return system_call("landlock_create_ruleset", None, 0, _FLAG_VERSION)
    except OSError:
        return 0


def missing() -> str:
    """Returns what the system lacks to confine files; empty if nothing."""
    found = version()
    if found >= _CUTTING:
        return ""
    told = f"version {found}" if found else "none"
    return f"Landlock of version {_CUTTING} is needed (Linux 6.2, and enabled), there is {told}"


def confine(readable: Iterable[str | Path], writable: Iterable[str | Path]) -> None:
    """Takes all files but some from this thread and those that it starts, and more, for good.

    That is as much as the kernel knows: nothing, perhaps.
    """
    known = version()
    if known < _CUTTING:
        return
    files = (1 << _RIGHTS.get(known, 16)) - 1
    attributes = struct.pack(
        "=QQQ", files, 3 if known >= _TCP else 0, 3 if known >= _SIGNALS else 0
    )
    size = 24 if known >= _SIGNALS else 16 if known >= _TCP else 8
    ruleset = system_call("landlock_create_ruleset", attributes, size, 0)
    try:
        for paths, rights in ((readable, _READ), (writable, _READ | _WRITE)):
            for path in paths:
                _allow(ruleset, path, rights)
        forbid_new_privileges()
        system_call("landlock_restrict_self", ruleset, 0)
    finally:
        os.close(ruleset)


def _allow(ruleset: int, path: str | Path, rights: int) -> None:
    """Adds a file, or all of a folder, to those that can be used, if it is there."""
    try:
        opened = os.open(path, os.O_PATH | os.O_CLOEXEC)
    except OSError:
        return
    try:
        if not Path(f"/proc/self/fd/{opened}").is_dir():
            rights &= _OF_FILES
        rule = struct.pack("=Qi", rights, opened)
        system_call("landlock_add_rule", ruleset, _RULE_OF_PATH, rule, 0)
    finally:
        os.close(opened)
