"""Reads the poses of datasets of LeRobot, version 3.0; the layout is told in `lerobot`.

A frame's time is its number by the frames per second, since timestamps are floats of 32 bits. The
frames are ordered by their numbers, and their timestamps have to agree: what a dataset tells twice
is the same twice, or an error.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from ssduck.errors import RecordError
from ssduck.formatting import short_repr
from ssduck.geometry.arrays import Array
from ssduck.interchange.lerobot import CODEBASE_VERSION, INDICES, INFO_PATH
from ssduck.interchange.pose_batches import ImportedPoses
from ssduck.schema import POSE

# The fewest and the most frames per second that stand for any.
_FPS = (1e-6, 1e6)
# The columns of `meta/episodes` that are read; others have the statistics of features.
_OWN = ("ssduck/tags", "ssduck/world")
_LISTED = ("episode_index", "length", "tasks", "data/chunk_index", "data/file_index", *_OWN)
# So many names of a feature that are not read are told of.
_TOLD = 8
# How far a timestamp may be from its frame, s, as LeRobot has it; and a float of 32 bits, relative.
_TOLERANCE, _ROUNDING = 1e-4, 2.0**-23

# The feature and the place of each column of the poses of each frame, by the frame's name.
_Places = Mapping[str, Mapping[str, tuple[str, int]]]


def read_poses(folder: Path) -> Iterator[ImportedPoses]:
    """Yields the poses of each episode of a dataset, and what the dataset says of it.

    Poses are found where a feature has names such as `cup.x`, `cup.y`, `cup.z` and, unless nothing
    is turned, `cup.qw` to `cup.qz`. Other features do not tell of named frames.
    """
    info = _read_json(_file(folder, INFO_PATH))
    if info.get("codebase_version") != CODEBASE_VERSION:
        raise RecordError(
            f"{folder} is a dataset of version {info.get('codebase_version')!r}; ssduck reads "
            f"{CODEBASE_VERSION}: convert it with LeRobot"
        )
    features = info.get("features")
    dataset = _Dataset(folder, info, features if isinstance(features, dict) else {})
    try:
        yield from dataset.episodes()
    except (pa.ArrowException, OSError, KeyError, TypeError, ValueError, IndexError) as error:
        if isinstance(error, RecordError):
            raise
        raise RecordError(f"{folder} cannot be read as a dataset of LeRobot: {error}") from error


@dataclass(frozen=True)
class _Dataset:
    """A dataset that is read: its folder, its `info.json` and the features that this describes."""

    folder: Path
    info: Mapping[str, Any]
    features: Mapping[str, Any]

    def episodes(self) -> Iterator[ImportedPoses]:
        """Yields the poses of each episode, and what the dataset says of it."""
        places = self._places()
        used = {feature for columns in places.values() for feature, _ in columns.values()}
        unread = sorted(self._unread(places))
        fps = self._frames_per_second()
        numbers: set[int] = set()
        for episode in self._listed():
            number = self._index(episode, "episode_index")
            if number in numbers:
                raise RecordError(f"{self.folder} lists the episode {number} twice")
            numbers.add(number)
            frames = self._frames_of(episode, number, sorted(used), fps)
            task, others = self._tasks(episode, number)
            about = {"task": task, "tags": json.loads(episode.get("ssduck/tags") or "{}")}
            about["world"] = episode.get("ssduck/world")
            told = [
                *unread,
                *(f"the task {short_repr(each)} of episode {number}" for each in others),
            ]
            yield ImportedPoses([*places], [_poses(frames, places)], about, told)

    def _listed(self) -> list[dict[str, Any]]:
        files = sorted((self.folder / "meta/episodes").glob("*/*.parquet"))
        return [row for file in files for row in _rows_of(file, _LISTED).to_pylist()]

    def _names(self, feature: str) -> list[Any]:
        about = self.features[feature]
        names = about.get("names") if isinstance(about, dict) else None
        return names if isinstance(names, list) else []

    def _places(self) -> _Places:
        """Returns where the poses of each frame are."""
        found: dict[str, dict[str, tuple[str, int]]] = {}
        for feature in self.features:
            for place, name in enumerate(self._names(feature)):
                frame, _, column = str(name).rpartition(".")
                if not frame or column not in POSE:
                    continue
                columns = found.setdefault(frame, {})
                if column in columns:
                    raise RecordError(
                        f"{self.folder} has two numbers named {short_repr(name)}, in the features "
                        f"{columns[column][0]} and {feature}: rename one in meta/info.json"
                    )
                columns[column] = feature, place
        whole = {name: columns for name, columns in found.items() if columns.keys() >= {*POSE[:3]}}
        if not whole:
            raise RecordError(
                f"{self.folder} tells of no named frames: no feature has names such as cup.x, "
                f"cup.y, cup.z; its features are {', '.join(sorted(self.features))}"
            )
        for frame, columns in whole.items():
            turn = [name for name in POSE[3:] if name in columns]
            if turn and len(turn) < len(POSE[3:]):
                raise RecordError(
                    f"{self.folder} has a part of the orientation of {short_repr(frame)}, "
                    f"{', '.join(turn)}: name all of qw, qx, qy, qz, or none, in meta/info.json"
                )
        return whole

    def _frames_per_second(self) -> float:
        fps = self.info.get("fps")
        if isinstance(fps, bool) or not isinstance(fps, int | float):
            fps = None
        if fps is None or not _FPS[0] <= fps <= _FPS[1]:
            raise RecordError(
                f"{self.folder} has {short_repr(self.info.get('fps'))} frames per second (fps in "
                f"meta/info.json): give a number from {_FPS[0]:g} to {_FPS[1]:g}"
            )
        return float(fps)

    def _index(self, episode: Mapping[str, Any], name: str) -> int:
        index = episode[name]
        if isinstance(index, bool) or not isinstance(index, int) or index < 0:
            raise RecordError(
                f"{self.folder} lists an episode whose {name} is {short_repr(index)}: it has to be "
                "a whole number from 0"
            )
        return index

    def _unread(self, places: _Places) -> Iterator[str]:
        """Yields the features that tell of no pose, and the names of the others that do not."""
        used = {where for columns in places.values() for where in columns.values()}
        for feature in self.features.keys() - {"timestamp", *INDICES}:
            names = self._names(feature)
            others = [str(n) for place, n in enumerate(names) if (feature, place) not in used]
            if len(others) == len(names):
                yield feature
            elif others:
                more = f" and {len(others) - _TOLD} more" if len(others) > _TOLD else ""
                yield f"{', '.join(others[:_TOLD])}{more} of {feature}"

    def _tasks(self, episode: Mapping[str, Any], number: int) -> tuple[str | None, list[Any]]:
        """Returns the task of an episode, and further ones."""
        tasks = episode.get("tasks")
        if tasks is not None and not isinstance(tasks, list):
            raise RecordError(
                f"{self.folder}: the tasks of the episode {number} are {short_repr(tasks)}, no list"
            )
        task = tasks[0] if tasks else None
        if task is not None and not isinstance(task, str):
            raise RecordError(
                f"{self.folder}: the task of the episode {number} is {short_repr(task)}, no text"
            )
        return task, tasks[1:] if tasks else []

    def _frames_of(
        self, episode: Mapping[str, Any], number: int, used: Sequence[str], fps: float
    ) -> _Frames:
        """Returns the times and the values of an episode's frames, in their order."""
        indices = {
            name: self._index(episode, f"data/{name}") for name in ("chunk_index", "file_index")
        }
        path = str(self.info["data_path"]).format(**indices)
        file = _file(self.folder, path)
        columns = [*used, "timestamp", "frame_index"]
        rows = _rows_of(file, columns, filters=[("episode_index", "=", number)])
        which = f"the episode {number} of {self.folder}"
        told = episode.get("length")
        if not rows.num_rows or told not in (None, rows.num_rows):
            length = "" if told is None else f", and its length is {short_repr(told)}"
            raise RecordError(f"{which} has {rows.num_rows} frames in {path}{length}")
        has_number = "frame_index" in rows.column_names
        rows = rows.sort_by("frame_index" if has_number else "timestamp")
        times = _times(rows, fps, which)
        values = {name: _values(rows[name], name, self._names(name), which) for name in used}
        return _Frames(times, values)


@dataclass(frozen=True)
class _Frames:
    """The times of an episode's frames, s, and the numbers of each feature, (frames, numbers)."""

    times: Array
    values: Mapping[str, Array]


def _times(rows: pa.Table, fps: float, which: str) -> Array:
    """Returns the times of frames in their order, s."""
    numbers = np.arange(rows.num_rows)
    if "frame_index" in rows.column_names:
        told = rows["frame_index"].to_numpy()
        if (told != numbers).any():
            at = int(np.argmax(told != numbers))
            raise RecordError(
                f"{which} has a frame_index {told[at]} where {at} is due: the frames of an episode "
                "have to be numbered from 0, each once"
            )
    times = numbers / fps
    stamps = rows["timestamp"].to_numpy().astype(np.float64)
    # Beyond 5,000 frames per second the tolerance would hide a frame that is missing.
    allowed = min(_TOLERANCE, 0.5 / fps) + _ROUNDING * times
    agrees = np.abs(stamps - times) <= allowed  # a timestamp that is missing does not
    if not agrees.all():
        at = int(np.argmin(agrees))
        raise RecordError(
            f"{which} has the timestamp {stamps[at]:g} s at the frame {at}, which at {fps:g} "
            f"frames per second is at {times[at]:g} s: correct the timestamps, or fps in "
            "meta/info.json"
        )
    return times


def _values(column: pa.ChunkedArray, feature: str, names: Sequence[Any], which: str) -> Array:
    """Returns the numbers of a feature, (frames, names)."""
    kind, numbers = column.type, column
    is_list = pa.types.is_list(kind) or pa.types.is_large_list(kind)
    if is_list or pa.types.is_fixed_size_list(kind):
        lengths = pc.list_value_length(column).unique().to_pylist()
        kind, numbers = kind.value_type, pc.list_flatten(column)
    else:
        lengths = [1]
    if not (pa.types.is_floating(kind) or pa.types.is_integer(kind)):
        raise RecordError(
            f"{which}: the feature {feature} is of type {column.type}: it has to be a list of "
            f"{len(names)} numbers in each frame"
        )
    odd = next((length for length in lengths if length != len(names)), len(names))
    if odd != len(names) or column.null_count:
        raise RecordError(
            f"{which}: the feature {feature} has {odd or 'no'} numbers in a frame, and "
            f"{len(names)} names in meta/info.json"
        )
    return np.asarray(numbers.to_numpy(), dtype=np.float64).reshape(len(column), len(names))


def _poses(frames: _Frames, places: _Places) -> pa.Table:
    """Returns a row for each pose, as `ssduck.write_record` takes them."""
    ticks, count = len(frames.times), len(places)
    columns = {
        "time": np.repeat(frames.times, count),
        "name": pa.array([*places] * ticks),
    }
    defaults = dict(zip(POSE[3:], (1.0, 0.0, 0.0, 0.0), strict=True))
    for column in POSE:
        stacked = [
            frames.values[where[column][0]][:, where[column][1]]
            if column in where
            else np.full(ticks, defaults[column])
            for where in places.values()
        ]
        columns[column] = np.stack(stacked, axis=1).reshape(-1)
    return pa.table(columns)


def _rows_of(file: Path, columns: Sequence[str], **chosen: Any) -> pa.Table:
    """Returns the rows of a file, with those of the columns that it has."""
    names = pq.read_schema(file).names
    return pq.read_table(file, columns=[name for name in columns if name in names], **chosen)


def _file(folder: Path, name: str) -> Path:
    file = folder / name
    if not file.is_file():
        raise RecordError(f"{file} cannot be read: there is no such file")
    return file


def _read_json(file: Path) -> dict[str, Any]:
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise RecordError(f"{file} cannot be read: {error}") from error
    if not isinstance(content, dict):
        raise RecordError(f"{file} has no JSON object")
    return content
