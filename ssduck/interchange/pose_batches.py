"""Checks poses that come from anywhere, and brings them into one form: `PoseBatch`.

A *frame* is an entity, by its name, or a link of one, by `entity.link`. Frames are in the order of
the entities, each followed by its links.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from ssduck.errors import ArgumentError, check_known
from ssduck.formatting import short_repr
from ssduck.geometry.arrays import Array, Flags, Indices
from ssduck.geometry.poses import unit_quaternions
from ssduck.schema import POSE, TWIST
from ssduck.world.layout import EntityInfo

# A quaternion whose square differs from 1 by less is one of unit length, and stays as it is.
UNIT_TOLERANCE = 1e-9
_SHAPES = "(ticks, 7): x, y, z, qw, qx, qy, qz, or (ticks, 3): x, y, z"


@dataclass(frozen=True, eq=False)
class Frames:
    """The frames of the entities of a record."""

    names: tuple[str, ...]  # the names of the frames
    owners: Indices  # the number of the entity of each frame, (frames,)
    starts: Indices  # the first frame of each entity, (entities,)

    @classmethod
    def of(cls, entities: Sequence[EntityInfo]) -> Frames:
        """Returns the frames of entities."""
        names: list[str] = []
        owners: list[int] = []
        starts: list[int] = []
        for number, entity in enumerate(entities):
            assert entity.body is not None
            starts.append(len(names))
            owners += [number] * len(entity.body.links)
            names += [entity.name, *(f"{entity.name}.{k.name}" for k in entity.body.links[1:])]
        if len(set(names)) < len(names):
            twice = next(name for name in names if names.count(name) > 1)
            raise ArgumentError(f"entities: {short_repr(twice)} is both an entity and a link")
        return cls(tuple(names), np.array(owners, np.intp), np.array(starts, np.intp))

    def __len__(self) -> int:
        return len(self.names)

    def number(self, name: Any, argument: str) -> int:
        """Returns the number of a frame."""
        message = f"{argument}: no entity or link is called {short_repr(name)}"
        check_known(name, self.names, message, ArgumentError)
        return self.names.index(name)


@dataclass(frozen=True, eq=False)
class PoseBatch:
    """The poses of frames at some ticks."""

    times: Array  # simulated times, s, (ticks,), ascending
    poses: Array  # x, y, z, qw, qx, qy, qz, world frame, m, (ticks, frames, 7)
    # the velocities vx, vy, vz, m/s, and wx, wy, wz, rad/s, world frame, (ticks, frames, 6); NaN
    # for unknown ones
    twists: Array
    present: Flags  # whether each entity is there, (ticks, entities)


def batch_of(
    frames: Frames,
    poses: Any,
    times: Any,
    velocities: Any,
    after: float | None,
    *,
    are_whole: bool = True,
) -> PoseBatch:
    """Returns poses as a batch; see `ssduck.write_record`."""
    if hasattr(poses, "__arrow_c_stream__") or hasattr(poses, "__arrow_c_array__"):
        if times is not None or velocities is not None:
            raise ArgumentError(
                "times, velocities: a table of poses has its own columns: time, and vx to wz"
            )
        table = pa.table(poses)
        batch = _batch_of_table(frames, table, are_whole=are_whole)
        _check_order(batch.times, after, may_repeat="tick" in table.column_names)
    else:
        checked = _times(times)
        placed = _stacked(frames, poses, len(checked), "poses", _SHAPES)
        if placed.shape[2] == 3:
            turned = np.zeros((*placed.shape[:2], 4))
            turned[..., 0] = 1.0
            placed = np.concatenate((placed, turned), axis=2)
        twists = np.full((*placed.shape[:2], 6), np.nan)
        if velocities is not None:
            twists = _stacked(frames, velocities, len(checked), "velocities", "(ticks, 6)")
        everywhere = np.ones((len(checked), len(frames.starts)), dtype=bool)
        batch = PoseBatch(checked, placed, twists, everywhere)
        _check_order(batch.times, after, may_repeat=False)
    return PoseBatch(
        batch.times, _with_unit_quaternions(batch, frames), batch.twists, batch.present
    )


def _times(times: Any) -> Array:
    if times is None:
        raise ArgumentError("times: give the time of each tick, s, in an array (ticks,)")
    array = _numbers(times, "times")
    if array.ndim != 1:
        raise ArgumentError(f"times: the shape is {array.shape}, and is to be (ticks,)")
    _check_finite(array, "times", "tick")
    return array


def _numbers(values: Any, argument: str) -> Array:
    try:
        array = np.asarray(values)
        if array.dtype.kind not in "iuf":
            raise TypeError(f"values of the type {array.dtype}")
        return array.astype(np.float64)
    except (TypeError, ValueError) as error:
        raise ArgumentError(f"{argument}: expected an array of numbers: {error}") from error


def _check_finite(array: Array, argument: str, unit: str) -> None:
    wrong = np.argwhere(~np.isfinite(array))
    if len(wrong):
        value = array[tuple(wrong[0])]
        raise ArgumentError(f"{argument}: {unit} {wrong[0][0]} has the value {value}")


def _check_order(times: Array, after: float | None, *, may_repeat: bool) -> None:
    before = times if after is None else np.concatenate(([after], times))
    steps = np.diff(before)
    wrong = np.flatnonzero(steps < 0.0 if may_repeat else steps <= 0.0)
    if len(wrong):
        place = int(wrong[0])
        raise ArgumentError(
            f"times: they are to ascend, and {before[place + 1]:g} s follows {before[place]:g} s"
        )


def _stacked(frames: Frames, values: Any, ticks: int, argument: str, shapes: str) -> Array:
    """Returns the numbers of all frames, (ticks, frames, n)."""
    widths = (6,) if argument == "velocities" else (7, 3)
    if not isinstance(values, Mapping):
        array = _numbers(values, argument)
        if (
            array.ndim != 3
            or array.shape[:2] != (ticks, len(frames))
            or array.shape[2] not in widths
        ):
            expected = " or ".join(str((ticks, len(frames), width)) for width in widths)
            raise ArgumentError(
                f"{argument}: the shape is {array.shape}, and is to be {expected}: ticks, frames, "
                "numbers"
            )
        _check_finite(array, argument, "tick")
        return array
    columns: dict[int, Array] = {}
    for name, given in values.items():
        number = frames.number(name, argument)
        array, where = _numbers(given, f"{argument}[{name!r}]"), f"{argument}[{name!r}]"
        if array.ndim == 1 and array.shape[0] in widths:  # it stands still
            array = np.broadcast_to(array, (ticks, len(array)))
        if array.ndim != 2 or array.shape[0] != ticks or array.shape[1] not in widths:
            raise ArgumentError(
                f"{where}: the shape is {array.shape}, and is to be {shapes}, of {ticks} ticks"
            )
        _check_finite(array, where, "tick")
        columns[number] = array
    missing = [name for number, name in enumerate(frames.names) if number not in columns]
    if missing and argument == "poses":
        raise ArgumentError(f"{argument}: {short_repr(missing[0])} has none")
    return _joined(columns, ticks, len(frames), widths[0])


def _joined(columns: Mapping[int, Array], ticks: int, count: int, width: int) -> Array:
    joined = np.full((ticks, count, width), np.nan)
    for number, array in columns.items():
        joined[:, number, : array.shape[1]] = array
        if width == 7 and array.shape[1] == 3:
            joined[:, number, 3:] = (1.0, 0.0, 0.0, 0.0)
    return joined


# -- tables -----------------------------------------------------------------------------------


def _batch_of_table(frames: Frames, table: pa.Table, *, are_whole: bool) -> PoseBatch:
    """Returns the poses of a table with a row for each frame of each tick."""
    present = set(table.column_names)
    needed = ("time", "name", *POSE[:3])
    for column in needed:
        message = (
            f"poses: the table has no column {column!r}; it needs {', '.join(needed)}, and may "
            f"have {', '.join((*POSE[3:], *TWIST))}"
        )
        check_known(column, present, message, ArgumentError)
    for group in (POSE[3:], TWIST):
        lacking = [name for name in group if name not in present]
        if lacking and len(lacking) < len(group):
            raise ArgumentError(f"poses: the table has no column {lacking[0]!r}")
    times, ticks = _ticks(table)
    numbers = _frame_numbers(frames, table["name"])
    is_there = np.zeros((len(times), len(frames)), dtype=bool)
    is_there[ticks, numbers] = True
    if is_there.sum() < len(ticks):
        keys, counts = np.unique(ticks * len(frames) + numbers, return_counts=True)
        tick, frame = divmod(int(keys[np.argmax(counts > 1)]), len(frames))
        raise ArgumentError(f"poses: {frames.names[frame]!r} has two rows at {times[tick]:g} s")
    poses = np.full((len(times), len(frames), 7), np.nan)
    poses[..., 3:] = (1.0, 0.0, 0.0, 0.0)
    twists = np.full((len(times), len(frames), 6), np.nan)
    for columns, values in ((POSE, poses), (TWIST, twists)):
        for place, column in enumerate(columns):
            if column in present:
                values[ticks, numbers, place] = _column(table, column, may_lack=columns is TWIST)
    if not are_whole and len(frames):
        is_there = np.logical_and.reduceat(is_there, frames.starts, axis=1)[:, frames.owners]
    return PoseBatch(times, poses, twists, _whole_entities(frames, times, is_there))


def _ticks(table: pa.Table) -> tuple[Array, Indices]:
    """Returns the times of a table's ticks, (ticks,), and the tick of each row, by its number."""
    times, key, unit = _column(table, "time"), "time", " s"
    numbers = times
    if "tick" in table.column_names:
        key, unit = "tick", ""
        if not pa.types.is_integer(table["tick"].type) or table["tick"].null_count:
            raise ArgumentError("poses: the column 'tick' has other values than whole numbers")
        numbers = table["tick"].to_numpy()
    wrong = np.flatnonzero(numbers[1:] < numbers[:-1])
    if len(wrong):
        place = int(wrong[0])
        raise ArgumentError(
            f"poses: the rows are to ascend by {key}, and row {place + 1}, "
            f"{numbers[place + 1]:g}{unit}, follows {numbers[place]:g}{unit}"
        )
    _, first, ticks = np.unique(numbers, return_index=True, return_inverse=True)
    wrong = np.flatnonzero(times != times[first][ticks])
    if len(wrong):
        row = int(wrong[0])
        raise ArgumentError(
            f"poses: tick {numbers[row]} is at {times[first[ticks[row]]]:g} s, and at "
            f"{times[row]:g} s"
        )
    return times[first], ticks


def _frame_numbers(frames: Frames, names: pa.ChunkedArray) -> Indices:
    encoded = names.combine_chunks()
    if not pa.types.is_dictionary(encoded.type):
        encoded = encoded.dictionary_encode()
    if encoded.null_count:
        raise ArgumentError("poses: the column 'name' lacks a value")
    known = [frames.number(name, "poses") for name in encoded.dictionary.to_pylist()]
    numbers: Indices = np.array(known, dtype=np.intp)[encoded.indices.to_numpy()]
    return numbers


def _column(table: pa.Table, name: str, *, may_lack: bool = False) -> Array:
    where = f"poses: the column {name!r}"
    try:
        column = table[name].cast(pa.float64())
    except (pa.ArrowInvalid, pa.ArrowNotImplementedError) as error:
        raise ArgumentError(f"{where} has other values than numbers: {error}") from error
    if column.null_count and not may_lack:
        raise ArgumentError(f"{where} lacks a value")
    values: Array = column.to_numpy()
    if not may_lack:
        _check_finite(values, where, "row")
    elif np.isinf(values).any():
        raise ArgumentError(f"{where} has an infinite value")
    return values


def _whole_entities(frames: Frames, times: Array, is_there: Flags) -> Flags:
    """Returns whether each entity is there, (ticks, entities); each is with all of its links."""
    present = is_there[:, frames.starts]
    wrong = np.argwhere(is_there != present[:, frames.owners])
    if len(wrong):
        tick, frame = wrong[0].tolist()
        owner = frames.names[frames.starts[frames.owners[frame]]]
        raise ArgumentError(
            f"poses: at {times[tick]:g} s, {owner!r} is there in part: it needs a row for itself "
            "and for each of its links"
        )
    flags: Flags = present
    return flags


def _with_unit_quaternions(batch: PoseBatch, frames: Frames) -> Array:
    """Returns the poses with quaternions of unit length; those that have it keep their bits."""
    turned = batch.poses[..., 3:]
    squares: npt.NDArray[np.float64] = np.sum(turned * turned, axis=2)
    squares[~batch.present[:, frames.owners]] = 1.0
    wrong = np.argwhere(~(squares > 0.0) | np.isinf(squares))
    if len(wrong):
        tick, frame = wrong[0].tolist()
        raise ArgumentError(
            f"poses: at {batch.times[tick]:g} s, the quaternion w, x, y, z of "
            f"{frames.names[frame]!r} is {turned[tick, frame].tolist()}, which is no rotation"
        )
    others = np.abs(squares - 1.0) > UNIT_TOLERANCE
    if not others.any():
        return batch.poses
    poses = batch.poses.copy()
    poses[..., 3:][others] = unit_quaternions(turned[others])
    return poses


@dataclass(frozen=True)
class ImportedPoses:
    """The poses of an episode."""

    # the names of the frames, those of entities that are known before those of links
    names: Sequence[str]
    # tables of poses, as `ssduck.write_record` takes them, one after the other
    tables: Iterable[pa.Table]
    # what the source says of the episode: `world`, `tags`, `kinds` and `task`
    about: Mapping[str, Any]
    unread: Sequence[str]  # what is in the source and not in the tables
