"""Measures taking a tick of MuJoCo worlds against bare loops that step and copy arrays.

`python -m benchmarks mujoco` takes some seconds. The bare loop steps boxes that rest on a plane,
and copies the arrays that a tick needs, or reads them body by body. The last columns are of a tick
as worlds of an interpreter take it, recorded in memory with contacts, against a loop that copies
the arrays and calls `mj_contactForce` for each contact.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

import ssduck
from benchmarks.timing import medians, text_of

# The arrays that a tick reads: poses, and what velocities follow from.
ARRAYS = ("xpos", "xmat", "xquat", "cvel", "subtree_com")
COUNTS = (40, 300, 1000)
# The number of calls in a row of a default tick.
CALLS = 64


def simulation(count: int) -> tuple[Any, Any]:
    """Returns the model and the data of boxes at rest on a plane."""
    import mujoco

    boxes = "".join(
        f'<body pos="{n % 32 * 0.3} {n // 32 * 0.3} .1"><freejoint/>'
        '<geom type="box" size=".1 .1 .1"/></body>'
        for n in range(count)
    )
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><worldbody><geom type="plane" size="0 0 1"/>{boxes}</worldbody></mujoco>'
    )
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, 10)
    return model, data


def copies(data: Any) -> Callable[[], object]:
    """Returns a function that copies the arrays of a tick."""
    return lambda: [getattr(data, name).copy() for name in ARRAYS]


def by_body(model: Any, data: Any) -> Callable[[], object]:
    """Returns a loop over the bodies that reads the same arrays."""

    def loop() -> object:
        arrays = [getattr(data, name) for name in ARRAYS]
        return [[array[number].tolist() for array in arrays] for number in range(model.nbody)]

    return loop


def with_contacts(model: Any, data: Any) -> Callable[[], object]:
    """Returns a loop that copies the arrays of a tick, and of the contacts with their forces."""
    import mujoco

    def loop() -> object:
        forces = np.zeros((data.ncon, 6))
        for number, force in enumerate(forces):
            mujoco.mj_contactForce(model, data, number, force)
        contact = data.contact
        parts = contact.geom, contact.dist, contact.frame, contact.pos
        return [part.copy() for part in (*parts, *(getattr(data, n) for n in ARRAYS))], forces

    return loop


def rows() -> Iterator[tuple[str, ...]]:
    """Yields a row for each number of boxes."""
    import mujoco

    for count in COUNTS:
        model, data = simulation(count)
        world = ssduck.World.attach(model, data)
        world.snapshot.recorded = frozenset()  # the entities only
        recorded, ss = ssduck.World.attach(model, data), ssduck.Interpreter()
        ss.add_variable("boxes", recorded)
        ways = {
            "tick": world.tick,
            "copies": copies(data),
            "bodies": by_body(model, data),
            "step": lambda model=model, data=data: mujoco.mj_step(model, data),  # type: ignore[misc]
        }
        times = medians(ways, 100)
        # Rows are written in blocks of ticks: so many calls have a share of all costs.
        loops = {"default": recorded.tick, "contacts": with_contacts(model, data)}
        many = {
            name: lambda call=call: [call() for _ in range(CALLS)] for name, call in loops.items()
        }
        sums = medians(many, 10, time.process_time)
        ss.close()
        ratio = (times["step"] + times["tick"]) / (times["step"] + times["copies"])
        yield (
            f"{count:,} boxes",
            text_of(times["tick"]),
            text_of(times["copies"]),
            text_of(times["bodies"]),
            text_of(times["step"]),
            f"{ratio:.2f}",
            text_of(sums["default"] / CALLS),
            text_of(sums["contacts"] / CALLS),
            f"{sums['default'] / sums['contacts']:.2f}",
        )


HEADER = (
    "taking a tick of MuJoCo",
    "ssduck",
    "copies of arrays",
    "body by body",
    "a step",
    "step and tick / step and copies",
    "a default tick",
    "copies, contacts and forces",
    "ratio",
)
