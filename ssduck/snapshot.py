"""A tick to tables.

A *tick* is one snapshot of a world at a simulated time; its tables are those of
`ssduck.tables`.

Contract of time. `Snapshot.take` replaces all of it at once; between two takes nothing changes
it, and it never asks the simulator again. A table that nobody asked for is not read from the
simulator; asking for one takes a fresh tick with it in, so that all tables that a query reads
are of one moment. A table that was asked for is read with every tick until `FORGOTTEN_AFTER`
ticks have passed without a question.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Iterable, Sequence
from itertools import accumulate
from typing import Any

import numpy as np

from ssduck.geometry import Array, Geometry
from ssduck.layout import Member, Part
from ssduck.simulators import Contact, Frames, Simulator
from ssduck.tables import TABLES, LiveTable

FORGOTTEN_AFTER = 240
ON_DEMAND = frozenset(("links", "joints", "shapes", "contacts"))


class Snapshot:
    """The tables of the current tick of one world.

    Attributes:
        tables: by name.
        members: the entities by row: sensors first, then bodies.
        rows: the row of each entity's id.
        number: of the tick, from 1.
        time: of the tick, simulated seconds.
    """

    def __init__(self) -> None:
        self.tables = {name: LiveTable(columns) for name, columns in TABLES.items()}
        self.members: list[Member] = []
        self.rows: dict[int, int] = {}
        self.number = 0
        self.time = 0.0
        self._asked: dict[str, int] = {}
        self._geometries: dict[str, int] = {}
        self._warned: set[int] = set()
        self._parts: list[Part] = []
        self._frames: dict[Part, Frames] = {}
        self._jointed: list[Member] = []

    # -- what is in the world -------------------------------------------------------------

    def set_members(self, members: Iterable[Member], watched: bool) -> None:
        """Lay the tables out for these entities.

        Args:
            members: in load order.
            watched: whether bodies that cannot move by themselves may be moved by others.
        """
        self.members = sorted(members, key=lambda member: member.kind != "sensor")
        self.rows = {member.id: row for row, member in enumerate(self.members)}
        bodies = [member for member in self.members if member.body is not None]
        self._jointed = [member for member in bodies if member.body and member.body.joints]
        self._set_parts(bodies, watched)
        listed = self.members
        self.tables["entities"].fill(
            len(listed),
            {
                "id": [member.id for member in listed],
                "name": [member.name for member in listed],
                "kind": [member.kind for member in listed],
                "parent": [member.parent for member in listed],
                "mass": [member.mass for member in listed],
                "enabled": [member.body is not None for member in listed],
                "visible": [member.body is not None for member in listed],
            },
        )
        self._fill_links(bodies)
        self._fill_joints(bodies)
        self._fill_shapes(bodies)
        self.tables["ticks"].fill(1, {})

    def _set_parts(self, bodies: Sequence[Member], watched: bool) -> None:
        sensors = [member for member in self.members if member.sensor is not None]
        first_link = _starts(bodies, [len(m.body.links) if m.body else 0 for m in bodies])
        first_shape = _starts(bodies, [len(m.body.shapes) if m.body else 0 for m in bodies])
        still = [] if watched else [m for m in bodies if m.body and not m.body.movable]
        apart = {member.id for member in still}
        self._parts = []
        self._frames = {}
        for some in (still, [member for member in bodies if member.id not in apart]):
            ids = {member.id for member in some}
            on_these = [sensor for sensor in sensors if sensor.mount[0] in ids]
            self._parts.append(Part(some, on_these, self.rows, first_link, first_shape))

    def _fill_links(self, bodies: Sequence[Member]) -> None:
        links = [
            (member.id, number, link)
            for member in bodies
            if member.body
            for number, link in enumerate(member.body.links)
        ]
        self.tables["links"].fill(
            len(links),
            {
                "entity": [entity for entity, _, _ in links],
                "link": [number for _, number, _ in links],
                "name": [link.name for _, _, link in links],
                "parent": [link.parent if link.parent >= 0 else None for _, _, link in links],
                "mass": [link.mass for _, _, link in links],
            },
        )

    def _fill_joints(self, bodies: Sequence[Member]) -> None:
        joints = [(m.id, joint) for m in bodies if m.body for joint in m.body.joints]
        columns = ("link", "name", "type", "lower", "upper", "max_effort", "max_velocity")
        values = {name: [getattr(joint, name) for _, joint in joints] for name in columns}
        values["entity"] = [entity for entity, _ in joints]
        self.tables["joints"].fill(len(joints), values)

    def _fill_shapes(self, bodies: Sequence[Member]) -> None:
        shapes = [
            (member.id, number, shape)
            for member in bodies
            if member.body
            for number, shape in enumerate(member.body.shapes)
        ]
        geometries = [self._geometry_id(shape.geometry) for _, _, shape in shapes]
        self.tables["shapes"].fill(
            len(shapes),
            {
                "entity": [entity for entity, _, _ in shapes],
                "link": [shape.frame for _, _, shape in shapes],
                "shape": [number for _, number, _ in shapes],
                "geometry": geometries,
            },
        )
        distinct = {id: s.geometry for id, (_, _, s) in zip(geometries, shapes, strict=True)}
        sizes = np.array([geometry.size for geometry in distinct.values()]).reshape(-1, 3)
        self.tables["geometries"].fill(
            len(distinct),
            {
                "id": list(distinct),
                "type": [geometry.type for geometry in distinct.values()],
                "size_x": sizes[:, 0],
                "size_y": sizes[:, 1],
                "size_z": sizes[:, 2],
                "vertices": [geometry.vertices.tolist() for geometry in distinct.values()],
                "faces": [geometry.faces.tolist() for geometry in distinct.values()],
            },
        )

    def _geometry_id(self, geometry: Geometry) -> int:
        return self._geometries.setdefault(geometry.key, len(self._geometries) + 1)

    def value(self, row: int, column: str) -> Any:
        """One value of the table of entities; None for an unknown one."""
        return self.tables["entities"].arrow[column][row].as_py()

    # -- a tick ---------------------------------------------------------------------------

    def ask(self, tables: Iterable[str]) -> bool:
        """Note that these tables are asked for; tells whether this tick lacks any of them."""
        lacking = False
        for name in ON_DEMAND.intersection(tables):
            lacking = lacking or not self._is_read(name)
            self._asked[name] = self.number
        return lacking

    def _is_read(self, name: str) -> bool:
        asked = self._asked.get(name)
        return asked is not None and self.number - asked < FORGOTTEN_AFTER

    def read_all_anew(self) -> None:
        """Read what cannot move once more with the next tick: it was moved by hand."""
        self._frames.clear()

    def take(self, simulator: Simulator) -> None:
        """Read a tick: the entities, and the tables that were asked for."""
        jointed = [member.body for member in self._jointed if member.body]
        joints = simulator.read_joints(jointed) if self._is_read("joints") else None
        contacts = list(simulator.read_contacts()) if self._is_read("contacts") else None
        still, moving = self._parts
        read = [moving] if still in self._frames else [still, moving]
        frames = {part: simulator.read_frames(part.bodies) for part in read}
        # All of this tick is read before anything of the last one is overwritten.
        self._frames.update(frames)
        self.number += 1
        self.time = simulator.time
        self._write(read, joints, contacts)

    def _write(
        self, read: Sequence[Part], joints: Array | None, contacts: Sequence[Contact] | None
    ) -> None:
        entities = self.tables["entities"].reals("x", "zmax")
        for part in read:
            part.write_entities(self._frames[part], entities)
        if self._is_read("links"):
            for part in self._parts:
                part.write_links(self._frames[part], self.tables["links"].reals("x", "zmax"))
        if self._is_read("shapes"):
            for part in self._parts:
                part.write_shapes(self._frames[part], self.tables["shapes"].reals("x", "zmax"))
        if joints is not None:
            self.tables["joints"].reals("position", "effort")[:] = joints.T
        if contacts is not None:
            self._write_contacts(contacts)
        self.tables["ticks"]["wall_time"][:] = time.time()
        for name in ("entities", "ticks", *filter(self._is_read, ON_DEMAND)):
            table = self.tables[name]
            table["tick"][:] = self.number
            table["time"][:] = self.time
            table.written()
        if not self.tables["entities"].whole:
            self._warn_of_unknown(entities)

    def _warn_of_unknown(self, numbers: Array) -> None:
        """Say once of each entity that the simulator has lost where it is."""
        for row in np.flatnonzero(np.isnan(numbers).any(axis=0)):
            member = self.members[row]
            if member.id not in self._warned:
                self._warned.add(member.id)
                warnings.warn(
                    f"{member.name}: the simulator gives a pose or a velocity that is no number; "
                    "what follows from it is NULL",
                    stacklevel=5,
                )

    def _write_contacts(self, contacts: Sequence[Contact]) -> None:
        table = self.tables["contacts"]
        ids = {member.body.handle: member.id for member in self.members if member.body}
        rows = sorted(_contact_row(contact, ids) for contact in contacts)
        if len(rows) != table.count:
            table.fill(len(rows), {})
        numbers = np.array(rows, dtype=np.float64).reshape(-1, 15)
        for column, name in enumerate(("a", "link_a", "b", "link_b")):
            table[name][:] = numbers[:, column]
        table.reals("ax", "force")[:] = numbers[:, 4:].T


def _contact_row(contact: Contact, ids: dict[int, int]) -> tuple[float, ...]:
    """A contact with a < b; its normal points from b to a."""
    a = (ids[contact.body_a], contact.link_a)
    b = (ids[contact.body_b], contact.link_b)
    if a <= b:
        points, normal = (*contact.point_a, *contact.point_b), contact.normal
    else:
        x, y, z = contact.normal
        a, b = b, a
        points, normal = (*contact.point_b, *contact.point_a), (-x, -y, -z)
    return (*a, *b, *points, *normal, contact.depth, contact.force)


def _starts(bodies: Sequence[Member], counts: Sequence[int]) -> dict[int, int]:
    """The row of each body's first entry, in a table that lists them body after body."""
    firsts = accumulate(counts, initial=0)
    return dict(zip((member.id for member in bodies), firsts, strict=False))
