"""The records of an interpreter: recording worlds, their past, exports to folders."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from ssduck import validation
from ssduck.adapters.result import Result
from ssduck.errors import ArgumentError, EvaluationError, record_errors
from ssduck.formatting import short_repr
from ssduck.interchange.macros import checked_distance, pair_query, write_pairs
from ssduck.interpreter.execution import Execution
from ssduck.interpreter.program import CompiledProgram
from ssduck.interpreter.triggers.registry import TriggerRegistry
from ssduck.recording.episode import Tags, given_tags
from ssduck.recording.folder_recording import ParquetRecording, whole_record
from ssduck.recording.paths import episode_number, expand_path
from ssduck.recording.replay.past import Past, past_of
from ssduck.recording.spec import Recording, no_ticks_message
from ssduck.recording.stores.parquet_layout import FolderRun
from ssduck.schema import RECORDABLE
from ssduck.world.entities import Entity
from ssduck.world.world import World

# The endings of files that `ssduck export` writes, and not the method.
_FILES_OF_COMMAND = (".mcap", ".rrd")
# What to write for arguments that other functions have, and `export` has not.
_INSTEAD_IN_EXPORT = {
    "format": "it writes Parquet; the command has others: ssduck export RECORD -o PATH --format "
    "mcap, of a record that it wrote",
    **dict.fromkeys(("folder", "output", "file"), "the folder is path"),
    **dict.fromkeys(("since", "begin", "until"), "the simulated times are start and end, s"),
}


class Records:
    """The records of an interpreter's worlds; its public methods are those of the interpreter.

    Args:
        execution: runs its programs.
        evaluate: returns the value of a program.
        sql: returns the rows of a statement of SQL.
        triggers: its triggers.
    """

    def __init__(
        self,
        execution: Execution,
        evaluate: Callable[[str | CompiledProgram], Any],
        sql: Callable[[str, Sequence[Any]], Result],
        triggers: TriggerRegistry,
    ) -> None:
        self._execution, self._evaluate, self._sql = execution, evaluate, sql
        self._triggers = triggers
        self._lock, self._database = execution.lock, execution.database
        self._database.observe_episodes(self)

    def record(
        self, world: str | World, recording: Recording | None, *, tags: Tags | None = None
    ) -> None:
        """Records the ticks of a world from now on, instead of as before.

        The recording begins with the current tick. The previous one is dropped, unless it is in a
        file.

        Args:
            world: the world, or the name of its variable.
            recording: the tables, entities and ticks to record; None for none.
            tags: what you say of the run: texts, True, False or finite numbers, by name.

        Raises:
            ArgumentError: the world is not of this interpreter, or lacks an entity of the
                recording; or a tag is another value.
            UnsupportedError: the world is itself a record.

        >>> import ssduck
        >>> with ssduck.load("kitchen") as ss:
        ...     ss.record("kitchen", ssduck.Recording(tables=("entities", "joints"), seconds=60.0))
        ...     ss.run(1.0, every=60)  # steps of 1/240 s
        ...     ss.past("kitchen").times
        [0.0, 0.25, 0.5, 0.75, 1.0]
        """
        validation.instance(recording, Recording, "record: recording")
        with self._lock:
            try:
                self._database.record(self._world(world), recording, given_tags(tags))
            finally:  # also if Ctrl-C came after the recording began: plans read the former one
                self._execution.planner.forget()

    def episode_began(self, world: World) -> None:
        """Records a world that the user has reset as a new episode; see `World.tick`."""
        with self._lock:
            try:
                self._database.begin_episode(world)
            finally:
                if self._database.is_recorded(world):  # plans read the former one
                    self._execution.planner.forget()
        self._triggers.episode_began(world)

    def past(self, world: str | World, age: float | None = None) -> Past:
        """Returns the past of a world, as `kitchen{age}` does: a source for queries.

        Args:
            world: the world, or the name of its variable.
            age: a simulated time from 0 up, s, or the time before now if negative; None for all
                ticks.

        Raises:
            EvaluationError: the world is not recorded, or not at that time.
            ArgumentError: the world is not of this interpreter, or the age is no finite number.

        >>> import ssduck
        >>> with ssduck.load("kitchen") as ss:
        ...     ss.run(1.0, every=60)  # steps of 1/240 s
        ...     _ = ss.add_variable("before", ss.past("kitchen", 0.5))
        ...     ss.eval("SELECT id, time FROM before WHERE id(this) == 'fridge';")
        [{'id': 'fridge', 'time': 0.5}]
        """
        with self._lock:
            chosen = self._world(world)
            seconds = None if age is None else validation.seconds(age)
            record = self._database.record_of(chosen)
            record.warn_of_dropped_ticks(seconds)
            return past_of(record, seconds)

    @record_errors()
    def record_to(
        self,
        path: str | Path,
        world: str | World | None = None,
        recording: Recording | None = None,
        *,
        tags: Tags | None = None,
    ) -> ParquetRecording:
        """Writes the ticks of a world to a folder of Parquet files from now on, as a new episode.

        The files are written part by part: however the recording ends, all parts but the last are
        complete.

        Args:
            path: the folder; it is made if it does not exist, and may hold other episodes.
            world: the world, or the name of its variable; None for the first world.
            recording: the tables, entities and ticks to write; None for all tables.
            tags: what you say of the run: texts, True, False or finite numbers, by name, such as
                `{"task": "pick", "success": True}`. `Episode.tags` gives them back.

        Returns:
            The running recording, to be closed: `with ss.record_to("run/"): …`.

        Raises:
            RecordError: the folder holds other files, or cannot be written.
            ArgumentError: the world is not of this interpreter, or lacks an entity of the
                recording; or a tag is another value.
        """
        recording = recording or Recording(tables=RECORDABLE)
        if recording.is_bounded:
            raise ArgumentError(
                "a folder keeps all ticks; seconds, ticks and max_bytes limit a history in "
                "memory only"
            )
        with self._lock:
            worlds = list(self._database.worlds.values())
            if world is None and not worlds:
                raise ArgumentError("there is no world to record")
            chosen = worlds[0] if world is None else self._world(world)
            # The working directory may change while the recording runs.
            folder = expand_path(path).absolute()
            return self._database.record_to(chosen, recording, folder, given_tags(tags))

    @record_errors()
    def export(
        self,
        /,  # `of_part` gives it by position, as others may have any name
        path: str | Path,
        world: str | World | None = None,
        *,
        entities: Iterable[str | Entity] | str | CompiledProgram | None = None,
        start: float | None = None,
        end: float | None = None,
        tags: Tags | None = None,
        pairs: float | None = None,
        **others: Any,
    ) -> dict[str, Path]:
        """Writes the records of worlds to a folder of Parquet files, each as a new episode.

        Args:
            path: the folder; it is made if it does not exist, and may hold other episodes.
            world: the world, or the name of its variable; None for all recorded worlds.
            entities: the entities to write, by name or as handles, or a program that gives them;
                None for all. A sensor includes the body that it is mounted on.
            start: the simulated time of the first tick, s.
            end: the simulated time of the last tick, s.
            tags: what you say of the runs, added to the tags of the records.
            pairs: a distance, m, to write also the table of the pairs of entities within it, for
                tools without ssduck; see `ssduck macros`.
            **others: an error, which says what to write.

        Returns:
            The folder of each episode's ticks, by the name of its world.

        Raises:
            ArgumentError: the path is that of a file of another format.
            RecordError: the folder holds other files, or cannot be written.
            EvaluationError: a world is not recorded, or not at that time.

        >>> import ssduck, tempfile
        >>> with ssduck.load("kitchen") as ss, tempfile.TemporaryDirectory() as folder:
        ...     ss.run(1.0, every=60)  # steps of 1/240 s
        ...     episodes = ss.export(folder, entities=["fridge"], start=0.5)
        ...     with ssduck.open(folder) as record:
        ...         episodes["kitchen"].name, record.past("kitchen").times
        ('episode=0', [0.5, 0.75, 1.0])
        """
        arguments = ("path", "world", "entities", "start", "end", "tags", "pairs")
        validation.no_others(others, "export", arguments, _INSTEAD_IN_EXPORT)
        named = (
            self._evaluate(entities) if isinstance(entities, str | CompiledProgram) else entities
        )
        names = None if named is None else _names(named)
        start, end = (None if time is None else validation.seconds(time) for time in (start, end))
        within = None if pairs is None else checked_distance(pairs)
        with self._lock:
            worlds = (
                [w for w in self._database.worlds.values() if self._database.is_recorded(w)]
                if world is None
                else [self._world(world)]
            )
            if not worlds:
                known = list(self._database.worlds)
                raise EvaluationError(no_ticks_message(known[0]) if known else "there is no world")
            folder, added_tags = expand_path(path), given_tags(tags)
            if folder.suffix in _FILES_OF_COMMAND:
                raise ArgumentError(
                    f"this writes a folder of Parquet files, and {folder.name} is the name of a "
                    f"file: ssduck export RECORD --format {folder.suffix[1:]} writes such files"
                )
            folders: dict[str, Path] = {}
            with whole_record(folder) as begun:
                for chosen in worlds:
                    folders[self._database.schema_of(chosen)] = self._database.export(
                        chosen, folder, names, (start, end), begun, added_tags
                    )
                if within is not None:
                    for name, ticks_folder in folders.items():
                        run = FolderRun(folder, name, episode_number(ticks_folder))
                        self._write_pairs(run, within)
            return folders

    def _write_pairs(self, run: FolderRun, within: float) -> None:
        """Writes the pairs of an exported episode within a distance, m."""
        _, ticks_and_times = run.ticks()
        ticks, entities = ticks_and_times.numbers, run.read("models/entities")["id"].to_numpy()
        rows = self._sql(pair_query(run.world), [within, int(ticks[0]), int(ticks[-1])]).arrow()
        # The record may have more ticks and entities than were exported.
        is_exported = np.isin(rows["tick"].to_numpy(), ticks)
        for side in ("a", "b"):
            is_exported &= np.isin(rows[side].to_numpy(), entities)
        write_pairs(run, rows.filter(pa.array(is_exported)), within)

    def flush(self) -> dict[str, int]:
        """Stores all recorded ticks; in a file they survive a crash.

        Returns:
            The last stored tick of each world, by its name.

        Raises:
            SqlError: the ticks cannot be stored, for example on a full disk; none of them is lost.
        """
        with self._lock:
            return self._database.flush()

    def _world(self, world: str | World) -> World:
        value = self._execution.variable(world) if isinstance(world, str) else world
        if not isinstance(value, World) or value not in self._database.worlds.values():
            raise ArgumentError(f"{short_repr(world)} is no world of this interpreter")
        return value


def _names(entities: Iterable[str | Entity]) -> tuple[str, ...]:
    names = []
    for entity in entities:
        if not isinstance(entity, str | Entity):
            raise ArgumentError(f"entities must be names or entities, not {short_repr(entity)}")
        names.append(entity if isinstance(entity, str) else entity.name)
    if not names:
        raise ArgumentError("there are no entities to write")
    return tuple(dict.fromkeys(names))
