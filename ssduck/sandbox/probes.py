"""Shows which effects a sealed process has, by trying what each forbids.

A probe does no harm where it gets through. It asks for what the process could have without the
wall, so that its failure shows the wall.
"""

from __future__ import annotations

import fcntl
import os
import resource
import signal
import socket
import struct
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from mmap import MAP_ANONYMOUS, MAP_PRIVATE, mmap
from pathlib import Path

from ssduck.errors import SandboxError
from ssduck.limits import EFFECTS
from ssduck.sandbox.kernel import PR_SET_PDEATHSIG, death_signal, prctl, system_call
from ssduck.sandbox.seal import Walls

Probe = Callable[[Walls], object]
# What a call raises that is refused; a call that the kernel lacks is refused, too.
_REFUSALS = (PermissionError, MemoryError, ValueError)
_NOT_THERE = 38  # ENOSYS
_TRACE_PEEK = 2  # fails of a process that is not traced, without harm
# A signal that is none, with the code of one that a program queues.
_QUEUED = struct.pack("=iii", 0, 0, -1).ljust(128, b"\0")


def holes(walls: Walls) -> dict[str, list[str]]:
    """Returns what this process can do although an effect forbids it, by the effect."""
    return {
        effect: [name for name, probe in probes.items() if _gets_through(probe, walls)]
        for effect, probes in _PROBES.items()
    }


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


def _gets_through(probe: Probe, walls: Walls) -> bool:
    try:
        probe(walls)
    except _REFUSALS:
        return False
    except OSError as error:
        return error.errno != _NOT_THERE
    return True


# -- files ------------------------------------------------------------------------------------


def _open(path: Path, flags: int) -> None:
    os.close(os.open(path, flags, 0o600))


def _opening(place: int, flags: int) -> Probe:
    """Returns a probe that opens one of the files by which probes try the wall."""
    return lambda walls: _open(walls.own_files[place], flags)


def _make_outside(walls: Walls) -> None:
    path = Path(walls.folder, "new")
    _open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL)
    path.unlink()


def _link_outside(walls: Walls) -> None:
    link = walls.scratch / "link"
    link.hardlink_to(walls.own_files[1])
    link.unlink()


# -- network, processes, signals -------------------------------------------------------------


def _socket(family: int, kind: int) -> Probe:
    return lambda _: socket.socket(family, kind).close()


def _fork(_: Walls) -> None:
    if (child := os.fork()) == 0:
        os._exit(0)
    os.waitpid(child, 0)


def _execute(walls: Walls) -> None:
    with suppress(FileNotFoundError):  # it was looked for
        os.execve(walls.scratch / "none", ["none"], {})  # noqa: S606


def _raw(name: str, *arguments: int | bytes | Callable[[], int] | None) -> Probe:
    """Returns a probe that makes a system call; an error of its arguments is none of the wall."""
    return lambda _: system_call(name, *(one() if callable(one) else one for one in arguments))


def _own_signals(_: Walls) -> None:
    reading, writing = os.pipe()
    try:
        fcntl.fcntl(reading, fcntl.F_SETOWN, os.getppid())
    finally:
        os.close(reading)
        os.close(writing)


# -- memory and time --------------------------------------------------------------------------


def _take_memory(walls: Walls) -> None:
    try:
        mmap(-1, walls.memory + 2**20, flags=MAP_PRIVATE | MAP_ANONYMOUS).close()
    except OSError as error:
        raise MemoryError from error


def _raise_limit(limit: int) -> Probe:
    def probe(_: Walls) -> None:
        hard = resource.getrlimit(limit)[1]
        if hard != resource.RLIM_INFINITY:
            resource.setrlimit(limit, (hard, hard + 1))

    return probe


_PROBES: dict[str, dict[str, Probe]] = {
    "files": {
        "read a file": _opening(1, os.O_RDONLY),
        "list a folder": lambda walls: list(Path(walls.folder).iterdir()),
        "write to a file": _opening(0, os.O_WRONLY),
        "cut a file": _opening(0, os.O_RDONLY | os.O_TRUNC),
        "make a file": _make_outside,
        "change a file's mode": lambda walls: walls.own_files[0].chmod(0o600),
        "link to a file": _link_outside,
    },
    "network": {
        "open a TCP socket": _socket(socket.AF_INET, socket.SOCK_STREAM),
        "open a UDP socket of IPv6": _socket(socket.AF_INET6, socket.SOCK_DGRAM),
        "open a local socket": _socket(socket.AF_UNIX, socket.SOCK_STREAM),
        "open a socket to the kernel": _socket(getattr(socket, "AF_NETLINK", 16), socket.SOCK_RAW),
    },
    "processes": {
        "fork": _fork,
        "start a program": _execute,
        "trace a process": _raw("ptrace", _TRACE_PEEK, os.getppid),
        "read a process's memory": _raw("process_vm_readv", os.getppid, None, 0, None, 0, 0),
        "make a namespace": _raw("unshare", 0),
        "use the kernel's rings": _raw("io_uring_setup", 1, None),
    },
    "signals": {
        "send a signal": _raw("kill", os.getppid, 0),
        "send one to a thread": _raw("tkill", os.getppid, 0),
        "queue one": _raw("rt_sigqueueinfo", os.getppid, 0, _QUEUED),
        "have the kernel send one": _own_signals,
        "read another process's limits": (
            lambda _: resource.prlimit(os.getppid(), resource.RLIMIT_CORE)
        ),
    },
    "memory": {
        "take more memory": _take_memory,
        "raise its limit": _raise_limit(resource.RLIMIT_AS),
        "share memory": _raw("shmget", 0, 0, 0),
    },
    "time": {
        "raise its limit of processor time": _raise_limit(resource.RLIMIT_CPU),
        # It is refused to change the signal; one that is not there is a hole.
        "outlive its host": (
            lambda _: death_signal() == signal.SIGKILL and prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
        ),
    },
}
