"""The process from which workers are forked: it has imported ssduck, and has read nothing.

The host executes it (`main`), so that it has nothing of the host's memory, threads and environment.
It opens no DuckDB and starts no thread. It ends when its host ends, and its workers end with it.
"""

from __future__ import annotations

import gc
import json
import os
import select
import signal
import socket
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import Any, NoReturn

from ssduck.errors import SandboxError
from ssduck.sandbox.kernel import PR_SET_PDEATHSIG, has_ended, prctl
from ssduck.sandbox.seal import Walls, check_one_thread, remove

# In the folder of a worker: what it is to do. The folder is named to the zygote, bytes.
ORDER, _MAX_NAME = "order", 1 << 13
# How long a worker that was killed may take to end, s.
_ENDING = 10.0
READY, FAILED, FORKED = b"r", b"!", b"f"
# What workers need, and what the first question would import: modules that start no thread.
_IMPORTED = (
    *("ssduck.interpreter.interpreter", "ssduck.interpreter.opening", "ssduck.interpreter.lint"),
    *("ssduck.adapters.registry", "ssduck.columns.selects", "ssduck.interpreter.scalar_select"),
    *("ssduck.interpreter.query_runner", "ssduck.database.schemas", "ssduck.sandbox.worker"),
    *("ssduck.simulators.pybullet.backend", "ssduck.simulators.mujoco.backend", "trimesh", "fcl"),
    *("pyarrow.parquet", "pyarrow.compute", "pyarrow.dataset", "scipy.spatial", "scipy.optimize"),
)
Serve = Callable[[int, Walls, dict[str, Any]], None]


def main() -> None:
    """Imports ssduck, and forks a worker for each order of the host, until that ends."""
    from ssduck.sandbox.worker import serve

    run(serve, json.loads(sys.argv[1]))


def run(serve: Serve, given: Sequence[Any], imported: Sequence[str] = _IMPORTED) -> NoReturn:
    """Is the process's whole work; at its end, the folders of all workers are gone.

    Args:
        serve: what workers do.
        given: the descriptor of the socket to the host, the number of the host's process, and the
            folder of all workers.
        imported: the modules that it imports for them.
    """
    descriptor, host, folder = given
    os.chdir("/")
    _keep_only(descriptor)
    workers: list[int] = []
    try:
        orders, watched = socket.socket(fileno=descriptor), os.pidfd_open(host)
        if os.getppid() == host and _prepare(
            orders, imported
        ):  # else it ended before it could be watched
            _serve_host(orders, watched, workers, serve)
    except OSError:
        pass  # the host has ended
    finally:
        _end_all(workers, folder)
        os._exit(0)


def _prepare(orders: socket.socket, imported: Sequence[str]) -> bool:
    """Imports what workers need, and tells the host whether that could be done."""
    try:
        for name in imported:
            with suppress(ImportError):  # one of the simulators
                import_module(name)
        if imported:
            # What is made of the relations is kept with them, for all workers.
            from ssduck.database.schemas import description_script

            description_script(("kitchen",), "kitchen", frozenset())
        check_one_thread()
    except Exception as error:  # noqa: BLE001  # the host tells of it
        orders.send(FAILED + f"{type(error).__name__}: {error}".encode()[:1000])
        return False
    gc.collect()
    gc.freeze()
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)
    orders.send(READY)
    return True


def _serve_host(orders: socket.socket, host: int, workers: list[int], serve: Serve) -> None:
    """Forks workers until the host ends."""
    poll = select.poll()
    for waiting in (orders.fileno(), host):
        poll.register(waiting, select.POLLIN)
    while host not in (ready := {descriptor for descriptor, _ in poll.poll()}):
        if orders.fileno() in ready:
            folder, descriptors, _, _ = socket.recv_fds(orders, _MAX_NAME, 1)
            if not folder:
                return
            workers[:] = [worker for worker in workers if _lives(worker)]
            with suppress(OSError):  # the system has no process left; the host sees the end
                workers.append(_fork(Path(os.fsdecode(folder)), descriptors[0], serve))
            os.close(descriptors[0])


def _end_all(workers: list[int], folder: str) -> None:
    """Ends all workers, and removes their folders."""
    for worker in workers:
        with suppress(ProcessLookupError):
            signal.pidfd_send_signal(worker, signal.SIGKILL)
            has_ended(worker, _ENDING)
    remove(folder)


def _lives(worker: int) -> bool:
    if has_ended(worker):
        os.close(worker)
        return False
    return True


def _fork(folder: Path, connection: int, serve: Serve) -> int:
    """Forks a worker, gives the host the descriptor of its process, and returns it."""
    zygote = os.getpid()
    check_one_thread()
    if (worker := os.fork()) == 0:
        try:
            _begin(zygote, connection)
            order = json.loads((folder / ORDER).read_text())
            serve(connection, Walls(**order.pop("walls")), order)
        finally:
            os._exit(1)
    process = os.pidfd_open(worker)
    with socket.socket(fileno=os.dup(connection)) as there, suppress(OSError):
        socket.send_fds(there, [FORKED], [process])  # the host may have given up
    return process


def _begin(zygote: int, connection: int) -> None:
    """Ends with the zygote, and keeps no descriptor but the connection."""
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != zygote:
        raise SandboxError("the zygote has ended")
    _keep_only(connection)


def _keep_only(descriptor: int) -> None:
    """Closes all descriptors but one, which is no standard stream."""
    null = os.open(os.devnull, os.O_RDWR)
    for standard in range(3):
        os.dup2(null, standard)
    os.closerange(3, descriptor)
    os.closerange(descriptor + 1, os.sysconf("SC_OPEN_MAX"))
