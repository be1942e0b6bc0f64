"""Measures records of poses from anywhere, and macros in plain DuckDB, against code by hand.

`python -m benchmarks interchange` writes the poses of 20 boxes at 4,800 ticks by `write_record`,
and by numpy and pyarrow as a user would without ssduck: poses and boxes, no models and no
checksums. It asks the files of the record for a relation by a macro, and by the same condition
written out. The times are processor times.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterator
from itertools import count
from pathlib import Path
from statistics import median
from typing import Any

import duckdb
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

import ssduck
from benchmarks.timing import text_of
from ssduck.interchange.macros import macro_script

TICKS, BOXES = 4800, 20
SIZES = (0.1, 0.2, 0.3)
ROUNDS = 7
HEADER = ("poses and macros", "by hand", "ssduck", "ratio", "bound")
BY_HAND = (
    "SELECT count(*) FROM frame a JOIN frame b USING (tick) WHERE b.x BETWEEN a.xmin AND a.xmax "
    "AND b.y BETWEEN a.ymin AND a.ymax AND b.z >= a.zmax AND a.id <> b.id"
)
BY_MACRO = "SELECT count(*) FROM frame a JOIN frame b USING (tick) WHERE above(a, b)"


def rows() -> Iterator[tuple[str, ...]]:
    """Yields a row for each task."""
    times, poses = _motion()
    entities = {f"box_{number}": {"box": SIZES} for number in range(BOXES)}
    with tempfile.TemporaryDirectory() as folder:
        places = (Path(folder) / str(number) for number in count())
        before, after, _ = _medians(
            lambda: _write_by_hand(next(places), times, poses),
            lambda: ssduck.write_record(next(places), entities, poses, times),
        )
        yield _cells("writing a tick of 20 boxes", before / TICKS, after / TICKS, 3.0)
        run = Path(folder) / "asked"
        ssduck.write_record(run, entities, poses, times)
        with duckdb.connect() as connection:
            connection.execute(macro_script(["above"]).text)
            files = str(run / "entities" / "**" / "*.parquet")
            connection.execute(f"CREATE VIEW frame AS SELECT * FROM read_parquet('{files}')")
            answers = [
                lambda query=query: connection.execute(query).fetchall()
                for query in (BY_HAND, BY_MACRO)
            ]
            before, after, found = _medians(*answers)
        if found[0] != found[1] or found[0] == [(0,)]:
            raise AssertionError(f"the answers are {found}")
        yield _cells("above, 4,800 ticks, plain DuckDB", before, after, 1.1)


def _motion() -> tuple[Any, Any]:
    random = np.random.default_rng(20)
    poses = random.normal(size=(TICKS, BOXES, 7))
    poses[..., 3:] /= np.linalg.norm(poses[..., 3:], axis=2, keepdims=True)
    return np.arange(TICKS) / 240, poses


def _write_by_hand(place: Path, times: Any, poses: Any) -> None:
    """Writes poses and boxes, (ticks, boxes, 7), to one file."""
    place.mkdir()
    w, x, y, z = (poses[..., column] for column in range(3, 7))
    entries = (
        *(1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        *(2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        *(2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    matrices = np.abs(np.stack(entries, axis=-1)).reshape(TICKS, BOXES, 3, 3)
    reach = matrices @ (np.array(SIZES) / 2)
    columns: dict[str, Any] = {
        "tick": np.repeat(np.arange(TICKS), BOXES),
        "time": np.repeat(times, BOXES),
        "id": np.tile(np.arange(BOXES), TICKS),
        "name": pa.array([f"box_{number}" for number in range(BOXES)] * TICKS),
    }
    for number, name in enumerate(("x", "y", "z", "qw", "qx", "qy", "qz")):
        columns[name] = poses[..., number].ravel()
    for number, axis in enumerate("xyz"):
        columns[f"{axis}min"] = (poses[..., number] - reach[..., number]).ravel()
        columns[f"{axis}max"] = (poses[..., number] + reach[..., number]).ravel()
    pq.write_table(pa.table(columns), place / "poses.parquet", compression="lz4")


def _medians(
    first: Callable[[], object], second: Callable[[], object]
) -> tuple[float, float, tuple[object, object]]:
    """Returns the processor times, s, of two calls that take turns, and their last results."""
    times: tuple[list[float], list[float]] = [], []
    found: list[object] = [None, None]
    for number in range(-1, ROUNDS):
        for index, call in enumerate((first, second)):
            start = time.process_time()
            found[index] = call()
            if number >= 0:
                times[index].append(time.process_time() - start)
    return median(times[0]), median(times[1]), (found[0], found[1])


def _cells(name: str, before: float, after: float, bound: float) -> tuple[str, ...]:
    return name, text_of(before), text_of(after), f"{after / before:.2f}", f"{bound}"
