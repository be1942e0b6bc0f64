"""Writes episodes as a dataset of LeRobot, version 3.0.

    meta/info.json                            features, frames per second, counts
    meta/stats.json                           statistics of each feature
    meta/tasks.parquet                        the texts of the tasks
    meta/episodes/chunk-000/file-000.parquet  where each episode is, its task and statistics
    data/chunk-000/file-000.parquet           the frames, with a row group for each episode

A frame of a dataset is a tick. `observation.environment_state` has the poses of entities and links,
`observation.state` the positions of joints. Episodes of gymnasium environments have `action`,
`next.reward` and `next.done`; their last tick, after which there is no action, is no frame. A
record has no videos.

The layout is that of `LeRobotDatasetMetadata` in https://github.com/huggingface/lerobot, v3.0.
"""

from __future__ import annotations

import json
import math
import shutil
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from ssduck.errors import ArgumentError, RecordError
from ssduck.formatting import short_repr
from ssduck.geometry.arrays import Array, Indices
from ssduck.interchange.motion import Motion
from ssduck.schema import POSE

CODEBASE_VERSION = "v3.0"
POSES, JOINTS = "observation.environment_state", "observation.state"
ACTION, REWARD, DONE = "action", "next.reward", "next.done"
DATA_PATH = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
EPISODES_PATH = f"meta/episodes/{DATA_PATH.removeprefix('data/')}"
TASKS_PATH, INFO_PATH, STATS_PATH = "meta/tasks.parquet", "meta/info.json", "meta/stats.json"
# The number of files in a folder, and the size of a file, MiB.
CHUNK_SIZE, DATA_FILE_SIZE = 1000, 100
# Simulated times differ from whole frames by less, as a fraction of a frame.
_TOLERANCE = 1e-3
# The largest number of frames per second that is found in the times of ticks.
_MAX_FPS = 1_000_000
_ADVICE = "give the frames per second (--fps); a frame has the last tick until its time then"
_QUANTILES = {"q01": 0.01, "q10": 0.1, "q50": 0.5, "q90": 0.9, "q99": 0.99}
INDICES = ("frame_index", "episode_index", "index", "task_index")


def write_dataset(folder: Path, motions: Iterable[Motion], fps: int | None = None) -> Path:
    """Writes episodes as a dataset; all of it, or nothing."""
    try:
        if folder.exists() and any(folder.iterdir()):
            raise RecordError(f"{folder} is not empty: give a new folder")
        is_new = not folder.exists()
        folder.mkdir(parents=True, exist_ok=True)
        try:
            _Dataset(folder, fps, has_frame_per_tick=fps is None).write(motions)
        except BaseException:
            for name in ("meta", "data"):
                shutil.rmtree(folder / name, ignore_errors=True)
            if is_new:
                with suppress(OSError):  # someone else has put a file there
                    folder.rmdir()
            raise
    except OSError as error:
        if isinstance(error, RecordError):
            raise
        raise RecordError(f"{folder} cannot be written: {error.strerror}") from error
    return folder


@dataclass
class _Dataset:
    """A dataset that is being written."""

    folder: Path
    fps: int | None
    has_frame_per_tick: bool
    names: dict[str, list[str]] = field(default_factory=dict)
    tasks: dict[str, int] = field(default_factory=dict)
    episodes: list[dict[str, Any]] = field(default_factory=list)
    statistics: list[dict[str, dict[str, Any]]] = field(default_factory=list)
    robots: set[str] = field(default_factory=set)
    frames: int = 0

    def write(self, motions: Iterable[Motion]) -> None:
        """Writes the frames, then what describes them."""
        writer: pq.ParquetWriter | None = None
        file, size = 0, 0
        try:
            for motion in motions:
                rows, features = self._frames_of(motion)
                if writer is None or size > DATA_FILE_SIZE << 20:
                    if writer is not None:
                        writer.close()
                        file, size = file + 1, 0
                    writer = pq.ParquetWriter(self._file(DATA_PATH, file), rows.schema)
                writer.write_table(rows, row_group_size=max(rows.num_rows, 1))
                size += rows.nbytes
                self._add_episode(motion, rows.num_rows, file, features)
        finally:
            if writer is not None:
                writer.close()
        if not self.episodes:
            raise ArgumentError("there is no episode to write")
        self._write_metadata()

    def _file(self, pattern: str, number: int) -> Path:
        chunk, file = divmod(number, CHUNK_SIZE)
        place = self.folder / pattern.format(chunk_index=chunk, file_index=file)
        place.parent.mkdir(parents=True, exist_ok=True)
        return place

    def _frames_of(self, motion: Motion) -> tuple[pa.Table, dict[str, Array]]:
        """Returns the rows of an episode, and the values of its features."""
        which = f"episode {motion.run.number} of {motion.run.world!r}"
        if self.has_frame_per_tick:
            found = _frames_per_second(motion.times, which)
            if self.fps not in (None, found):
                raise ArgumentError(
                    f"{which} has {found} ticks per second, and the episodes before it "
                    f"{self.fps}: {_ADVICE}"
                )
            self.fps = found
        assert self.fps is not None
        chosen = _ticks_of_frames(motion.times, self.fps)
        outcomes = _outcomes(motion, chosen, self.fps, which)
        chosen = chosen[: len(outcomes[ACTION])] if outcomes else chosen
        features = _features(motion, chosen, which) | outcomes
        names = _names(motion)
        if not self.names:
            self.names = names
        for feature in (POSES, JOINTS, ACTION):
            here, others = names.get(feature, []), self.names.get(feature, [])
            if here != others:
                odd = sorted(set(here) ^ set(others)) or here
                raise ArgumentError(
                    f"{which} has other {feature} than the episodes before it, such as "
                    f"{short_repr(odd[0])}: a dataset has the same for all; write it apart"
                )
        count = len(chosen)
        task = self.tasks.setdefault(_task(motion), len(self.tasks))
        columns: dict[str, Any] = {name: _vectors(values) for name, values in features.items()}
        if outcomes:
            columns[DONE] = columns[DONE].cast(pa.bool_())
        numbers = np.arange(count)
        columns["timestamp"] = pa.array((numbers / self.fps).astype(np.float32))
        features["timestamp"] = (numbers / self.fps)[:, None]
        for name, values in zip(
            INDICES,
            (numbers, len(self.episodes) + 0 * numbers, self.frames + numbers, task + 0 * numbers),
            strict=True,
        ):
            columns[name] = pa.array(values, pa.int64())
            features[name] = values[:, None].astype(np.float64)
        self.robots |= {f.entity.name for f in motion.frames if f.entity.kind == "robot"}
        return pa.table(columns), features

    def _add_episode(
        self, motion: Motion, count: int, file: int, features: Mapping[str, Array]
    ) -> None:
        chunk, number = divmod(file, CHUNK_SIZE)
        statistics = {name: _statistics(values) for name, values in features.items()}
        self.statistics.append(statistics)
        self.episodes.append(
            {
                "episode_index": len(self.episodes),
                "tasks": [_task(motion)],
                "length": count,
                "data/chunk_index": chunk,
                "data/file_index": number,
                "dataset_from_index": self.frames,
                "dataset_to_index": self.frames + count,
                "meta/episodes/chunk_index": 0,
                "meta/episodes/file_index": 0,
                **{
                    f"stats/{name}/{kind}": value
                    for name, values in statistics.items()
                    for kind, value in values.items()
                },
                # Where it is from; readers ignore further columns.
                "ssduck/id": motion.run.id,
                "ssduck/world": motion.run.world,
                "ssduck/episode": motion.run.number,
                "ssduck/tags": json.dumps(dict(motion.run.tags), sort_keys=True),
            }
        )
        self.frames += count

    def _write_metadata(self) -> None:
        pq.write_table(pa.Table.from_pylist(self.episodes), self._file(EPISODES_PATH, 0))
        pq.write_table(_task_table(self.tasks), self.folder / TASKS_PATH)
        _write_json(self.folder / STATS_PATH, _joined(self.statistics))
        _write_json(self.folder / INFO_PATH, self._info())

    def _info(self) -> dict[str, Any]:
        features: dict[str, Any] = {
            name: {"dtype": "float64", "shape": [len(names)], "names": names}
            for name, names in self.names.items()
        }
        features["timestamp"] = {"dtype": "float32", "shape": [1], "names": None}
        if ACTION in self.names:
            features[REWARD] = {"dtype": "float64", "shape": [1], "names": None}
            features[DONE] = {"dtype": "bool", "shape": [1], "names": None}
        features |= {name: {"dtype": "int64", "shape": [1], "names": None} for name in INDICES}
        return {
            "codebase_version": CODEBASE_VERSION,
            "robot_type": ", ".join(sorted(self.robots)) or None,
            "total_episodes": len(self.episodes),
            "total_frames": self.frames,
            "total_tasks": len(self.tasks),
            "chunks_size": CHUNK_SIZE,
            "data_files_size_in_mb": DATA_FILE_SIZE,
            "video_files_size_in_mb": 200,
            "fps": self.fps,
            "splits": {"train": f"0:{len(self.episodes)}"},
            "data_path": DATA_PATH,
            "video_path": None,
            "features": features,
        }


def _write_json(file: Path, content: Mapping[str, Any]) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(json.dumps(content, indent=4) + "\n", encoding="utf-8")


def _task(motion: Motion) -> str:
    """Returns the text of an episode's task: its tag, or the name of the world."""
    return str(motion.run.tags.get("task", motion.run.world))


def _task_table(tasks: Mapping[str, int]) -> pa.Table:
    """Returns the tasks as pandas writes a frame whose index is the text."""
    rows = pa.table({"task_index": pa.array(tasks.values(), pa.int64()), "task": list(tasks)})
    columns = [
        {
            "name": name,
            "field_name": name,
            "pandas_type": kind,
            "numpy_type": dtype,
            "metadata": None,
        }
        for name, kind, dtype in (("task_index", "int64", "int64"), ("task", "unicode", "object"))
    ]
    about = {"index_columns": ["task"], "column_indexes": [], "columns": columns}
    return rows.replace_schema_metadata({"pandas": json.dumps(about)})


# -- frames -----------------------------------------------------------------------------------


def _frames_per_second(times: Array, which: str) -> int:
    """Returns the number of ticks per second of evenly spaced ticks."""
    steps = np.diff(times)
    if not len(steps):
        raise ArgumentError(f"{which} has one tick: {_ADVICE}")
    step = float(np.median(steps))
    fps = round(1.0 / step) if step > 1.0 / _MAX_FPS else 0
    if fps < 1 or abs(1.0 / step - fps) > _TOLERANCE * fps:
        raise ArgumentError(
            f"the ticks of {which} are {step:g} s apart, no fraction of 1 s: {_ADVICE}"
        )
    expected = times[0] + np.arange(len(times)) / fps
    if np.abs(times - expected).max() > _TOLERANCE / fps + 1e-9 * abs(times[-1]):
        raise ArgumentError(f"the ticks of {which} are not evenly spaced: {_ADVICE}")
    return fps


def _ticks_of_frames(times: Array, fps: int) -> Indices:
    """Returns the tick of each frame: the last one until its time, (frames,)."""
    count = math.floor((times[-1] - times[0]) * fps + _TOLERANCE) + 1
    moments = times[0] + (np.arange(count) + _TOLERANCE) / fps
    ticks: Indices = np.searchsorted(times, moments, side="right") - 1
    return ticks


def _features(motion: Motion, ticks: Indices, which: str) -> dict[str, Array]:
    missing = np.argwhere(np.isnan(motion.poses[ticks]).any(axis=2))
    if len(missing):
        tick, frame = missing[0].tolist()
        raise ArgumentError(
            f"{which}: {motion.names[frame]!r} has no pose at {motion.times[ticks[tick]]:g} s: a "
            "dataset has the same entities in each frame; export the others first (--entities)"
        )
    features = {POSES: motion.poses[ticks].reshape(len(ticks), -1)}
    if motion.joints:
        unknown = np.argwhere(np.isnan(motion.positions[ticks]))
        if len(unknown):
            name = motion.joints[int(unknown[0][1])]
            raise ArgumentError(
                f"{which}: the position of the joint {name!r} is not known throughout"
            )
        features[JOINTS] = motion.positions[ticks]
    return features


def _outcomes(motion: Motion, ticks: Indices, fps: int, which: str) -> dict[str, Array]:
    """Returns the action of each frame's step, the reward, in its last frame, and the end."""
    steps = motion.steps
    if steps is None or not steps.actions:
        return {}
    moments = motion.times[0] + (np.arange(len(ticks)) + _TOLERANCE) / fps
    places = np.searchsorted(np.array(steps.times), moments, side="right") - 1
    places = places[places < len(steps.actions)]
    missing = np.setdiff1d(np.arange(len(steps.actions)), places)
    if len(missing) or (places < 0).any():
        raise ArgumentError(
            f"{which} has {len(steps.actions)} steps with actions, and no frame in "
            f"{len(missing)} of them: give more frames per second (--fps)"
        )
    is_last = np.append(places[1:] != places[:-1], True)
    rewards = np.where(is_last, np.array(steps.rewards)[places], 0.0)
    done = np.arange(len(places)) == len(places) - 1
    return {
        ACTION: np.array(steps.actions)[places],
        REWARD: rewards[:, None],
        DONE: done[:, None].astype(np.float64),
    }


def _names(motion: Motion) -> dict[str, list[str]]:
    names = {POSES: [f"{frame}.{column}" for frame in motion.names for column in POSE]}
    if motion.joints:
        names[JOINTS] = list(motion.joints)
    if motion.steps is not None and motion.steps.actions:
        names[ACTION] = [f"action_{n}" for n in range(len(motion.steps.actions[0]))]
    return names


def _vectors(values: Array) -> pa.Array:
    """Returns rows of numbers as lists of a fixed length; a single number as itself."""
    flat = pa.array(np.ascontiguousarray(values).reshape(-1))
    return (
        flat if values.shape[1] == 1 else pa.FixedSizeListArray.from_arrays(flat, values.shape[1])
    )


# -- statistics -------------------------------------------------------------------------------


def _statistics(values: Array) -> dict[str, list[float] | list[int]]:
    result: dict[str, Any] = {
        "min": values.min(axis=0).tolist(),
        "max": values.max(axis=0).tolist(),
        "mean": values.mean(axis=0).tolist(),
        "std": values.std(axis=0).tolist(),
        "count": [len(values)],
    }
    quantiles = np.quantile(values, list(_QUANTILES.values()), axis=0)
    return result | {name: one.tolist() for name, one in zip(_QUANTILES, quantiles, strict=True)}


def _joined(episodes: Sequence[Mapping[str, Mapping[str, Any]]]) -> dict[str, dict[str, Any]]:
    """Returns the statistics of all episodes from those of each, as LeRobot joins them."""
    result = {}
    for name in episodes[0]:
        parts = {key: np.array([one[name][key] for one in episodes]) for key in episodes[0][name]}
        counts = parts["count"].astype(np.float64)
        total = counts.sum()
        mean = (parts["mean"] * counts).sum(axis=0) / total
        spread = parts["std"] ** 2 + (parts["mean"] - mean) ** 2
        joined: dict[str, Any] = {
            "min": parts["min"].min(axis=0).tolist(),
            "max": parts["max"].max(axis=0).tolist(),
            "mean": mean.tolist(),
            "std": np.sqrt((spread * counts).sum(axis=0) / total).tolist(),
            "count": [int(total)],
        }
        # Quantiles of parts do not give that of the whole: LeRobot takes their weighted mean.
        for key in _QUANTILES:
            joined[key] = ((parts[key] * counts).sum(axis=0) / total).tolist()
        result[name] = joined
    return result
