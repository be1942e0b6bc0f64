"""Measures what the page of `ss.view()` costs the simulation, and how soon it answers.

`python -m benchmarks view` takes a minute. Boxes fall; the viewer is a process that receives
all that a page receives, and draws nothing. Times of steps are processor times of this process, the
server's threads included. The time from Enter to the highlight is real time in Chromium, if it is
installed: the median of some queries, each until the scene is drawn with its answer.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from urllib.parse import urlsplit

from websockets.sync.client import connect

import ssduck
from benchmarks.ticks import boxes
from benchmarks.timing import text_of
from tools.browser import Browser, chromium

HEADER = (
    *("bodies", "step", "page, nobody looks", "one viewer looks", "updates a second, of ticks"),
    "query answered",
    "Enter to highlight",
)
STEPS, ASKED = 150, 20
# How often the three ways to step take turns; a ratio is the median of theirs.
TURNS = 7
# The share of a step at 240 Hz is what matters: steps keep this pace, s.
PACE = 1.0 / 240.0
_RECEIVER = """
import sys
from websockets.sync.client import connect
with connect(sys.argv[1], origin=sys.argv[2], max_size=None, proxy=None) as socket:
    updates = 0
    for message in socket:
        if isinstance(message, bytes) and message[0] == 2:
            updates += 1
            if updates == 1:
                print('ready', flush=True)
        print(updates, file=sys.stderr, flush=True)
"""


@dataclass(frozen=True)
class _Turn:
    """The processor times of a step, s, and how many updates and ticks there were in a second."""

    bare: float
    unseen: float
    seen: float
    updates: float
    ticks: float


def rows() -> Iterator[tuple[str, ...]]:
    """Yields a row for each number of bodies."""
    for count in (40, 300, 1000):
        with ssduck.Interpreter() as ss, boxes(count, owned=True) as (world, _):
            ss.add_variable("sim", world)
            turns = [_turn(ss, world) for _ in range(TURNS)]
            page = ss.view()
            asked = _answer_time(*_socket_of(page.url))
            lit = _highlight_time(page.url)
            page.close()
        bare = median(turn.bare for turn in turns)
        times = (
            text_of(bare),
            _ratio(bare, [turn.unseen / turn.bare for turn in turns]),
            _ratio(bare, [turn.seen / turn.bare for turn in turns]),
        )
        updates, ticks = (
            median(turn.updates for turn in turns),
            median(turn.ticks for turn in turns),
        )
        yield (str(count), *times, f"{updates:.0f} of {ticks:.0f}", text_of(asked), lit)


def _turn(ss: ssduck.Interpreter, world: ssduck.World) -> _Turn:
    """Steps a world without a page, with one that nobody looks at, and with a viewer."""
    bare, _ = _step_time(world)
    page = ss.view()
    unseen, _ = _step_time(world)
    command = [sys.executable, "-c", _RECEIVER, *_socket_of(page.url)]
    with subprocess.Popen(  # noqa: S603  # its own program
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as viewer:
        assert viewer.stdout is not None
        viewer.stdout.readline()
        seen, wall = _step_time(world)
        viewer.terminate()
        _, lines = viewer.communicate()
    page.close()
    return _Turn(bare, unseen, seen, int(lines.split()[-1]) / wall, STEPS / wall)


def _socket_of(url: str) -> tuple[str, str]:
    """Returns the address of the socket of a page, and the origin of the page."""
    address = urlsplit(url)
    return f"ws://{address.netloc}/socket?{address.query}", f"http://{address.netloc}"


def _ratio(bare: float, ratios: Sequence[float]) -> str:
    ratio = median(ratios)
    return f"{text_of(bare * ratio)} ({ratio:.2f} x)"


def _step_time(world: ssduck.World) -> tuple[float, float]:
    """Returns the processor time of a step and its tick, and the real time of all steps, s."""
    started, used = time.perf_counter(), time.process_time()
    for number in range(STEPS):
        world.step()
        rest = started + (number + 1) * PACE - time.perf_counter()
        if rest > 0:
            time.sleep(rest)
    return (time.process_time() - used) / STEPS, time.perf_counter() - started


def _highlight_time(url: str) -> str:
    """Returns the median time from Enter to the drawn highlight; "-" without Chromium."""
    if chromium() is None:
        return "-"
    with tempfile.TemporaryDirectory() as folder:
        browser = Browser(Path(folder))
        try:
            page = browser.open(url)
            page.wait("window.__ss && __ss.ready")
            times = []
            for number in range(ASKED):
                page.value("__ss.highlighted = 0; 0")
                page.ask(f"SELECT id(this) FROM sim WHERE z(this) > {0.5 + 0.001 * number};")
                times.append(page.wait("__ss.highlighted"))
        finally:
            browser.close()
    return text_of(sorted(times)[ASKED // 2] / 1e3)


def _answer_time(url: str, origin: str) -> float:
    """Returns the median time from a question to its answer, s."""
    question = {"type": "ask", "text": "SELECT id(this) FROM sim WHERE z(this) > 0.5;"}
    times = []
    headers = {"Origin": origin}
    with connect(url, additional_headers=headers, max_size=None, proxy=None) as socket:
        for number in range(ASKED):
            started = time.perf_counter()
            socket.send(json.dumps({**question, "id": number}))
            while True:
                message = socket.recv()
                if isinstance(message, str) and json.loads(message).get("id") == number:
                    break
            times.append(time.perf_counter() - started)
    return sorted(times)[ASKED // 2]
