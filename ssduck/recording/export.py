"""Exports the recorded ticks of a world to a folder of Parquet files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa

from ssduck.errors import EvaluationError
from ssduck.recording.replay.record import Record
from ssduck.recording.spec import Recording, check_names, chosen_members
from ssduck.recording.stores.parquet import ParquetStore
from ssduck.schema import RECORDABLE, RECORDED

# So many rows of entities make a part, about: ten megabytes.
PART_ROWS = 1 << 18


def exported(
    record: Record,
    recording: Recording,
    world: str,
    path: Path,
    names: tuple[str, ...] | None,
    between: tuple[float | None, float | None],
) -> Path:
    """Write ticks of a world as a new episode; gives the folder of its ticks.

    Args:
        record: what is kept of the world, which the caller holds.
        recording: how.
        world: what the world is called.
        path: the folder of episodes.
        names: of the entities that are written; None for all.
        between: simulated times from which and until which, s; None without end.

    Raises:
        RecordError: the folder has something else in it, or cannot be written.
        EvaluationError: nothing is kept of that time.
        ArgumentError: no entity has one of the names.
    """
    numbers = _ticks(record, between)
    record.warn_of_masses()
    chosen = Recording(
        tables=tuple(sorted(record.tables & set(RECORDABLE))),
        entities=recording.entities if names is None else names,
        every=recording.every,
    )
    members = list(record.members.values())
    check_names(Recording(entities=names), members)
    kept = members if names is None else chosen_members(members, names)
    ids = None if names is None else pa.array([member.id for member in kept])
    folder = ParquetStore(path, world, chosen)
    try:
        folder.add_members(kept, record.world.snapshot)
        for first, last in _parts(numbers, max(len(kept), 1)):
            fetched = {table: in_order(record.fetch(table, first, last)) for table in folder.tables}
            folder.add({table: _of(rows, table, ids) for table, rows in fetched.items()})
        folder.finish()
    except BaseException:  # half of it would be taken for all
        folder.discard()
        raise
    return folder.run.place("ticks")


def in_order(rows: pa.Table) -> pa.Table:
    """Rows by tick, those of a tick as they were."""
    ticks = rows["tick"].to_numpy()
    if (ticks[1:] >= ticks[:-1]).all():
        return rows
    return rows.take(np.argsort(ticks, kind="stable"))


def _ticks(record: Record, between: tuple[float | None, float | None]) -> list[int]:
    numbers, times = record.ticks.numbers, record.ticks.times
    low = -np.inf if between[0] is None else between[0]
    high = np.inf if between[1] is None else between[1]
    found: list[int] = numbers[(times >= low - 1e-9) & (times <= high + 1e-9)].tolist()
    if not found:
        name = record.world.name
        told = f"from {times[0]:g} s to {times[-1]:g} s" if len(times) else "nothing"
        raise EvaluationError(f"no tick of {name!r} of that time is recorded, but {told}")
    return found


def _parts(numbers: list[int], rows: int) -> list[tuple[int, int]]:
    """The first and the last tick of each part."""
    step = max(PART_ROWS // rows, 1)
    parts = [numbers[start : start + step] for start in range(0, len(numbers), step)]
    return [(part[0], part[-1]) for part in parts]


def _of(rows: pa.Table, table: str, ids: pa.Array | None) -> pa.Table:
    """The rows of some entities."""
    if ids is None:
        return rows
    is_chosen = np.ones(rows.num_rows, dtype=bool)
    for column in RECORDED[table].entity_columns:
        is_chosen &= np.isin(rows[column].to_numpy(), ids.to_numpy())
    return rows.filter(pa.array(is_chosen))
