"""Records a world to a folder of Parquet files until it is told to stop: `ParquetRecording`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Self

from ssduck.recording.episode import Episode
from ssduck.recording.recorder import Recorder
from ssduck.recording.spec import Recording
from ssduck.recording.stores.parquet import ParquetStore, write_tags
from ssduck.recording.tags import Tags, given_tags

if TYPE_CHECKING:
    from ssduck.world.world import World


class ParquetRecording:
    """A recording of a world to a folder, until it is closed.

    If the user resets the simulation, the recording goes on in a new episode.

    Attributes:
        world: the recorded world.
    """

    def __init__(
        self,
        world: World,
        recording: Recording,
        path: Path,
        name: str,
        part_ticks: int,
        recorders: list[Recorder],
        tags: Tags | None = None,
        order: int = 0,
    ) -> None:
        self.world = world
        self._order = order
        self._tags = tags
        self._recording, self._path, self._name = recording, path, name
        self._part_ticks = part_ticks
        self._recorders = recorders
        self._start()

    def _start(self) -> None:
        """Starts a new episode."""
        recording, world = self._recording, self.world
        self._folder = ParquetStore(
            self._path,
            self._name,
            recording,
            tags=self._tags,
            camera=world.camera,
            order=self._order,
        )
        self._recorder = Recorder(recording, self._folder, self._part_ticks, recording.flush_every)
        self._recorders.append(self._recorder)
        try:
            world.add_recorder(self._recorder)
        except BaseException:
            self._recorder.stop_flushing()
            self._recorder.wait()
            world.remove_recorder(self._recorder)
            self._recorders.remove(self._recorder)
            self._folder.discard()
            raise

    @property
    def is_running(self) -> bool:
        """Whether it is not closed."""
        return self._recorder in self._recorders

    def begin_episode(self) -> None:
        """Completes the episode, and goes on in a new one."""
        self.close()
        self._start()

    @property
    def number(self) -> int:
        """The number of the present episode."""
        return self._folder.run.number

    @property
    def episode(self) -> Episode:
        """The episode as it is on the disk so far."""
        return self._folder.run.episode

    def tag(self, tags: Tags) -> None:
        """Adds tags to the present episode, at any time, and replaces those of the same names.

        Args:
            tags: texts, True, False or finite numbers, by name.

        Raises:
            ArgumentError: a tag is another value.
            RecordError: the file that describes the episode cannot be written.
        """
        write_tags(self._folder.run, given_tags(tags))

    def flush(self) -> int | None:
        """Writes the buffered ticks to the disk; returns the last tick there, or None.

        Other programs than ssduck see them when the part that they belong to is complete.

        Raises:
            RecordError: they cannot be written, as the disk is full, say; they stay buffered.
        """
        with self.world.pinned():
            self._recorder.flush()
            return self._folder.last_tick

    def close(self) -> None:
        """Writes the buffered ticks, and ends the recording.

        Raises:
            RecordError: they cannot be written; the recording goes on, and can be closed again.
        """
        if not self.is_running:
            return
        self._recorder.mass_changes.warn(self.world)
        with self.world.pinned():
            self._recorder.finish()
        self._recorder.stop_flushing()
        self.world.remove_recorder(self._recorder)
        self._recorders.remove(self._recorder)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
