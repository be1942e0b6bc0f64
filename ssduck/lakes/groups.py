"""Episodes of one group, of which one stands for the models of all.

A manifest says which are, from the rows of their models, and has the checksums of their files.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache

from ssduck.errors import RecordError
from ssduck.lakes.manifest import EpisodeEntry
from ssduck.recording.paths import expand_path, part_name
from ssduck.recording.static_tables import run_of
from ssduck.recording.stores.batched_parts import BatchedFile
from ssduck.recording.stores.object_store import ObjectPath
from ssduck.recording.stores.parquet_layout import FolderRun
from ssduck.recording.stores.summaries import StoredFile
from ssduck.schema import MODELS


class EpisodeGroup:
    """The episodes with the models, tables and entities of one of them.

    Args:
        entry: the episode.

    Attributes:
        run: the episode.
        models: the rows of each model.
        number: the number of its run.

    Raises:
        RecordError: its models cannot be read.
    """

    def __init__(self, entry: EpisodeEntry) -> None:
        self.run = _run_of(entry)
        self.models = {table: self.run.read(f"models/{table}") for table in MODELS}
        self.number = run_of(self.models) or 0
        # The files of the episodes whose descriptions were read.
        self._described: dict[tuple[str, str, int], tuple[StoredFile, ...]] = {}

    def files_of(self, entry: EpisodeEntry) -> EntryFiles:
        """Returns the files of an episode of the group.

        Raises:
            RecordError: its description is damaged, or was edited and is another than the group's.
        """
        if self._described.get(entry.key) != entry.files:
            run = _run_of(entry)
            if _description(run) != _description(self.run):
                raise RecordError(f"{run.about_file} describes another recording than its group's")
            self._described[entry.key] = entry.files
        return EntryFiles(entry)


def _run_of(entry: EpisodeEntry) -> FolderRun:
    return FolderRun(expand_path(entry.path), entry.world, entry.episode)


def _description(run: FolderRun) -> tuple[object, ...]:
    """Returns what the description of an episode has in common with others of its group."""
    return run.world, run.tables, run.recording, run.description.get("camera")


class EntryFiles:
    """The parts of an episode, as its entry has them."""

    def __init__(self, entry: EpisodeEntry) -> None:
        self._path = entry.path
        self._end = f"/world={entry.world}/episode={entry.episode}"
        self._sums: dict[str, dict[str, int]] = {}
        for file in entry.files:
            folder, _, name = file.name.rpartition("/")
            self._sums.setdefault(folder, {})[name] = file.checksum

    def parts(self, table: str) -> list[BatchedFile]:
        """Returns the files of a table, in their order."""
        folder = f"{table}{self._end}"
        sums: Mapping[str, int] = self._sums.get(folder, {})
        names = [part_name(number) for number in range(len(sums))]
        if not names or sorted(sums) != names:
            raise RecordError(f"{self._path}/{folder} has other files than complete parts")
        place = f"{_resolved(self._path)}/{folder}"
        return [BatchedFile(f"{place}/{name}", sums[name], table) for name in names]


@lru_cache(maxsize=1024)
def _resolved(path: str) -> str:
    """Returns the path of a record without links."""
    place = expand_path(path).resolve()
    return str(place) if isinstance(place, ObjectPath) else place.as_posix()
