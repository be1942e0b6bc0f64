"""The table of the pairs of a record whose shapes are near each other: for tools without shapes.

    pairs/world=kitchen/episode=0/part-000000.parquet

A row is two entities a < b at a tick whose clearance is at most `within`, which the footer says.
The table follows from the others; ssduck itself does not read it.
"""

from __future__ import annotations

import json
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from ssduck import validation
from ssduck.errors import NumberError, RecordError
from ssduck.recording.paths import FORMAT, check_inside, part_name
from ssduck.recording.stores.checksums import verified_parquet, write_parquet
from ssduck.recording.stores.parquet_layout import PAIRS, FolderRun

_WITHIN = b"ssduck pairs"
COLUMNS = pa.schema(
    [
        ("tick", pa.int64()),
        ("time", pa.float64()),
        ("a", pa.int64()),
        ("b", pa.int64()),
        ("clearance", pa.float64()),
        ("depth", pa.float64()),
    ]
)


def checked_distance(within: float) -> float:
    """Returns the largest clearance of pairs, m."""
    distance = validation.finite_number(within, "pairs", "metres")
    if distance < 0.0:
        raise NumberError(f"pairs: {distance:g} m is less than 0")
    return distance


def pair_query(schema: str) -> str:
    """Returns the SELECT of the pairs of a world at recorded ticks.

    Its parameters are the distance, and the first and the last tick.
    """
    history = f'"{validation.identifier(schema, "a world")}".entities_history'
    return (
        "SELECT a.tick, a.time, a.id AS a, b.id AS b, clearance(a, b) AS clearance, "  # noqa: S608
        f"penetration(a, b) AS depth FROM {history} AS a JOIN {history} AS b "
        "ON a.tick = b.tick AND a.id < b.id WHERE near(a, b, ?) AND a.tick BETWEEN ? AND ? "
        "ORDER BY a.tick, a.id, b.id"
    )


def write_pairs(run: FolderRun, rows: pa.Table, within: float) -> Path:
    """Writes the pairs of an episode; returns their file."""
    file = run.place(PAIRS) / part_name(0)
    check_inside(run.path, file)
    label = run.label(PAIRS, 0)
    metadata = {_WITHIN: json.dumps({"within": within}).encode()}
    if label is not None:
        metadata[FORMAT.encode()] = label
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        labelled = rows.cast(COLUMNS).replace_schema_metadata(metadata)
        write_parquet(labelled, file, compression="zstd")
    except OSError as error:
        raise RecordError(f"{file} cannot be written: {error.strerror}") from error
    return file


def pairs_of(run: FolderRun) -> tuple[Path, float] | None:
    """Returns the file of an episode's pairs, and their largest clearance, m; None without one."""
    file = run.place(PAIRS) / part_name(0)
    check_inside(run.path, file)
    if not file.is_file():
        return None
    stored: pq.ParquetFile = verified_parquet(file, has_checksums=True)
    metadata = stored.schema_arrow.metadata or {}
    label = run.label(PAIRS, 0)
    if label is not None and metadata.get(FORMAT.encode()) != label:
        raise RecordError(f"{file} is of another episode: it was copied there; remove it")
    try:
        within = json.loads(metadata[_WITHIN])["within"]
        return file, checked_distance(within)
    except (KeyError, TypeError, ValueError) as error:
        raise RecordError(f"{file} is damaged: it does not say how near its pairs are") from error
