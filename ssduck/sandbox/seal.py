"""Seals a worker for good: what it can read, write, call and take from then on."""

from __future__ import annotations

import itertools
import os
import shutil
import sys
import sysconfig
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from ssduck.errors import SandboxError
from ssduck.sandbox import landlock, seccomp
from ssduck.sandbox.kernel import drop_capabilities

# In the private folder of a worker: what it may write, and files by which probes try the wall.
SCRATCH, READABLE, OUTSIDE = "scratch", "readable", "outside"
# What a Python process reads beside its own files: the linker's cache, the clock's zone, the sizes
# of the machine.
_SYSTEM = (
    *("/lib", "/lib64", "/usr/lib", "/usr/lib64", "/usr/local/lib", "/etc/ld.so.cache"),
    *("/etc/localtime", "/usr/share/zoneinfo", "/dev/urandom", "/dev/random"),
    "/sys/devices/system/cpu",
)
# What the process is told of itself, and nothing of others, as of their sockets and mounts.
_PROCESS = (
    *(f"/proc/self/{name}" for name in ("cgroup", "fd", "maps", "stat", "statm", "status")),
    *("/proc/meminfo", "/proc/cpuinfo"),
)
# What may limit its memory and its processors.
_CONTROL = Path("/sys/fs/cgroup")
_CONTROLS = ("memory.max", "memory.limit_in_bytes", "cpu.max", "cpu.cfs_*")
_DESCRIPTORS = 1024
# What `remove` calls folders that it has moved.
_MOVED = "moved-"


@dataclass(frozen=True)
class Walls:
    """What a worker may use.

    Attributes:
        folder: its private folder, with `SCRATCH`, `READABLE` and `OUTSIDE`.
        readable: the files and folders that it can read beside the libraries.
        memory: how much more address space it may take than when it seals itself, bytes.
        file_bytes: the largest size of a file that it writes.
        processor_seconds: the processor time that it may take in all, s.
    """

    folder: str
    readable: tuple[str, ...] = ()
    memory: int = 2 * 10**9
    file_bytes: int = 64 * 2**20
    processor_seconds: int = 36_000

    @property
    def scratch(self) -> Path:
        """The only folder that it can write to."""
        return Path(self.folder, SCRATCH)

    @property
    def own_files(self) -> tuple[Path, Path]:
        """The files by which probes try the wall: one that it can read, and one that it cannot."""
        return Path(self.folder, READABLE), Path(self.folder, OUTSIDE)

    def prepare(self) -> None:
        """Makes the private folder; it must not be there."""
        self.scratch.mkdir(parents=True, mode=0o700)
        for file in self.own_files:
            file.write_bytes(b"probe")


def remove(folder: str | Path) -> None:
    """Removes a folder of a worker: one that is nested too deeply for `rmtree`, too."""
    numbers = itertools.count()
    with suppress(OSError):
        while inner := _folders_in(folder):
            for entry in inner:
                for below in _folders_in(entry):
                    below.rename(Path(folder, f"{_MOVED}{next(numbers)}"))
                shutil.rmtree(entry, ignore_errors=True)
    shutil.rmtree(folder, ignore_errors=True)


def _folders_in(folder: str | Path) -> list[Path]:
    """Returns the folders in a folder, which its owner can read and change from then on."""
    with os.scandir(folder) as entries:
        found = [Path(entry) for entry in entries if entry.is_dir(follow_symlinks=False)]
    for path in found:
        path.chmod(0o700)
    return found


def seal(walls: Walls) -> list[str]:
    """Seals this process, which has one thread; returns what the system lacks for that."""
    import resource

    check_one_thread()
    lacking = [told for told in (landlock.missing(), seccomp.missing()) if told]
    drop_capabilities()
    for limit, size in limits(walls).items():
        hard = resource.getrlimit(limit)[1]
        most = size if hard == resource.RLIM_INFINITY else min(size, hard)
        resource.setrlimit(limit, (most, most))
    if landlock.version():
        # The kernel makes an entry of /proc anew, for which there is no rule then, unless somebody
        # has it open.
        for entry in _PROCESS:
            os.open(entry, os.O_PATH)
    own = (str(walls.own_files[0]), *walls.readable)
    readable = (*libraries(), *_SYSTEM, *map(str, _controls()), *_PROCESS, *own)
    landlock.confine(readable, (walls.scratch, Path(os.devnull)))
    if not seccomp.missing():
        seccomp.refuse_calls()
    return lacking


def _controls() -> Iterator[Path]:
    """Yields the files that say what this process may take of its machine."""
    folders = {_CONTROL, _CONTROL / "memory", _CONTROL / "cpu"}
    with suppress(OSError):
        for line in Path("/proc/self/cgroup").read_text().splitlines():
            _, names, path = line.split(":", 2)
            folders |= {Path(_CONTROL, name, path.lstrip("/")) for name in names.split(",")}
    for folder, name in itertools.product(folders, _CONTROLS):
        yield from folder.glob(name)


def limits(walls: Walls) -> dict[int, int]:
    """Returns what the process may take at most, by the limit's number."""
    import resource

    pages = int(Path("/proc/self/statm").read_text().split()[0])
    return {
        resource.RLIMIT_CORE: 0,
        resource.RLIMIT_FSIZE: walls.file_bytes,
        resource.RLIMIT_NOFILE: _DESCRIPTORS,
        resource.RLIMIT_AS: pages * resource.getpagesize() + walls.memory,
        resource.RLIMIT_CPU: walls.processor_seconds,
    }


def check_one_thread() -> None:
    """Checks that this process has one thread only."""
    names = [
        (task / "comm").read_text(encoding="utf-8", errors="replace").strip()
        for task in sorted(Path("/proc/self/task").iterdir())
    ]
    if len(names) != 1:
        raise SandboxError(
            f"the sandbox cannot start: a library that it imports has started threads "
            f"({', '.join(names[1:])}); update it, or remove it from this environment"
        )


def libraries() -> list[str]:
    """Returns the folders of Python and of the packages that are installed, and ssduck's own.

    The other folders of Python's path, as the current one, are not among them.
    """
    names = ("stdlib", "platstdlib", "purelib", "platlib")
    installed = {sysconfig.get_path(name) for name in names}
    installed |= {
        path for path in sys.path if Path(path).name in ("site-packages", "dist-packages")
    }
    package = find_spec("ssduck")
    assert package is not None
    assert package.submodule_search_locations is not None
    own = Path(package.submodule_search_locations[0])
    beside = own.parent / "scenes"  # in a checkout
    return [*sorted(installed), str(own), *([str(beside)] if beside.is_dir() else [])]
