"""Loads a scene from a stranger in a process of its own, before this process loads it.

Simulators crash on files in more ways than checks know of. What crashes the other process is an
error here. This module is both: `Trial` starts a process that runs `main`, and reads lines of JSON
from it: that it is ready, each model file that it reads, and how the trial ended. A model that has
taken the process over may write anything there, so nothing else is believed.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import pickle
import signal
import subprocess
import sys
import threading
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from queue import SimpleQueue
from typing import IO, Any

from ssduck.errors import (
    LimitError,
    SceneError,
    SelectScriptError,
    SimulatorError,
    UnsupportedError,
)
from ssduck.limits import Limits, ending_text, limit_process_memory, python_command
from ssduck.simulators.backends import backend
from ssduck.simulators.interface import DEFAULT_BACKEND, Body, Simulator
from ssduck.simulators.recognition import MUJOCO, simulator_of_scene
from ssduck.simulators.scene_bodies import MODEL_SUFFIXES
from ssduck.simulators.scene_files import check_files_inside, files_beside
from ssduck.simulators.scenes import Camera, Scene, shipped_scenes

# A process may take so long to start on a busy machine, s.
_START_SECONDS = 60.0
# A process that tells nothing more may take so long to end, s.
_ENDING_SECONDS = 5.0
# A scene may take so long to be loaded, however short the time of programs is, s.
LEAST_LOADING = 30.0
# So many bytes of the files of a scene are hashed.
_MAX_HASHED = 1 << 29
# The option of Linux's `prctl` for the signal that a process gets when its parent ends.
_PR_SET_PDEATHSIG = 1
# The longest line that is read of what the process tells, bytes.
_MAX_LINE = 65_536
# The errors that the process may tell, by name; others are a SceneError.
_ERRORS = {each.__name__: each for each in (LimitError, SceneError, UnsupportedError)}
_TITLES = {DEFAULT_BACKEND: "PyBullet", MUJOCO: "MuJoCo"}


class Trial:
    """Loads a scene in a process of its own, before this process loads it.

    Args:
        scene: the scene.
        limits: `seconds` and `memory` of the process; with `files=False`, all files of the scene
            are in its folder. None for no trial, as with `trial=False`, and with scenes that come
            with ssduck.
        simulator: the name of the simulator; None for that of the scene.
    """

    def __init__(self, scene: Scene, limits: Limits | None, simulator: str | None = None) -> None:
        is_foreign = scene.path not in shipped_scenes().values()
        self._limits = limits if limits is not None and limits.has_trial and is_foreign else None
        self._scene, self._simulator = scene, simulator
        self._passed: Mapping[Path, tuple[Any, ...]] | None = None

    @property
    def is_needed(self) -> bool:
        """Whether another process loads the scene first."""
        return self._limits is not None

    @contextmanager
    def passed(self) -> Iterator[None]:
        """Loads the scene in another process, unless that was done with the same files.

        The body of the `with` statement loads it here.

        Raises:
            SceneError: the simulator crashes, the scene cannot be loaded, or its files change.
            LimitError: loading takes too long, or too much memory.
            SimulatorError: no process can be started.
        """
        if self._limits is None:
            yield
            return
        files = self._files(self._limits)
        if files != self._passed:
            name = self._simulator or simulator_of_scene(self._scene)
            _try(_Request(self._scene, name, self._limits))
            self._check_files(files, self._limits)
            self._passed = files
        yield
        self._check_files(files, self._limits)

    def _files(self, limits: Limits) -> Mapping[Path, tuple[Any, ...]]:
        """Returns what changes with the content of each file that loading may read.

        It is a hash, and the size and times of the file, which count alone where all files have
        more than `_MAX_HASHED` bytes: a file of a few bytes on the disk may be one of terabytes.
        """
        files = files_beside(self._scene) if limits.files else check_files_inside(self._scene)
        found: dict[Path, tuple[Any, ...]] = {}
        left = _MAX_HASHED
        for file in files:
            if not file.is_file():  # a pipe would be waited for
                continue
            status = file.stat()
            times = status.st_ino, status.st_size, status.st_mtime_ns, status.st_ctime_ns
            left -= status.st_size
            found[file] = (*times, _hash(file) if left >= 0 else None)
        return found

    def _check_files(self, before: Mapping[Path, tuple[Any, ...]], limits: Limits) -> None:
        now = self._files(limits)
        changed = sorted({file for file, _ in before.items() ^ now.items()})
        if changed:
            raise SceneError(f"{changed[0]} has changed while {self._scene.path} was loaded")


def _hash(file: Path) -> bytes:
    try:
        with file.open("rb") as stream:
            return hashlib.file_digest(stream, "sha256").digest()
    except OSError as error:
        raise SceneError(f"{file} cannot be read: {error.strerror}") from error


@dataclass(frozen=True)
class _Request:
    """What the process loads."""

    scene: Scene
    simulator: str
    limits: Limits


class _Deadline:
    """Ends a process when its time is up."""

    def __init__(
        self, process: subprocess.Popen[bytes], lines: SimpleQueue[bytes], seconds: float
    ) -> None:
        self._process, self._lines = process, lines
        self._timer: threading.Timer | None = None
        self.is_over = False
        self.restart(seconds)

    def restart(self, seconds: float) -> None:
        """Gives the process so much time from now on, s."""
        self.cancel()
        if math.isfinite(seconds):
            self._timer = threading.Timer(seconds, self._end)
            self._timer.daemon = True
            self._timer.start()

    def cancel(self) -> None:
        """Gives the process all time."""
        if self._timer is not None:
            self._timer.cancel()

    def _end(self) -> None:
        self.is_over = True
        _kill(self._process)
        self._lines.put(b"")


def _read(stream: IO[bytes], lines: SimpleQueue[bytes]) -> None:
    """Passes lines on, and an empty one at the end.

    It is done in a thread: what the process has started may keep its pipe longer than it has time.
    """
    with stream:
        for line in iter(partial(stream.readline, _MAX_LINE), b""):
            lines.put(line)
    lines.put(b"")


def _kill(process: subprocess.Popen[bytes]) -> None:
    """Ends a process that leads a session, and what it has started."""
    if hasattr(os, "killpg"):
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(process.pid, signal.SIGKILL)
    process.kill()


def _try(request: _Request) -> None:
    """Loads a scene in a process of its own; see `Trial.passed`."""
    backend(request.simulator)  # is there one of that name?
    process = _started(request.scene)
    assert process.stdin is not None
    assert process.stdout is not None
    lines, seconds = SimpleQueue[bytes](), _START_SECONDS
    deadline = _Deadline(process, lines, seconds)
    threading.Thread(target=_read, args=(process.stdout, lines), daemon=True).start()
    begins, file, is_loaded = False, str(request.scene.path), False
    try:
        with suppress(BrokenPipeError), process.stdin as stream:
            stream.write(pickle.dumps(request))
        for line in iter(lines.get, b""):
            match _told(line):
                case {"begins": True} if not begins:  # once: it is given no more time
                    begins, seconds = True, _loading_seconds(request.limits)
                    deadline.restart(seconds)
                case {"reads": str(file)}:
                    pass
                case {"loaded": True}:
                    file, is_loaded = str(request.scene.path), True
                case {"passed": True}:
                    return
                case {"error": str(message), "type": str(name), "suggestions": list(names)}:
                    raise _ERRORS.get(name, SceneError)(message, suggestions=map(str, names))
                case _:
                    break
        else:
            with suppress(subprocess.TimeoutExpired):  # how did it end?
                process.wait(_ENDING_SECONDS)
    finally:
        deadline.cancel()
        _kill(process)
        process.wait()
    if not begins and not deadline.is_over:
        raise SimulatorError(
            f"the process that loads {file} first did not start: {ending_text(process.returncode)}"
        )
    if deadline.is_over:
        raise LimitError(f"{file}: loading takes more than {seconds:g} s (Limits: seconds)")
    title = _TITLES.get(request.simulator, request.simulator)
    what = "crashes when this scene runs" if is_loaded else "crashes on this file"
    memory = "" if request.limits.memory is None else ", or needs more memory than it may take"
    raise SceneError(f"{file}: {title} {what}{memory} ({ending_text(process.returncode)})")


def _started(scene: Scene) -> subprocess.Popen[bytes]:
    try:
        return subprocess.Popen(  # noqa: S603  # this file
            python_command(__name__),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
    except OSError as error:
        reason = error.strerror
        raise SimulatorError(f"no process can be started to load {scene.path}: {reason}") from error


def _told(line: bytes) -> Any:
    """Returns what a line of the process tells; None for nonsense."""
    try:
        return json.loads(line)
    except (ValueError, RecursionError):
        return None


def _loading_seconds(limits: Limits) -> float:
    """Returns how long loading may take, s."""
    return math.inf if limits.seconds is None else max(limits.seconds, LEAST_LOADING)


# -- in the process ---------------------------------------------------------------------------


def main() -> None:
    """Loads the scene that the parent sends, and uses it a little."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    _end_with_parent()
    warnings.simplefilter("ignore")  # the parent warns
    tells = os.fdopen(os.dup(1), "w", encoding="utf-8", buffering=1)
    os.dup2(2, 1)  # simulators print
    request = pickle.load(sys.stdin.buffer)  # noqa: S301  # of the parent
    assert isinstance(request, _Request)
    simulators = backend(request.simulator)

    def tell(**news: Any) -> None:
        tells.write(f"{json.dumps(news)}\n")

    def audit(event: str, arguments: tuple[Any, ...]) -> None:
        if event == "open" and str(arguments[0]).lower().endswith(MODEL_SUFFIXES):
            tell(reads=str(arguments[0]))

    _limit_process(request.limits)
    tell(begins=True)
    sys.addaudithook(audit)
    try:
        simulator = simulators.load(request.scene)
        bodies = _described(simulator, request.scene)
        tell(loaded=True)
        _use(simulator, bodies)
    except MemoryError:
        message = f"{request.scene.path}: loading takes too much memory (Limits: memory)"
        tell(error=message, type=LimitError.__name__, suggestions=[])
    except SelectScriptError as error:
        tell(error=error.message, type=type(error).__name__, suggestions=error.suggestions)
    except Exception as error:  # noqa: BLE001  # whatever a library raises on such a file
        message = f"{request.scene.path} cannot be loaded: {type(error).__name__}: {error}"
        tell(error=message, type=SceneError.__name__, suggestions=[])
    else:
        tell(passed=True)


def _described(simulator: Simulator, scene: Scene) -> list[Body]:
    try:
        bodies, _ = simulator.describe() or ([], [])
    except SceneError as error:
        raise SceneError(f"{scene.path}: {error.message}") from error
    return bodies


def _end_with_parent() -> None:
    """Has the system end this process when its parent ends, however that does (Linux)."""
    if sys.platform != "linux":
        return
    import ctypes

    parent = os.getppid()
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:  # it has ended meanwhile
        os._exit(1)


def _limit_process(limits: Limits) -> None:
    """Limits memory, leaves no core file, and ends the process if nobody else does."""
    try:
        import resource
    except ImportError:  # Windows
        return
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    limit_process_memory(limits)
    seconds = _loading_seconds(limits)
    if math.isfinite(seconds):  # in place of the parent, if that is killed
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
        signal.setitimer(signal.ITIMER_REAL, _START_SECONDS + seconds)


def _use(simulator: Simulator, bodies: Sequence[Body]) -> None:
    """Reads what a world may read of a simulation, and makes a step and a picture of it."""
    with suppress(Exception):  # an error of this kind is one when it is used, too
        simulator.read_link_poses(tuple(bodies), with_velocities=True)
        simulator.read_joints(bodies)
        simulator.step(1)
        simulator.read_contacts().all()
    if simulator.backend == DEFAULT_BACKEND:  # MuJoCo draws what it has checked, on a graphics card
        with suppress(Exception):
            simulator.render(Camera(), 16, 16, shadow=True)
