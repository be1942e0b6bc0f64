"""The files of an episode as its manifest lists them, table by table."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache

from ssduck.errors import RecordError
from ssduck.lakes.manifest import EpisodeEntry
from ssduck.recording.paths import expand_path
from ssduck.recording.stores.batched_parts import BatchedFile
from ssduck.recording.stores.object_store import ObjectPath
from ssduck.recording.stores.part_names import label_of, part_name


class EntryFiles:
    """The parts of an episode.

    Args:
        entry: the episode.
        key: the text that its labels have of it.
    """

    def __init__(self, entry: EpisodeEntry, key: str) -> None:
        self.key = key
        self._path = entry.path
        self._end = f"/world={entry.world}/episode={entry.episode}"
        self._sums: dict[str, dict[str, int]] = {}
        for file in entry.files:
            folder, _, name = file.name.rpartition("/")
            self._sums.setdefault(folder, {})[name] = file.checksum

    def parts(self, table: str) -> list[BatchedFile]:
        """Returns the files of a table, or of a model such as `models/links`, in their order.

        Raises:
            RecordError: there are none, or others than complete parts.
        """
        folder = f"{table}{self._end}"
        sums: Mapping[str, int] = self._sums.get(folder, {})
        names = [part_name(number) for number in range(len(sums))]
        if not names or sorted(sums) != names:
            raise RecordError(f"{self._path}/{folder} has other files than complete parts")
        place = f"{_resolved(self._path)}/{folder}"
        return [
            BatchedFile(f"{place}/{name}", sums[name], label_of(self.key, table, number), table)
            for number, name in enumerate(names)
        ]


@lru_cache(maxsize=1024)
def _resolved(path: str) -> str:
    """Returns the path of a record without links."""
    place = expand_path(path).resolve()
    return str(place) if isinstance(place, ObjectPath) else place.as_posix()
