"""Measures one question to many recorded episodes: a loop of `open`, a lake, Ray, Spark, DuckDB.

`python -m benchmarks lake [FOLDER]` asks the episodes of a record that `python -m tools.lake record
FOLDER COUNT` made; without a folder, it records 100 first, which takes a minute. Times are those of
the processor, of this process and of those that it starts, for an episode, unless the table says
otherwise.
"""

from __future__ import annotations

import os
import resource
import sys
import tempfile
import time
import zlib
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any

import duckdb

import ssduck
from benchmarks.timing import print_table
from ssduck.errors import UnsupportedError
from ssduck.lakes.lake import Lake
from ssduck.lakes.workers import forget_readers

HEADER = ("question", "way", "processor, ms an episode", "wall, ms an episode", "budget")
THREE = (
    "[on(sim.table, sim.cup), holds(near(sim.gripper, sim.cup, 0.002)), "
    "least(clearance(sim.gripper, sim.wall))];"
)
FORMULA = "holds(above(sim.table, sim.cup));"
# Reads nothing of an episode: what it takes is the proof that the files are whole, and one group's.
NOTHING = "1;"
EPISODES = 100
RAY = {"num_cpus": 2, "include_dashboard": False, "_node_ip_address": "127.0.0.1"}
# The number of episodes of a loop of `open`, which takes longest.
LOOP = 20
# The folders of the files that an answer to the formula depends on.
CHECKED = ("entities/", "episodes/", "models/", "ticks/")
# How often the engines take turns.
TURNS = 3
# The answers of one process are those of DuckDB, whose query finds the intervals as `holds` does.
BY_HAND = """
    WITH bodies AS (
        SELECT episode, tick, time, name, x, y, z, xmin, xmax, ymin, ymax, zmax
        FROM read_parquet(?, hive_partitioning = true) WHERE name IN ('table', 'cup')),
    flags AS (
        SELECT a.episode, a.tick, a.time, b.x BETWEEN a.xmin AND a.xmax
            AND b.y BETWEEN a.ymin AND a.ymax AND b.z >= a.zmax AS is_above
        FROM bodies a JOIN bodies b USING (episode, tick)
        WHERE a.name = 'table' AND b.name = 'cup'),
    changes AS (
        SELECT *, is_above IS DISTINCT FROM lag(is_above) OVER episodes AS is_start,
            coalesce(lead(time) OVER episodes, time) AS following
        FROM flags WINDOW episodes AS (PARTITION BY episode ORDER BY tick)),
    spans AS (
        SELECT *, sum(is_start::INT) OVER (PARTITION BY episode ORDER BY tick) AS span
        FROM changes),
    held AS (
        SELECT episode, min(time) AS start, max(following) AS stop FROM spans WHERE is_above
        GROUP BY episode, span)
    SELECT episode, list([start, stop] ORDER BY start) FROM held GROUP BY episode ORDER BY episode
"""


def _processor() -> float:
    """Returns the time of the processor of this process and of its children that have ended, s."""
    own, others = (
        resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    )
    return own.ru_utime + own.ru_stime + others.ru_utime + others.ru_stime


def _timed(call: Callable[[], Any]) -> tuple[float, float, Any]:
    """Returns the times of a call, of the processor and of the wall, s, and its value."""
    processor, wall = _processor(), time.perf_counter()
    value = call()
    return _processor() - processor, time.perf_counter() - wall, value


def _sum(*times: tuple[float, float, Any]) -> tuple[float, float, Any]:
    """Returns the times of several calls together."""
    processor, wall, _ = zip(*times, strict=True)
    return sum(processor), sum(wall), None


def _loop(folder: Path, program: str, count: int) -> list[Any]:
    """Returns the answers of a loop of `open`."""
    answers = []
    for number in range(count):
        with ssduck.open(folder, "sim", number) as ss:
            answers.append(ss.eval(program))
    return answers


def by_hand(folder: Path) -> dict[int, Any]:
    """Returns the intervals in which the cup is above the table, as DuckDB alone finds them."""
    with duckdb.connect() as connection:
        files = f"{folder}/entities/world=sim/*/*.parquet"
        return dict(connection.execute(BY_HAND, [files]).fetchall())


def check_files(lake: Lake) -> None:
    """Reads the files that the formula's answer depends on, and compares their checksums."""
    for entry in lake.entries:
        for file in entry.files:
            if file.name.startswith(CHECKED):
                assert zlib.crc32(Path(entry.path, file.name).read_bytes()) == file.checksum


def rows(folder: Path | None = None) -> Iterator[tuple[str, ...]]:
    """Yields a row for each question and way to ask it."""
    with tempfile.TemporaryDirectory() as temporary:
        if folder is None:
            from tests.support.lake_episodes import record_episodes

            folder = Path(temporary, "record")
            record_episodes(folder, EPISODES)
        yield from _rows_of(Lake(folder), folder)


def _rows_of(lake: Lake, folder: Path) -> Iterator[tuple[str, ...]]:
    count, some = len(lake), min(LOOP, len(lake))
    lake.ask(NOTHING, processes=1)  # imports what all need
    forget_readers()
    proof = _timed(partial(lake.ask, NOTHING, processes=1))
    yield _row("nothing", "one process: the proof of the files", proof, count)
    for name, program, budget in (("three parts", THREE, 15), ("formula", FORMULA, 3)):
        loop = _timed(partial(_loop, folder, program, some))
        yield _row(name, "loop of open", loop, some)
        forget_readers()
        one = _timed(partial(lake.ask, program, processes=1))
        yield _row(name, "one process", one, count, f"{budget} ms")
        again = _timed(partial(lake.ask, program, processes=1))
        yield _row(name, "one process, the next question", again, count)
    hand = _timed(lambda: by_hand(folder))
    checks = _timed(lambda: check_files(lake))
    answers = one[2].to_pylist()
    assert {row["episode"]: row["answer"] for row in answers if row["answer"]} == hand[2]
    for way, base in (
        ("DuckDB by hand", hand),
        ("DuckDB by hand, and checksums of the files", _sum(hand, checks)),
        ("DuckDB by hand, and the proof of the files", _sum(hand, proof)),
    ):
        limit = " of 1.3" if base is hand else ""
        ratios = f"{one[0] / base[0]:.2f}{limit}, the next question {again[0] / base[0]:.2f}"
        yield _row("formula", way, base, count, ratios)
    forget_readers()
    yield from _engines(lake)


def _engines(lake: Lake) -> Iterator[tuple[str, ...]]:
    """Yields a row for each engine, and for its start: its first answers to a few episodes.

    The engines take turns, and a ratio is the median of those of the turns: a machine under load
    is no faster for one of them.
    """
    ways: dict[str, dict[str, Any]] = {
        "one process": {"processes": 1},
        "two processes": {"processes": 2},
        "Ray, two workers": {"engine": "ray", "processes": 2, "options": RAY},
        "Spark, local[2]": {"engine": "spark", "processes": 2},
    }
    for way, arguments in list(ways.items()):
        if arguments.get("engine") == "spark":
            arguments["session"] = _spark()
        try:
            start = _timed(partial(lake.ask, THREE, "episode < 4", batch=2, **arguments))
        except UnsupportedError as error:
            yield "three parts", way, "", "", error.message
            del ways[way]
            continue
        if way != "one process":
            yield "three parts", f"{way}: the start", "", f"{start[1]:.1f} s in all", ""
    # The processes of this machine are kept, as the workers of the others are.
    turns = [
        {way: _timed(partial(lake.ask, THREE, **arguments))[1] for way, arguments in ways.items()}
        for _ in range(TURNS)
    ]
    for way in ways:
        base = {"one process": "one process", "two processes": "one process"}
        ratio = median(turn[way] / turn[base.get(way, "two processes")] for turn in turns)
        limit = {"one process": "", "two processes": " of 0.55"}.get(way, " of 1.3")
        wall = median(turn[way] for turn in turns)
        times = (0.0, wall, None)
        yield _row("three parts", way, times, len(lake), f"{ratio:.2f}{limit}", wall_only=True)


def _spark() -> Any:
    """Returns a session of Spark with two threads; None if it is not installed."""
    try:
        from pyspark.sql import SparkSession
    except ImportError:
        return None
    os.environ.setdefault("PYSPARK_PYTHON", sys.executable)
    builder = SparkSession.builder.master("local[2]").config("spark.ui.enabled", "false")
    return builder.config("spark.driver.host", "127.0.0.1").getOrCreate()


def _row(
    name: str,
    way: str,
    times: tuple[float, float, Any],
    count: int,
    budget: str = "",
    *,
    wall_only: bool = False,
) -> tuple[str, ...]:
    processor, wall = (f"{seconds / count * 1e3:.1f}" for seconds in times[:2])
    return name, way, "" if wall_only else processor, wall, budget


def main(arguments: Sequence[str]) -> None:
    """Prints the table; the argument is the folder of a record."""
    print_table(HEADER, rows(Path(arguments[0]) if arguments else None))
