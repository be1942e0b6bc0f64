"""What an interpreter keeps of its worlds: recording them, their past, writing it to folders."""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from ssduck import validation
from ssduck.database.database import Database
from ssduck.errors import ArgumentError, EvaluationError
from ssduck.formatting import short_repr
from ssduck.interpreter.planner import Planner
from ssduck.interpreter.program import CompiledProgram
from ssduck.recording.paths import given_path
from ssduck.recording.replay.past import PastTicks, past_of
from ssduck.recording.spec import Recording
from ssduck.recording.stores.parquet import ParquetRecording
from ssduck.schema import RECORDABLE
from ssduck.world.entities import Entity
from ssduck.world.world import World


class RecordingMethods(ABC):
    """What an interpreter lets its users do with what is kept of its worlds."""

    _database: Database
    _lock: threading.RLock
    _planner: Planner

    @abstractmethod
    def variable(self, name: str) -> Any:
        """The value of a variable."""

    @abstractmethod
    def eval(self, program: str | CompiledProgram) -> Any:
        """Run a program."""

    def record(self, world: str | World, recording: Recording | None) -> None:
        """Keep the ticks of a world from now on: what of them, and for how long.

        It begins with the present tick. What was kept of the world before is dropped, but for
        that in a file.

        Args:
            world: the world, or the name of its variable.
            recording: what is kept; None for nothing.

        Raises:
            ArgumentError: it is no world of this interpreter, or has no entity of a name.
            UnsupportedError: it is a record itself.
        """
        if not isinstance(recording, Recording | None):
            raise ArgumentError(f"what is kept is told by a Recording, not {short_repr(recording)}")
        with self._lock:
            self._database.record(self._world(world), recording)
            self._planner.forget()

    def past(self, world: str | World, age: float | None = None) -> PastTicks:
        """What `kitchen{age}` is: a source for queries.

        Args:
            world: the world, or the name of its variable.
            age: seconds: from 0 up a simulated time, below 0 the time until now, None for all
                that is kept.

        Raises:
            EvaluationError: nothing is kept of it, or nothing of that time.
            ArgumentError: it is no world of this interpreter, or that is no finite number.
        """
        with self._lock:
            chosen = self._world(world)
            seconds = None if age is None else validation.seconds(age)
            return past_of(self._database.record_of(chosen), seconds)

    def record_to(
        self,
        path: str | Path,
        world: str | World | None = None,
        recording: Recording | None = None,
    ) -> ParquetRecording:
        """Write the ticks of a world to a folder of Parquet files from now on, as a new episode.

        What is written is sealed in parts: whatever ends the recording, all but the last part is
        there, and it is whole.

        Args:
            path: the folder; it is made if it is not there, and may hold other episodes.
            world: the world, or the name of its variable; None for the first one.
            recording: what is written; None for all tables.

        Returns:
            What writes them, until it is closed: `with ss.record_to("run/"): …`.

        Raises:
            RecordError: the folder has something else in it, or cannot be written.
            ArgumentError: it is no world of this interpreter, or has no entity of a name.
        """
        recording = recording or Recording(tables=RECORDABLE)
        if recording.is_bounded:
            raise ArgumentError("a folder keeps all: seconds and ticks are for a history in memory")
        with self._lock:
            worlds = list(self._database.worlds.values())
            if world is None and not worlds:
                raise ArgumentError("there is no world to be recorded")
            chosen = worlds[0] if world is None else self._world(world)
            # Whoever records may go to another working directory meanwhile.
            return self._database.record_to(chosen, recording, given_path(path).absolute())

    def export(
        self,
        path: str | Path,
        world: str | World | None = None,
        *,
        entities: Iterable[str | Entity] | str | CompiledProgram | None = None,
        start: float | None = None,
        end: float | None = None,
    ) -> dict[str, Path]:
        """Write what is kept of worlds to a folder of Parquet files, each as a new episode.

        Args:
            path: the folder; it is made if it is not there, and may hold other episodes.
            world: the world, or the name of its variable; None for all that are recorded.
            entities: those that are written, by name or as handles, or a program that yields
                them; None for all. A sensor brings the body that it sits on.
            start: simulated time from which on ticks are written, s.
            end: and until which.

        Returns:
            The folder of each episode's ticks, by the name of its world.

        Raises:
            RecordError: the folder has something else in it, or cannot be written.
            EvaluationError: nothing is kept of a world, or nothing of that time.
        """
        chosen = self.eval(entities) if isinstance(entities, str | CompiledProgram) else entities
        names = None if chosen is None else _names(chosen)
        start, end = (None if time is None else validation.seconds(time) for time in (start, end))
        with self._lock:
            worlds = (
                [w for w in self._database.worlds.values() if self._database.keeps(w)]
                if world is None
                else [self._world(world)]
            )
            if not worlds:
                raise EvaluationError("no world is recorded here")
            database, place = self._database, given_path(path)
            return {
                database.schema_of(each): database.export(each, place, names, (start, end))
                for each in worlds
            }

    def flush(self) -> dict[str, int]:
        """Store what is recorded; in a file it survives whatever happens then.

        Returns:
            The last tick of each world, by its name.

        Raises:
            SqlError: it cannot be stored, for the disk is full, say; nothing is lost by that.
        """
        with self._lock:
            return self._database.flush()

    def _world(self, world: str | World) -> World:
        found = self.variable(world) if isinstance(world, str) else world
        if not isinstance(found, World) or found not in self._database.worlds.values():
            raise ArgumentError(f"{short_repr(world)} is no world of this interpreter")
        return found


def _names(entities: Iterable[str | Entity]) -> tuple[str, ...]:
    """The names of entities that are given by name or as handles."""
    found = []
    for entity in entities:
        if not isinstance(entity, str | Entity):
            raise ArgumentError(f"entities are to be names or entities, not {short_repr(entity)}")
        found.append(entity if isinstance(entity, str) else entity.name)
    if not found:
        raise ArgumentError("there are no entities to be written")
    return tuple(dict.fromkeys(found))
