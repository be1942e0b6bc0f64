"""Runs inputs in worker processes, which may crash or hang."""

from __future__ import annotations

import contextlib
import faulthandler
import multiprocessing
import os
import resource
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from tools.fuzzing.bench import Bench, Finding, shortened
from tools.fuzzing.mutation import input_of

# The seconds after which an input hangs; an interpreter limits its queries to 2 s.
HANG = 11.0
# The bytes of a worker.
MEMORY = 6 * 2**30


def _work(seed: int, numbers: range, progress: Any, findings: Connection, log: str) -> None:
    """Runs inputs in a worker process.

    Args:
        seed: the seed of the inputs.
        numbers: the numbers of the inputs.
        progress: receives the number of the current input and the time of its start, or 0.
        findings: receives the findings, and None at the end.
        log: the file for traces of crashes and hangs.
    """
    import warnings

    warnings.simplefilter("ignore")
    trace = Path(log).open("w", encoding="utf-8")  # noqa: SIM115  # open until the process ends
    faulthandler.enable(trace)
    faulthandler.register(signal.SIGUSR1, trace, all_threads=False)
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.__stdout__.fileno() if sys.__stdout__ else 1)
    sys.stdout = open(os.devnull, "w", encoding="utf-8")  # noqa: PTH123, SIM115  # so does print
    bench = Bench()
    for number in numbers:
        tested = input_of(seed, number)
        progress[1] = time.monotonic()
        progress[0] = number
        fault = bench.check(tested)
        progress[1] = 0.0
        if fault is not None:
            findings.send(Finding(number, tested, *fault))
    findings.send(None)
    findings.close()


@dataclass
class Worker:
    """A process that runs some of the inputs, restarted after an input that ends it."""

    seed: int
    numbers: range
    log: str
    process: Any = None
    progress: Any = None
    receiver: Any = None
    is_done: bool = False
    findings: list[Finding] = field(default_factory=list)

    def begin(self) -> None:
        context = multiprocessing.get_context("spawn")
        self.progress = context.Array("d", [-1.0, 0.0], lock=False)
        self.receiver, sender = context.Pipe(duplex=False)
        arguments = (self.seed, self.numbers, self.progress, sender, self.log)
        self.process = context.Process(target=_work, args=arguments, daemon=True)
        self.process.start()
        sender.close()

    def end(self) -> None:
        self.process.kill()
        self.process.join()

    def poll(self) -> list[Finding]:
        """Returns the findings since the last call."""
        new = list(self._received())
        if self.is_done:
            self.process.join()
        elif not self.process.is_alive():
            new += list(self._received())
            if not self.is_done:
                new.append(self._lost(f"crash, exit status {self.process.exitcode}"))
        elif self._hangs():
            os.kill(self.process.pid, signal.SIGUSR1)  # it writes where it is
            time.sleep(0.5)
            self.end()
            new.append(self._lost("hang"))
        self.findings += new
        return new

    def _hangs(self) -> bool:
        since: float = self.progress[1]  # read once: it is 0 when no input runs
        return since > 0 and time.monotonic() - since > HANG

    def _received(self) -> Iterator[Finding]:
        with contextlib.suppress(EOFError, OSError):
            while not self.is_done and self.receiver.poll():
                finding = self.receiver.recv()
                if finding is None:
                    self.is_done = True
                else:
                    yield finding

    def _lost(self, kind: str) -> Finding:
        """Handles a process that ended in an input, and continues after the input."""
        number = int(self.progress[0])
        trace = Path(self.log).read_text(encoding="utf-8")
        if number < 0:
            raise RuntimeError(f"a worker does not begin: {kind}\n{trace}")
        self.numbers = range(number + self.numbers.step, self.numbers.stop, self.numbers.step)
        if self.numbers:
            self.begin()
        else:
            self.is_done = True
        lines = [line.strip() for line in trace.splitlines() if "/ssduck/" in line]
        cause = lines[0].rpartition("/")[2] if lines else ""
        return Finding(number, input_of(self.seed, number), kind, cause, shortened(trace, 3000))

    @property
    def at(self) -> int:
        """The number of started inputs."""
        if self.is_done:
            return len(self.numbers)
        return 0 if self.progress[0] < 0 else self.numbers.index(int(self.progress[0]))


def fuzz(
    count: int,
    seed: int = 0,
    jobs: int = 2,
    on_finding: Callable[[Finding], None] | None = None,
) -> list[Finding]:
    """Runs inputs in worker processes; returns the findings.

    Args:
        count: the number of inputs.
        seed: the seed of the inputs.
        jobs: the number of processes.
        on_finding: a callback for each finding.
    """
    with tempfile.TemporaryDirectory() as folder:
        workers = [
            Worker(seed, range(job, count, jobs), str(Path(folder) / f"{job}.txt"))
            for job in range(min(jobs, count))
        ]
        try:
            for worker in workers:
                worker.begin()
            while not all(worker.is_done for worker in workers):
                time.sleep(0.1)
                for worker in workers:
                    if not worker.is_done:
                        for finding in worker.poll():
                            if on_finding is not None:
                                on_finding(finding)
        finally:
            for worker in workers:
                if worker.process is not None:
                    worker.end()
    return [finding for worker in workers for finding in worker.findings]


def distinct(findings: Sequence[Finding]) -> list[tuple[Finding, int]]:
    """Returns the shortest finding of each kind and cause, and their number."""
    groups: dict[tuple[str, str], list[Finding]] = {}
    for finding in findings:
        groups.setdefault((finding.kind, finding.cause), []).append(finding)
    return [(min(g, key=lambda f: len(f.input.text)), len(g)) for g in groups.values()]
