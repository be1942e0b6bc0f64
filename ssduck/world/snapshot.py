"""A tick to tables.

A *tick* is one snapshot of a world at a simulated time; its tables are those of
`ssduck.schema`.

Contract of time. `Snapshot.take` replaces all of it at once; between two takes nothing changes
it, and it never asks the simulator again. A table that nobody asked for is not read from the
simulator; asking for one takes a fresh tick with it in, so that all tables that a query reads
are of one moment. A table that was asked for is read with every tick until `FORGOTTEN_AFTER`
ticks have passed without a question.
"""

from __future__ import annotations

import copy
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import accumulate, chain
from typing import Any

import numpy as np

from ssduck.errors import UnsupportedError, warn
from ssduck.geometry.arrays import Array, Indices
from ssduck.geometry.batch import ShapeTable
from ssduck.geometry.distance import CallCounter
from ssduck.geometry.narrow_phase import NarrowPhase
from ssduck.geometry.queries import ShapeQueries
from ssduck.geometry.shapes import Geometry
from ssduck.geometry.solids import Solid, solid_of
from ssduck.schema import FORGOTTEN_AFTER, ON_DEMAND, TABLES
from ssduck.simulators.interface import Body, Contact, LinkPoses, Simulator
from ssduck.world.layout import BodyGroup, EntityInfo, TableLayout
from ssduck.world.live_tables import LiveTable
from ssduck.world.run_numbers import new_run
from ssduck.world.sensor_readings import Reading, SensorReader, TickContext, has_rays, posed


class Snapshot:
    """The tables of the current tick of one world.

    Attributes:
        tables: by name.
        number: of the tick, from 1.
        time: of the tick, simulated seconds.
        listed: the entities in load order, as they were given to `take`.
        disabled: the bodies that take no part in collisions.
        hidden: the bodies that are not drawn.
        unavailable: tables whose rows nobody knows, and why: asking for them is an error.
        sensing: what its sensors have measured.
        calls: how often the narrow phase was called, over all ticks.
        masses: of the links of bodies by entity, kg, as they were read last.
        geometries: the numbers of geometries in the table of geometries, by their keys.
        run: the number of the run that its ticks are of; that of a what-if world is another one.
    """

    def __init__(self, geometries: dict[str, int] | None = None, run: int | None = None) -> None:
        self.run = new_run() if run is None else run
        self.tables = {name: LiveTable(table.columns) for name, table in TABLES.items()}
        self.number = 0
        self.time = 0.0
        self.load_order: list[EntityInfo] = []
        self.unavailable: Mapping[str, str] = {}
        # Whether all ticks to be taken are one: poses that were given, or recorded.
        self._is_final = False
        self._is_past = False
        self._layout = TableLayout((), is_external=False)
        # What cannot move is read once; None if that has to be done (again).
        self._still: LinkPoses | None = None
        # What the tables tell of: the frames of what cannot move, and of the rest.
        self._frames: tuple[LinkPoses, ...] = ()
        self.disabled: frozenset[Body] = frozenset()
        self.hidden: frozenset[Body] = frozenset()
        self._requested: dict[str, int] = {}
        # Tables that are read with every tick, asked for or not.
        self.recorded: frozenset[str] = frozenset()
        self._read: frozenset[str] = frozenset()
        self.geometries: dict[str, int] = {} if geometries is None else geometries
        self.sensing = SensorReader()
        self.calls = CallCounter()
        self._shapes: ShapeQueries | None = None
        self._solids: tuple[TableLayout, Any] | None = None
        # When each sensor was asked for by itself, and which are as they are at this tick.
        self._requested_sensors: dict[int, int] = {}
        self._read_sensors: frozenset[int] = frozenset()
        self._warned: set[int] = set()
        # The ticks at which masses and margins were read last, and the masses of the links then, by
        # entity.
        self._masses_tick = 0
        self._margins_tick = 0
        self.masses: dict[int, list[float]] = {}

    @property
    def entities(self) -> Sequence[EntityInfo]:
        """The entities by row: sensors first, then bodies."""
        return self._layout.entities

    @property
    def rows(self) -> dict[int, int]:
        """The row of each entity's id."""
        return self._layout.rows

    @property
    def layout(self) -> TableLayout:
        """Where the entities go in the tables; the same object as long as they are the same."""
        return self._layout

    @property
    def is_complete(self) -> bool:
        """Whether all numbers of all entities are known."""
        return all(table.is_complete for table in self.tables.values())

    @property
    def body_groups(self) -> Iterator[tuple[BodyGroup, LinkPoses]]:
        """The bodies that are read together, and where their frames are at this tick."""
        return zip(
            (self._layout.static_bodies, self._layout.moving_bodies), self._frames, strict=True
        )

    def joints(self) -> dict[Body, Array]:
        """Of each body's joints, position, velocity and effort at this tick, (joints, 3).

        The table of joints has to have been asked for.
        """
        told = self.tables["joints"].doubles("position", "effort").T.copy()
        first = 0
        found = {}
        for _, body in self._layout.bodies:
            if body.joints:
                found[body] = told[first : first + len(body.joints)]
                first += len(body.joints)
        return found

    def clone(self, unavailable: Mapping[str, str]) -> Snapshot:
        """The same tick, to be taken anew of the same entities in other poses, and for good.

        It shares what does not depend on poses. What cannot move and has not been moved is not
        read again: see `invalidate_static_poses`.

        Args:
            unavailable: tables whose rows nobody knows, and why.
        """
        clone = copy.copy(self)
        # What is made anew, here or there, leaves the other's as it is.
        shared = ("geometries", *unavailable)
        clone.tables = {
            name: copy.copy(table) if name in shared else table.clone()
            for name, table in self.tables.items()
        }
        for name in unavailable:
            clone.tables[name].fill(0, {})
        clone.unavailable = unavailable
        clone.calls, clone._shapes = CallCounter(), None  # noqa: SLF001
        clone.sensing = self.sensing.clone()
        clone._is_final = True  # noqa: SLF001  # one class
        clone._requested, clone._read = {}, frozenset()  # noqa: SLF001
        clone.recorded = frozenset()
        clone._requested_sensors, clone._read_sensors = {}, frozenset()  # noqa: SLF001
        clone._warned = set(self._warned)  # noqa: SLF001
        clone._set_run(new_run())  # noqa: SLF001
        return clone

    def _set_run(self, run: int) -> None:
        """Let its ticks be of a run."""
        self.run = run
        self.tables["entities"]["run"].fill(run)

    def past(self, number: int, unavailable: Mapping[str, str]) -> Snapshot:
        """A clone, to be taken of a tick that was before."""
        clone = self.clone(unavailable)
        clone._is_past = True  # noqa: SLF001  # one class
        clone._set_run(self.run)  # noqa: SLF001
        clone.go_to(number)
        return clone

    def go_to(self, number: int) -> None:
        """Let the tick that is taken next be that of a number, whatever was before."""
        self.number = number
        self.invalidate_static_poses()

    # -- what is in the world -------------------------------------------------------------

    def _lay_out(self, layout: TableLayout) -> None:
        """Make the tables anew for these entities."""
        self._layout = layout
        listed = layout.entities
        self.tables["entities"].fill(
            len(listed),
            {
                "id": [member.id for member in listed],
                "name": [member.name for member in listed],
                "kind": [member.kind for member in listed],
                "parent": [member.parent for member in listed],
                "mass": [member.mass for member in listed],
                **self._flag_columns(),
                "run": np.full(len(listed), self.run),
            },
        )
        self._fill_links(layout.bodies)
        self._fill_joints(layout.bodies)
        self._fill_shapes(layout.bodies)
        self.tables["contacts"].fill(0, {})
        self.tables["sensings"].fill(0, {})
        self.tables["ticks"].fill(1, {})

    def _flag_columns(self) -> dict[str, list[bool]]:
        """Whether each entity takes part in collisions, and is drawn; a sensor does neither."""
        bodies = [member.body for member in self.entities]
        return {
            name: [body is not None and body not in absent for body in bodies]
            for name, absent in (("enabled", self.disabled), ("visible", self.hidden))
        }

    def _fill_links(self, bodies: Sequence[tuple[int, Body]]) -> None:
        links = [(id, n, link) for id, body in bodies for n, link in enumerate(body.links)]
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

    def _fill_joints(self, bodies: Sequence[tuple[int, Body]]) -> None:
        joints = [(id, joint) for id, body in bodies for joint in body.joints]
        columns = ("link", "name", "type", "lower", "upper", "max_effort", "max_velocity")
        values = {name: [getattr(joint, name) for _, joint in joints] for name in columns}
        values["entity"] = [entity for entity, _ in joints]
        self.tables["joints"].fill(len(joints), values)

    def _fill_shapes(self, bodies: Sequence[tuple[int, Body]]) -> None:
        shapes = [(id, n, shape) for id, body in bodies for n, shape in enumerate(body.shapes)]
        geometries = [self.geometry_id(shape.geometry) for _, _, shape in shapes]
        self.tables["shapes"].fill(
            len(shapes),
            {
                "entity": [entity for entity, _, _ in shapes],
                "link": [shape.frame for _, _, shape in shapes],
                "shape": [number for _, number, _ in shapes],
                "geometry": geometries,
                "margin": [shape.margin for _, _, shape in shapes],
                "exact": [shape.exact for _, _, shape in shapes],
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

    def geometry_id(self, geometry: Geometry) -> int:
        """The number of a geometry in the table of geometries: equal ones have one."""
        return self.geometries.setdefault(geometry.key, len(self.geometries) + 1)

    def shapes(self) -> ShapeQueries:
        """The shapes of this tick, to be compared; the table of shapes has to be asked for."""
        if self._shapes is None:
            solids, of, starts, numbers, sorts = self._sorted
            table = self.tables["shapes"]
            narrow = NarrowPhase(
                solids,
                of,
                table.doubles("x", "z").T.copy(),
                table.doubles("qw", "qz").T.copy(),
                table.doubles("xmin", "zmax").T.copy(),
                starts,
                self.calls,
                sorts.margins,
            )
            entities = self.tables["entities"]
            boxes = entities.doubles("xmin", "zmax").copy()
            self._shapes = ShapeQueries(narrow, numbers, sorts, boxes, entities["id"].copy())
        return self._shapes

    @property
    def _sorted(self) -> tuple[list[Solid], Indices, list[int], dict[int, int], ShapeTable]:
        """The solids, which one each shape is, where those of each entity begin, its number."""
        if self._solids is None or self._solids[0] is not self._layout:
            bodies = self._layout.bodies
            shapes = [shape for _, body in bodies for shape in body.shapes]
            different = {shape.geometry.key: shape.geometry for shape in shapes}
            place = {key: number for number, key in enumerate(different)}
            of = np.array([place[shape.geometry.key] for shape in shapes], dtype=np.intp)
            margins = self.tables["shapes"]["margin"].copy()
            solids = list(map(solid_of, different.values()))
            counts = [len(body.shapes) for _, body in bodies]
            starts = list(accumulate(counts, initial=0))
            numbers = {id: number for number, (id, _) in enumerate(bodies)}
            # What has no body, a sensor, has the empty run behind all others.
            without = [member.id for member in self.entities if member.body is None]
            numbers |= dict.fromkeys(without, len(bodies))
            owners = np.repeat(np.arange(len(bodies)), counts)
            found = (
                solids,
                of,
                [*starts, starts[-1]],
                numbers,
                ShapeTable(solids, of, owners, margins),
            )
            self._solids = self._layout, found
        return self._solids[1]

    def value(self, row: int, column: str) -> Any:
        """One value of the table of entities; None for an unknown one."""
        return self.tables["entities"].arrow[column][row].as_py()

    # -- a tick ---------------------------------------------------------------------------

    def request_tables(self, tables: Iterable[str]) -> bool:
        """Note that these tables are asked for; tells whether this tick lacks any of them."""
        wanted = ON_DEMAND.intersection(tables).difference(self.unavailable)
        self._requested |= dict.fromkeys(wanted, self.number)
        return not (wanted | self.recorded) <= self._read

    def has(self, table: str) -> bool:
        """Whether this tick has a table that is read when it is asked for."""
        return table in self._read and table not in self.unavailable

    def request_sensor(self, sensor: int, *, picture: bool) -> bool:
        """Note that a sensor is asked for; tells whether this tick lacks it, or its colours.

        Raises:
            UnsupportedError: nobody knows what it perceives.
        """
        if "sensings" in self.unavailable:
            raise UnsupportedError(self.unavailable["sensings"])
        self._requested_sensors[sensor] = self.number
        lacks_picture = picture and self.sensing.request_picture(sensor, self.number)
        return lacks_picture or sensor not in self._read_sensors

    def switch(self, sensor: int, *, on: bool) -> None:
        """Switch a sensor on or off: the table of sensings is to be read once more."""
        self.sensing.switch(sensor, on=on)
        self._read -= {"sensings"}
        self._read_sensors -= {sensor}

    def invalidate_static_poses(self) -> None:
        """Read what cannot move once more with the next tick: it was moved by hand."""
        self._still = None

    def read_masses(self, simulator: Simulator) -> bool:
        """Read the masses at this tick, unless that is done: whoever has a client may change them.

        With each tick they would take a third of what the poses do.

        Returns:
            Whether they were read.
        """
        if self._masses_tick == self.number:
            return False
        self._masses_tick = self.number
        bodies = self._layout.bodies
        masses = simulator.read_masses([body for _, body in bodies])
        self.tables["links"]["mass"][:] = [mass for own in masses for mass in own]
        entities = self.tables["entities"]["mass"]
        for (id, _), own in zip(bodies, masses, strict=True):
            entities[self.rows[id]] = sum(own)
            self.masses[id] = own
        return True

    def read_margins(self, simulator: Simulator) -> None:
        """Read the collision margins at this tick, unless that is done; as masses are read."""
        if self._margins_tick == self.number:
            return
        self._margins_tick = self.number
        margins = simulator.read_margins([body for _, body in self._layout.bodies])
        now, told = np.array(list(chain(*margins)), np.float64), self.tables["shapes"]["margin"]
        if not np.array_equal(now, told):
            told[:] = now
            self._shapes = self._solids = None

    @property
    def margins(self) -> float:
        """How far apart two shapes may be that touch by their margins, metres."""
        return 2.0 * float(self.tables["shapes"]["margin"].max(initial=0.0))

    @property
    def names_with_changed_margins(self) -> list[str]:
        """The entities whose margins are not those that they came with, and records keep."""
        shapes = [(id, shape) for id, body in self._layout.bodies for shape in body.shapes]
        told = self.tables["shapes"]["margin"].tolist()
        found = {id for (id, shape), now in zip(shapes, told, strict=True) if shape.margin != now}
        return [member.name for member in self.entities if member.id in found]

    # A simulation that explodes has infinite numbers; it is told of in `_finish`.
    @np.errstate(invalid="ignore")
    def take(self, simulator: Simulator, members: list[EntityInfo]) -> None:
        """Read a tick: the entities, and the tables that were asked for.

        Args:
            simulator: what knows where the members are.
            members: the entities in load order; the same object as long as they are the same.
        """
        same = members is self.load_order
        layout = self._layout if same else TableLayout(members, simulator.is_external)
        coming = self.number + (not self._is_final)
        wanted = {name for name, at in self._requested.items() if coming - at <= FORGOTTEN_AFTER}
        wanted |= self.recorded
        still = self._still if same else None
        if still is None:
            still = simulator.read_link_poses(layout.static_bodies.bodies, with_velocities=True)
        with_velocities = "links" in wanted or layout.moving_bodies.sensors_on_links
        moving = simulator.read_link_poses(
            layout.moving_bodies.bodies, with_velocities=with_velocities
        )
        joints = None
        if "joints" in wanted:
            jointed = [body for _, body in layout.bodies if body.joints]
            joints = simulator.read_joints(jointed)
        scan = TickContext(coming, simulator.time, layout, anew=still is not self._still)
        perceiving = self._perceiving(layout, coming, together="sensings" in wanted)
        due = self.sensing.due(scan, perceiving, is_external=simulator.is_external)
        sensors = posed(layout, still, moving, due)
        contacts: list[Contact] = []
        if "contacts" in wanted or not all(has_rays(sensor.member) for sensor in sensors):
            contacts = list(simulator.read_contacts())
        readings = self.sensing.read(simulator, scan, sensors, contacts)
        # All of this tick is read before anything of the last one is overwritten.
        self._note_flags(simulator, same=same)
        if not same:
            self._lay_out(layout)
            self.load_order = members
        self._read = frozenset(wanted)
        self._shapes = None
        self.number, self.time = coming, simulator.time
        self._write_frames(still, moving, anew=still is not self._still)
        self._still = still
        self._frames = still, moving
        if joints is not None:
            self.tables["joints"].doubles("position", "effort")[:] = joints.T
        if "contacts" in wanted:
            self._write_contacts(contacts)
        self.sensing.readings = readings
        self._read_sensors = frozenset(member.id for member in perceiving)
        if "sensings" in wanted:
            self._write_sensings(readings)
        self._finish()

    def _note_flags(self, simulator: Simulator, *, same: bool) -> None:
        """Take note of bodies that came to take part in collisions, or to be drawn, or ceased."""
        disabled, hidden = simulator.disabled, simulator.hidden
        if disabled is self.disabled and hidden is self.hidden:
            return
        self.disabled, self.hidden = disabled, hidden
        if same:  # else all columns are made anew
            self.tables["entities"].put(self._flag_columns())

    def _perceiving(self, layout: TableLayout, coming: int, *, together: bool) -> list[EntityInfo]:
        """The sensors that are asked for: all of them together, or some."""
        asked = {
            id: at for id, at in self._requested_sensors.items() if coming - at <= FORGOTTEN_AFTER
        }
        self._requested_sensors = asked
        if not (together or asked):
            return []
        sensors = [member for member in layout.entities if member.sensor is not None]
        return sensors if together else [member for member in sensors if member.id in asked]

    def _write_frames(self, still: LinkPoses, moving: LinkPoses, *, anew: bool) -> None:
        """Write poses, velocities and boxes; `anew`: those of what cannot move as well."""
        layout = self._layout
        entities = self.tables["entities"].doubles("x", "zmax")
        if anew:
            layout.static_bodies.write_entities(still, entities)
        layout.moving_bodies.write_entities(moving, entities)
        parts = (layout.static_bodies, still), (layout.moving_bodies, moving)
        if "links" in self._read:
            for part, frames in parts:
                part.write_links(frames, self.tables["links"].doubles("x", "zmax"))
        if "shapes" in self._read:
            for part, frames in parts:
                part.write_shapes(frames, self.tables["shapes"].doubles("x", "zmax"))

    def _finish(self) -> None:
        """Date the tables that were written, and let their readers see it."""
        if not self._is_past:
            self.tables["ticks"]["wall_time"].fill(time.time())
        for name in ("entities", "ticks", *self._read):
            table = self.tables[name]
            table["tick"].fill(self.number)
            table["time"].fill(self.time)
            if name != "ticks":  # whose numbers are known
                table.publish_unknown()
        # Of what was a tick before, it was said then.
        if not self.tables["entities"].is_complete and not self._is_past:
            self._warn_of_unknown(self.tables["entities"].doubles("x", "zmax"))

    def _warn_of_unknown(self, numbers: Array) -> None:
        """Say once of each entity that the simulator has lost where it is."""
        for row in np.flatnonzero(np.isnan(numbers).any(axis=0)).tolist():
            member = self.entities[row]
            if member.id not in self._warned:
                self._warned.add(member.id)
                warn(
                    f"{member.name}: the simulator gives a pose or a velocity that is no number; "
                    "what follows from it is NULL",
                )

    def _write_contacts(self, contacts: Sequence[Contact]) -> None:
        table = self.tables["contacts"]
        ids = {body.handle: id for id, body in self._layout.bodies}
        rows = sorted(_contact_row(contact, ids) for contact in contacts)
        if len(rows) != table.count:
            table.fill(len(rows), {})
        numbers = np.array(rows, dtype=np.float64).reshape(-1, 18)
        for column, name in enumerate(("a", "link_a", "b", "link_b")):
            table[name][:] = numbers[:, column]
        table.doubles("ax", "fz")[:] = numbers[:, 4:].T

    def _write_sensings(self, readings: Mapping[int, Reading]) -> None:
        table = self.tables["sensings"]
        rows = [
            (sensor, entity, hits, reading.rays, reading.time)
            for sensor, reading in sorted(readings.items())
            for entity, hits in reading.hits.items()
            if entity in self.rows  # it may have gone since
        ]
        if len(rows) != table.count:
            table.fill(len(rows), {})
        numbers = np.array(rows, dtype=np.float64).reshape(-1, 5)
        for column, name in enumerate(("sensor", "entity", "hits", "rays", "measured")):
            table[name][:] = numbers[:, column]


def _contact_row(contact: Contact, ids: dict[int, int]) -> tuple[float, ...]:
    """A contact with a < b; its normal points from b to a, its force is that on a."""
    a = (ids[contact.body_a], contact.link_a)
    b = (ids[contact.body_b], contact.link_b)
    points, way = (*contact.point_a, *contact.point_b), 1.0
    if a > b:
        a, b = b, a
        points, way = (*contact.point_b, *contact.point_a), -1.0
    normal = [way * part for part in contact.normal]
    sides = zip(normal, contact.friction, strict=True)
    force = [contact.force * along + way * across for along, across in sides]
    return (*a, *b, *points, *normal, contact.depth, contact.force, *force)
