"""Reads what an export has of an episode: what moves, actions, and the triangles of shapes."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from ssduck.geometry.arrays import Array, Flags, Indices, Triangles
from ssduck.geometry.shapes import Geometry, PlacedGeometry
from ssduck.geometry.solids import solid_of
from ssduck.recording.episode_steps import EpisodeSteps, recorded_steps
from ssduck.recording.static_tables import members_of
from ssduck.recording.stores.parquet_layout import FolderRun
from ssduck.schema import FRAMES, MODELS, POSE
from ssduck.world.layout import EntityInfo


@dataclass(frozen=True, eq=False)
class Frame:
    """A frame whose pose is recorded: an entity, or a link of one."""

    name: str  # the name of the entity, or `entity.link`
    entity: EntityInfo
    link: int  # the number of the link; 0 for the entity

    @property
    def shapes(self) -> dict[int, PlacedGeometry]:
        """The shapes that move with it, by their numbers among those of the entity."""
        shapes = self.entity.body.shapes if self.entity.body else ()
        return {number: each for number, each in enumerate(shapes) if each.frame == self.link}


@dataclass(frozen=True, eq=False)
class Motion:
    """What moves in an episode."""

    run: FolderRun
    frames: tuple[Frame, ...]  # the frames, entity by entity, each followed by its links
    ticks: Indices  # the numbers of the ticks, (ticks,)
    times: Array  # their simulated times, s, (ticks,)
    # x, y, z, qw, qx, qy, qz of each frame, world frame, m, (ticks, frames, 7); NaN where it is not
    # there
    poses: Array
    # the names of the joints whose position is a number, `entity.joint`; empty if joints are not
    # recorded
    joints: tuple[str, ...]
    positions: Array  # their positions, rad or m, (ticks, joints); NaN for unknown ones
    # the steps of an episode of a gymnasium environment; None for others
    steps: EpisodeSteps | None = None

    @property
    def names(self) -> list[str]:
        """The names of the frames."""
        return [frame.name for frame in self.frames]

    @property
    def present(self) -> Flags:
        """Whether each frame is there, (ticks, frames)."""
        return ~np.isnan(self.poses[:, :, 0])


def motion_of(run: FolderRun) -> Motion:
    """Returns what moves in an episode."""
    models = {table: run.read(f"models/{table}") for table in MODELS}
    members = sorted(members_of(models).values(), key=lambda member: member.id)
    buffer = run.ticks()[1]
    ticks = buffer.numbers
    frames = tuple(_frames(members))
    numbers = {(frame.entity.id, frame.link): n for n, frame in enumerate(frames)}
    poses = np.full((len(ticks), len(frames), 7), np.nan)
    fill(poses, _rows(run, "entities", ("id",), POSE), ticks, numbers)
    links = "links" if "links" in run.tables else FRAMES
    if links in run.tables:
        fill(poses, _rows(run, links, ("entity", "link"), POSE), ticks, numbers)
    joints, positions = _joints(run, members, ticks)
    steps = None
    if (run.world, run.number) in recorded_steps(run.path):
        steps = EpisodeSteps.read(run.path, run.world, run.number)
    return Motion(run, frames, ticks, buffer.times, poses, joints, positions, steps)


def _frames(members: Sequence[EntityInfo]) -> Iterator[Frame]:
    for member in members:
        yield Frame(member.name, member, 0)
        for number, link in enumerate(member.body.links if member.body else ()):
            if number and link.region is None:
                yield Frame(f"{member.name}.{link.name}", member, number)


def _rows(
    run: FolderRun, table: str, keys: Sequence[str], values: Sequence[str]
) -> Iterator[tuple[Indices, list[Indices], Array]]:
    """Yields the ticks, keys and values of the rows of each part of a table, and of its log."""
    for rows in (*run.parts_of(table), *([run.log[table]] if run.log else [])):
        yield rows_of(rows, keys, values)


def rows_of(
    rows: pa.Table, keys: Sequence[str], values: Sequence[str]
) -> tuple[Indices, list[Indices], Array]:
    """Returns the ticks, the keys and the values, (rows, values), of a table."""
    columns = [rows[name].to_numpy() for name in values]
    return rows["tick"].to_numpy(), [rows[key].to_numpy() for key in keys], np.column_stack(columns)


def fill(
    target: npt.NDArray[Any],
    parts: Iterable[tuple[Indices, list[Indices], Array]],
    ticks: Indices,
    numbers: Mapping[tuple[int, int], int],
) -> None:
    """Writes values to the rows of their ticks, and the columns of their keys."""
    keys = sorted(numbers)
    codes = np.array([(first << 32) + second for first, second in keys], dtype=np.int64)
    places = np.array([numbers[key] for key in keys], dtype=np.intp)
    for row_ticks, row_keys, values in parts:
        first = row_keys[0].astype(np.int64) << 32
        wanted = first + (row_keys[1] if len(row_keys) > 1 else 0)
        found = np.searchsorted(codes, wanted)
        tick = np.searchsorted(ticks, row_ticks)
        is_known = (codes.take(found, mode="clip") == wanted) if len(codes) else wanted < 0
        is_known &= ticks.take(tick, mode="clip") == row_ticks
        target[tick[is_known], places[found[is_known]]] = values[is_known]


def _joints(
    run: FolderRun, members: Sequence[EntityInfo], ticks: Indices
) -> tuple[tuple[str, ...], Array]:
    """Returns the names and the positions of the joints that have one number each."""
    if "joints" not in run.tables:
        return (), np.zeros((len(ticks), 0))
    named = [
        (member.id, number, f"{member.name}.{joint.name}")
        for member in members
        for number, joint in enumerate(member.body.joints if member.body else ())
        if joint.type in ("revolute", "prismatic")
    ]
    numbers = {(id, number): place for place, (id, number, _) in enumerate(named)}
    positions = np.full((len(ticks), len(named), 1), np.nan)
    fill(positions, _rows(run, "joints", ("entity", "joint"), ("position",)), ticks, numbers)
    return tuple(name for _, _, name in named), positions[:, :, 0]


_SIDES = 32
# Half the edge of the square that stands for a plane, m.
PLANE_HALF_SIZE = 10.0


def mesh_of(geometry: Geometry) -> tuple[Array, Triangles]:
    """Returns the vertices (n, 3), m, and triangles (m, 3) of a hull, mesh, capsule or plane.

    A capsule has so many sides; a plane is a square around the origin.
    """
    match geometry.type:
        case "plane":
            return square(np.array(geometry.size), PLANE_HALF_SIZE)
        case "capsule":
            capsule = capsule_mesh(geometry, _SIDES)
            return np.array(capsule.vertices), np.array(capsule.faces, dtype=np.int32)
        case _:
            surface = solid_of(geometry).surface
            return surface.vertices, surface.faces.astype(np.int32)


def capsule_mesh(geometry: Geometry, sides: int) -> Any:
    """Returns a mesh of trimesh of a capsule around the origin."""
    import trimesh

    radius, length, _ = geometry.size
    capsule = trimesh.creation.capsule(radius=radius, height=length, count=[sides, sides])
    return capsule.apply_translation(-capsule.bounds.mean(axis=0))


def square(normal: Array, half_size: float) -> tuple[Array, Triangles]:
    """Returns the corners, m, and the two triangles of a square that stands for a plane."""
    along = np.eye(3)[np.argmin(np.abs(normal))]
    first = np.cross(normal, along)
    first /= np.linalg.norm(first)
    sides = np.array([first, np.cross(normal, first)])
    signs = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    return half_size * (signs @ sides), np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32)
