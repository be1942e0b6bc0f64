"""Upgrades records of older releases: `upgrade` writes them in the present format."""

from __future__ import annotations

from pathlib import Path

from ssduck.errors import RecordError, record_errors
from ssduck.interpreter.archives import episodes
from ssduck.interpreter.opening import open_record
from ssduck.recording.episode import Episode
from ssduck.recording.episode_steps import EpisodeSteps, recorded_steps
from ssduck.recording.folder_episodes import BegunEpisode, whole_record
from ssduck.recording.paths import expand_path
from ssduck.recording.stores.atomic_files import finish_folder, unfinished_folder
from ssduck.recording.stores.part_names import episode_number


@record_errors()
def upgrade(path: str | Path, output: str | Path) -> list[Episode]:
    """Writes all episodes of a record to a new folder, in the present format.

    All rows, the times of the starts, ids, tags and steps stay as they are. The files get the
    labels and checksums, episodes the ids, and tables the columns that older releases did not
    write; what was not recorded is NULL. The record itself stays. Episodes without ticks are left
    out. On a disk, the new folder is there when it is complete: until then it has another name,
    which begins with a dot, beside it. A process that is killed leaves that one.

    Args:
        path: the folder or the DuckDB file of the record.
        output: the new folder.

    Returns:
        The episodes of the new folder.

    Raises:
        RecordError: the record is damaged or of a later version than this ssduck, or has no ticks;
            or the folder is not new, or cannot be written.

    >>> import ssduck, tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     _ = ssduck.write_record(f"{folder}/old", ["cup"], {"cup": [0, 0, 1]}, [0.0])
    ...     [episode.world for episode in ssduck.upgrade(f"{folder}/old", f"{folder}/new")]
    ['world']
    """
    source, folder = expand_path(path).absolute(), expand_path(output).absolute()
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise RecordError(f"{folder} is there already: give a new folder")
    listed = [episode for episode in episodes(source) if episode.ticks]
    if not listed:
        raise RecordError(f"{source} has no episode with ticks")
    with_steps = set(recorded_steps(source) if source.is_dir() else ())
    place = unfinished_folder(folder)
    with whole_record(place, is_private=place != folder) as begun:
        for episode in listed:
            name = episode.world, episode.number
            # Before the episode is written, as the file may be damaged.
            steps = EpisodeSteps.read(source, *name) if name in with_steps else None
            _upgrade(source, episode, steps, place, begun)
        finish_folder(place, folder)
    return episodes(folder)


def _upgrade(
    source: Path,
    episode: Episode,
    steps: EpisodeSteps | None,
    folder: Path,
    begun: list[BegunEpisode],
) -> None:
    """Writes an episode to the new folder, and adds it to `begun`."""
    about = {"started": episode.started}
    if episode.id is not None:
        about["id"] = episode.id
    with open_record(source, episode.world, episode.number) as ss:
        database = ss._database  # noqa: SLF001  # it reads the record
        (world,) = database.worlds.values()
        ticks = database.export(world, folder, None, (None, None), begun, about=about)
    if steps is not None:
        steps.write(folder, episode.world, episode_number(ticks))
