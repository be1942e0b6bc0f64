"""Calls Linux's kernel through the C library: what Python's `os` has not."""

from __future__ import annotations

import ctypes
import os
import select
from functools import cache
from typing import Any

from ssduck.sandbox.system_calls import number_of

PR_SET_PDEATHSIG, PR_GET_PDEATHSIG, PR_SET_SECCOMP, PR_CAPBSET_DROP = 1, 2, 22, 24
_PR_SET_NO_NEW_PRIVS, _PR_CAPBSET_READ = 38, 23
# The version of the structures of capabilities, with two words for each set of them.
_CAPABILITIES = 0x20080522


@cache
def _library() -> Any:
    library = ctypes.CDLL(None, use_errno=True)
    library.syscall.restype = ctypes.c_long
    return library


def system_call(name: str, *arguments: int | bytes | None) -> int:
    """Makes a system call; one that this machine has not is refused."""
    number = number_of(name, os.uname().machine)
    if number is None:
        raise PermissionError
    words = [one if isinstance(one, bytes) else ctypes.c_long(one or 0) for one in arguments]
    return _checked(_library().syscall(ctypes.c_long(number), *words))


def prctl(option: int, *arguments: int) -> int:
    """Reads or changes an attribute of this process or thread."""
    words = [ctypes.c_ulong(one) for one in (*arguments, 0, 0, 0, 0)[:4]]
    return _checked(_library().prctl(option, *words))


def death_signal() -> int:
    """Returns the signal that this process gets when its parent ends; 0 for none."""
    found = ctypes.c_int()
    prctl(PR_GET_PDEATHSIG, ctypes.addressof(found))
    return found.value


def has_ended(process: int, seconds: float = 0.0) -> bool:
    """Checks whether the process of a descriptor has ended, or ends within some time, s."""
    poll = select.poll()
    poll.register(process, select.POLLIN)
    return bool(poll.poll(1000 * seconds))


def forbid_new_privileges() -> None:
    """Lets no program that is executed from now on have more privileges than this process."""
    prctl(_PR_SET_NO_NEW_PRIVS, 1)


def drop_capabilities() -> None:
    """Gives up what the superuser may do, for good."""
    number = 0
    while True:
        try:
            has_it = prctl(_PR_CAPBSET_READ, number)
        except OSError:
            break  # the kernel knows no more
        if has_it:
            try:
                prctl(PR_CAPBSET_DROP, number)
            except OSError:
                break  # only the superuser can; others have none
        number += 1
    header = (ctypes.c_uint32 * 2)(_CAPABILITIES, 0)
    none = (ctypes.c_uint32 * 6)()
    _checked(_library().capset(ctypes.byref(header), ctypes.byref(none)))


def _checked(result: int) -> int:
    if result < 0:
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))
    return result
