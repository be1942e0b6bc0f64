"""Measures the terms of a task over a batch of environments, and the same in numpy by hand.

`python -m benchmarks batches` takes a minute, and needs MuJoCo and gymnasium. Eight terms, and
relations of shapes, are evaluated in random states of a cube on a table; a vector of environments
of gymnasium is stepped bare, with `VectorQueryWrapper`, and with a `QueryWrapper` in each. Times
are those of the processor, a tick included.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium.vector import SyncVectorEnv

import ssduck
from benchmarks.timing import medians, text_of
from ssduck.gym import QueryWrapper, VectorQueryWrapper

COUNTS = (1, 64, 4096)
# The libraries that states may come in; those that are installed are measured.
LIBRARIES = ("torch", "jax.numpy")
VECTOR = 16
MODEL = """
<mujoco>
  <worldbody>
    <geom type="plane" size="2 2 .1"/>
    <body name="table" pos="0 0 .3"><geom type="box" size=".4 .4 .02"/></body>
    <body name="cube" pos="0 0 .4"><freejoint/><geom type="box" size=".03 .03 .03"/></body>
    <body name="ball" pos="1 0 .5"><freejoint/><geom type="sphere" size=".04"/></body>
  </worldbody>
</mujoco>
"""
SUCCESS = "upright(sim.cube, 0.2) AND z(sim.cube) > 0.34"
REWARD = {
    "near": "exp(-distance(sim.cube, [0.1, 0, 0.35]))",
    "above": "int(above(sim.cube, sim.table))",
    "slow": "-norm(linearVelocity(sim.cube))",
    "height": "clip(z(sim.cube), 0, 1)",
    "side": "tanh(x(sim.cube))",
    "least": "max([-1.0, z(sim.ball)])",
    "apart": "-distance(sim.cube, sim.ball)",
}
SHAPES = ("touching(sim.cube, sim.table)", "on(sim.table, sim.cube)")
PUSHER = {
    "success": "distance(sim.object, sim.goal) < 0.1",
    "reward": {"near": "-distance(sim.object, sim.goal)", "slow": "-0.1 * speed(sim.object)"},
}
Arrays = dict[str, npt.NDArray[np.float64]]


def states(model: Any, count: int, seed: int) -> Arrays:
    """Returns the arrays of states in which cubes are on and near the table."""
    draw = np.random.default_rng(seed)
    xpos = np.tile([[0, 0, 0], [0, 0, 0.3], [0, 0, 0], [0, 0, 0]], (count, 1, 1)).astype(float)
    xpos[:, 2:] = draw.uniform([-0.5, -0.5, 0.34], [0.5, 0.5, 0.4], (count, 2, 3))
    turned = np.zeros((count, model.nbody, 4))
    turned[..., 0] = 1.0
    velocities = draw.normal(0, 0.1, (count, model.nbody, 6))
    return {"xpos": xpos, "xquat": turned, "cvel": velocities, "subtree_com": xpos}


def in_library(arrays: Arrays, library: str) -> dict[str, Any]:
    """Returns arrays of another library, in its own precision, on the processor."""
    xp = import_module(library)
    return {name: xp.asarray(array) for name, array in arrays.items()}


def by_hand(arrays: Arrays) -> tuple[npt.NDArray[np.bool_], npt.NDArray[np.float64]]:
    """Returns success and reward as a user computes them."""
    cube, ball, turn = arrays["xpos"][:, 2], arrays["xpos"][:, 3], arrays["xquat"][:, 2]
    tilt = 2 * np.arctan2(np.hypot(turn[:, 1], turn[:, 2]), np.hypot(turn[:, 0], turn[:, 3]))
    success = (tilt <= 0.2) & (cube[:, 2] > 0.34)
    reward = np.exp(-np.linalg.norm(cube - [0.1, 0, 0.35], axis=1))
    is_above = (np.abs(cube[:, :2]) <= 0.4).all(axis=1) & (cube[:, 2] >= 0.32)
    reward += is_above
    reward -= np.linalg.norm(arrays["cvel"][:, 2, 3:], axis=1)
    reward += np.clip(cube[:, 2], 0, 1) + np.tanh(cube[:, 0]) + np.maximum(-1.0, ball[:, 2])
    return success, reward - np.linalg.norm(cube - ball, axis=1)


def of_batch(ask: Callable[[], Any], sim: Any, drawn: list[Arrays]) -> Callable[[], Any]:
    """Returns a call that takes the next states and asks."""
    turns = iter(range(1 << 30))

    def call() -> Any:
        turn = next(turns)
        sim.tick(**drawn[turn % len(drawn)], time=float(turn))
        return ask()

    return call


def rows() -> Iterator[tuple[str, ...]]:
    """Yields a row for each number of environments and for each vector."""
    import mujoco

    model = mujoco.MjModel.from_xml_string(MODEL)
    for count in COUNTS:
        drawn = [states(model, count, seed) for seed in range(8)]
        with ssduck.Interpreter(recording=None) as ss:
            sim = ss.add_variable("sim", ssduck.World.batch(model, count))
            terms = ss.terms(success=SUCCESS, reward=REWARD)
            asked: dict[str, Callable[[], Any]] = {
                f"`{text}`": partial(ss.eval, ss.compile(f"{text};")) for text in SHAPES
            }
            asked["`heldFor` of eight terms' success"] = ss.terms(success=f"heldFor({SUCCESS}) > 1")
            ways = {name: of_batch(ask, sim, drawn) for name, ask in asked.items()}
            ways["eight terms"] = of_batch(terms, sim, drawn)
            ways["eight terms, numpy by hand"] = of_batch(partial(by_hand, drawn[0]), sim, drawn)
            for library in LIBRARIES:
                if count == COUNTS[-1] and find_spec(library.partition(".")[0]) is not None:
                    own = [in_library(arrays, library) for arrays in drawn]
                    ways[f"eight terms, states of {library}"] = of_batch(terms, sim, own)
            rounds = 20 if count > 64 else 200
            for name, seconds in medians(ways, rounds, time.process_time).items():
                yield f"{count:,} environments", name, text_of(seconds), ""
    yield from of_vectors()


def of_vectors() -> Iterator[tuple[str, ...]]:
    """Yields a row for each way to step a vector of environments."""

    def make() -> gymnasium.Env[Any, Any]:
        return gymnasium.make("Pusher-v5")

    def wrapped() -> gymnasium.Env[Any, Any]:
        return QueryWrapper(make(), **PUSHER, forward=False)  # type: ignore[arg-type]

    vectors: dict[str, Any] = {
        "bare": SyncVectorEnv([make] * VECTOR),
        "`VectorQueryWrapper`": VectorQueryWrapper(SyncVectorEnv([make] * VECTOR), **PUSHER),  # type: ignore[arg-type]
        "a `QueryWrapper` in each": SyncVectorEnv([wrapped] * VECTOR),
    }
    actions = np.zeros((VECTOR, 7), np.float32)
    for vector in vectors.values():
        vector.reset(seed=0)
    ways = {name: partial(vector.step, actions) for name, vector in vectors.items()}
    times = medians(ways, 300, time.process_time)
    for name, seconds in times.items():
        ratio = f"{seconds / times['bare']:.2f}"
        yield f"a step of {VECTOR} Pushers", name, text_of(seconds), ratio
    for vector in vectors.values():
        vector.close()


HEADER = ("what is asked of", "how", "time", "of bare")
