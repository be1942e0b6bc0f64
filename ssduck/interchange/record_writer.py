"""Writes records of poses from anywhere: another simulator, motion capture, a real robot."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from os import PathLike
from pathlib import Path
from types import TracebackType
from typing import Any, Self, TypeAlias

import numpy as np
import pyarrow as pa

from ssduck import validation
from ssduck.errors import ArgumentError, check_known, record_errors
from ssduck.formatting import short_repr
from ssduck.geometry.arrays import Array, Flags, Indices
from ssduck.geometry.mesh_files import load_hulls, load_mesh
from ssduck.geometry.poses import IDENTITY, unit_quaternions
from ssduck.geometry.shapes import Geometry, PlacedGeometry
from ssduck.interchange.pose_batches import Frames, PoseBatch, batch_of
from ssduck.recording.buffers import MAX_BUFFERED_ROWS
from ssduck.recording.episode import Episode, Tags, given_tags
from ssduck.recording.paths import expand_path
from ssduck.recording.spec import Recording
from ssduck.recording.stores.parquet import ParquetStore
from ssduck.schema import FRAMES, LINK_FACTOR, MAX_LINKS, RECORDED
from ssduck.simulators.interface import Body, Link, LinkPoses
from ssduck.simulators.scene_bodies import PRIMITIVES
from ssduck.world import ctrl_c
from ssduck.world.layout import BodyGroup, EntityInfo, TableLayout
from ssduck.world.snapshot import Snapshot

# The descriptions of entities by name, or their names alone.
Entities: TypeAlias = Mapping[str, Mapping[str, Any]] | Sequence[str]

KINDS = ("robot", "kinbody")
_PRIMITIVES = {**PRIMITIVES, "ellipsoid": (3, "half its lengths along x, y and z")}
_FORMS = (*_PRIMITIVES, "mesh", "hull")
_SHAPE_KEYS = (*_FORMS, "scale", "position", "orientation")
_LINK_KEYS = (*_SHAPE_KEYS, "shapes", "mass")
_ENTITY_KEYS = (*_LINK_KEYS, "kind", "movable", "links")


def entities_of(entities: Entities) -> list[EntityInfo]:
    """Returns the entities of a record, with the ids from 1 on."""
    if isinstance(entities, str) or not isinstance(entities, Mapping | Sequence):
        raise ArgumentError(
            f"entities: give a dict of descriptions by name, or a list of names, not "
            f"{short_repr(entities)}"
        )
    described = entities if isinstance(entities, Mapping) else _undescribed(entities)
    if len(described) >= LINK_FACTOR:
        raise ArgumentError(f"entities: a world has at most {LINK_FACTOR - 1:,} of them")
    return [
        _entity(number, name, description)
        for number, (name, description) in enumerate(described.items(), start=1)
    ]


def _undescribed(names: Sequence[str]) -> dict[str, dict[str, Any]]:
    described: dict[str, dict[str, Any]] = {}
    for name in names:
        if name in described:
            raise ArgumentError(f"entities: {short_repr(name)} is there twice")
        described[name] = {}
    return described


def _entity(id: int, name: Any, description: Any) -> EntityInfo:
    where = f"entities[{short_repr(name)}]"
    if not isinstance(name, str) or not name or not name.isprintable():
        raise ArgumentError(f"{where}: a name is a text of one letter or more")
    values = _checked(description, _ENTITY_KEYS, where)
    kind = values.get("kind", "kinbody")
    message = f"{where}: kind: {short_repr(kind)} is neither robot nor kinbody"
    check_known(kind, KINDS, message, ArgumentError)
    links, shapes = _links(values, name, where)
    movable = validation.boolean(values.get("movable", True), f"{where}: movable")
    body = Body(id, name, kind, movable, tuple(links), (), tuple(shapes))
    return EntityInfo(id, name, kind, body=body)


def _links(
    values: Mapping[str, Any], name: str, where: str
) -> tuple[list[Link], list[PlacedGeometry]]:
    """Returns the links of an entity, its base first, and their shapes."""
    links = [Link(name, -1, _mass(values, where))]
    shapes = list(_shapes(values, 0, where))
    numbers = {name: 0}
    described = validation.mapping(values.get("links"), f"{where}: links are given in a dict")
    if len(described) > MAX_LINKS - 1:
        raise ArgumentError(f"{where}: an entity has at most {MAX_LINKS:,} links")
    for link, description in described.items():
        place = f"{where}: links[{short_repr(link)}]"
        if not isinstance(link, str) or not link or link in numbers:
            raise ArgumentError(f"{place}: a name is a text that no other link of it has")
        values = _checked(description, (*_LINK_KEYS, "parent"), place)
        parent = values.get("parent", name)
        message = f"{place}: parent: {short_repr(parent)} is no link before it"
        check_known(parent, numbers, message, ArgumentError)
        numbers[link] = len(links)
        shapes += _shapes(values, len(links), place)
        links.append(Link(link, numbers[parent], _mass(values, place)))
    return links, shapes


def _checked(description: Any, keys: Sequence[str], where: str) -> Mapping[str, Any]:
    values = validation.mapping(description, f"{where} is described in a dict")
    for key in values:
        check_known(key, keys, f"{where}: there is no key {short_repr(key)}", ArgumentError)
    return values


def _mass(values: Mapping[str, Any], where: str) -> float:
    mass = validation.finite_number(values.get("mass", 0.0), f"{where}: mass", "kg")
    if mass < 0.0:
        raise ArgumentError(f"{where}: mass: {mass:g} kg is less than 0")
    return mass


# -- shapes -----------------------------------------------------------------------------------


def _shapes(values: Mapping[str, Any], link: int, where: str) -> Iterator[PlacedGeometry]:
    """Yields the shapes of a link: the one that is described with it, and those of a list."""
    if any(key in values for key in _SHAPE_KEYS):
        own = {key: values[key] for key in _SHAPE_KEYS if key in values}
        yield from _shape(own, link, where)
    listed = values.get("shapes", ())
    if isinstance(listed, str) or not isinstance(listed, Sequence):
        raise ArgumentError(f"{where}: shapes: give a list of dicts, not {short_repr(listed)}")
    for number, shape in enumerate(listed):
        place = f"{where}: shapes[{number}]"
        yield from _shape(_checked(shape, _SHAPE_KEYS, place), link, place)


def _shape(values: Mapping[str, Any], link: int, where: str) -> Iterator[PlacedGeometry]:
    forms = [form for form in _FORMS if form in values]
    if len(forms) != 1:
        told = " and ".join(forms) or "no form"
        raise ArgumentError(f"{where}: a shape has one form of {', '.join(_FORMS)}, not {told}")
    (form,) = forms
    if "scale" in values and form not in ("mesh", "hull"):
        raise ArgumentError(f"{where}: scale is for meshes and hulls of files, not for a {form}")
    position = validation.finite_array(
        values.get("position", (0.0, 0.0, 0.0)), 3, f"{where}: position"
    )
    orientation = validation.finite_array(
        values.get("orientation", IDENTITY), 4, f"{where}: orientation"
    )
    if not np.linalg.norm(orientation) > 0.0:
        raise ArgumentError(f"{where}: orientation: the quaternion w, x, y, z has the length 0")
    turned = unit_quaternions(orientation[None])[0]
    for geometry in _geometries(form, values, where):
        yield PlacedGeometry(link, geometry, position, turned)


def _geometries(form: str, values: Mapping[str, Any], where: str) -> Sequence[Geometry]:
    value, place = values[form], f"{where}: {form}"
    if form in _PRIMITIVES:
        return [_primitive(form, value, place)]
    if not isinstance(value, str | PathLike):
        if form == "mesh":
            raise ArgumentError(f"{place}: give the path of a file, not {short_repr(value)}")
        return [_hull(value, place)]
    file = Path(value).absolute()
    scale = values.get("scale", 1.0)
    scales = [scale] * 3 if validation.is_number(scale) else scale
    factors = tuple(validation.finite_array(scales, 3, f"{where}: scale").tolist())
    try:
        return [load_mesh(file, factors)] if form == "mesh" else load_hulls(file, factors)
    except ValueError as error:
        raise ArgumentError(f"{place}: {error}") from error


def _primitive(form: str, value: Any, place: str) -> Geometry:
    count, meaning = _PRIMITIVES[form]
    numbers = [value] if count == 1 and validation.is_number(value) else value
    size = validation.finite_array(numbers, count, f"{place} ({meaning})")
    if form == "plane":
        length = float(np.linalg.norm(size))
        if not length > 0.0:
            raise ArgumentError(f"{place}: the normal has the length 0")
        return Geometry.primitive("plane", (size / length).tolist())
    if not (size > 0.0).all():
        raise ArgumentError(f"{place}: {meaning}: a length is not above 0")
    return Geometry.primitive(form, [*size.tolist(), *[0.0] * (3 - count)])  # type: ignore[arg-type]


def _hull(points: Any, place: str) -> Geometry:
    try:
        array = np.array(points, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ArgumentError(f"{place}: give a file, or points (n, 3)") from error
    if array.ndim != 2 or array.shape[1] != 3 or len(array) < 4 or not np.isfinite(array).all():
        raise ArgumentError(f"{place}: give a file, or four or more points (n, 3) that are finite")
    return Geometry.hull(array)


# -- poses ------------------------------------------------------------------------------------


# The boxes of about so many frames are computed together.
_FRAMES_AT_ONCE = 2048


def write_record(
    folder: str | Path,
    entities: Entities,
    poses: Any,
    times: Any = None,
    *,
    velocities: Any = None,
    world: str = "world",
    tags: Tags | None = None,
) -> Episode:
    """Writes poses from anywhere as an episode of a record, which `ssduck.open` answers as any.

    Relations of positions work, and those of shapes for the entities whose shapes are given. There
    are no contacts, readings of sensors and positions of joints: a query for them is an error that
    says so. If anything is wrong, nothing is written.

    Metres, seconds, kilograms; world frame, z up; poses are those of link frames, and quaternions
    w, x, y, z.

    Args:
        folder: the folder; it is made if it does not exist, and may hold other episodes.
        entities: the names of the entities; or a dict of their descriptions by name. A description
            may have: one shape, `box` (lengths along x, y, z), `sphere` (radius), `cylinder` or
            `capsule` (radius, length along z), `ellipsoid` (half its lengths along x, y, z),
            `plane` (normal), `mesh` (a file: all triangles) or `hull` (a file, or points (n, 3)),
            with `position` and `orientation` in the frame of the entity, and `scale` for a file; or
            any number of them, `shapes`; `kind` (`robot`, or `kinbody` by default); `mass`;
            `movable` (`True` by default); `links`, a dict of further links by name, each with
            shapes, mass and `parent` (a link before it; by default the entity itself).
        poses: an array of the poses of all frames, (ticks, frames, 7): x, y, z, qw, qx, qy, qz, or
            (ticks, frames, 3) of positions; or such an array for each frame by its name, (ticks,
            7) or (ticks, 3), or (7,) or (3,) of what stands still; or a table (Arrow, pandas,
            polars) with a row for each frame at each tick: time, name, x, y, z, and qw, qx, qy, qz
            unless nothing is turned, and vx, vy, vz, wx, wy, wz if they are known. With a column
            tick, of ascending numbers, several ticks may be at one time. Frames are the
            entities in their order, each followed by its links, whose names are `entity.link`. In
            a table, an entity may be missing at a tick: it is not there then. A quaternion of
            another length than 1 is scaled.
        times: the time of each tick, s, ascending; None for a table, which has them.
        velocities: of each frame, as `poses`, (…, 6): vx, vy, vz, m/s, and wx, wy, wz, rad/s, world
            frame; None if they are unknown. Unknown ones are NULL.
        world: the name of the world.
        tags: what you say of the run: texts, True, False or finite numbers, by name.

    Returns:
        The episode.

    Raises:
        ArgumentError: a name, a shape of an array or a number is wrong; times do not ascend; a
            value is NaN or infinite.
        RecordError: the folder holds other files, or cannot be written.

    >>> import numpy as np, ssduck, tempfile
    >>> times = np.arange(3) / 10
    >>> falling = np.stack([0 * times, 0 * times, 1 - times], axis=1)
    >>> entities = {"table": {"box": [1, 1, 0.1]}, "cup": {"sphere": 0.05}}
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     _ = ssduck.write_record(folder, entities, {"table": [0, 0, 0], "cup": falling}, times)
    ...     with ssduck.open(folder) as ss:
    ...         ss.eval("SELECT round(clearance(world.cup, this), 3) FROM world{} "
    ...                 "WHERE id == 'table' AS list;")
    [0.9, 0.8, 0.7]
    """
    writer = RecordWriter(folder, entities, world=world, tags=tags)
    return writer.write_whole([batch_of(writer.frames, poses, times, velocities, None)])


class RecordWriter:
    """Writes an episode in batches of ticks: a context manager for long runs.

    A batch is checked before any of it is written. The episode begins with the first one. What was
    written stays, whatever happens to the process, in complete parts and a log, as with
    `Interpreter.record_to`.

    Args:
        folder: the folder; see `write_record`, also for the others.
        entities: the entities.
        world: the name of the world.
        tags: what you say of the run.

    Raises:
        ArgumentError: a name, a key or a value is wrong.

    >>> import numpy as np, ssduck, tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     with ssduck.RecordWriter(folder, ["marker"], world="lab") as writer:
    ...         for start in (0.0, 1.0):
    ...             writer.add(np.zeros((2, 1, 3)), times=[start, start + 0.5])
    ...     ssduck.episodes(folder)[0].ticks
    4
    """

    def __init__(
        self,
        folder: str | Path,
        entities: Entities,
        *,
        world: str = "world",
        tags: Tags | None = None,
    ) -> None:
        self._path = expand_path(folder).absolute()
        self._world = validation.world_name(world)
        self._tags = given_tags(tags)
        self._entities = entities_of(entities)
        self.frames = Frames.of(self._entities)
        has_links = len(self.frames) > len(self._entities)
        self._recording = Recording(tables=("entities", "links") if has_links else ("entities",))
        self._rows = _RowMaker(self._entities, self.frames, has_links=has_links)
        self._store: ParquetStore | None = None
        self._ticks = 0
        self.last: float | None = None
        self._is_closed = False

    def add(self, poses: Any, times: Any = None, *, velocities: Any = None) -> None:
        """Writes the poses of further ticks; see `write_record`.

        Raises:
            ArgumentError: a shape of an array or a number is wrong, or a time is not after the
                last one; nothing of the batch is written.
            RecordError: the folder holds other files, or cannot be written.
        """
        if self._is_closed:
            raise ArgumentError("add: the record is closed; write another one")
        batch = batch_of(self.frames, poses, times, velocities, self.last)
        if len(batch.times):
            if self._store is None:
                self.begin(is_export=False)
            self.write(batch)

    def write_whole(self, batches: Iterable[PoseBatch]) -> Episode:
        """Writes all batches of the episode, or nothing."""
        try:
            for batch in batches:
                if len(batch.times):
                    if self._store is None:
                        self.begin(is_export=True)
                    self.write(batch)
            if self._store is None:
                raise ArgumentError("poses: there is no tick")
            return self.close()
        except BaseException:
            self.discard()
            raise

    @record_errors()
    def begin(self, *, is_export: bool) -> None:
        """Begins the episode; if it is an export, it exists only when it is closed."""
        with ctrl_c.deferred():  # so that `discard` has what was begun
            self._store = ParquetStore(
                self._path, self._world, self._recording, is_export=is_export, tags=self._tags
            )
        self._store.add_members(self._entities, Snapshot())

    def write(self, batch: PoseBatch) -> None:
        """Writes a batch, part by part."""
        assert self._store is not None
        most = max(MAX_BUFFERED_ROWS // max(len(self.frames), 1), 1)
        for start in range(0, len(batch.times), most):
            part = PoseBatch(*(each[start : start + most] for each in vars(batch).values()))
            self._store.append(self._rows.tables(part, self._ticks + 1))
            self._ticks += len(part.times)
            self.last = float(part.times[-1])

    def close(self) -> Episode:
        """Completes the episode, and returns it.

        Raises:
            ArgumentError: nothing was written.
            RecordError: the folder cannot be written.
        """
        if self._store is None:
            raise ArgumentError("close: nothing was written: add poses before")
        if not self._is_closed:
            self._store.complete()
            self._store.finish()
            self._is_closed = True
        return self._store.run.episode

    def discard(self) -> None:
        """Removes what was written of the episode."""
        with ctrl_c.deferred():
            if self._store is not None:
                self._store.discard()
            self._is_closed = True

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, _: BaseException | None, __: TracebackType | None
    ) -> None:
        if kind is None or self._store is not None:
            self.close()


# -- rows -------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _RowMaker:
    """Makes the rows of the tables of a record from poses, with the boxes of the shapes."""

    entities: Sequence[EntityInfo]
    frames: Frames
    has_links: bool

    def tables(self, batch: PoseBatch, first: int) -> dict[str, pa.Table]:
        """Returns the rows of a batch by table; its first tick gets the number `first`."""
        ticks = np.arange(first, first + len(batch.times))
        counts = len(self.entities), len(self.frames)
        of_entities, of_links = (np.zeros((19, count, len(ticks))) for count in counts)
        for portion, poses in _in_portions(batch, max(_FRAMES_AT_ONCE // max(counts[1], 1), 1)):
            self._bodies.write_entities(poses, of_entities[..., portion])
            if self.has_links:
                self._bodies.write_links(poses, of_links[..., portion])
        flags = np.ones(counts[0], dtype=np.uint8)
        ids = np.arange(1, counts[0] + 1)
        rows = {
            "ticks": _rows("ticks", ticks, batch.times, {"wall_time": None}),
            "entities": _numbered(
                "entities",
                batch,
                ticks,
                of_entities,
                batch.present,
                {"id": ids, "enabled": flags, "visible": flags},
            ),
        }
        if not self.has_links:
            return rows | {FRAMES: _rows(FRAMES, ticks[:0], batch.times[:0], {})}
        return rows | {"links": self._link_rows(batch, ticks, of_links)}

    @cached_property
    def _bodies(self) -> BodyGroup:
        return TableLayout(self.entities, is_external=True).moving_bodies

    def _link_rows(self, batch: PoseBatch, ticks: Indices, block: Array) -> pa.Table:
        """Returns the rows of the links of entities that have several."""
        owners, starts = self.frames.owners, self.frames.starts
        several = np.flatnonzero(np.bincount(owners, minlength=len(starts))[owners] > 1)
        numbers = {"entity": owners[several] + 1, "link": several - starts[owners[several]]}
        present = batch.present[:, owners[several]]
        return _numbered("links", batch, ticks, block[:, several], present, numbers)


def _numbered(
    table: str,
    batch: PoseBatch,
    ticks: Indices,
    block: Array,
    present: Flags,
    fixed: Mapping[str, Any],
) -> pa.Table:
    """Returns the rows of a table of poses: of what is present, tick by tick."""
    tick, column = np.nonzero(present)
    names = [name for name in RECORDED[table].tick_columns.doubles if name != "time"]
    values = {name: block[place][column, tick] for place, name in enumerate(names)}
    return _rows(
        table, ticks[tick], batch.times[tick], values | {n: v[column] for n, v in fixed.items()}
    )


def _rows(table: str, ticks: Indices, times: Array, values: Mapping[str, Any]) -> pa.Table:
    """Returns rows with the columns of a table that differ from tick to tick; NULL for NaN."""
    columns = RECORDED[table].tick_columns
    types = {
        **dict.fromkeys(columns.integers, pa.int64()),
        **dict.fromkeys(columns.doubles, pa.float64()),
        **dict.fromkeys(columns.booleans, pa.uint8()),
    }
    given: dict[str, Any] = {"tick": ticks, "time": times, **values}
    arrays = [
        pa.nulls(len(ticks), type)
        if given.get(name) is None
        else pa.array(np.ascontiguousarray(given[name]), type, from_pandas=type == pa.float64())
        for name, type in types.items()
    ]
    return pa.table(arrays, names=list(types))


def _in_portions(batch: PoseBatch, count: int) -> Iterator[tuple[slice, LinkPoses]]:
    """Yields the ticks, so many at a time at most, each time with their poses."""
    for start in range(0, len(batch.times), count):
        portion = slice(start, min(start + count, len(batch.times)))
        poses = batch.poses[portion].reshape(-1, 7)
        states = np.concatenate((poses, batch.twists[portion].reshape(-1, 6)), axis=1)
        yield portion, LinkPoses(poses[:, :3].copy(), states, orientations=poses[:, 3:].copy())
