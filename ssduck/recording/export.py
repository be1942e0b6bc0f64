"""Exports the recorded ticks of a world to a folder of Parquet files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa

from ssduck.errors import EvaluationError
from ssduck.recording.folder_episodes import BegunEpisode
from ssduck.recording.replay.record import Record
from ssduck.recording.spec import Recording, check_names, chosen_members
from ssduck.recording.stores.parquet import ParquetStore
from ssduck.recording.stores.stored_columns import with_nulls
from ssduck.recording.tags import Tags
from ssduck.schema import RECORDABLE, RECORDED
from ssduck.world import ctrl_c

# About so many rows of entities make a part: ten megabytes.
PART_ROWS = 1 << 18


def export(
    record: Record,
    recording: Recording,
    world: str,
    path: Path,
    names: tuple[str, ...] | None,
    between: tuple[float | None, float | None],
    begun: list[BegunEpisode],
    tags: Tags | None = None,
    order: int = 0,
) -> Path:
    """Writes recorded ticks of a world as a new episode, and returns the folder of its ticks.

    Args:
        record: the record of the world; the caller holds the world.
        recording: what is recorded of the world.
        world: the name of the world.
        path: the folder of episodes.
        names: the names of the exported entities; None for all.
        between: the first and the last simulated time, s; None for no limit.
        begun: gets the episode as it begins; the caller discards it if anything fails, as a part of
            an episode would pass for all of it.
        tags: what the user says of the run, added to the tags of the record.
        order: a number that is less than those of the worlds that were added later.
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
    selected = members if names is None else chosen_members(members, names)
    ids = None if names is None else pa.array([member.id for member in selected])
    with ctrl_c.deferred():
        store = ParquetStore(
            path,
            world,
            chosen,
            is_export=True,
            tags={**record.tags, **(tags or {})},
            camera=record.world.camera,
            order=order,
        )
        begun.append(store)
    store.add_members(selected, record.world.snapshot)
    for first, last in _parts(numbers, max(len(selected), 1)):
        fetched = {
            table: with_nulls(in_order(record.fetch(table, first, last))) for table in store.tables
        }
        store.add({table: _rows_of(ids, table, rows) for table, rows in fetched.items()})
    store.finish()
    return store.run.place("ticks")


def in_order(rows: pa.Table) -> pa.Table:
    """Returns rows sorted by tick; the rows of a tick keep their order."""
    ticks = rows["tick"].to_numpy()
    if (ticks[1:] >= ticks[:-1]).all():
        return rows
    return rows.take(np.argsort(ticks, kind="stable"))


def _ticks(record: Record, between: tuple[float | None, float | None]) -> list[int]:
    numbers, times = record.ticks.numbers, record.ticks.times
    low = -np.inf if between[0] is None else between[0]
    high = np.inf if between[1] is None else between[1]
    selected: list[int] = numbers[(times >= low - 1e-9) & (times <= high + 1e-9)].tolist()
    if not selected:
        name = record.world.name
        recorded = f"from {times[0]:g} s to {times[-1]:g} s" if len(times) else "nothing"
        raise EvaluationError(f"no tick of {name!r} of that time is recorded, but {recorded}")
    return selected


def _parts(numbers: list[int], rows: int) -> list[tuple[int, int]]:
    """Returns the first and the last tick of each part."""
    step = max(PART_ROWS // rows, 1)
    parts = [numbers[start : start + step] for start in range(0, len(numbers), step)]
    return [(part[0], part[-1]) for part in parts]


def _rows_of(ids: pa.Array | None, table: str, rows: pa.Table) -> pa.Table:
    """Returns the rows of some entities; all rows if `ids` is None."""
    if ids is None:
        return rows
    is_selected = np.ones(rows.num_rows, dtype=bool)
    for column in RECORDED[table].entity_columns:
        is_selected &= np.isin(rows[column].to_numpy(), ids.to_numpy())
    return rows.filter(pa.array(is_selected))
