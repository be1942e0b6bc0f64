"""Measures raw SQL against SelectScript for the same question, and against DuckDB by itself.

`python -m benchmarks raw` takes some minutes. A way runs at a fresh tick and, at once, again. The
tables are those of the kitchen at rest, and of random scenes of boxes. DuckDB by itself executes a
statement that is prepared on the same tables.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from functools import partial

import ssduck
from benchmarks.random_scenes import bodies_of, random_scene
from benchmarks.timing import Way, minima, text_of
from ssduck.simulators.pybullet.simulator import PyBulletSimulator

SIZES = (300, 1000, 10000)
# The relations, with their further arguments.
RELATIONS = {"collides": "", "near": ", 0.05", "touching": "", "on": "", "above": ""}
FILTER = "SELECT name FROM entities WHERE kind = 'robot'"
# The greatest ratios to SelectScript, and to DuckDB's prepared statement.
MAX_RATIO, MAX_FILTER_RATIO = 1.3, 1.5
ROUNDS, MAX_SECONDS = 40, 4.0
HEADER = (
    "raw SQL",
    "scene",
    "fresh tick",
    "again",
    "compared with",
    "fresh tick",
    "again",
    "ratio",
    "ratio again",
    "bound",
)


def rows() -> Iterator[tuple[str, ...]]:
    """Yields a row for each question and scene."""
    with ssduck.load("kitchen") as ss:
        kitchen = ss.call_variable("kitchen")
        kitchen.step(480)
        yield from _scene(ss, "kitchen", "kitchen")
    for size in SIZES:
        with ExitStack() as stack:
            scene = random_scene("cube", "boxes", size)
            client, _ = stack.enter_context(bodies_of(scene))
            ss = stack.enter_context(ssduck.Interpreter(recording=None))
            ss.add_variable("world", ssduck.World(PyBulletSimulator(client, owned=True)))
            yield from _scene(ss, "world", f"{size:,} boxes")


def _scene(ss: ssduck.Interpreter, world: str, label: str) -> Iterator[tuple[str, ...]]:
    for name, more in RELATIONS.items():
        program = ss.compile(
            f"SELECT id(a.this), id(b.this) FROM a = {world}, b = {world} "
            f"WHERE {name}(a.this, b.this{more}) AS list;"
        )
        sql = f'SELECT a.name, b.name FROM entities a, entities b WHERE "{name}"(a, b{more})'
        other = ("SelectScript", partial(ss.eval, program), MAX_RATIO)
        yield _row(ss, world, (name, label), partial(_fetched, ss, sql), other)
    prepared = ss._database.connection  # the same tables, without ssduck's layers
    prepared.run(f"PREPARE benchmark AS {FILTER}")
    execute = partial(_executed, prepared._connection)
    other = ("DuckDB, prepared", execute, MAX_FILTER_RATIO)
    yield _row(ss, world, ("kind = 'robot'", label), partial(_fetched, ss, FILTER), other)


def _fetched(ss: ssduck.Interpreter, sql: str) -> object:
    return ss.sql(sql).fetchall()


def _executed(connection: object) -> object:
    return connection.execute("EXECUTE benchmark").fetchall()  # type: ignore[attr-defined]


def _row(
    ss: ssduck.Interpreter,
    world: str,
    labels: tuple[str, str],
    call: Callable[[], object],
    other: tuple[str, Callable[[], object], float],
) -> tuple[str, ...]:
    name, compared, bound = other
    for _ in range(3):  # the second run prepares a statement
        call()
        compared()
    tick = ss.call_variable(world).tick
    ways: Mapping[str, Way] = {
        "fresh": Way(call, tick),
        "again": Way(call),
        "other": Way(compared, tick),
        "other again": Way(compared),
    }
    times = minima(ways, ROUNDS, MAX_SECONDS)
    ratios = times["fresh"] / times["other"], times["again"] / times["other again"]
    outcome = "met" if max(ratios) <= bound else "not met"
    return (
        *labels,
        text_of(times["fresh"]),
        text_of(times["again"]),
        name,
        text_of(times["other"]),
        text_of(times["other again"]),
        *(f"{ratio:.2f}" for ratio in ratios),
        f"{bound}: {outcome}",
    )
