"""A zygote whose workers run Python of a test, as if a stranger had taken them over.

`main` is what its process runs. `HookedZygote` starts it; it can take effects and layers away from
its workers.
"""

import json
import sys

from ssduck.sandbox.processes import Zygote

# The system calls that a worker may make without an effect.
OPENED = {
    "files": ("chmod", "fchmodat", "link", "linkat"),
    "network": ("socket", "connect"),
    "processes": (
        *("clone", "fork", "wait4", "execve", "ptrace", "process_vm_readv", "unshare"),
        "io_uring_setup",
    ),
    "signals": ("kill", "tkill", "rt_sigqueueinfo", "fcntl", "prlimit64"),
    "memory": ("shmget",),
    "time": ("prctl",),
}


class HookedZygote(Zygote):
    """A zygote of `main`.

    Attributes:
        without: the effects and layers that its next workers lack.
    """

    def __init__(self):
        super().__init__(__name__)
        self.without = ()

    def worker(self, walls, order):
        return super().worker(walls, {**order, "without": self.without})


def main():
    from ssduck.sandbox import worker, zygote

    held = {}

    def python(own, code):
        names = {"worker": own, "ss": own._opened.get("ss"), "connection": held["connection"]}
        if "\n" not in code:
            return eval(code, names)  # noqa: S307
        exec(code, names)  # noqa: S102
        return names.get("result")

    worker.Worker.python = python  # type: ignore[attr-defined]

    def serve(connection, walls, order):
        held["connection"] = connection
        for name in order.get("without", ()):
            take_away(name)
        worker.serve(connection, walls, order)

    zygote.run(serve, json.loads(sys.argv[1]))


def take_away(name):
    """Has this process seal itself without an effect, or without a layer."""
    from ssduck.sandbox import landlock, seal, seccomp

    for call in OPENED.get(name, ()):
        seccomp.ALLOWED |= {call}
        seccomp._CHECKED.pop(call, None)
        if call == "clone":
            seccomp._threads_only = lambda _: iter(())
    if name in ("files", "landlock"):
        landlock.version = lambda: 0
    elif name == "seccomp":
        seccomp.missing = lambda: "no filter"
    elif name == "network":
        landlock._TCP = 1000
    elif name == "signals":
        landlock._SIGNALS = 1000
    elif name in ("memory", "time", "limits"):
        limits = seal.limits
        taken = {"memory": {9}, "time": {0}, "limits": set(range(20))}[name]
        seal.limits = lambda walls: {n: m for n, m in limits(walls).items() if n not in taken}
