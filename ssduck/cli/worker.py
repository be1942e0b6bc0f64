"""Answers agents in a process of its own, which is ended when a program exceeds its limits.

The two processes exchange lines of JSON: a question names a method of `Answers` and its arguments;
an answer is a text, the bytes of a picture, or an error. `main` is what the process runs.
"""

from __future__ import annotations

import base64
import json
import os
import queue
import signal
import subprocess
import sys
import threading
from contextlib import suppress
from dataclasses import asdict, dataclass
from typing import Any, TextIO

from ssduck.cli.child_process import late_text, signal_text
from ssduck.cli.records import open_or_load
from ssduck.errors import LimitError, SelectScriptError
from ssduck.interpreter.completion import Language
from ssduck.limits import GRACE, Limits, ending_text, limit_process_memory, python_command
from ssduck.mcp.answers import InterpreterAnswers, WorkerError
from ssduck.validation import steps_in

# The line that stops the question before it.
_STOP = "stop"
_GONE = "variables that programs have set are gone"


@dataclass(frozen=True)
class Source:
    """What a worker opens.

    Attributes:
        seconds: the time that a scene is simulated first, s.
        episode: the number of the episode of a record; None for the last one.
    """

    location: str
    seconds: float | None
    episode: int | None
    limits: Limits


class WorkerAnswers:
    """The answers of a worker, which is started again after it has ended."""

    def __init__(self, source: Source) -> None:
        self._source = source
        self._lock = threading.Lock()
        # Is held while a question begins, ends or is stopped.
        self._changing = threading.Lock()
        self._is_asking = self._is_stopped = False
        self._killer: threading.Timer | None = None
        self._process: subprocess.Popen[str] | None = None
        with self._lock:
            self._start()

    def close(self) -> None:
        """Ends the worker."""
        with self._lock:
            self._end()

    def begin(self) -> None:
        """Forgets what was stopped before."""
        self._is_stopped = False

    def stop(self) -> None:
        """Ends the question that was begun last; the worker, too, if that takes too long."""
        with self._changing:
            self._is_stopped = True
            if self._is_asking and self._process is not None and self._killer is None:
                self._killer = threading.Timer(GRACE, self._process.kill)
                self._killer.start()
                with suppress(BrokenPipeError):
                    self._write(_STOP)

    def schema(self) -> str:
        """Returns the guide, the worlds, tables and functions."""
        return str(self._ask("schema"))

    def help(self, name: str) -> str:
        """Returns the description of a function, a relation or a result form."""
        return str(self._ask("help", name))

    def query(self, program: str, language: Language, max_rows: int) -> str:
        """Returns the result of a program as JSON, cut to a number of rows and a largest size."""
        return str(self._ask("query", program, language, max_rows))

    def picture(self, program: str, language: Language, width: int, height: int) -> bytes:
        """Returns the PNG picture of a result, or one where what a program selects stands out."""
        return base64.b64decode(self._ask("picture", program, language, width, height))

    def _ask(self, *question: Any) -> Any:
        with self._lock:
            if self._process is None or self._process.poll() is not None:
                self._end()
                self._start()
            assert self._process is not None
            timer = None
            if (seconds := self._source.limits.seconds) is not None:
                timer = threading.Timer(seconds + GRACE, self._process.kill)
                timer.start()
            try:
                with self._changing:
                    if self._is_stopped:
                        raise LimitError("the request was cancelled")
                    self._is_asking = True
                    self._write(question)
                return self._answer()
            except (EOFError, BrokenPipeError):
                is_late = timer is not None and not timer.is_alive()
                status = self._end()
                if is_late:
                    message = late_text(self._source.limits)
                else:
                    message = f"the process of the program ended ({_reason(status)})"
                raise LimitError(f"{message}; {_GONE}") from None
            finally:
                with self._changing:
                    self._is_asking, killer, self._killer = False, self._killer, None
                for one in (timer, killer):
                    if one is not None:
                        one.cancel()

    def _write(self, line: Any) -> None:
        assert self._process is not None
        assert self._process.stdin is not None
        self._process.stdin.write(f"{json.dumps(line)}\n")
        self._process.stdin.flush()

    def _answer(self) -> Any:
        assert self._process is not None
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line.endswith("\n"):
            raise EOFError
        answer = json.loads(line)
        if "error" in answer:
            raise WorkerError(answer["error"])
        return answer["value"]

    def _start(self) -> None:
        self._process = subprocess.Popen(  # noqa: S603  # this file
            python_command(__name__, json.dumps(asdict(self._source))),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            encoding="utf-8",
        )
        try:
            self._answer()
        except EOFError:
            raise WorkerError(f"the process for programs ended ({_reason(self._end())})") from None
        except WorkerError:
            self._end()
            raise

    def _end(self) -> int:
        """Ends the worker, and returns its exit status."""
        process, self._process = self._process, None
        if process is None:
            return 0
        process.kill()
        for stream in (process.stdin, process.stdout):
            if stream is not None:
                with suppress(BrokenPipeError):
                    stream.close()
        return process.wait()


def _reason(status: int) -> str:
    return ending_text(status) if status >= 0 else signal_text(-status)


# -- in the worker ----------------------------------------------------------------------------


def main() -> None:
    """Opens a scene or a record, and answers questions until there are no more."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    questions, answers = _streams()
    settings = json.loads(sys.argv[1])
    source = Source(**{**settings, "limits": Limits(**settings["limits"])})
    try:
        ss = open_or_load(source.location, source.episode, source.limits)
        ss.strict = True
        if source.seconds is not None:
            (world,) = ss.worlds
            world.step(steps_in(source.seconds, world.timestep, "--seconds"))
    except SelectScriptError as error:
        _write(answers, {"error": str(error)})
        return
    with ss:
        limit_process_memory(source.limits)
        _write(answers, {"value": None})
        interpreter_answers = InterpreterAnswers(ss)
        waiting: queue.SimpleQueue[list[Any] | None] = queue.SimpleQueue()
        reader = threading.Thread(
            target=_read_questions, args=(questions, interpreter_answers, waiting), daemon=True
        )
        reader.start()
        while (question := waiting.get()) is not None:
            method, *arguments = question
            try:
                value = getattr(interpreter_answers, method)(*arguments)
            except SelectScriptError as error:
                _write(answers, {"error": f"{type(error).__name__}: {error}"})
            except MemoryError:
                _write(answers, {"error": "LimitError: the program needs too much memory"})
            else:
                is_bytes = isinstance(value, bytes)
                _write(answers, {"value": base64.b64encode(value).decode() if is_bytes else value})


def _read_questions(
    lines: TextIO, answers: InterpreterAnswers, waiting: queue.SimpleQueue[list[Any] | None]
) -> None:
    """Reads questions, which wait for the main thread, and requests to stop the last of them."""
    for line in lines:
        question = json.loads(line)
        if question == _STOP:
            answers.stop()
        else:
            answers.begin()
            waiting.put(question)
    waiting.put(None)


def _streams() -> tuple[TextIO, TextIO]:
    """Returns the streams of questions and answers; all other output goes to standard error."""
    questions = os.fdopen(os.dup(0), "r", encoding="utf-8")
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    null = os.open(os.devnull, os.O_RDONLY)
    os.dup2(null, 0)
    os.close(null)
    os.dup2(2, 1)
    return questions, answers


def _write(stream: TextIO, answer: dict[str, Any]) -> None:
    stream.write(f"{json.dumps(answer)}\n")
    stream.flush()
