"""The steps of an episode of a wrapped environment, and the files that keep them.

A record in a folder gets a file for each episode, `gym/sim-0.json` beside `episodes/sim-0.json`. It
has what the ticks do not: the seed and options of the reset, the terms, the values of variables,
and the action and the reward of each step.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from ssduck import validation
from ssduck.errors import ArgumentError, RecordError
from ssduck.formatting import short_repr
from ssduck.recording.episode import Tag
from ssduck.recording.paths import episodes_named
from ssduck.recording.stores.descriptions import Value, check_description, read_description
from ssduck.recording.stores.files import write_json

# The folder of these files in a record.
FOLDER = "gym"
VERSION = 1
_MAX_TIME = 1e300


def _is_numbers(value: Any) -> bool:
    return isinstance(value, list) and all(validation.is_number(number) for number in value)


def _are_times(value: Any) -> bool:
    return (
        _is_numbers(value)
        and all(abs(time) <= _MAX_TIME for time in value)
        and all(before <= after for before, after in pairwise(value))
    )


def _are_ticks(value: Any) -> bool:
    return (
        isinstance(value, list)
        and all(type(tick) is int and 0 <= tick < 1 << 53 for tick in value)
        and all(before < after for before, after in pairwise(value))
    )


def _are_actions(value: Any) -> bool:
    if value is None:
        return True
    is_list = isinstance(value, list) and all(map(_is_numbers, value))
    return is_list and len(set(map(len, value))) < 2


# What a file has of an episode.
_DESCRIPTION = {
    "version": Value("a number", lambda value: type(value) is int and value >= 1),
    "seed": Value(
        "an integer or null", lambda value: value is None or type(value) is int, is_required=False
    ),
    "terms": Value("an object", lambda value: isinstance(value, dict)),
    "times": Value("a list of finite times, in order", _are_times),
    "ticks": Value("a list of ticks, in order", _are_ticks),
    "variables": Value(
        "an object of lists",
        lambda value: (
            isinstance(value, dict) and all(isinstance(one, list) for one in value.values())
        ),
    ),
    "rewards": Value("a list of numbers", _is_numbers),
    "actions": Value("lists of equally many numbers, or null", _are_actions, is_required=False),
    "return": Value("a number", validation.is_number),
    "success": Value("true, false or null", lambda value: value in (True, False, None)),
}


class NewerStepsError(RecordError):
    """The steps of an episode are of a version that this ssduck does not read."""


@dataclass
class EpisodeSteps:
    """The steps of an episode."""

    terms: Mapping[str, Any]  # the texts of the terms
    seed: int | None = None  # the seed of the reset
    options: Any = None  # the options of the reset, as values of JSON; None if they are none
    # the simulated time of the tick at the reset and after each step, s
    times: list[float] = field(default_factory=list)
    ticks: list[int] = field(default_factory=list)  # the numbers of these ticks
    # the values of each variable at those ticks
    variables: dict[str, list[Any]] = field(default_factory=dict)
    rewards: list[float] = field(default_factory=list)  # the reward of each step
    # the action of each step, as numbers; None if they are others, or not recorded
    actions: list[list[float]] | None = field(default_factory=list)
    # whether the task was done after the last step; None without such a term
    success: bool | None = None

    def add_tick(self, number: int, time: float, variables: Mapping[str, Any]) -> None:
        """Adds a tick at a simulated time, s, with the values of the variables."""
        self.ticks.append(number)
        self.times.append(time)
        for name, value in variables.items():
            self.variables.setdefault(name, []).append(value)

    def add_action(self, numbers: list[float] | None) -> None:
        """Adds the action of a step, as `action_numbers` gives it."""
        if (
            numbers is None
            or self.actions is None
            or any(len(numbers) != len(one) for one in self.actions[:1])
        ):
            self.actions = None
        else:
            self.actions.append(numbers)

    @property
    def total(self) -> float:
        """The return: the sum of the rewards, in the order of the steps."""
        return float(sum(self.rewards))

    @property
    def tags(self) -> dict[str, Tag]:
        """The tags of the episode: `return`, as far as it is finite, `seed` and `success`."""
        tags: dict[str, Tag] = {"return": self.total} if math.isfinite(self.total) else {}
        if self.seed is not None:
            tags["seed"] = self.seed
        return tags if self.success is None else tags | {"success": self.success}

    def write(self, folder: Path, world: str, number: int) -> None:
        """Writes the file of the episode."""
        if not (_are_times(self.times) and _are_ticks(self.ticks)):
            raise RecordError(
                f"episode {number} of {world!r}: its ticks or their times fall, so that they are "
                "not of one episode; nothing is written of its steps"
            )
        content = {
            "version": VERSION,
            "seed": self.seed,
            "options": self.options,
            "success": self.success,
            "return": self.total,
            "terms": dict(self.terms),
            "times": self.times,
            "ticks": self.ticks,
            "variables": self.variables,
            "rewards": self.rewards,
            "actions": self.actions,
        }
        file = steps_file(folder, world, number)
        try:
            file.parent.mkdir(exist_ok=True)
            write_json(content, file)
        except OSError as error:
            raise RecordError(f"{file} cannot be written: {error.strerror}") from error

    @classmethod
    def read(cls, folder: Path, world: str, number: int) -> EpisodeSteps:
        """Returns the steps that a file keeps."""
        file = steps_file(folder, world, number)
        if not file.exists():
            raise RecordError(
                f"episode {number} of {world!r} has no steps of an environment, as "
                "QueryWrapper(record=…) writes them, so that it has no score; lake.ask answers "
                f"programs about any episode ({file} is not there)"
            )
        content = read_description(file)
        check_description(content, _DESCRIPTION, str(file), "the steps of the episode")
        if content["version"] > VERSION:
            raise NewerStepsError(
                f"{file} is of version {content['version']}; this ssduck reads those up to "
                f"{VERSION}: install a newer one"
            )
        times, variables, rewards = content["times"], content["variables"], content["rewards"]
        actions, ticks = content.get("actions"), content["ticks"]
        lengths = {len(times), len(ticks), len(rewards) + 1, *map(len, variables.values())}
        lengths |= set() if actions is None else {len(actions) + 1}
        if len(lengths) != 1:
            raise RecordError(f"{file} is damaged: its lists have different lengths")
        try:
            variables = {
                validation.identifier(name, "a variable"): [
                    plain(value, f"variables[{name!r}]") for value in values
                ]
                for name, values in variables.items()
            }
        except ArgumentError as error:
            raise RecordError(f"{file} is damaged: {error.message}") from error
        return cls(
            content["terms"],
            content.get("seed"),
            content.get("options"),
            times,
            ticks,
            variables,
            rewards,
            actions,
            content["success"],
        )


def steps_file(folder: Path, world: str, number: int) -> Path:
    """Returns the file of the steps of an episode of a record."""
    return folder / FOLDER / f"{world}-{number}.json"


def recorded_steps(folder: Path) -> list[tuple[str, int]]:
    """Returns the worlds and numbers of the episodes of which a record keeps the steps."""
    return episodes_named(folder / FOLDER)


def plain(value: Any, key: str) -> Any:
    """Returns the value of a variable as one of SelectScript and JSON."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, bool | str) or (isinstance(value, int) and abs(value) < 1 << 53):
        return value
    if isinstance(value, float):
        return value
    if isinstance(value, list | tuple):
        return [plain(item, key) for item in value]
    raise ArgumentError(
        f"{key} is {short_repr(value)}: a variable is True, False, a number, a text, or a list or "
        "an array of such"
    )


def action_numbers(action: Any) -> list[float] | None:
    """Returns an action as numbers, from an array of any shape; None if it has others."""
    try:
        numbers = np.asarray(action)
    except ValueError:  # parts of several shapes
        return None
    if numbers.dtype.kind not in "biuf":
        return None
    flat: list[float] = numbers.astype(np.float64).reshape(-1).tolist()
    return flat if all(map(math.isfinite, flat)) else None


def recordable(value: Any) -> Any:
    """Returns options of a reset as JSON can keep them: what it has no type for, as a text."""
    match value:
        case None | bool() | str() | int():
            return value
        case float():
            return value if math.isfinite(value) else str(value)
        case dict():
            return {str(key): recordable(item) for key, item in value.items()}
        case list() | tuple():
            return [recordable(item) for item in value]
        case np.ndarray() | np.generic():
            return recordable(value.tolist())
        case _:
            return short_repr(value)
