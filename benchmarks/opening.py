"""Times opening a small episode and asking it a first question, in processor time."""

from __future__ import annotations

import statistics
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import pybullet

import ssduck
from ssduck import Recording

HEADER = ("a small episode", "minimum", "median", "budget")
BODIES = 25
TICKS = 121
BUDGET_MS = 25.0
PROGRAMS = {
    "opening": None,
    "opening, then a filter of all ticks": "SELECT id FROM lab{} WHERE z > 0.6 AS list;",
    "opening, then a filter of a tick": "SELECT id FROM lab{0.25} WHERE z < 1 AS list;",
}


def rows(rounds: int) -> Iterator[tuple[str, ...]]:
    """Yields the processor time of opening a folder, and of a first answer."""
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder) / "run"
        _record(place)
        for name, program in PROGRAMS.items():
            times = _times(partial(_ask, place, program), rounds)
            shown = (f"{1e3 * value:.1f} ms" for value in (min(times), statistics.median(times)))
            yield name, *shown, f"{BUDGET_MS:g} ms"


def _record(place: Path) -> None:
    """Records boxes that fall."""
    client = pybullet.connect(pybullet.DIRECT)
    pybullet.setGravity(0, 0, -9.81, client)
    box = pybullet.createCollisionShape(
        pybullet.GEOM_BOX, halfExtents=[0.1] * 3, physicsClientId=client
    )
    for number in range(BODIES):
        position = [number % 5 * 0.3, number // 5 * 0.3, 0.1 * (number % 3) + 0.5]
        pybullet.createMultiBody(int(number > 0), box, -1, position, physicsClientId=client)
    world = ssduck.World.attach(client, name="lab")
    with ssduck.Interpreter(recording=None) as ss:
        ss.add_variable("lab", world)
        recording = Recording(tables=("entities", "links", "contacts"))
        with ss.record_to(place, recording=recording):
            world.step(TICKS - 1)
    pybullet.disconnect(client)


def _ask(place: Path, program: str | None) -> None:
    with ssduck.open(place) as ss:
        if program is not None and not ss.eval(program):
            raise AssertionError(f"{program} finds nothing")


def _times(call: Callable[[], object], rounds: int) -> list[float]:
    """Returns the processor times of calls, s, after two to warm up."""
    times = []
    for number in range(rounds + 2):
        start = time.process_time()
        call()
        if number >= 2:
            times.append(time.process_time() - start)
    return times
