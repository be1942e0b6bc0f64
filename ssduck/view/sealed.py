"""Answers the questions of pages in sandboxes: for the present, for the past, and for scans.

The host has the world, and shows it. A program of a page runs where it can do no harm, and a long
one does not delay the simulation:

    of this process                          of a sandbox, one for each use
    viewer -> SealedAnswers -- question -->  AnswersInside -> Answers -> a copy of the world,
                            <---- JSON ----                              or its record
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import lru_cache
from itertools import count
from typing import Any, Literal, TypeAlias

from ssduck.errors import LimitError, SandboxError, SelectScriptError, warn
from ssduck.interpreter.interpreter import Interpreter
from ssduck.interpreter.stopping import StopRequest
from ssduck.recording.replay.replayed_world import CopiedWorld, ReplayedWorld
from ssduck.sandbox.budget import Budget, InvalidAnswerError
from ssduck.sandbox.interpreter import SandboxedInterpreter
from ssduck.sandbox.opening import open_record
from ssduck.sandbox.processes import shared_zygote
from ssduck.view.answers import Answers, error_message
from ssduck.view.live import Asked, LiveSource, Source, Ticks, page_limits, recorded_time
from ssduck.view.scans import Scan

Use: TypeAlias = Literal["present", "past", "scan"]


class PageSandboxes:
    """The sandboxes that answer about a source, for all its viewers; each starts when it is asked.

    Two threads ask: one for scans, one for all other questions.
    """

    def __init__(self, source: Source) -> None:
        self._source = source
        self._sandboxes: dict[Use, SandboxedInterpreter] = {}
        self._viewer_numbers = count()

    @classmethod
    def of(cls, source: Source) -> PageSandboxes | None:
        """Returns those of a source; None, with a warning, if the system has no sandbox."""
        try:
            shared_zygote()
        except SandboxError as error:
            warn(f"programs of the page run in this process: {error.message}")
            return None
        return cls(source)

    def answers(self) -> SealedAnswers:
        """Returns the answers for another viewer."""
        return SealedAnswers(self, next(self._viewer_numbers))

    def sandbox(self, use: Use) -> SandboxedInterpreter:
        """Returns the sandbox for a use, with the world as it is now."""
        source = self._source
        if use not in self._sandboxes:
            self._sandboxes[use] = self._new_sandbox()
        sandbox = self._sandboxes[use]
        if isinstance(source, LiveSource):
            source.check_is_there()
            sandbox.follow(source.name, source.world, source.interpreter, is_past=use != "present")
        return sandbox

    def _new_sandbox(self) -> SandboxedInterpreter:
        source, limits = self._source, page_limits()
        if isinstance(source, LiveSource):
            return SandboxedInterpreter(limits=limits, strict=True)
        return open_record(source.path, episode=source.episode, limits=limits, strict=True)

    def use_of(self, question: dict[str, Any]) -> Use:
        """Returns the use of a question: a record has no present."""
        is_present = question.get("at") is None and isinstance(self._source, LiveSource)
        return "present" if is_present else "past"

    def close(self) -> None:
        """Ends the sandboxes."""
        for sandbox in self._sandboxes.values():
            sandbox.close()


class SealedAnswers:
    """Answers the questions of a viewer, as `Answers` does."""

    def __init__(self, sandboxes: PageSandboxes, viewer: int) -> None:
        self._sandboxes, self._viewer = sandboxes, viewer
        # The use of the sandbox that has the last result, to be downloaded.
        self._last_use: Use | None = None

    def answer(self, question: dict[str, Any], stop: StopRequest) -> dict[str, Any]:
        """Returns the answer to a question; an error has its place and suggestions."""
        use = self._sandboxes.use_of(question)
        if question.get("type") == "ask":
            self._last_use = use
        elif question.get("type") == "download" and self._last_use is not None:
            use = self._last_use
        try:
            return _asked(self._sandboxes.sandbox(use), stop, "answer", self._viewer, question)
        except SelectScriptError as error:
            return {"error": error_message(error)}

    def scan(self, question: dict[str, Any], stop: StopRequest) -> SealedScan:
        """Returns a search for the changes of an answer."""
        sandbox = self._sandboxes.sandbox("scan")
        _asked(sandbox, stop, "begin_scan", self._viewer, question)
        return SealedScan(sandbox, self._viewer, stop)


class SealedScan:
    """A search for the changes of an answer that goes on in a sandbox, as `Scan` does."""

    def __init__(self, sandbox: SandboxedInterpreter, viewer: int, stop: StopRequest) -> None:
        self._sandbox, self._viewer, self._stop = sandbox, viewer, stop
        self.progress: dict[str, Any] = {}

    def advance(self, seconds: float) -> bool:
        """Asks at further ticks for some time; returns whether there are more."""
        arguments = self._viewer, seconds
        # The search ends at the tick at which it began, whatever the world has done since.
        told = _asked(self._sandbox, self._stop, "advance_scan", *arguments, updates_copies=False)
        more = told.pop("more", False)
        self.progress = told
        return more is True


def _asked(
    sandbox: SandboxedInterpreter,
    stop: StopRequest,
    method: str,
    *arguments: Any,
    updates_copies: bool = True,
) -> dict[str, Any]:
    """Returns what a method of `AnswersInside` says, which may be anything if it is taken over."""
    with stop.applies_to(sandbox):
        text = sandbox.ask(f"page answers.{method}", *arguments, updates_copies=updates_copies)
    try:
        answer = Budget().parsed(text.encode())
    except (AttributeError, ValueError, RecursionError, InvalidAnswerError):
        answer = None
    if not isinstance(answer, dict):
        raise LimitError("the process of the page sent no answer")
    return answer


# -- in the sandbox ---------------------------------------------------------------------------


# So many viewers, the last that asked, have a result to download and a search to go on with.
_MAX_VIEWERS = 16


@dataclass
class _Viewer:
    """What a viewer has asked for."""

    answers: Answers
    scan: Scan | None = None


class AnswersInside:
    """Answers the questions of all viewers where they are sealed: about the only world there is.

    Args:
        ss: the interpreter that has the world.
        record: the path of the record that it reads; None for a copy of a live world.
    """

    def __init__(self, ss: Interpreter, record: str | None) -> None:
        self._ss, self._record = ss, record
        self._viewer = lru_cache(_MAX_VIEWERS)(lambda _number: _Viewer(Answers(self)))

    def answer(self, viewer: int, question: dict[str, Any]) -> str:
        """Returns the answer to a question, as JSON."""
        return json.dumps(self._viewer(viewer).answers.answer(question, StopRequest()))

    def begin_scan(self, viewer: int, question: dict[str, Any]) -> str:
        """Begins a search for the changes of an answer, in place of the viewer's last one."""
        own = self._viewer(viewer)
        own.scan = own.answers.scan(question, StopRequest())
        return json.dumps({})

    def advance_scan(self, viewer: int, seconds: float) -> str:
        """Goes on with a search, and returns its progress."""
        scan = self._viewer(viewer).scan
        if scan is None or scan.world is not self._world:
            raise LimitError("the world is recorded anew, or its process is another one: ask again")
        more = scan.advance(seconds)
        return json.dumps(scan.progress | {"more": more})

    # -- the source of the answers ------------------------------------------------------------

    def mirror(self, time: float | None) -> Asked:
        """Returns the world, at a time."""
        world = self._world
        if not isinstance(world, CopiedWorld) and (time is not None or self._record is not None):
            world.seek(recorded_time(world, time))
        return Asked(self._ss, world)

    def recorded(self) -> Asked:
        """Returns the world, which goes through the recorded ticks."""
        return Asked(self._ss, self._world)

    def ticks(self) -> Ticks | None:
        """Returns the recorded ticks; None if nothing is recorded."""
        past = self._world.past
        return None if past is None else Ticks(past[1].ticks.numbers, past[1].ticks.times)

    @property
    def _world(self) -> ReplayedWorld:
        world = self._ss.worlds[0]
        assert isinstance(world, ReplayedWorld)
        return world
