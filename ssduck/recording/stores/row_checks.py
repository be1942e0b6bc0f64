"""Finds what is wrong with the rows of ticks that a stranger may have written.

The replay and SQL take for granted that each row is of a known entity, that no entity is there
twice at a tick, that a body has all of its links, and that each row has the number and the time of
a tick of the record.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from ssduck.geometry.arrays import Array, Indices
from ssduck.recording.buffers import TickBuffer
from ssduck.recording.static_tables import join_model
from ssduck.recording.stores.base import RowBlock
from ssduck.schema import FRAMES, MODELS, RECORDED, TABLES
from ssduck.world.layout import EntityInfo

Integers = npt.NDArray[np.int64]

# The columns of each table that name a link, by that of its entity.
_LINKS = {"contacts": {"a": "link_a", "b": "link_b"}}
# The tables that have a row for each part of a body at each tick that has one of them.
_COMPLETE = frozenset(("links", "joints", FRAMES))
# Of those that SQL reads, the bodies are those of the table of entities.
TABLES_OF_BODIES = frozenset(("links", "joints"))
_LARGEST = 1 << 62
TWICE = "a row is twice there"


@cache
def key_types(table: str) -> pa.Schema:
    """Returns the columns of a table that are checked, which have all but the measured numbers."""
    columns = RECORDED[table].tick_columns
    return pa.schema(
        [
            *((name, pa.int64()) for name in columns.integers),
            ("time", pa.float64()),
            *((name, pa.bool_()) for name in columns.booleans),
        ]
    )


@cache
def repeated_columns(table: str) -> tuple[str, ...]:
    """Returns the columns that a folder repeats of their model in each row of a table."""
    if table not in MODELS:
        return ()
    stored = TABLES[table].tick_columns.names
    return tuple(name for name in TABLES[table].names if name not in stored)


@cache
def repeated_texts(table: str) -> tuple[str, ...]:
    """Returns those of the repeated columns that have texts."""
    names = repeated_columns(table)
    columns = RECORDED[table].columns
    return tuple(one.name for one in columns if one.name in names and one.type == "string")


def model_columns(table: str) -> list[str]:
    """Returns the columns that a folder repeats in each row, after the keys that they follow from.

    None for a table without a model.
    """
    return [*TABLES[table].key, *repeated_columns(table)] if table in MODELS else []


def other_model(table: str, rows: pa.Table, model: pa.Table) -> str | None:
    """Returns that rows have other values than their model, and which; None if they have not.

    Args:
        table: a table with a model.
        rows: some of `model_columns`, of known entities and links.
        model: the rows of the model.
    """
    keys = TABLES[table].key
    names = [name for name in rows.column_names if name in model.column_names or name in keys]
    distinct = rows.select(names).group_by(names, use_threads=False).aggregate([])
    expected = join_model(table, distinct.select(keys), model, names)
    for name in names:
        found = (None if _is_nan(one) else one for one in distinct[name].to_pylist())
        if any(one != other for one, other in zip(found, expected[name].to_pylist(), strict=True)):
            return f"the column {name!r} has another value than its model"
    return None


def _is_nan(value: Any) -> bool:
    return isinstance(value, float) and math.isnan(value)


@dataclass(frozen=True, eq=False)
class _Model:
    """The rows of a model, prepared to be compared with many parts."""

    rows: pa.Table
    places: Integers  # the number of its row, by that of a part of a member in a tick; -1 for none

    @cached_property
    def _columns(self) -> dict[str, pa.Array]:
        """The columns by name; texts are numbered."""
        columns = {}
        for name in self.rows.column_names:
            column = self.rows[name].combine_chunks()
            is_text = pa.types.is_string(column.type)
            columns[name] = column.dictionary_encode() if is_text else column
        return columns

    def is_repeated(self, rows: pa.Table, numbers: Integers) -> bool:
        """Checks whether rows have the values of the model; those with NaN are taken not to."""
        places = self.places.take(numbers)
        return all(
            _are_equal(rows[name].combine_chunks(), self._columns[name], places)
            for name in rows.column_names
        )


def _are_equal(found: pa.Array, model: pa.Array, places: Integers) -> bool:
    """Checks whether a column has the values of the rows of its model at some places."""
    if pa.types.is_string(found.type):
        found = found.dictionary_encode()
    if pa.types.is_dictionary(found.type):
        texts = {text: number for number, text in enumerate(found.dictionary.to_pylist())}
        numbers = [texts.get(text, -1) for text in model.dictionary.to_pylist()]
        model = pa.array(numbers, found.indices.type).take(model.indices)
        found = found.indices
    if found.null_count or model.null_count or pa.types.is_boolean(found.type):
        return bool(found.equals(model.take(pa.array(places))))
    return np.array_equal(found.to_numpy(), model.to_numpy().take(places))


class RowChecks:
    """Checks rows against the models of the entities of a record."""

    def __init__(self, members: Mapping[int, EntityInfo]) -> None:
        self._members = members
        # The number of parts of each member, by table.
        self._counts: dict[str, Integers] = {}
        self._models: dict[str, _Model] = {}

    def problem(self, table: str, rows: pa.Table, ticks: TickBuffer) -> str | None:
        """Returns what is wrong with the rows of a table at some ticks; None for nothing.

        Args:
            table: the table.
            rows: all of its rows at these ticks, of all columns or those of `key_types`.
            ticks: the ticks of the record.
        """
        for column in rows.schema:
            if column.type != pa.float64() and rows[column.name].null_count:
                return f"the column {column.name!r} lacks a value"
        problem = stray_row(rows, ticks.numbers, ticks.times)
        if problem is not None:
            return problem
        for name in RECORDED[table].entity_columns:
            link = _LINKS.get(table, {}).get(name)
            links = None if link is None else rows[link].to_numpy()
            if (problem := self._unknown(rows[name].to_numpy(), links)) is not None:
                return problem
        return self._problem_of_keys(table, rows) if RECORDED[table].key and len(rows) else None

    def problem_of_block(self, table: str, block: RowBlock, ticks: TickBuffer) -> str | None:
        """Returns what is wrong with all rows of a part, which are of its own ticks."""
        problem = self.problem(table, block.rows, ticks)
        if problem is not None:
            return problem
        numbers = block.rows["tick"].to_numpy()
        if len(numbers) and (numbers.min() < block.first or numbers.max() > block.last):
            is_other = (numbers < block.first) | (numbers > block.last)
            return f"one at the tick {numbers[is_other][0]} is among those of others"
        return self._other_model(table, block)

    def _other_model(self, table: str, block: RowBlock) -> str | None:
        """Returns that the rows of a part, which are right else, have other values than models."""
        if block.repeated is None:
            return None
        rows, model = block.repeated
        prepared = self._model(table, model)
        names = [name for name in repeated_columns(table) if name in rows.column_names]
        compared = rows.select([name for name in names if name in model.column_names])
        if prepared.is_repeated(compared, self._numbers(table, block.rows)):
            return None
        return other_model(table, rows, model)  # finds the column, which takes longer

    def _model(self, table: str, rows: pa.Table) -> _Model:
        """Returns the model of a table, which is the same for all parts."""
        if table not in self._models or self._models[table].rows is not rows:
            places = np.full(int(self._parts(table).sum()), -1, dtype=np.int64)
            numbers = self._numbers(table, rows)
            places[numbers] = np.arange(len(rows))
            self._models[table] = _Model(rows, places)
        return self._models[table]

    def stranger(self, ids: Integers) -> str | None:
        """Returns that an id is that of no entity; None if there is none."""
        is_unknown = self._places(ids) < 0
        return f"the entity {ids[is_unknown][0]} is unknown" if is_unknown.any() else None

    def _unknown(self, ids: Integers, links: Integers | None) -> str | None:
        """Returns that an id is that of no entity, or that a link of the entity is unknown."""
        if links is not None and self._are_links(ids, links):
            return None
        problem = self.stranger(ids)
        if problem is None and links is not None:
            counts = self._parts("links").take(self._places(ids))
            problem = None if _are_below(links, counts) else "a link is unknown"
        return problem

    def _are_links(self, ids: Integers, links: Integers) -> bool:
        """Checks whether all links are known, quickly: of many rows, as those of contacts."""
        if not len(ids):
            return False
        is_first = np.ones(len(ids), dtype=bool)
        is_first[1:] = (ids[1:] != ids[:-1]) | (links[1:] != links[:-1])
        ids, links = ids[is_first], links[is_first]
        # Unsigned, a negative number is larger than any limit.
        if int(ids.view(np.uint64).max()) >= len(self._link_limits):
            return False
        return bool((links.view(np.uint64) < self._link_limits.take(ids)).all())

    @cached_property
    def _link_limits(self) -> npt.NDArray[np.uint64]:
        """The number of links of each member by its id, from 0 on; 0 for ids of no member."""
        limits = np.zeros(len(self._place_of_id), dtype=np.uint64)
        limits[sorted(self._members)] = self._parts("links")
        return limits

    def problem_of_bodies(
        self, table: str, rows: pa.Table, entities: pa.Table, *, single: bool
    ) -> str | None:
        """Returns that the bodies with parts are not those that are there, at some ticks.

        Args:
            table: a table of parts of bodies, as `links`.
            rows: its rows, which have no problem.
            entities: the rows of the entities at the same ticks, which have no problem.
            single: whether bodies of one link have a row of it, which repeats their pose.
        """
        owner, number = RECORDED[table].key
        has_parts = self._parts(table) > (table == "links" and not single)
        is_first = rows[number].to_numpy() == 0
        present = self._places(entities["id"].to_numpy())
        is_body = has_parts.take(present)
        ticks = rows["tick"].to_numpy()[is_first], entities["tick"].to_numpy()[is_body]
        places = self._places(rows[owner].to_numpy()[is_first]), present[is_body]
        if len(ticks[0]) == len(ticks[1]):
            keys = keys_of(np.concatenate(ticks), np.concatenate(places), len(has_parts))
            found, expected = map(_ascending, np.split(keys, 2))
            if np.array_equal(found, expected):
                return None
        return "those of a body are missing at a tick, or there without it"

    def rows_of_a_tick(self, table: str) -> int:
        """Returns how many rows a tick has at most, of a table whose rows are numbered."""
        return int(self._parts(table).sum())

    def place_of_pairs(self, a: Integers, b: Integers) -> Integers:
        """Returns a number of each pair of entities, which are known."""
        places: Integers = self._places(a) * len(self._members) + self._places(b)
        return places

    @cached_property
    def _place_of_id(self) -> Integers:
        """The place of each member by its id, from 0 on; -1 for other ids below and above."""
        ids = sorted(self._members)
        places = np.full(max(ids, default=0) + 2, -1, dtype=np.int64)
        places[ids] = np.arange(len(ids))
        return places

    def _places(self, ids: Integers) -> Integers:
        """Returns the places of entities among the members, by their ids; -1 for unknown ones."""
        places: Integers = self._place_of_id.take(ids, mode="clip")
        return places

    def _parts(self, table: str) -> Integers:
        """Returns the number of parts of each member: its links, joints or shapes."""
        if table not in self._counts:
            bodies = [self._members[id].body for id in sorted(self._members)]
            attribute = table if table in ("joints", "shapes") else "links"
            counts = [
                1 if table == "entities" else 0 if body is None else len(getattr(body, attribute))
                for body in bodies
            ]
            self._counts[table] = np.array(counts, dtype=np.int64)
        return self._counts[table]

    def _numbers(self, table: str, rows: pa.Table) -> Integers:
        """Returns a number of each row in its tick: that of its part among those of all members."""
        owner, *numbered = RECORDED[table].key
        counts = self._parts(table)
        starts: Integers = (np.cumsum(counts) - counts).take(self._places(rows[owner].to_numpy()))
        return starts + rows[numbered[0]].to_numpy() if numbered else starts

    def _problem_of_keys(self, table: str, rows: pa.Table) -> str | None:
        """Returns that a row is twice there, or that a part of a body is missing."""
        owner, *numbered = RECORDED[table].key
        counts = self._parts(table)
        numbers: Any = rows[numbered[0]].to_numpy() if numbered else 0
        if not _are_below(numbers, counts.take(self._places(rows[owner].to_numpy()))):
            return "a link is unknown"
        size = int(counts.sum())
        keys = keys_of(rows["tick"].to_numpy(), self._numbers(table, rows), size)
        steps = np.diff(keys)
        if (steps < 0).any():  # most are ascending already
            keys = np.sort(keys)
            steps = np.diff(keys)
        if not steps.all():
            return TWICE
        if table in _COMPLETE and not self._are_complete(keys, counts):
            return "a body lacks some of them"
        return None

    def _are_complete(self, keys: Integers, counts: Integers) -> bool:
        """Checks whether the parts of a body are all there or none, from ascending keys."""
        size = int(counts.sum())
        owners = np.repeat(np.arange(len(counts)), counts).take(keys % size)
        begins = np.flatnonzero(np.diff(keys // size, prepend=-1) | np.diff(owners, prepend=-1))
        return int(counts.take(owners.take(begins)).sum()) == len(keys)


def keys_of(ticks: Integers, numbers: Integers, size: int) -> Integers:
    """Returns a number of each row, from its tick and its number, less than `size`, in the tick."""
    if not len(ticks):
        return ticks
    offsets = ticks - ticks.min()
    if int(offsets.max()) * size > _LARGEST:
        offsets = np.unique(ticks, return_inverse=True)[1]
    keys: Integers = offsets * size + numbers
    return keys


def _are_below(numbers: Any, counts: Integers) -> bool:
    return bool(((numbers >= 0) & (numbers < counts)).all())


def _ascending(keys: Integers) -> Integers:
    """Returns keys in ascending order; most are already."""
    return np.sort(keys) if (np.diff(keys) < 0).any() else keys


def stray_row(rows: pa.Table, numbers: Indices, times: Array) -> str | None:
    """Returns what is wrong with the first row that is of no tick; None if there is none.

    Args:
        rows: rows with `tick` and `time`, s, which lack no value.
        numbers: the numbers of the ticks, ascending.
        times: their times, s.
    """
    own, own_times = rows["tick"].to_numpy(), rows["time"].to_numpy()
    if not len(own):
        return None
    # Of each row that has not the tick and the time of the row before it.
    begins = np.flatnonzero((own[1:] != own[:-1]) | (own_times[1:] != own_times[:-1])) + 1
    own, own_times = (values[np.append(0, begins)] for values in (own, own_times))
    places = np.searchsorted(numbers, own)
    is_right = numbers.take(places, mode="clip") == own
    is_right &= times.take(places, mode="clip") == own_times
    if is_right.all():
        return None
    first = int(np.argmin(is_right))
    return (
        f"one is at the tick {own[first]} and the time {own_times[first]} s, which the record does "
        "not have"
    )
