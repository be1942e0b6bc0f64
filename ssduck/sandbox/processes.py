"""The host's side of the zygote and of its workers: starts, asks, watches and ends them."""

from __future__ import annotations

import fcntl
import itertools
import json
import os
import signal
import socket
import stat
import sys
import tempfile
import threading
import time
import weakref
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, replace
from importlib.resources import files
from pathlib import Path
from typing import Any

from ssduck.errors import LimitError, SandboxError
from ssduck.lazy import ONE_THREAD
from ssduck.limits import python_command
from ssduck.sandbox.budget import UNLIMITED, Budget, InvalidAnswerError
from ssduck.sandbox.kernel import has_ended
from ssduck.sandbox.messages import LOOK_EVERY, Message, Waiting, receive, send
from ssduck.sandbox.reports import error_of, tell, told_error
from ssduck.sandbox.seal import SCRATCH, Walls, check_one_thread, remove
from ssduck.sandbox.values import Decoder, Encoder
from ssduck.sandbox.zygote import FAILED, FORKED, ORDER, READY, run
from ssduck.world.ctrl_c import allowed, deferred

# What a worker's processes inherit of the host's environment: nothing that may be a secret.
_KEPT = ("LANG", "LANGUAGE", "TZ", "LD_LIBRARY_PATH", "PYTHONHOME")
# The largest size of all files in a scratch folder, bytes, and numbers of files and of threads.
_MAX_SCRATCH, _MAX_FILES, _MAX_THREADS = 256 * 2**20, 1000, 64
_BLOCK = 512  # of `st_blocks`
_REMOVED = b" (deleted)"  # ends the path of a file without a name in a process's `maps`
# A worker may run for so long, in several questions, before its host looks at them, s.
_UNWATCHED = 0.01
# How long a process may take to begin, and to end once it is told to, s.
_BEGINNING, _ENDING = 60.0, 10.0


# Why a worker was ended.
_LATE = "the program took too long, and its process was ended"


class WorkerEndedError(Exception):
    """The process of a worker has ended, or had to be ended; the message says why.

    Attributes:
        is_late: whether it did not answer in time.
    """

    def __init__(self, message: str, *, is_late: bool = False) -> None:
        super().__init__(message)
        self.is_late = is_late


class Zygote:
    """The process from which this host's workers are forked.

    Args:
        module: the module whose `main` it runs; None for one that is a fork of this process, which
            has one thread, and imports nothing beforehand.

    Attributes:
        pid: the number of the process.
        host: that of this process.
    """

    def __init__(self, module: str | None = "ssduck.sandbox.zygote") -> None:
        if not hasattr(os, "pidfd_open"):
            raise SandboxError(
                f"the sandbox lacks all effects on {sys.platform}: it needs Linux 6.2 or later"
            )
        self.host = os.getpid()
        self._lock = threading.Lock()
        self._numbers = itertools.count()
        self._is_ready = False
        self._folder = tempfile.mkdtemp(prefix="ssduck-sandbox-")
        self._orders, there = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with there:
            if module is None:
                self.pid = _forked(there, self.host, self._folder)
            else:
                self.pid = _executed(module, there, self.host, self._folder)
        self._process = os.pidfd_open(self.pid)
        self._finalizer = weakref.finalize(
            self, _end_zygote, self.pid, self._process, self._orders, self._folder, self.host
        )

    @property
    def is_alive(self) -> bool:
        """Whether it can be asked for workers by this process."""
        is_own = self.host == os.getpid()
        return is_own and self._finalizer.alive and not has_ended(self._process)

    def close(self) -> None:
        """Ends it, and its workers."""
        self._finalizer()

    def worker(self, walls: Walls, order: dict[str, Any]) -> WorkerProcess:
        """Returns a new worker."""
        with self._lock:
            self._await_ready()
            folder = Path(self._folder, f"worker{next(self._numbers)}")
            walls = replace(walls, folder=str(folder))
            walls.prepare()
            (folder / ORDER).write_text(json.dumps({**order, "walls": asdict(walls)}))
            here, there = socket.socketpair()
            here.settimeout(_BEGINNING)
            try:
                with there:
                    socket.send_fds(self._orders, [os.fsencode(folder)], [there.fileno()])
                answer, descriptors, _, _ = socket.recv_fds(here, 1, 1, socket.MSG_CMSG_CLOEXEC)
                if answer != FORKED or not descriptors:
                    raise OSError("it has no process left")
                return WorkerProcess(here, descriptors[0], folder, order["answer_bytes"])
            except OSError as error:  # this process, too, may have no descriptor left
                here.close()
                raise SandboxError(f"the sandbox cannot start a process: {error}") from error

    def _await_ready(self) -> None:
        """Waits until it has imported ssduck."""
        if self._is_ready:
            return
        self._orders.settimeout(_BEGINNING)
        try:
            answer = self._orders.recv(2000)
        except TimeoutError:
            answer = FAILED + b"it takes too long"
        if answer != READY:
            self.close()
            told = answer[len(FAILED) :].decode(errors="replace") or "its process ended"
            raise SandboxError(f"the sandbox cannot start: {told}")
        self._orders.settimeout(None)
        self._is_ready = True


def _environment() -> dict[str, str]:
    kept = {name: os.environ[name] for name in os.environ if name in _KEPT or name[:3] == "LC_"}
    return {**kept, **ONE_THREAD}


def _executed(module: str, orders: socket.socket, host: int, folder: str) -> int:
    """Starts a zygote that has nothing of this process; it takes the socket."""
    own = str(Path(str(files("ssduck"))).parent)
    # Where it looks for modules: not in what is relative to this folder.
    path = [*(path for path in map(str, sys.path) if Path(path).is_absolute()), own]
    passed = 3  # after its own standard streams, since this process's may be closed
    command = python_command(module, json.dumps([passed, host, folder]), path=path)
    return os.posix_spawn(
        command[0],
        command,
        _environment(),
        file_actions=[
            (os.POSIX_SPAWN_DUP2, orders.fileno(), passed),
            *((os.POSIX_SPAWN_OPEN, own, os.devnull, os.O_RDWR, 0) for own in range(3)),
        ],
        setsid=True,  # Ctrl-C in a terminal is the host's
    )


def _forked(orders: socket.socket, host: int, folder: str) -> int:
    """Makes a fork of this process a zygote, which takes the socket."""
    from ssduck.sandbox.worker import serve

    if (pid := os.fork()) == 0:
        try:
            os.setsid()
            environment = _environment()
            os.environ.clear()
            os.environ.update(environment)
            passed = fcntl.fcntl(orders, fcntl.F_DUPFD_CLOEXEC, 3)
            run(serve, (passed, host, folder), ())
        finally:
            os._exit(1)
    return pid


def _end_zygote(pid: int, process: int, orders: socket.socket, folder: str, host: int) -> None:
    orders.close()
    if os.getpid() == host:  # a forked child leaves it to its parent
        if not has_ended(process, _ENDING):
            signal.pidfd_send_signal(process, signal.SIGKILL)
        with suppress(ChildProcessError):
            os.waitpid(pid, 0)
        remove(folder)
    os.close(process)


_shared: list[Zygote] = []
_starting = threading.Lock()


def shared_zygote() -> Zygote:
    """Returns the zygote of this process; starts one, in the background, if there is none."""
    with _starting:
        if not (_shared and _shared[0].is_alive):
            _shared[:] = [Zygote()]
        return _shared[0]


def fork_zygote() -> None:
    """Makes a fork of this process, which is a command's own, its zygote: it imports once.

    `ONE_THREAD` was set before. If there are other threads nevertheless, or no sandbox, it is left
    to `shared_zygote`.
    """
    with suppress(SandboxError):
        check_one_thread()
        _shared[:] = [Zygote(None)]


class WorkerProcess:
    """A worker.

    It is stopped, and takes no processor time, while it is not asked.

    Args:
        connection: the socket to it.
        process: the descriptor of its process.
        folder: its private folder.
        answer_bytes: the largest size of an answer, bytes.
    """

    def __init__(
        self, connection: socket.socket, process: int, folder: Path, answer_bytes: int
    ) -> None:
        connection.setblocking(False)
        self._connection = connection
        self._process = process
        self._scratch = folder / SCRATCH
        self._answer_bytes = answer_bytes
        self._number, self._unwatched, self._next_maps = 0, 0.0, 0.0
        self.host = os.getpid()
        self._finalizer = weakref.finalize(
            self, _end_worker, process, connection, folder, self.host
        )
        self._pid = _pid_of(process)

    @property
    def is_alive(self) -> bool:
        """Whether it can be asked."""
        is_own = self._finalizer.alive and self.host == os.getpid()
        return is_own and not has_ended(self._process)

    def _stop(self) -> None:
        """Ends the program that it runs, if any, as Ctrl-C does."""
        with suppress(OSError):
            self._signal(signal.SIGINT)

    def end(self) -> None:
        """Ends it, and removes its files."""
        self._finalizer()

    def ask(
        self,
        request: str,
        arguments: Sequence[Any],
        options: Mapping[str, Any],
        *,
        seconds: float | None,
        world: Callable[[str], Any],
        name_of: Callable[[Any], str],
        call: Callable[..., Any],
        is_stopped: Callable[[], bool] | None = None,
    ) -> Any:
        """Returns the answer to a request; after some time, s, the process is ended.

        Before it answers, the process may ask the host by `call`: for a name, with arguments.
        """
        encoder = Encoder(Budget(UNLIMITED), name_of)
        document = encoder.text([request, list(arguments), dict(options)])
        self._number = (self._number + 1) % 2**32
        began = time.monotonic()
        if is_stopped is not None and is_stopped():
            raise LimitError("the program was stopped")

        def look() -> None:
            self._look()
            if is_stopped is not None and is_stopped():
                self._stop()

        wait = Waiting(self._connection.fileno(), seconds, look, self._stop)
        try:
            with deferred():
                self._signal(signal.SIGCONT)
                message = self._exchange(document, encoder, wait, is_call=False)
                while message.is_call:
                    reply, encoder = self._reply(message, world, name_of, call, wait)
                    message = self._exchange(reply, encoder, wait, is_call=True)
                self._signal(signal.SIGSTOP)
                self._unwatched += time.monotonic() - began
                if self._unwatched > _UNWATCHED:
                    self._look()
            if not wait.is_pressed:
                warnings, error, value = self._answer(message, world)
        except TimeoutError:
            told = _LATE
        except InvalidAnswerError as error_of_answer:
            told = f"the process of the program sent no answer ({error_of_answer}), and was ended"
        except (EOFError, ConnectionError, ProcessLookupError):
            told = "the process of the program ended; it may have needed more memory than it may"
            told += " take, or crashed"
        except _HarmError as harm:
            told = str(harm)
        except BaseException:
            self.end()
            raise
        else:
            if wait.is_pressed:  # the program has ended as it does in this process
                raise KeyboardInterrupt
            tell(warnings)
            if error is not None:
                raise error
            return value
        self.end()
        if wait.is_pressed:
            raise KeyboardInterrupt from None
        raise WorkerEndedError(told, is_late=told is _LATE) from None

    def _exchange(
        self, document: bytes, encoder: Encoder, wait: Waiting, *, is_call: bool
    ) -> Message:
        wait.check()
        descriptor = self._connection.fileno()
        send(descriptor, self._number, document, encoder.parts, wait, is_call=is_call)
        return receive(descriptor, self._check_size, wait)

    def _reply(
        self,
        message: Message,
        world: Callable[[str], Any],
        name_of: Callable[[Any], str],
        call: Callable[..., Any],
        wait: Waiting,
    ) -> tuple[bytes, Encoder]:
        """Returns the JSON that replies to a call, and the encoder with its body."""
        name, arguments, *_ = self._values(message, world)
        if not (isinstance(name, str) and isinstance(arguments, list | tuple)):
            raise InvalidAnswerError("it is no call")
        encoder = Encoder(Budget(UNLIMITED), name_of)
        try:
            if wait.is_pressed:
                raise LimitError("the program was stopped")
            with allowed():
                value = call(name, *arguments)
            return encoder.text([value]), encoder
        except InvalidAnswerError:
            raise
        except (Exception, KeyboardInterrupt) as error:  # noqa: BLE001  # the program gets it
            if isinstance(error, KeyboardInterrupt):
                wait.press()
            encoder = Encoder(Budget(UNLIMITED), name_of)
            return encoder.text([None, told_error(error)]), encoder

    def _check_size(self, document: int, body: int) -> None:
        if document + body > self._answer_bytes:
            raise InvalidAnswerError(f"it has more than {self._answer_bytes:,} bytes")

    def _answer(
        self, message: Message, world: Callable[[str], Any]
    ) -> tuple[list[list[str]], Exception | None, Any]:
        """Returns the warnings, the error and the value of an answer."""
        value, warnings, *told = self._values(message, world)
        try:
            for name, text in warnings:
                if not (isinstance(name, str) and isinstance(text, str)):
                    raise InvalidAnswerError("this is no warning")
            return warnings, error_of(told[0]) if told else None, value
        except (ValueError, TypeError, AttributeError) as error:
            raise InvalidAnswerError(str(error)) from error

    def _values(self, message: Message, world: Callable[[str], Any]) -> Sequence[Any]:
        if message.number != self._number:
            raise InvalidAnswerError("it answers another question")
        budget = Budget(self._answer_bytes)
        decoder = Decoder(
            message.body,
            budget,
            entity=lambda name, *own: world(name).reference(*own),
            world=world,
        )
        try:
            budget.charge(len(message.body))
            values = decoder.value(message.document)
            if len(values) >= 2:
                return list(values)
        except (LimitError, ValueError, TypeError, AttributeError) as error:
            raise InvalidAnswerError(str(error)) from error
        raise InvalidAnswerError("it is incomplete")

    def _signal(self, number: int) -> None:
        signal.pidfd_send_signal(self._process, number)

    def _look(self) -> None:
        """Checks that it has not filled its scratch folder, nor started too many threads."""
        self._unwatched = 0.0
        sizes = list(itertools.islice(self._sizes(), _MAX_FILES))
        if sum(sizes) > _MAX_SCRATCH or len(sizes) == _MAX_FILES:
            raise _HarmError("the program filled the disk, and its process was ended")
        with suppress(OSError):
            status = Path(f"/proc/{self._pid}/stat").read_text(encoding="ascii", errors="replace")
            if int(status.rpartition(")")[2].split()[17]) > _MAX_THREADS:
                raise _HarmError("the program started many threads, and its process was ended")

    def _sizes(self) -> Iterator[int]:
        """Yields the sizes of its files, and of those without a name that it has, bytes."""
        folders = [str(self._scratch)]
        while folders:
            try:
                with os.scandir(folders.pop()) as entries:
                    for entry in entries:
                        with suppress(FileNotFoundError):  # it has just been removed
                            yield _size_of(entry.stat(follow_symlinks=False))
                            if entry.is_dir(follow_symlinks=False):
                                folders.append(entry.path)
            except FileNotFoundError:
                pass
            except OSError:  # its path is too long, or it cannot be read: nobody knows what it has
                yield _MAX_SCRATCH + 1
        with suppress(OSError), os.scandir(f"/proc/{self._pid}/fd") as entries:
            for entry in entries:
                with suppress(FileNotFoundError):
                    found = entry.stat()
                    if stat.S_ISREG(found.st_mode) and not found.st_nlink:
                        yield _size_of(found)
        yield from self._sizes_of_mapped()

    def _sizes_of_mapped(self) -> Iterator[int]:
        """Yields the largest size of each file without a name that it has in its memory only.

        They are looked at ten times a second, since that takes long.
        """
        if time.monotonic() < self._next_maps:
            return
        self._next_maps = time.monotonic() + LOOK_EVERY
        with suppress(OSError):
            maps = Path(f"/proc/{self._pid}/maps").read_bytes()
            if _REMOVED in maps:
                scratch = os.fsencode(self._scratch)
                lines = (line.split(None, 5) for line in maps.splitlines())
                removed = {
                    line[4]
                    for line in lines
                    if len(line) > 5 and line[5].startswith(scratch) and line[5].endswith(_REMOVED)
                }
                yield from (Walls.file_bytes for _ in removed)


def _size_of(found: os.stat_result) -> int:
    return max(found.st_size, found.st_blocks * _BLOCK)


class _HarmError(Exception):
    """A worker does what no seal forbids, but its host."""


def _end_worker(process: int, connection: socket.socket, folder: Path, host: int) -> None:
    connection.close()
    if os.getpid() == host:
        with suppress(ProcessLookupError):
            signal.pidfd_send_signal(process, signal.SIGKILL)
        has_ended(process, _ENDING)
        remove(folder)
    os.close(process)


def _pid_of(process: int) -> int:
    """Returns the number of the process that a descriptor stands for."""
    lines = Path(f"/proc/self/fdinfo/{process}").read_text(encoding="ascii").splitlines()
    return int(next(line.split()[1] for line in lines if line.startswith("Pid:")))
