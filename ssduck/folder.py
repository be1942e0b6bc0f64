"""Records as folders of Parquet files.

    run/
      ssduck.json                                             what this is, its version, the units
      episodes/kitchen-0.json                                 what is recorded of which world
      entities/world=kitchen/episode=0/part-000000.parquet    a table, in sealed parts
      links/… joints/… shapes/… contacts/… sensings/… ticks/…
      models/entities/world=kitchen/episode=0/part-000000.parquet    what the entities are

A folder such as `run/entities` is read by DuckDB, polars and pandas as it is: its rows are those
of the table at each tick, and the world and the episode are columns by the folders' names.

A part is written under another name, which begins with a dot, and gets its own when it is
complete; its ticks come last. So a part whose ticks are there is whole, whatever happened, and
one whose ticks are not there is not counted.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from ssduck.errors import RecordError, nearest
from ssduck.geometry import Geometry
from ssduck.layout import Member
from ssduck.models import KEYS, models_of, told_of
from ssduck.recording import FRAMES, Recorder, Recording
from ssduck.tables import TABLES

if TYPE_CHECKING:
    from ssduck.world import World

FORMAT = "ssduck record"
VERSION = 1
UNITS = {
    "position": "m",
    "angle": "rad",
    "time": "s",
    "mass": "kg",
    "force": "N",
    "frame": "world, z up as the scene has it",
    "quaternion": "w, x, y, z",
}
# So many ticks make a part, if nobody asks for it before.
PART_TICKS = 2400
_ABOUT = "ssduck.json"
_PART = re.compile(r"part-(\d{6,})\.parquet")


@dataclass(frozen=True)
class Episode:
    """A run that is recorded in a folder.

    Attributes:
        path: the folder.
        world: the name of the world.
        number: of the episode, from 0.
        tables: those that are recorded.
        started: when, in ISO 8601.
        recording: what was kept of the ticks.
    """

    path: Path
    world: str
    number: int
    tables: tuple[str, ...]
    started: str
    recording: dict[str, Any] = field(default_factory=dict)

    def place(self, table: str) -> Path:
        """Where the parts of a table are; `models/entities` and the like are tables, too."""
        return self.path / table / f"world={self.world}" / f"episode={self.number}"

    @cached_property
    def parts(self) -> list[int]:
        """The numbers of the parts that are whole."""
        return _numbers(self.place("ticks"))

    def files(self, table: str) -> list[Path]:
        """The files of a table, of whole parts only.

        Raises:
            RecordError: one is missing.
        """
        is_model = table.startswith("models/")
        found = _numbers(self.place(table)) if is_model else self.parts
        files = [self.place(table) / _part(number) for number in found]
        for file in files:
            if not file.is_file():
                raise RecordError(
                    f"{file} is missing: the record {self.path} was damaged, or only copied in part"
                )
        return files

    def read(self, table: str, columns: Collection[str] | None = None) -> pa.Table:
        """All rows of a table.

        Raises:
            RecordError: a file is damaged.
        """
        found = []
        for file in self.files(table):
            try:
                found.append(pq.ParquetFile(file).read(columns and list(columns)))
            except (pa.ArrowException, OSError, KeyError) as error:
                raise RecordError(f"{file} cannot be read: it is damaged: {error}") from error
        if not found:
            raise RecordError(f"{self.place(table)} holds no whole part: nothing was stored")
        return pa.concat_tables(found)


def _numbers(place: Path) -> list[int]:
    if not place.is_dir():
        return []
    found = [_PART.fullmatch(file.name) for file in place.iterdir()]
    return sorted(int(match.group(1)) for match in found if match)


def _part(number: int) -> str:
    return f"part-{number:06d}.parquet"


# -- reading ----------------------------------------------------------------------------------


def episodes(path: str | Path) -> list[Episode]:
    """The episodes in a folder, by world and number.

    Raises:
        RecordError: it is no record, a damaged one, or one of a newer version.
    """
    folder = Path(path)
    _check(folder)
    found = [_episode(folder, file) for file in (folder / "episodes").glob("*.json")]
    return sorted(found, key=lambda episode: (episode.world, episode.number))


def is_folder(path: str | Path) -> bool:
    """Whether there is a folder of that name."""
    return Path(path).is_dir()


def _check(folder: Path) -> None:
    if not folder.is_dir():
        raise RecordError(f"there is no folder {folder}")
    about = folder / _ABOUT
    if not about.is_file():
        raise RecordError(f"{folder} is no record of ssduck: it has no {_ABOUT}")
    told = _json(about)
    if told.get("format") != FORMAT:
        raise RecordError(f"{folder} is no record of ssduck: {about} is of another format")
    number = told.get("version")
    if type(number) is not int or number < 1:
        raise RecordError(f"{about} is damaged: it tells no version")
    if number > VERSION:
        raise RecordError(
            f"{folder} is a record of version {number}; this ssduck reads those up to {VERSION}: "
            "install a newer one"
        )


def _episode(folder: Path, file: Path) -> Episode:
    told = _json(file)
    try:
        return Episode(
            folder,
            told["world"],
            told["episode"],
            tuple(told["tables"]),
            told["started"],
            told.get("recording", {}),
        )
    except (KeyError, TypeError) as error:
        raise RecordError(f"{file} is damaged: {error!r} is missing or of another type") from error


def _json(file: Path) -> dict[str, Any]:
    try:
        told = json.loads(file.read_text("utf-8"))
    except (OSError, ValueError) as error:
        raise RecordError(f"{file} cannot be read: {error}") from error
    if not isinstance(told, dict):
        raise RecordError(f"{file} is damaged: it holds no object")
    return told


def chosen_episode(found: list[Episode], world: str | None, number: int | None) -> Episode:
    """One of the episodes of a folder: the last one of a world, or that of a number.

    Raises:
        RecordError: there is none such.
    """
    own = [episode for episode in found if world in (None, episode.world)]
    if not own:
        worlds = sorted({episode.world for episode in found})
        raise RecordError(
            f"nothing of a world {world!r} is recorded", suggestions=nearest(str(world), worlds)
        )
    if number is None:
        return own[-1]
    for episode in own:
        if episode.number == number:
            return episode
    known = ", ".join(str(episode.number) for episode in own)
    raise RecordError(f"there is no episode {number} of {own[0].world!r}; there are {known}")


# -- writing ----------------------------------------------------------------------------------


class Folder:
    """Writes an episode of a world into a folder (`ssduck.recording.Store`).

    Args:
        path: the folder; it is made if it is not there.
        world: what the world is called.
        recording: what is kept of its ticks.

    Raises:
        RecordError: there is a folder with something else in it, or it cannot be written.
    """

    keeps = False

    def __init__(self, path: str | Path, world: str, recording: Recording) -> None:
        self.path = Path(path)
        frames = () if "links" in recording.tables else (FRAMES,)
        self.tables = ("ticks", *recording.tables, *frames)
        self.episode = _begun(self.path, world, self.tables, recording)
        self._models: dict[str, pa.Table] = {}
        self._geometries: set[int] = set()
        self._count = self._told = 0
        self.last_tick: int | None = None

    def add_members(
        self, members: Collection[Member], geometry_id: Callable[[Geometry], int]
    ) -> None:
        """Keep what entities are, before rows of theirs; geometries by their numbers."""
        for table, rows in models_of(members, geometry_id, self._geometries).items():
            before = self._models.get(table)
            self._models[table] = rows if before is None else pa.concat_tables([before, rows])
            self._write(f"models/{table}", self._told, rows)
        self._geometries |= set(self._models["geometries"]["id"].to_pylist())
        self._told += 1

    def add(self, rows: Mapping[str, pa.Table]) -> None:
        """Keep the rows of whole ticks as a part, all or none of them."""
        for table, own in rows.items():
            if table != "ticks":
                self._write(table, self._count, self._whole(table, own, rows["entities"]))
        self._write("ticks", self._count, rows["ticks"])
        self._count += 1
        self.last_tick = int(np.max(rows["ticks"]["tick"].to_numpy()))

    def _whole(self, table: str, rows: pa.Table, entities: pa.Table) -> pa.Table:
        """The rows with what is fixed, as the table has them."""
        if table not in KEYS:
            return rows
        if table == "links":
            rows = pa.concat_tables([rows, self._bodies_as_links(rows, entities)])
        names = [column.name for column in TABLES[table]]
        flags = [name for name in ("enabled", "visible") if name in rows.column_names]
        for name in flags:
            place = rows.column_names.index(name)
            rows = rows.set_column(place, name, rows[name].cast(pa.bool_()))
        return told_of(table, rows, self._models[table], names)

    def _bodies_as_links(self, links: pa.Table, entities: pa.Table) -> pa.Table:
        """The links of bodies that have one: they are as the body."""
        model = self._models["entities"]
        single = model.filter(pa.array(model["links"].to_numpy() == 1))["id"].to_numpy()
        own = entities.filter(pa.array(np.isin(entities["id"].to_numpy(), single)))
        number = pa.array(np.zeros(own.num_rows, dtype=np.int64))
        named = own.rename_columns({"id": "entity"}).append_column("link", number)
        return named.select(links.column_names)

    def _write(self, table: str, number: int, rows: pa.Table) -> None:
        place = self.episode.place(table)
        try:
            place.mkdir(parents=True, exist_ok=True)
            _seal(place / _part(number), lambda file: _write_parquet(rows, file))
        except OSError as error:
            raise RecordError(
                f"{place} cannot be written: {error}; what was stored before is whole"
            ) from error

    def drop_before(self, tick: int) -> int:  # noqa: ARG002
        """Drop nothing: a folder keeps all."""
        return 0

    def fetch(self, table: str, first: int, last: int) -> pa.Table:  # noqa: ARG002
        """Refuse: what is in a folder is read by opening it."""
        raise RecordError(f"{table}: open {self.path} to read what is recorded there")

    def near(self, asked: Any, waiting: pa.Table | None) -> pa.Table:  # noqa: ARG002
        """Refuse, as `fetch`."""
        raise RecordError(f"open {self.path} to read what is recorded there")


class FolderRecording:
    """The ticks of a world on their way to a folder, until it is closed.

    Args:
        world: whose ticks.
        recorder: keeps them.
        folder: where to.
        recorders: those whose rows are stored at the end; it is one of them.

    Attributes:
        episode: what is written.
    """

    def __init__(
        self, world: World, recorder: Recorder, folder: Folder, recorders: list[Recorder]
    ) -> None:
        self.episode = folder.episode
        self._world = world
        self._recorder = recorder
        self._folder = folder
        self._recorders = recorders

    def flush(self) -> int | None:
        """Write what waits as a part; tells the last tick that is on the disk, None for none.

        Raises:
            RecordError: it cannot be written, for the disk is full, say; nothing is lost by that.
        """
        with self._world.held():
            self._recorder.flush()
            return self._folder.last_tick

    def close(self) -> None:
        """Write what waits, and record no more."""
        if self._recorder not in self._recorders:
            return
        self.flush()
        self._world.forget(self._recorder)
        self._recorders.remove(self._recorder)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _begun(path: Path, world: str, tables: Collection[str], recording: Recording) -> Episode:
    """A new episode in a folder."""
    try:
        path.mkdir(parents=True, exist_ok=True)
        if not (path / _ABOUT).exists():
            if any(path.iterdir()):
                raise RecordError(f"{path} has something else in it, and is no record of ssduck")
            told = {"format": FORMAT, "version": VERSION, "units": UNITS}
            _seal(path / _ABOUT, lambda file: _write_json(told, file))
        _check(path)
        (path / "episodes").mkdir(exist_ok=True)
        return _claimed(path, world, tables, recording)
    except OSError as error:
        raise RecordError(f"{path} cannot be written: {error}") from error


def _claimed(path: Path, world: str, tables: Collection[str], recording: Recording) -> Episode:
    """An episode of a number that no other process takes."""
    number = 0
    while True:
        file = path / "episodes" / f"{world}-{number}.json"
        try:
            with file.open("x", encoding="utf-8"):
                break
        except FileExistsError:
            number += 1
    kept = {"every": recording.every, "entities": recording.entities}
    started = datetime.now(UTC).isoformat(timespec="seconds")
    told = {
        "world": world,
        "episode": number,
        "tables": list(tables),
        "started": started,
        "recording": kept,
    }
    _seal(file, lambda stream: _write_json(told, stream))
    return Episode(path, world, number, tuple(tables), started, kept)


def _seal(place: Path, write: Callable[[Path], None]) -> None:
    """Write a file under another name, and give it its own when it is on the disk."""
    unfinished = place.with_name(f".{place.name}.unfinished")
    write(unfinished)
    with unfinished.open("rb+") as file:
        os.fsync(file.fileno())
    unfinished.replace(place)
    _sync_folder(place.parent)


def _sync_folder(folder: Path) -> None:
    """See to it that the names in a folder are on the disk, where the system can."""
    if os.name != "posix":
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _write_json(told: Mapping[str, Any], file: Path) -> None:
    file.write_text(json.dumps(told, indent=2) + "\n", encoding="utf-8")


def _write_parquet(rows: pa.Table, file: Path) -> None:
    texts = [f.name for f in rows.schema if pa.types.is_string(f.type)]
    keys = [f.name for f in rows.schema if pa.types.is_integer(f.type)]
    pq.write_table(rows, file, compression="zstd", use_dictionary=[*texts, *keys])
