"""Refuses system calls: a filter that lets those through that a worker needs (Linux's seccomp).

The filter is a program of BPF, instructions of 8 bytes, which reads the machine, the number and the
arguments of each call. A call from another machine's instruction set (`int 0x80`) ends the process.
x32 has other numbers, which are not among those that are let through.
"""

from __future__ import annotations

import ctypes
import os
import struct
import sys
from collections.abc import Collection, Iterator

from ssduck.sandbox.kernel import PR_SET_SECCOMP, forbid_new_privileges, prctl
from ssduck.sandbox.system_calls import ALLOWED, MACHINES, number_of

# The audit architecture of each machine, both with the lower half of an argument first.
_ARCHITECTURES = {"x86_64": 0xC000003E, "aarch64": 0xC00000B7}
_LOAD, _EQUAL, _AT_LEAST, _AND, _RETURN = 0x20, 0x15, 0x35, 0x54, 0x06
_NUMBER, _ARCHITECTURE, _ARGUMENTS = 0, 4, 16  # places in what the filter reads
_LET, _KILL, _ERROR = 0x7FFF0000, 0x80000000, 0x00050000
# The C library uses older calls instead if one with such a number or a higher one is unknown.
_NEW_CALLS = 424
_FILTER_MODE = 2

# Threads, in the namespaces of the process.
_THREAD, _NAMESPACES = 0x00010000, 0x7E020080
# Calls that are allowed with these values of an argument: its index, and the values.
_CHECKED = {
    # It may read its death signal, and name its threads and its memory.
    "prctl": (0, (2, 3, 15, 16, 0x53564D41)),
    # It may ask whether a file is a terminal and what waits there, and set how it blocks.
    "ioctl": (1, (0x5401, 0x5421, 0x541B, 0x5450, 0x5451)),
    # It may not say who gets signals of a file, nor hold others back from opening it.
    "fcntl": (1, (0, 1, 2, 3, 4, 5, 6, 7, 36, 37, 38, 1030)),
    # A pair of streams: one of datagrams could send to any local address.
    "socketpair": (1, (1, 0x801, 0x80001, 0x80801)),
    # Its own limits only.
    "prlimit64": (0, (0,)),
}

Instruction = tuple[int, int, int, int]


def missing() -> str:
    """Returns what the system lacks for a filter; empty if nothing."""
    machine = os.uname().machine if sys.platform == "linux" else sys.platform
    return "" if machine in MACHINES else f"seccomp is used on Linux on {' and '.join(MACHINES)}"


def refuse_calls() -> None:
    """Refuses all but some system calls to this thread, and to those that it starts, for good."""
    program = filter_program(os.uname().machine)
    buffer = ctypes.create_string_buffer(program)
    length = len(program) // 8
    header = ctypes.create_string_buffer(struct.pack("HxxxxxxQ", length, ctypes.addressof(buffer)))
    forbid_new_privileges()
    prctl(PR_SET_SECCOMP, _FILTER_MODE, ctypes.addressof(header))


def filter_program(machine: str) -> bytes:
    """Returns the filter of a machine, as the kernel takes it."""
    lines = [
        (_LOAD, 0, 0, _ARCHITECTURE),
        (_EQUAL, 1, 0, _ARCHITECTURES[machine]),
        (_RETURN, 0, 0, _KILL),
        (_LOAD, 0, 0, _NUMBER),
    ]
    for name, (index, values) in _CHECKED.items():
        lines += _checked(number_of(name, machine), index, values)
    lines += _threads_only(number_of("clone", machine))
    for name in sorted(ALLOWED):
        if (number := number_of(name, machine)) is not None:
            lines += [(_EQUAL, 0, 1, number), (_RETURN, 0, 0, _LET)]
    lines += [
        (_AT_LEAST, 0, 1, _NEW_CALLS),
        (_RETURN, 0, 0, _ERROR | 38),  # ENOSYS
        (_RETURN, 0, 0, _ERROR | 1),  # EPERM
    ]
    return b"".join(struct.pack("HBBI", *line) for line in lines)


def _checked(number: int | None, index: int, values: Collection[int]) -> Iterator[Instruction]:
    """Yields the instructions for a call that is allowed with some values of an argument."""
    assert number is not None
    yield (_EQUAL, 0, 2 * len(values) + 2, number)
    yield (_LOAD, 0, 0, _ARGUMENTS + 8 * index)
    for value in values:
        yield (_EQUAL, 0, 1, value)
        yield (_RETURN, 0, 0, _LET)
    yield (_RETURN, 0, 0, _ERROR | 1)


def _threads_only(number: int | None) -> Iterator[Instruction]:
    """Yields the instructions for `clone`, which starts threads but no processes."""
    assert number is not None
    yield (_EQUAL, 0, 5, number)
    yield (_LOAD, 0, 0, _ARGUMENTS)
    yield (_AND, 0, 0, _THREAD | _NAMESPACES)
    yield (_EQUAL, 0, 1, _THREAD)
    yield (_RETURN, 0, 0, _LET)
    yield (_RETURN, 0, 0, _ERROR | 1)
