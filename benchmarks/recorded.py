"""Measures the cost of recording every tick of a world, and of queries about the history.

`python -m benchmarks time [OPTION ...]` takes many minutes; `--only` selects tables, and `--help`
lists the other options. It prints these tables: the time that recording adds to a tick, and to a
step; the memory of a record; a relation over a long run, against the same SQL by hand; the narrow
phase over a run, against FCL; relations of shapes over a window; and opening a record, against
`read_parquet` of DuckDB.
"""

from __future__ import annotations

import argparse
import gc
import statistics
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, closing, contextmanager
from functools import partial
from pathlib import Path
from typing import Any, TypeAlias

import duckdb
import fcl
import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pybullet

import ssduck
from benchmarks import opening, realtime
from benchmarks.ticks import kitchen
from benchmarks.timing import Way, minima, print_table, text_in_microseconds, text_of
from ssduck import Recording
from ssduck.geometry.arrays import Array
from ssduck.recording.background_writer import BackgroundWriter
from ssduck.recording.recorder import BUFFERED_TICKS, Recorder
from ssduck.recording.stores.memory import MemoryStore
from ssduck.schema import RECORDED
from ssduck.simulators.pybullet.simulator import PyBulletSimulator

Scene: TypeAlias = Callable[[], AbstractContextManager[tuple[ssduck.World, int]]]
Numbers: TypeAlias = npt.NDArray[Any]
# The entities of a long run: a table, a gripper, a cup, and other moving boxes.
ENTITIES = 40
TIMESTEP = 1 / 240
# Bytes of a row in a naive history: the changing columns as doubles, the tick and the id.
NAIVE = 22 * 8
_MEGABYTE = 1e6


@contextmanager
def boxes(count: int) -> Iterator[tuple[ssduck.World, int]]:
    """Yields a world of turning boxes in free fall and its client; the first is the `table`."""
    client = pybullet.connect(pybullet.DIRECT)
    shape = pybullet.createCollisionShape(
        pybullet.GEOM_BOX, halfExtents=[0.1, 0.2, 0.3], physicsClientId=client
    )
    pybullet.setGravity(0, 0, -1, client)
    names = {}
    rng = np.random.default_rng(count)
    for number in range(count):
        place = [number % 30, number // 30, 1.0]
        body = pybullet.createMultiBody(1, shape, basePosition=place, physicsClientId=client)
        pybullet.resetBaseVelocity(body, *rng.normal(size=(2, 3)).tolist(), client)
        names[body] = {0: "table", 1: "gripper", 2: "cup"}.get(number, f"box_{number}")
    yield ssduck.World(PyBulletSimulator(client, owned=True, names=names)), client
    pybullet.disconnect(client)


def _recorder(ss: ssduck.Interpreter) -> Recorder:
    """Returns the recorder of an interpreter's only world."""
    return ss._database._recorders.running[0]


# -- a tick -------------------------------------------------------------------------------------

COST = ("keeping a tick", "in", "tick", "with it", "ratio", "processor")


def costs(sizes: Sequence[int], ticks: int, rounds: int) -> Iterator[tuple[str, ...]]:
    """Yields the time that recording adds to a tick, including the storing of waiting ticks."""
    scenes: dict[str, Scene] = {f"{size:,} boxes": partial(boxes, size) for size in sizes}
    for name, scene in {**scenes, "kitchen": kitchen}.items():
        for place in ("memory", "a file"):
            with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
                plain, _ = stack.enter_context(scene())
                world, _ = stack.enter_context(scene())
                path = ":memory:" if place == "memory" else f"{folder}/run.duckdb"
                # Long enough that the memory of dropped ticks is used again.
                ticks_kept = 1200 if place == "memory" else None
                recording = Recording(tables=("entities",), ticks=ticks_kept)
                ss = stack.enter_context(ssduck.Interpreter(path, recording=recording))
                ss.add_variable("world", world)
                _take_ticks(world, 3 * ticks if place == "memory" else 0)
                storing = _recorder(ss)._writer
                ways = {
                    "plain": Way(partial(_take_ticks, plain, ticks), before=storing.wait),
                    "kept": Way(
                        partial(_take_ticks, world, ticks),
                        partial(_wait_for_storing, world, storing),
                    ),
                }
                wall, processor = _in_turns(ways, rounds)
            yield (
                name,
                place,
                text_of(wall["plain"] / ticks),
                text_of(wall["kept"] / ticks),
                f"{wall['kept'] / wall['plain']:.2f}",
                f"{processor['kept'] / processor['plain']:.2f}",
            )


# -- a step -------------------------------------------------------------------------------------

STEP = ("a step of the kitchen", "processor", "ratio")


def steps(count: int, rounds: int) -> Iterator[tuple[str, ...]]:
    """Yields the processor time of a step: bare, with its tick, and recorded, in turns.

    The ratios are to the step whose tick is recorded with entities only.
    """
    recordings = {
        "and its tick, entities are recorded": Recording(tables=("entities",)),
        "and its tick, as by default: links and contacts, too": Recording(),
    }
    with ExitStack() as stack:
        worlds = {}
        for name, recording in recordings.items():
            ss = stack.enter_context(ssduck.load("kitchen", recording=recording))
            worlds[name] = ss.call_variable("kitchen").step(6 * count)
        bare, _ = stack.enter_context(kitchen())
        ways: dict[str, Callable[[int], object]] = {
            "by itself": bare.simulator.step,
            **{name: world.step for name, world in worlds.items()},
        }
        times: dict[str, list[float]] = {name: [] for name in ways}
        for _ in range(rounds):
            for name, way in ways.items():
                start = time.process_time()
                way(count)
                times[name].append((time.process_time() - start) / count)
    middle = {name: statistics.median(values) for name, values in times.items()}
    reference = middle[next(iter(recordings))]
    for name, value in middle.items():
        yield name, text_of(value), f"{value / reference:.2f}"


def _take_ticks(world: ssduck.World, ticks: int) -> None:
    for _ in range(ticks):
        world.tick()


def _wait_for_storing(world: ssduck.World, storing: BackgroundWriter) -> None:
    """Takes ticks until some are being stored, as at the end of the timed part."""
    for _ in range(BUFFERED_TICKS + 1):
        if storing.is_busy:
            break
        world.tick()


def _in_turns(ways: Mapping[str, Way], rounds: int) -> tuple[dict[str, float], dict[str, float]]:
    """Returns the median wall time and processor time (all threads) of each way, s."""
    times: dict[str, list[tuple[float, float]]] = {name: [] for name in ways}
    gc.collect()
    gc.disable()
    try:
        for _ in range(rounds):
            for name, way in ways.items():
                way.before()
                wall, processor = time.perf_counter(), time.process_time()
                way.call()
                elapsed = time.perf_counter() - wall, time.process_time() - processor
                times[name].append(elapsed)
    finally:
        gc.enable()
    wall_times, processor_times = (
        {name: statistics.median(pair[which] for pair in result) for name, result in times.items()}
        for which in (0, 1)
    )
    return wall_times, processor_times


# -- memory -------------------------------------------------------------------------------------

BYTES = ("bytes an entity and tick", "what is kept", "memory", "file", "Parquet", "naive")


def bytes_per_row(boxes_count: int, ticks: int) -> Iterator[tuple[str, ...]]:
    """Yields the bytes for an entity at a tick."""
    scenes: dict[str, Scene] = {
        f"{boxes_count} boxes, all moving": partial(boxes, boxes_count),
        "kitchen": kitchen,
    }
    for name, scene in scenes.items():
        for label, recording in (
            ("all", Recording()),
            ("what changed", Recording(changed=True)),
        ):
            result = [
                _bytes(scene, recording, ticks, path) for path in (":memory:", "run.duckdb", "run")
            ]
            yield (name, label, *(f"{each:.0f}" for each in result), f"{NAIVE}")


def _bytes(scene: Scene, recording: Recording, ticks: int, path: str) -> float:
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        world, _ = stack.enter_context(scene())
        place = Path(folder) / path
        database = str(place) if path.endswith("duckdb") else ":memory:"
        ss = stack.enter_context(ssduck.Interpreter(database, recording=recording))
        ss.add_variable("world", world)
        rows = len(world) * ticks
        connection = ss._database.connection
        connection.run("CHECKPOINT")
        before = _used(ss, place)
        for _ in range(ticks):
            world.step()
        ss.flush()
        if path == "run":
            ss.export(place)
        else:
            connection.run("CHECKPOINT")
        return (_used(ss, place) - before) / rows


def _used(ss: ssduck.Interpreter, place: Path) -> int:
    """Returns the bytes of a file, of the files in a folder, or of a history in memory."""
    if place.is_file():
        return place.stat().st_size
    if place.name == "run":
        return sum(f.stat().st_size for f in place.rglob("*") if f.is_file())
    store = _recorder(ss)._store
    sql = "SELECT sum(memory_usage_bytes) FROM duckdb_memory()"
    ((table_bytes,),) = ss._database.connection.internal_rows(sql)
    return int(table_bytes + (store.nbytes if isinstance(store, MemoryStore) else 0))


# -- a long run ---------------------------------------------------------------------------------


def fill(ss: ssduck.Interpreter, world: ssduck.World, ticks: int, step: int = 6000) -> None:
    """Stores ticks that were never simulated: boxes move, some of them over the table."""
    recorder = _recorder(ss)
    world.request_tables(("shapes", "links"))  # later this would take another tick
    ss.flush()
    ids = np.array([member.id for member in world.snapshot.entities])
    first = world.snapshot.number + 1
    for start in range(first, first + ticks, step):
        numbers = np.arange(start, min(start + step, first + ticks))
        times = numbers * TIMESTEP
        rows = {
            "ticks": _table("ticks", [numbers], np.array([times, times])),
            "entities": _entities(numbers, times, ids),
        }
        for table, buffer in recorder.buffers.items():
            if table not in rows:
                rows[table] = buffer.arrow.slice(0, 0)
        recorder._store.add(rows)
        for number, at in zip(numbers.tolist(), times.tolist(), strict=True):
            recorder.ticks.append(number, at)
    world.snapshot.number = first + ticks - 1  # time ranges end with the current tick


def _entities(numbers: Numbers, times: Numbers, ids: Numbers) -> pa.Table:
    t = np.repeat(times, len(ids))
    n = np.tile(np.arange(len(ids)), len(times))
    reals = np.zeros((20, len(t)))
    speed = 0.1 + 0.01 * n
    angle = speed * t + n
    reals[0] = t
    reals[1:4] = 2 * np.cos(angle), 2 * np.sin(1.3 * angle), 0.3 + 0.5 * np.cos(0.7 * angle)
    reals[4], reals[7] = np.cos(angle / 2), np.sin(angle / 2)
    reals[8:10] = -2 * speed * np.sin(angle), 2.6 * speed * np.cos(1.3 * angle)
    still = n == 0
    reals[1:8, still] = np.array([[0, 0, 0.4, 1, 0, 0, 0]]).T
    # The gripper follows the cup at 5 mm to 5 cm.
    cup, gripper = n == 2, n == 1
    reals[1:14, gripper] = reals[1:14, cup]
    reals[3, gripper] += 0.6275 + 0.0225 * np.cos(9 * times)
    half = np.array([[0.25], [0.25], [0.3]])
    reals[14:17], reals[17:20] = reals[1:4] - half, reals[1:4] + half
    flags = np.ones(len(t), dtype=np.uint8)
    integers = [np.repeat(numbers, len(ids)), np.tile(ids, len(times))]
    return _table("entities", integers, reals, [flags, flags])


def _table(
    table: str, integers: Sequence[Numbers], reals: Array, flags: Sequence[Numbers] = ()
) -> pa.Table:
    names = RECORDED[table].tick_columns.names
    return pa.table([*map(pa.array, integers), *map(pa.array, reals), *map(pa.array, flags)], names)


@contextmanager
def long_run(ticks: int) -> Iterator[ssduck.Interpreter]:
    """Yields an interpreter with a long run `lab` and its handles `table`, `gripper`, `cup`."""
    with boxes(ENTITIES) as (world, _), ssduck.Interpreter(recording=Recording()) as ss:
        ss.add_variable("lab", world)
        for name in ("table", "gripper", "cup"):
            ss.add_variable(name, world[name])
        fill(ss, world, ticks)
        yield ss


OVER = ("a relation over a run", "rows", "found", "ssduck", "SQL by hand", "ratio")
ABOVE = "SELECT tick(this), id(this) FROM lab{} WHERE above(table, this) AND tick(this) % 1000 == 0"
HIGH = "SELECT tick(this), id(this) FROM lab{} WHERE above(table, this) AND z(this) > 0.7999"
_BY_HAND = """
    SELECT b.tick, b.name
    FROM lab.entities_history a JOIN lab.entities_history b ON a.tick = b.tick
    WHERE a.name = 'table' AND a.id <> b.id AND b.z >= a.zmax
        AND b.x BETWEEN a.xmin AND a.xmax AND b.y BETWEEN a.ymin AND a.ymax AND {}
"""


def over(ss: ssduck.Interpreter, rounds: int) -> Iterator[tuple[str, ...]]:
    """Yields the times of `above` over all ticks of a run.

    Raises:
        AssertionError: the answers differ.
    """
    ((rows,),) = ss.sql("SELECT count(tick) FROM lab.entities_history").fetchall()
    queries = {
        "above, each 1,000th tick": (ABOVE, "b.tick % 1000 = 0"),
        "above, and high up": (HIGH, "b.z > 0.7999"),
    }
    for name, (program, condition) in queries.items():
        ours = partial(ss.eval, ss.compile(f"{program} AS list;"))
        hand = partial(ss._database.connection.rows, _BY_HAND.format(condition))
        result, expected = _pairs(ours()), sorted(hand())
        if result != expected:
            raise AssertionError(f"{name}: {str(result)[:200]} is not {str(expected)[:200]}")
        times = minima({"ours": Way(ours), "hand": Way(hand)}, rounds, max_seconds=60.0)
        ratio = f"{times['ours'] / times['hand']:.2f}"
        yield name, f"{rows:,}", f"{len(result):,}", *map(text_of, times.values()), ratio


def _pairs(flat: list[Any]) -> list[tuple[Any, Any]]:
    return sorted(zip(flat[::2], flat[1::2], strict=True))


NEARBY = "SELECT tick(this) FROM lab{} WHERE this == cup AND near(gripper, this, 0.02) AS list;"
NEAR = (
    "the narrow phase over a run",
    "ticks",
    "pairs compared",
    "a pair",
    "FCL",
    "ratio",
    "with poses set",
    "ratio",
)


def near(sizes: Sequence[int], rounds: int) -> Iterator[tuple[str, ...]]:
    """Yields the times of `near` of two boxes at every tick, against FCL's distance of them.

    Raises:
        AssertionError: the answers differ.
    """
    for ticks in sizes:
        times: dict[str, list[float]] = {"ours": [], "bare": [], "set": []}
        for _ in range(rounds):  # a second query of the same run would reuse results
            with long_run(ticks) as ss:
                ours = minima({"ours": Way(partial(ss.eval, NEARBY))}, 1, max_seconds=60.0)
                pairs = ss.statistics()["lab"].pairs
                result = len(ss.eval(NEARBY))
                poses = ss.sql(
                    "SELECT x, y, z, qw, qx, qy, qz FROM lab.entities_history "
                    "WHERE name IN ('gripper', 'cup') AND tick > 1 ORDER BY tick, name"
                ).fetchall()
            hands = {name: Way(loop) for name, loop in _by_fcl(np.array(poses), result).items()}
            for name, seconds in {**ours, **minima(hands, 3, max_seconds=30.0)}.items():
                times[name].append(seconds)
        each = min(times["ours"]) / max(pairs, 1)
        # The loops call FCL at each tick, also for boxes that are far apart.
        bare, with_poses_set = (min(times[name]) / (len(poses) / 2) for name in ("bare", "set"))
        texts = (text_in_microseconds(each), text_in_microseconds(bare), f"{each / bare:.2f}")
        yield (
            "near",
            f"{ticks:,}",
            f"{pairs:,}",
            *texts,
            text_in_microseconds(with_poses_set),
            f"{each / with_poses_set:.2f}",
        )


def _by_fcl(poses: Array, result: int) -> dict[str, Callable[[], object]]:
    """Returns loops over poses (2 n, 7) of cup and gripper: as transforms and as numbers."""
    box = fcl.Box(0.2, 0.4, 0.6)
    cup, gripper = fcl.CollisionObject(box), fcl.CollisionObject(box)
    places, turns = poses[:, :3].copy(), poses[:, 3:].copy()
    transforms = [fcl.Transform(q, p) for q, p in zip(turns, places, strict=True)]

    def is_near(one: fcl.Transform, other: fcl.Transform) -> bool:
        cup.setTransform(one)
        gripper.setTransform(other)
        request, result = fcl.DistanceRequest(), fcl.DistanceResult()
        return bool(fcl.distance(cup, gripper, request, result) <= 0.02)

    def bare() -> int:
        return sum(map(is_near, transforms[::2], transforms[1::2]))

    def with_poses_set() -> int:
        near = 0
        for k in range(0, len(places), 2):
            one = fcl.Transform(turns[k], places[k])
            near += is_near(one, fcl.Transform(turns[k + 1], places[k + 1]))
        return near

    if abs(bare() - result) > 1:
        raise AssertionError(f"near at {result} ticks, FCL: {bare()}")
    return {"bare": bare, "set": with_poses_set}


WINDOW = ("a relation at each tick of a window", "ticks", "processor", "to touching", "again")
RELATIONS = ("touching", "on", "clearance", "supports", "restsOn")


def window(ticks: int, rounds: int) -> Iterator[tuple[str, ...]]:
    """Yields the processor times of relations of the kitchen's table and a cup, in turns.

    Each is asked of ticks about which nothing was asked before, and then again.
    """
    with ssduck.load("kitchen") as ss:
        ss.call_variable("kitchen").step(ticks)
        for name, entity in (("table", "table"), ("cup", "cup_905a")):
            ss.add_variable(name, ss.call_variable("kitchen")[entity])
        cache, count = ss.past("kitchen").record.answer_cache, len(ss.past("kitchen").ticks)
        times: dict[tuple[str, bool], list[float]] = {}
        for _ in range(rounds + 1):
            for relation in RELATIONS:
                cache.clear()
                for is_first in (True, False):
                    start = time.process_time()
                    ss.eval(f"changes({relation}(table, cup));")
                    elapsed = time.process_time() - start
                    times.setdefault((relation, is_first), []).append(elapsed)
    # Without the first round, in which shapes are prepared.
    middle = {key: statistics.median(values[1:]) for key, values in times.items()}
    for relation in RELATIONS:
        first, again = middle[relation, True], middle[relation, False]
        ratio = f"{first / middle[RELATIONS[0], True]:.2f}"
        yield relation, f"{count:,}", text_of(first), ratio, text_of(again)


# -- a record -----------------------------------------------------------------------------------

OPENED = ("a record in a folder", "MB", "files", "ssduck", "by hand", "ratio")


def opened(megabytes: float, rounds: int) -> Iterator[tuple[str, ...]]:
    """Yields the times of opening a record, and of a first query about a second or a tick."""
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder) / "run"
        # About 100 bytes a row.
        with long_run(max(int(megabytes * _MEGABYTE / 100 / ENTITIES), 480)) as ss:
            ss.export(place)
        size = sum(f.stat().st_size for f in place.rglob("*") if f.is_file()) / _MEGABYTE
        files = len(list((place / "entities").rglob("*.parquet")))
        with ssduck.open(place) as ss:
            middle = float(np.mean(ss.past("lab").times))
        rows = f"SELECT tick, name FROM read_parquet('{place}/entities/**/*.parquet')"
        last = f"(SELECT max(time) FROM read_parquet('{place}/ticks/**/*.parquet'))"
        tick = f"time > {middle!r} - {TIMESTEP} + 1e-9 AND time <= {middle!r} + 1e-9"
        queries = {
            "opening": ("", f"SELECT count(*) FROM ({rows})"),
            "opening, then the last second": (
                "SELECT tick(this), id(this) FROM lab{-1.0} WHERE z(this) > 0.5 AS list;",
                f"{rows} WHERE time >= {last} - 1 - 1e-9 AND z > 0.5",
            ),
            "opening, then a tick": (
                f"SELECT tick(this), id(this) FROM lab{{{middle!r}}} WHERE z(this) > 0.5 AS list;",
                f"{rows} WHERE {tick} AND z > 0.5",
            ),
        }
        for name, (program, sql) in queries.items():
            ours, hand = partial(_open, place, program), partial(_read, sql)
            if program and _pairs(ours()) != sorted(hand()):
                raise AssertionError(f"{name}: {str(ours())[:200]} is not {str(hand())[:200]}")
            times = minima({"ours": Way(ours), "hand": Way(hand)}, rounds, max_seconds=30.0)
            ratio = f"{times['ours'] / times['hand']:.2f}"
            yield name, f"{size:.0f}", f"{files}", *map(text_of, times.values()), ratio


def _open(place: Path, program: str) -> Any:
    with ssduck.open(place) as ss:
        return ss.eval(program)


def _read(sql: str) -> list[Any]:
    with closing(duckdb.connect()) as connection:
        return connection.execute(sql).fetchall()


# -- the run ------------------------------------------------------------------------------------


PARTS = ("cost", "step", "bytes", "over", "near", "window", "opened", "opening", "realtime")


def main(arguments: Sequence[str]) -> int:
    """Prints the requested tables."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks time")
    parser.add_argument(
        "--sizes", type=int, nargs="+", default=(40, 300, 1000), help="the sizes of worlds"
    )
    parser.add_argument("--ticks", type=int, default=2400, help="the ticks of each recording")
    parser.add_argument("--long", type=int, default=250_000, help="the ticks of the long run")
    parser.add_argument(
        "--near",
        type=int,
        nargs="+",
        default=(20_000, 100_000),
        help="the ticks of the runs in which shapes meet",
    )
    parser.add_argument(
        "--only", choices=PARTS, nargs="+", default=PARTS, help="the tables to print"
    )
    parser.add_argument("--window", type=int, default=1440, help="the ticks of the window")
    parser.add_argument("--gigabytes", type=float, default=0.1, help="the size of the record")
    parser.add_argument("--rounds", type=int, default=7, help="how often each way is timed")
    options = parser.parse_args(arguments)
    if "cost" in options.only:
        print_table(COST, costs(options.sizes, max(options.ticks // 2, 1), options.rounds))
    if "step" in options.only:
        print_table(STEP, steps(min(40, options.ticks), 5 * options.rounds))
    if "bytes" in options.only:
        print_table(BYTES, bytes_per_row(ENTITIES, 4 * options.ticks))
    if "over" in options.only:
        with long_run(options.long) as ss:
            print_table(OVER, over(ss, options.rounds))
    if "near" in options.only:
        print_table(NEAR, near(options.near, options.rounds))
    if "window" in options.only:
        print_table(WINDOW, window(options.window, options.rounds))
    if "opened" in options.only:
        print_table(OPENED, opened(1e3 * options.gigabytes, options.rounds))
    if "opening" in options.only:
        print_table(opening.HEADER, opening.rows(6 * options.rounds))
    if "realtime" in options.only:
        print_table(realtime.HEADER, realtime.rows(options.ticks))
    return 0
