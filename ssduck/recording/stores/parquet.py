"""Writing records as folders of Parquet files, in sealed parts (see `parquet_layout`)."""

from __future__ import annotations

import json
import os
import secrets
import shutil
from collections.abc import Callable, Collection, Mapping
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from ssduck.errors import RecordError
from ssduck.formatting import short_repr
from ssduck.geometry.shapes import Geometry
from ssduck.recording.background_writer import WHENEVER, Cut
from ssduck.recording.episode import Episode
from ssduck.recording.recorder import Recorder
from ssduck.recording.spec import Recording
from ssduck.recording.static_tables import ShapeNumbers, model_rows, with_model
from ssduck.recording.stores.base import TickStore
from ssduck.recording.stores.parquet_layout import (
    ABOUT,
    FORMAT,
    UNITS,
    VERSION,
    FolderRun,
    check_about,
    part_name,
)
from ssduck.schema import MODELS, TABLES, recorded_tables
from ssduck.world.layout import EntityInfo

if TYPE_CHECKING:
    from ssduck.world.world import World

# So many ticks make a part, if nobody asks for it before.
PART_TICKS = 2400
# So many bytes the name of a file may have, where the system does not tell.
_NAME_MAX = 255


class ParquetStore(TickStore):
    """An episode of a world that is written into a folder of Parquet files.

    Its rows are read when the folder is opened (`ssduck.recording.stores.parquet_archive`).

    Args:
        path: the folder; it is made if it is not there.
        world: what the world is called.
        recording: what is kept of its ticks.

    Raises:
        RecordError: there is a folder with something else in it, or it cannot be written.
    """

    def __init__(self, path: str | Path, world: str, recording: Recording) -> None:
        self.path = Path(path)
        self.recording = recording
        self.tables = recorded_tables(recording.tables)
        self.run = _begun(self.path, world, self.tables, recording)
        self._models: dict[str, pa.Table] = {}
        self._geometries: set[int] = set()
        self._count = self._told = 0
        self.last_tick: int | None = None

    def add_members(self, members: Collection[EntityInfo], numbers: ShapeNumbers) -> None:
        """Keep what entities are, all or none of it."""
        models = model_rows(members, numbers, self._geometries)
        for table in sorted(models, key=lambda table: table == "entities"):
            self._write(f"models/{table}", self._told, models[table])
        for table, rows in models.items():
            before = self._models.get(table)
            self._models[table] = rows if before is None else pa.concat_tables([before, rows])
        self._geometries |= set(models["geometries"]["id"].to_pylist())
        self._told += 1

    def add(self, rows: Mapping[str, pa.Table], cut: Cut = WHENEVER) -> None:
        """Keep the rows of whole ticks as a part, all or none of them."""
        if not self._told:  # the world is empty
            self.add_members((), _NoNumbers())
        for table, own in rows.items():
            if table != "ticks":
                self._write(table, self._count, self._whole(table, own, rows["entities"]))
        with cut:
            self._write("ticks", self._count, rows["ticks"])
            self._count += 1
            self.last_tick = int(np.max(rows["ticks"]["tick"].to_numpy()))

    def finish(self) -> None:
        """Note how many parts there are, so that it is noticed if some get lost.

        Raises:
            RecordError: that cannot be written.
        """
        parts = {"ticks": self._count, "models": self._told}
        try:
            told = json.loads(self.run.about.read_text("utf-8")) | {"parts": parts}
            _seal(self.run.about, lambda stream: _write_json(told, stream))
        except OSError as error:
            raise RecordError(f"{self.run.about} cannot be written: {error}") from error

    def discard(self) -> None:
        """Take back all of the episode."""
        self.run.about.unlink(missing_ok=True)
        for table in (*self.tables, *(f"models/{table}" for table in MODELS)):
            shutil.rmtree(self.run.place(table), ignore_errors=True)

    def _whole(self, table: str, rows: pa.Table, entities: pa.Table) -> pa.Table:
        """The rows with what is fixed, as the table has them."""
        if table not in TABLES:  # the poses of links are for ssduck alone
            return rows
        names = TABLES[table].names
        if not TABLES[table].model:
            return rows.select(names)
        if table == "links":
            rows = _ordered(pa.concat_tables([rows, self._bodies_as_links(rows, entities)]))
        for name in TABLES[table].tick_columns.booleans:
            place = rows.column_names.index(name)
            rows = rows.set_column(place, name, rows[name].cast(pa.bool_()))
        return with_model(table, rows, self._models[table], names)

    def _bodies_as_links(self, links: pa.Table, entities: pa.Table) -> pa.Table:
        """The links of bodies that have one: they are as the body."""
        model = self._models["entities"]
        single = model.filter(pa.array(model["links"].to_numpy() == 1))["id"].to_numpy()
        own = entities.filter(pa.array(np.isin(entities["id"].to_numpy(), single)))
        number = pa.array(np.zeros(own.num_rows, dtype=np.int64))
        named = own.rename_columns({"id": "entity"}).append_column("link", number)
        return named.select(links.column_names)

    def _write(self, table: str, number: int, rows: pa.Table) -> None:
        place = self.run.place(table)
        label = self.run.label(table, number)
        assert label is not None
        told = rows.replace_schema_metadata({FORMAT: label})
        try:
            place.mkdir(parents=True, exist_ok=True)
            _seal(place / part_name(number), lambda file: _write_parquet(told, file))
        except OSError as error:
            raise RecordError(
                f"{place} cannot be written: {error}; what was stored before is whole, and what "
                "was not is kept until there is room"
            ) from error

    def drop_before(self, tick: int) -> int:  # noqa: ARG002
        """Drops nothing: a folder keeps all ticks."""
        return 0


def _ordered(links: pa.Table) -> pa.Table:
    """Rows of links in order, however they came: sums over them are the same then."""
    keys = [links[name].to_numpy() for name in ("link", "entity", "tick")]
    return links.take(np.lexsort(keys))


@dataclass(frozen=True)
class _NoNumbers:
    """What numbers the geometries of a world that has no entities."""

    run: int = 0

    def geometry_id(self, geometry: Geometry) -> int:
        """Refuse: there are none."""
        raise AssertionError(geometry)


class ParquetRecording:
    """The ticks of a world on their way to a folder, until it is closed.

    Args:
        world: whose ticks.
        recorder: keeps them.
        folder: where to.
        recorders: those whose rows are stored at the end; it is one of them.

    """

    def __init__(
        self, world: World, recorder: Recorder, folder: ParquetStore, recorders: list[Recorder]
    ) -> None:
        self._world = world
        self._recorder = recorder
        self._folder = folder
        self._recorders = recorders

    @property
    def episode(self) -> Episode:
        """What is on the disk so far."""
        return self._folder.run.episode

    def flush(self) -> int | None:
        """Write what waits as a part; tells the last tick that is on the disk, None for none.

        Raises:
            RecordError: it cannot be written, for the disk is full, say; nothing is lost by that.
        """
        with self._world.pinned():
            self._recorder.flush()
            return self._folder.last_tick

    def close(self) -> None:
        """Write what waits, and record no more.

        Raises:
            RecordError: it cannot be written; it records on, and can be closed once more.
        """
        if self._recorder not in self._recorders:
            return
        self._recorder.reweighed.warn(self._world)
        self.flush()
        self._folder.finish()
        self._world.remove_recorder(self._recorder)
        self._recorders.remove(self._recorder)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _begun(path: Path, world: str, tables: Collection[str], recording: Recording) -> FolderRun:
    """A new episode in a folder."""
    if not world.isidentifier():
        raise RecordError(
            f"a world called {short_repr(world)} cannot be recorded: bind it to a name"
        )
    try:
        str(path.absolute()).encode()  # other names Parquet's library does not take
        path.mkdir(parents=True, exist_ok=True)
        _check_length(path, world)
        if not (path / ABOUT).exists():
            if any(file.name != _unfinished(path / ABOUT).name for file in path.iterdir()):
                raise RecordError(
                    f"{path} has something else in it, and is no record of ssduck: give a new "
                    "folder, or an empty one"
                )
            told = {"format": FORMAT, "version": VERSION, "units": UNITS}
            _seal(path / ABOUT, lambda file: _write_json(told, file))
        check_about(path)
        (path / "episodes").mkdir(exist_ok=True)
        return _claimed(path, world, tables, recording)
    except RecordError:
        raise
    except (OSError, ValueError) as error:  # a null character is a ValueError
        raise RecordError(f"{path} cannot be written: {error}") from error


def _check_length(path: Path, world: str) -> None:
    """Complain of a name of a world of which no file can be called.

    Raises:
        RecordError: it is too long for the system.
    """
    most = _NAME_MAX
    if hasattr(os, "pathconf"):
        with suppress(OSError, ValueError):
            most = os.pathconf(path, "PC_NAME_MAX")
    # The longest name of a file of an episode, of as many digits as come to be.
    room = most - len(os.fsencode(_unfinished(FolderRun(path, "", 10**6).about).name))
    length = len(os.fsencode(world))
    if length > room:
        raise RecordError(
            f"a world called {short_repr(world)} cannot be recorded in {path}: files are called "
            "after "
            f"it, and its name has {length} bytes, of {room} that there is room for: bind it to a "
            "shorter one"
        )


def _claimed(path: Path, world: str, tables: Collection[str], recording: Recording) -> FolderRun:
    """An episode of a number that no other process takes."""
    for number in count():
        run = FolderRun(path, world, number)
        try:
            with run.about.open("x", encoding="utf-8"):
                break
        except FileExistsError:
            continue
    told = {
        "world": world,
        "episode": number,
        "key": secrets.token_hex(8),
        "tables": list(tables),
        "started": datetime.now(UTC).isoformat(timespec="seconds"),
        "recording": {"every": recording.every, "entities": recording.entities},
    }
    _seal(run.about, lambda stream: _write_json(told, stream))
    return run


def _unfinished(place: Path) -> Path:
    """What a file is called until it is complete."""
    return place.with_name(f".{place.name}.unfinished")


def _seal(place: Path, write: Callable[[Path], None]) -> None:
    """Write a file under another name, and give it its own when it is on the disk."""
    unfinished = _unfinished(place)
    try:
        write(unfinished)
        with unfinished.open("rb+") as file:
            os.fsync(file.fileno())
        unfinished.replace(place)
    except OSError:
        unfinished.unlink(missing_ok=True)
        raise
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
    how = {"compression": "zstd", "use_dictionary": [*texts, *keys]}
    pq.write_table(rows, file.absolute(), **how)  # else md:x is a URI, and ~ another folder
