"""Writes the history of a batch as episodes of a record, which a lake asks."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ssduck import validation
from ssduck.errors import ArgumentError, ProgramWarning, warn
from ssduck.geometry.arrays import Indices
from ssduck.interpreter.interpreter import Interpreter
from ssduck.recording.spec import Recording
from ssduck.schema import RECORDABLE
from ssduck.simulators.environments import to_numpy
from ssduck.world.batches.batch_world import BatchWorld, PastEpisode

# The tag that has the number of an episode's environment.
ENVIRONMENT = "environment"


def export_batch(
    world: BatchWorld, path: str | Path, environments: Any, tags: Mapping[str, Any] | None
) -> list[int]:
    """Writes the history of environments as episodes; see `Interpreter.export_batch`."""
    numbers = world.numbers(environments, "export_batch")
    of_each = _tags_of_each(world, tags, numbers)
    episodes = [episode for number in numbers.tolist() for episode in world.past_episodes(number)]
    if not all(states.has_times for episode in episodes for states in episode.states):
        raise ArgumentError(
            "export_batch: an episode needs the simulated time of its ticks: give tick time=…"
        )
    if not all(episode.is_whole for episode in episodes):
        warn(
            "export_batch: older ticks were dropped, so that some episodes lack their beginning; "
            "World.batch(…, history=…) keeps more",
            ProgramWarning,
        )
    return [_export(world, path, one, of_each[one.environment]) for one in episodes]


def _tags_of_each(
    world: BatchWorld, tags: Mapping[str, Any] | None, numbers: Indices
) -> dict[int, dict[str, Any]]:
    result: dict[int, dict[str, Any]] = {n: {ENVIRONMENT: n} for n in numbers.tolist()}
    for name, value in validation.mapping(tags, "export_batch: tags are a dict by name").items():
        if isinstance(value, str | bool | int | float):
            values: list[Any] = [value] * world.count
        else:
            values = to_numpy(value, f"export_batch: tags[{name!r}]").tolist()
        if np.ndim(values) != 1 or len(values) != world.count:
            raise ArgumentError(
                f"export_batch: tags[{name!r}] is one value, or an array with one for each of the "
                f"{world.count} environments"
            )
        for number, own in result.items():
            own[name] = values[number]
    return result


def _export(
    world: BatchWorld, path: str | Path, episode: PastEpisode, tags: Mapping[str, Any]
) -> int:
    """Writes an episode; returns its number."""
    knows_contacts = all(states.knows_contacts for states in episode.states)
    tables = tuple(table for table in RECORDABLE if table != "contacts" or knows_contacts)
    ticks = world.replay(episode)
    own = next(ticks)
    with Interpreter(recording=None) as ss:
        ss.add_variable(world.name, own)
        with ss.record_to(path, own, Recording(tables=tables), tags=tags) as recording:
            for _ in ticks:
                pass
    return recording.number
