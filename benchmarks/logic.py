"""Measures temporal logic: over a record, over many episodes, and at a step of an environment.

`python -m benchmarks logic` takes a minute. The record has 100,000 ticks at 240 Hz of a height that
goes up and down. rtamt, if it is installed, has the same heights in Python's lists, and gives the
same margin. Times are those of the processor.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

import ssduck
from benchmarks.timing import medians, text_of
from ssduck.logic import traces
from ssduck.logic.traces import Trace, Window

RATE = 240
TICKS = 100_000
EPISODES, STEPS = 4_096, 200
# A formula, with the same one in rtamt's language.
FORMULAS = {
    "always(z(sim.cup) > 0.9 IMPLIES eventually(z(sim.cup) <= 0.3, 0, 5))": (
        "always((z > 0.9) implies (eventually[0:1200](z <= 0.3)))"
    ),
    "greatest(heldSince(z(sim.cup) > 0.2, z(sim.cup) > 0.9, 0, 5))": "",
    "robustness(always(z(sim.cup) > 0.9 IMPLIES eventually(z(sim.cup) <= 0.3, 0, 5)))": "",
    "WHY always(z(sim.cup) > 0.9 IMPLIES eventually(z(sim.cup) <= 0.3, 0, 5))": "",
}
NESTED = "historically(z(sim.cup) > 0.9 IMPLIES once(z(sim.cup) <= 0.3, 0, 0.5))"


def heights(ticks: int) -> tuple[Any, Any]:
    """Returns times, s, and heights, m."""
    times = np.arange(ticks) / RATE
    noise = np.random.default_rng(0).normal(size=ticks)
    return times, 0.6 + 0.5 * np.sin(times / 3) + 0.05 * noise


def write(folder: Path, ticks: int) -> None:
    """Writes a record of a cup that goes up and down."""
    times, z = heights(ticks)
    poses = np.zeros((ticks, 7))
    poses[:, 2], poses[:, 3] = z, 1.0
    entities = {"cup": {"sphere": 0.05}}
    ssduck.write_record(folder, entities, {"cup": poses}, times, world="sim")


def of_rtamt(formula: str) -> Callable[[], object] | None:
    """Returns a function that evaluates a formula with rtamt; None if that is not installed."""
    try:
        import rtamt
    except ImportError:
        return None
    specification = rtamt.StlDiscreteTimeOfflineSpecification()
    specification.declare_var("z", "float")
    specification.spec = formula
    specification.parse()
    values = heights(TICKS)[1].tolist()
    return lambda: specification.evaluate({"time": list(range(TICKS)), "z": values})


def rows() -> Iterator[tuple[str, ...]]:
    """Yields a row for each question."""
    with tempfile.TemporaryDirectory() as folder:
        write(Path(folder), TICKS)
        with ssduck.open(folder) as ss:
            for formula, theirs in FORMULAS.items():
                program = ss.compile(f"{formula};")
                ways: dict[str, Callable[[], object]] = {"ours": lambda p=program: ss.eval(p)}  # type: ignore[misc]
                other = of_rtamt(theirs) if theirs else None
                if other is not None:
                    ways["rtamt"] = other
                times = medians(ways, 5, time.process_time)
                ratio = f"{times['rtamt'] / times['ours']:.0f}" if other is not None else ""
                yield f"{TICKS} ticks: {formula}", text_of(times["ours"]), ratio
    yield f"{EPISODES} episodes of {STEPS} ticks, at once", text_of(_of_episodes()), ""
    yield f"a tick more of {NESTED}", text_of(_of_a_step()), ""


def _of_episodes() -> float:
    """Returns the time of a nested condition over many episodes, s."""
    times, _ = heights(STEPS)
    values = np.random.default_rng(0).normal(size=(EPISODES, STEPS))
    high, low = Trace.of(times, values > 0.9), Trace.of(times, values <= 0.3)

    def call() -> object:
        return traces.always(~high | traces.eventually(low, Window(0.0, 0.2)))

    return medians({"": call}, 5, time.process_time)[""]


def _of_a_step() -> float:
    """Returns what a nested term takes at a tick of a simulation that goes on, s."""
    import mujoco

    model = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><body name='cup'><freejoint/><geom size='.05'/></body></worldbody>"
        "</mujoco>"
    )
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    with ssduck.Interpreter(recording=None) as ss:
        sim = ss.add_variable("sim", ssduck.World.attach((model, data)))
        simple, nested = ss.compile("z(sim.cup) > 0.9;"), ss.compile(f"{NESTED};")
        _, z = heights(2_000)
        spent = {simple: 0.0, nested: 0.0}
        for number, height in enumerate(z.tolist()):
            data.qpos[2], data.time = height, number / RATE
            mujoco.mj_kinematics(model, data)
            sim.begin_episode() if number == 0 else sim.tick()
            for program in spent:
                start = time.process_time()
                ss.eval(program)
                spent[program] += time.process_time() - start
        return (spent[nested] - spent[simple]) / len(z)


HEADER = ("temporal logic", "time", "rtamt takes so many times as long")
