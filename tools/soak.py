"""Checks that the memory of a process stays constant in a long run.

`python -m tools.soak [TICKS] [--seed N] [--file]` prints the memory of the process at each tenth of
the run; the exit status is 1 if it ends 5 % or more above that of the first tenth. A million ticks
take about 11 minutes.

Two balls fly about and a table stands still; ticks older than ten seconds are dropped, a trigger
fires, and a query runs now and then.
"""

from __future__ import annotations

import argparse
import gc
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pybullet

import ssduck
from ssduck import Recording

# The recorded seconds.
SECONDS = 10.0
# The number of ticks between two queries.
QUERY_EVERY = 997
MAX_GROWTH = 1.05
QUERIES = (
    "SELECT id(this), z(this) FROM lab WHERE above(board, this) AS list;",
    "SELECT tick(this) FROM lab{-1.0} WHERE above(board, this) AND z(this) > 1.2 AS list;",
    "SELECT tick(this) FROM lab{-0.1} WHERE this == ball AND near(board, this, 0.05) AS list;",
    "t = SELECT time(this) FROM lab{-5.0} LIMIT 1 AS value; SELECT z FROM lab{t} AS list;",
)
SQL = "SELECT name, count(*), avg(z) FROM lab.entities_history GROUP BY name"


def memory() -> float:
    """Returns the memory of the process, megabytes."""
    gc.collect()
    pages = int(Path("/proc/self/statm").read_text("ascii").split()[1])
    return pages * 4096 / 1e6


class Lab:
    """A running world and an interpreter that records its last seconds."""

    def __init__(self, database: str, seed: int) -> None:
        self._random = np.random.default_rng(seed)
        self._client = pybullet.connect(pybullet.DIRECT)
        board = self._shape(pybullet.GEOM_BOX, halfExtents=[2, 2, 0.05])
        ball = self._shape(pybullet.GEOM_SPHERE, radius=0.1)
        self._body(board, 0.0, [0, 0, 0.45])
        self.balls = [self._body(ball, 1.0, [n - 0.5, 0, 1]) for n in range(2)]
        names = {0: "board", **{body: f"ball_{n}" for n, body in enumerate(self.balls)}}
        self.world = ssduck.World.attach(self._client, names=names)
        self.ss = ssduck.Interpreter(database, recording=Recording(seconds=SECONDS))
        self.ss.add_variable("lab", self.world)
        self.ss.add_variable("board", self.world["board"])
        self.ss.add_variable("ball", self.world["ball_0"])
        self.fired = 0
        self.ss.add_trigger("high", "SELECT id FROM lab WHERE z(this) > 1.2;", 1.0, self._fire)

    def _fire(self, _: object) -> None:
        self.fired += 1

    def _shape(self, kind: int, **size: object) -> int:
        return pybullet.createCollisionShape(kind, physicsClientId=self._client, **size)  # type: ignore[no-any-return]

    def _body(self, shape: int, mass: float, place: list[float]) -> int:
        return pybullet.createMultiBody(  # type: ignore[no-any-return]
            mass, shape, basePosition=place, physicsClientId=self._client
        )

    def run(self, ticks: int) -> None:
        for number in range(ticks):
            if number % 100 == 0:
                for body in self.balls:
                    place = self._random.uniform([-1, -1, 0.6], [1, 1, 2]).tolist()
                    pybullet.resetBasePositionAndOrientation(
                        body, place, [0, 0, 0, 1], self._client
                    )
            self.world.step()
            if number % QUERY_EVERY == 0:
                self.query(number // QUERY_EVERY)

    def query(self, number: int) -> None:
        index = number % (len(QUERIES) + 1)
        if index == len(QUERIES):
            self.ss.sql(SQL).fetchall()
        else:
            self.ss.eval(QUERIES[index])

    def close(self) -> None:
        self.ss.close()
        pybullet.disconnect(self._client)


def memory_of_run(ticks: int, seed: int, database: str = ":memory:") -> list[float]:
    """Returns the memory at each tenth of a run, megabytes."""
    lab = Lab(database, seed)
    megabytes = []
    try:
        for tenth in range(10):
            started = time.monotonic()
            lab.run(ticks // 10)
            megabytes.append(memory())
            assert lab.fired > tenth
            rate = ticks / 10 / (time.monotonic() - started)
            print(
                f"{10 * (tenth + 1):3} %: {megabytes[-1]:7.1f} MB, {rate:6.0f} ticks/s", flush=True
            )
    finally:
        lab.close()
    return megabytes


def main() -> int:
    parser = argparse.ArgumentParser(description="Let a recorded world run for long.")
    parser.add_argument("ticks", nargs="?", type=int, default=1_000_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--file", action="store_true", help="record into a DuckDB file")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        database = f"{folder}/soak.duckdb" if options.file else ":memory:"
        megabytes = memory_of_run(options.ticks, options.seed, database)
    growth = megabytes[-1] / megabytes[0]
    print(f"{options.ticks} ticks: {100 * (growth - 1):+.1f} % after the first tenth")
    return 0 if growth < MAX_GROWTH else 1


if __name__ == "__main__":
    sys.exit(main())
