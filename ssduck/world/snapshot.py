"""Reads ticks from a simulator into tables: `Snapshot`.

A *tick* is one reading of a world's state at a simulated time, in the tables of `ssduck.schema`.

`Snapshot.take` replaces all tables at once; between two takes the simulator is not read again. A
table that nobody requested is not read from the simulator. Requesting one reads this tick again
with it if the simulator has not moved on, else another one; shapes follow from the poses. It is
read with every tick until `FORGOTTEN_AFTER` ticks have passed without another request.
"""

from __future__ import annotations

import copy
import secrets
import time
from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from itertools import chain
from typing import Any

import numpy as np

from ssduck.errors import UnsupportedError, warn
from ssduck.formatting import joined_names
from ssduck.geometry.arrays import Array
from ssduck.geometry.distance import CallCounter
from ssduck.geometry.margins import Margins
from ssduck.geometry.shapes import Geometry, PlacedGeometry
from ssduck.schema import (
    FORGOTTEN_AFTER,
    OFTEN_UNKNOWN,
    ON_DEMAND,
    POSE,
    STORED_TABLES,
    TABLES,
    TWIST,
)
from ssduck.simulators.contact_pairs import ContactPairs
from ssduck.simulators.interface import (
    Body,
    ContactPoints,
    LinkPoses,
    Simulator,
)
from ssduck.world.layout import EntityInfo, TableLayout
from ssduck.world.live_tables import LiveTable
from ssduck.world.rows import (
    contact_pairs,
    geometry_columns,
    joint_columns,
    link_columns,
    shape_columns,
    write_contacts,
)
from ssduck.world.sensor_readings import (
    SensorReader,
    TickContext,
    TickState,
    has_rays,
    sensor_poses,
    write_sensings,
)
from ssduck.world.tick_geometry import TickGeometry

# The columns of doubles that a record has of each entity and tick.
RECORDED_DOUBLES = TABLES["entities"].tick_columns.doubles
# The bits of a double's significand: readers may convert the number to a double without loss.
_BITS = 53


def new_run() -> int:
    """Returns a random number for a run, above 0, which no other run has in practice."""
    return secrets.randbits(_BITS) or 1


class Snapshot(TickGeometry):
    """The tables of the current tick of one world.

    Attributes:
        number: the number of the tick, from 1.
        time: the simulated time of the tick, s.
        load_order: the entities in load order, as passed to `take`.
        disabled: the bodies that take no part in collisions.
        hidden: the bodies that are not drawn.
        unavailable: the tables whose rows are unknown, with the reason; requesting one is an
            error.
        sensing: the readings of the sensors.
        calls: the number of narrow-phase calls over all ticks.
        masses: the masses of links, kg, by the id of the entity, as last read.
        geometries: the ids in the table of geometries, by the keys of the geometries.
        warns_of_unknown: whether it warns of poses and velocities that are not numbers.
        run: the number of the run that the ticks belong to; a what-if world has its own.
        state: the state of the simulator at the tick; None before the first one.
    """

    def __init__(self, geometries: dict[str, int] | None = None, run: int | None = None) -> None:
        super().__init__()
        self.run = new_run() if run is None else run
        self._live = {name: LiveTable(table.columns) for name, table in STORED_TABLES.items()}
        self.state: TickState | None = None
        # The contacts of this tick, and those that are not in the table yet; see `tables`.
        self.contact_points = ContactPoints.none()
        self._are_contacts_written = self._are_rows_written = True
        self.number, self.time = 0, 0.0
        self.load_order: list[EntityInfo] = []
        self.unavailable: Mapping[str, str] = {}
        # Whether every take is of the same tick: with given poses, or of a record.
        self._is_final = self._is_past = False
        # The exact numbers of a recorded tick, by column and entity: others follow from poses.
        self._recorded_doubles: Array | None = None
        # The poses of bodies that cannot move are read once; None if they are to be read (again).
        self._static: LinkPoses | None = None
        # The poses of bodies that cannot move in the rows of links, and of shapes.
        self._written: dict[str, LinkPoses] = {}
        self.disabled = self.hidden = frozenset[Body]()
        self._requested: dict[str, int] = {}
        # The tables that are read with every tick, requested or not.
        self.recorded: frozenset[str] = frozenset()
        self._read: frozenset[str] = frozenset()
        self.geometries: dict[str, int] = {} if geometries is None else geometries
        self.drawn: Callable[[Body], Sequence[PlacedGeometry]] | None = None
        self.sensing = SensorReader()
        # The tick of each sensor's last own request, and the sensors read at this tick.
        self._requested_sensors: dict[int, int] = {}
        self._read_sensors: frozenset[int] = frozenset()
        # Whether a sensor was switched since the tick.
        self._is_switched = False
        self._warned, self.warns_of_unknown = set[int](), True
        # The layout that was looked through for forms that bend, and their names.
        self._checked: TableLayout | None = None
        self._bending: set[str] = set()
        # The ticks at which masses and margins were last read.
        self._masses_tick = self._margins_tick = 0
        # The margins that were read last; the same object while the simulator has the same.
        self._margins: Margins | None = None
        self.masses: dict[int, list[float]] = {}

    @property
    def tables(self) -> Mapping[str, LiveTable]:
        """The tables by name."""
        self.write_contacts()
        return self._tables

    def table(self, name: str) -> LiveTable:
        """Returns a table other than that of contacts, whose rows may be left for later."""
        return self._tables[name]

    def write_contacts(self) -> None:
        """Writes the table of contacts if it was left for later."""
        if not self._are_contacts_written:
            self._are_contacts_written = True
            write_contacts(self._live["contacts"], self.contact_points, self._layout)
            self._publish("contacts")

    def settle(self) -> None:
        """Writes all rows of this tick that were left for later: DuckDB reads without asking."""
        self.write_rows()
        self.write_contacts()

    def contacts(self) -> ContactPairs:
        """Returns the contacts of this tick, whose table must have been requested."""
        unwritten = None if self._are_contacts_written else self.contact_points
        return contact_pairs(unwritten, self._layout, lambda: self.tables["contacts"])

    @property
    def entities(self) -> Sequence[EntityInfo]:
        """The entities by row: sensors first, then bodies."""
        return self._layout.entities

    @property
    def rows(self) -> dict[int, int]:
        """The row in the table of entities, by the entity's id."""
        return self._layout.rows

    @property
    def layout(self) -> TableLayout:
        """The rows of the entities; the same object while the entities are the same."""
        return self._layout

    @property
    def is_complete(self) -> bool:
        """Whether every number is known in the tables that rarely have unknown ones."""
        return all(t.is_complete for n, t in self.tables.items() if n not in OFTEN_UNKNOWN)

    def joints(self) -> dict[Body, Array]:
        """Returns position, velocity and effort of joints by body, (joints, 3), if requested."""
        states = self._tables["joints"].doubles("position", "effort").T.copy()
        first = 0
        by_body = {}
        for _, body in self._layout.bodies:
            if body.joints:
                by_body[body] = states[first : first + len(body.joints)]
                first += len(body.joints)
        return by_body

    def clone(self, unavailable: Mapping[str, str], run: int | None = None) -> Snapshot:
        """Returns a copy to be taken of the same tick with the entities in other poses.

        The copy shares what does not depend on poses. It does not read the poses of bodies that
        cannot move again; see `invalidate_static_poses`.

        Args:
            unavailable: the tables whose rows are unknown there, with the reason.
            run: the number of the run of its ticks; None for a new one.
        """
        self.settle()
        clone = copy.copy(self)
        # The two snapshots must not write to each other's buffers.
        clone._live = {  # noqa: SLF001  # one class
            name: copy.copy(table) if name in ("geometries", *unavailable) else table.clone()
            for name, table in self.tables.items()
        }
        for name in unavailable:
            clone._live[name].fill(0, {})  # noqa: SLF001
        clone.unavailable = unavailable
        clone.calls, clone._shapes, clone._boxes = CallCounter(), None, None  # noqa: SLF001
        clone._shapes_and_sites = None  # noqa: SLF001
        clone.sensing = self.sensing.clone()
        clone._is_final, clone._recorded_doubles = True, None  # noqa: SLF001  # one class
        clone._requested, clone._read, clone._written = {}, frozenset(), {}  # noqa: SLF001
        clone.recorded = frozenset()
        clone._requested_sensors, clone._read_sensors = {}, frozenset()  # noqa: SLF001
        clone._warned = set(self._warned)  # noqa: SLF001
        clone._set_run(new_run() if run is None else run)  # noqa: SLF001
        return clone

    def restart(self) -> None:
        """Begins a new run: the following ticks are of another episode."""
        self._set_run(new_run())

    def _set_run(self, run: int) -> None:
        self.run = run
        self._live["entities"]["run"].fill(run)

    def go_to(self, number: int, doubles: Array) -> None:
        """Sets the number of the recorded tick that is taken next, and its `RECORDED_DOUBLES`."""
        self.number, self._recorded_doubles, self._is_past = number, doubles, True
        self.invalidate_static_poses()

    # -- the entities --------------------------------------------------------------------

    def _lay_out(self, layout: TableLayout) -> None:
        """Resets the tables for the entities of a layout."""
        self._layout, self._written = layout, {}
        self._margins = self.margins_of_pairs = None
        entities = layout.entities
        self._live["entities"].fill(
            len(entities),
            {
                "id": [info.id for info in entities],
                "name": [info.name for info in entities],
                "kind": [info.kind for info in entities],
                "parent": [info.parent for info in entities],
                "mass": [info.mass for info in entities],
                **self._flag_columns(),
                "run": np.full(len(entities), self.run),
            },
        )
        self._live["links"].fill(*link_columns(layout.bodies))
        self._live["joints"].fill(*joint_columns(layout.bodies))
        shapes, geometries = shape_columns(layout.bodies, self.geometry_id)
        self._live["shapes"].fill(*shapes)
        self._live["geometries"].fill(*geometry_columns(geometries))
        self._live["contacts"].fill(0, {})
        self._live["sensings"].fill(0, {})
        self._live["ticks"].fill(1, {})

    def _flag_columns(self) -> dict[str, list[bool]]:
        """Returns the columns `enabled` and `visible` of the entities; False for sensors."""
        bodies = [info.body for info in self.entities]
        return {
            name: [body is not None and body not in absent for body in bodies]
            for name, absent in (("enabled", self.disabled), ("visible", self.hidden))
        }

    def geometry_id(self, geometry: Geometry) -> int:
        """Returns the id of a geometry in the table of geometries, the same for equal ones."""
        return self.geometries.setdefault(geometry.key, len(self.geometries) + 1)

    def value(self, row: int, column: str, table: str = "entities") -> Any:
        """Returns a value of a table other than that of contacts; None if it is unknown."""
        numbers = self._numbers_in(table, row, (column,))
        return self._tables[table].value(column, row) if numbers is None else numbers[0]

    def has_double(self, column: str, table: str = "entities") -> bool:
        """Checks whether a column of a table has doubles."""
        return column in self._live[table].names_of_doubles

    def doubles_in(self, row: int, columns: tuple[str, ...], table: str = "entities") -> list[Any]:
        """Returns the values of columns of doubles in a row; None for unknown ones."""
        numbers = self._numbers_in(table, row, columns)
        return self._tables[table].doubles_in(row, columns) if numbers is None else numbers

    # -- a tick ---------------------------------------------------------------------------

    def request_tables(self, tables: Iterable[str]) -> bool:
        """Notes a request for tables; returns whether this tick lacks any of them."""
        requested = ON_DEMAND.intersection(tables).difference(self.unavailable)
        if "shapes" in requested:
            self._warn_of_bending()
        self._requested |= dict.fromkeys(requested, self.number)
        missing = (requested | self.recorded) - self._read
        if missing == {"shapes"} and self._link_poses:  # they follow from these
            self.write_rows()
            self._read |= missing
            self._write_parts("shapes")
            self._publish("shapes")
            missing = frozenset()
        return bool(missing)

    def _warn_of_bending(self) -> None:
        """Warns, once for each entity, of forms that bend, whose shapes are not the simulator's."""
        if self._layout is self._checked:
            return
        self._checked = self._layout
        names = [info.name for info in self.entities if info.body is not None and info.body.bends]
        new = [name for name in names if name not in self._bending]
        if new:
            self._bending.update(new)
            warn(
                f"{joined_names(new)}: spheres about the vertices stand in for what bends, as "
                "exact = false in the table of shapes says; distance, on and what else asks shapes "
                "is as exact as these are; contacts are the simulator's"
            )

    def has(self, table: str) -> bool:
        """Checks whether this tick includes a table that is read on request."""
        return table in self._read and table not in self.unavailable

    def request_sensor(self, sensor: int, *, picture: bool) -> bool:
        """Notes a request for a sensor's reading or picture; returns whether this tick lacks it."""
        if "sensings" in self.unavailable:
            raise UnsupportedError(self.unavailable["sensings"])
        self._requested_sensors[sensor] = self.number
        lacks_picture = picture and self.sensing.request_picture(sensor, self.number)
        return lacks_picture or sensor not in self._read_sensors

    def switch(self, sensor: int, *, on: bool) -> None:
        """Switches a sensor on or off; the table of sensings is read again when it is requested."""
        self.sensing.switch(sensor, on=on)
        self._read -= {"sensings"}
        self._read_sensors -= {sensor}
        self._is_switched = True

    def invalidate_static_poses(self) -> None:
        """Makes the next tick read the bodies that cannot move again: someone has moved them."""
        self._static = None

    def read_masses(self, simulator: Simulator) -> bool:
        """Reads the masses, which users of the client may change; returns whether it had to.

        Reading them with every tick would cost a third of what reading the poses costs.
        """
        if self._masses_tick == self.number:
            return False
        self._masses_tick = self.number
        bodies = self._layout.bodies
        masses = simulator.read_masses([body for _, body in bodies])
        self._live["links"]["mass"][:] = list(chain(*masses))
        entities = self._live["entities"]["mass"]
        for (id, _), link_masses in zip(bodies, masses, strict=True):
            entities[self.rows[id]] = sum(link_masses)
            self.masses[id] = link_masses
        return True

    def read_margins(self, simulator: Simulator) -> None:
        """Reads the collision margins, unless this tick has them; see `read_masses`."""
        if self._margins_tick == self.number:
            return
        self._margins_tick = self.number
        bodies = [body for _, body in self._layout.bodies]
        margins = simulator.read_margins(bodies)
        if margins is self._margins:
            return
        self._margins, numbers = margins, margins.numbers
        pairs = None if margins.classes is None else margins
        shapes, before = self._tables["shapes"], self.margins_of_pairs
        self.margins_of_pairs = pairs
        if pairs is not before or not np.array_equal(numbers, shapes["margin"]):
            shapes["margin"][:] = numbers
            shapes.publish()
            self._shapes = self._shapes_and_sites = self._solids = None

    # A diverging simulation has infinite numbers; `_finish` warns of them.
    @np.errstate(invalid="ignore")
    def take(
        self, simulator: Simulator, load_order: list[EntityInfo], *, is_again: bool = False
    ) -> None:
        """Reads a tick: the entities in load order and the requested tables.

        Args:
            simulator: the simulator of the entities.
            load_order: the same object while the entities are the same.
            is_again: whether it is this tick with more tables; see `is_still_of`.
        """
        same = load_order is self.load_order
        layout = self._layout if same else TableLayout(load_order, simulator.is_external)
        number = self.number + (not self._is_final and not is_again)
        tables = {name for name, at in self._requested.items() if number - at <= FORGOTTEN_AFTER}
        tables |= self.recorded
        # The whole tick is read before anything of the last one is overwritten.
        state = self._read_state(simulator, layout, number, tables, same=same)
        self._update_flags(simulator, same=same)
        if not same:
            self._lay_out(layout)
            self.load_order = load_order
        if is_again and self.state is not None:
            state = state._replace(wall_time=self.state.wall_time)
        self.state, self._read = state, frozenset(tables)
        self._shapes = self._shapes_and_sites = self._boxes = None
        self.number, self.time = number, simulator.time
        is_static_new = state.static is not self._static
        self._static = state.static
        self._link_poses = state.static, state.moving
        self.contact_points, self._are_contacts_written = state.contacts, "contacts" not in tables
        self.sensing.readings = state.readings
        self._read_sensors, self._is_switched = state.sensors, False
        self._are_rows_written = False
        if is_static_new or not state.moving.are_finite:
            self._write_rows(state, with_static=is_static_new)

    def write_rows(self) -> None:
        """Writes the rows of this tick, but those of contacts, unless they are written."""
        if not self._are_rows_written:
            assert self.state is not None
            self._write_rows(self.state, with_static=False)

    @np.errstate(invalid="ignore")
    def _write_rows(self, state: TickState, *, with_static: bool) -> None:
        table = self._live["entities"]
        block = table.doubles("x", "zmax")[..., None]
        static, moving = self.body_groups
        for group, poses in (static, moving) if with_static else (moving,):
            group.write_entities(poses, block)
        if self._recorded_doubles is not None:
            table.block[table.block_rows(RECORDED_DOUBLES)] = self._recorded_doubles
        for name in self._read.intersection(("links", "shapes")):
            self._write_parts(name)
        if state.joints is not None:
            self._live["joints"].doubles("position", "effort")[:] = state.joints.T
        if "sensings" in self._read:
            write_sensings(self._live["sensings"], state.readings, self.rows)
        if not self._is_past:
            self._live["ticks"]["wall_time"].fill(state.wall_time)
        for name in ("entities", "ticks", *self._read.difference(("contacts",))):
            self._publish(name)
        self._are_rows_written = True
        # The warning for a past tick was given when it was taken.
        if not self._is_past:
            self._warn_of_unknown()

    def is_still_of(self, simulator: Simulator, load_order: list[EntityInfo]) -> bool:
        """Checks whether the simulator is in this tick's state, so that more tables may be read."""
        is_known = self._static is not None and not self._is_switched
        now = id(load_order), simulator.time, simulator.disabled, simulator.hidden
        before = id(self.load_order), self.time, self.disabled, self.hidden
        if not is_known or now != before:
            return False
        poses = simulator.read_link_poses(self._layout.moving_bodies.bodies)
        last = self._link_poses[1]
        pairs = [(last.positions, poses.positions), (last.states, poses.states)]
        if "joints" in self._read:
            bodies = [body for _, body in self._layout.bodies if body.joints]
            if self.state is not None and self.state.joints is not None:
                pairs.append((self.state.joints, simulator.read_joints(bodies)))
        if "contacts" in self._read:
            contacts = self.contact_points, simulator.read_contacts()
            pairs += zip(*(points.columns.values() for points in contacts), strict=True)
        return all(np.array_equal(a, b, equal_nan=True) for a, b in pairs)

    def _read_state(
        self,
        simulator: Simulator,
        layout: TableLayout,
        number: int,
        tables: Container[str],
        *,
        same: bool,
    ) -> TickState:
        """Reads the state of a simulator for the tick of a number; `same`: if the entities stay."""
        static = self._static if same else None
        if static is None:
            static = simulator.read_link_poses(layout.static_bodies.bodies)
        moving = simulator.read_link_poses(layout.moving_bodies.bodies)
        joints = None
        if "joints" in tables:
            joints = simulator.read_joints([body for _, body in layout.bodies if body.joints])
        is_discontinuous = static is not self._static
        context = TickContext(number, simulator.time, layout, is_discontinuous)
        sensors = self._sensors_to_read(layout, number, all_sensors="sensings" in tables)
        may_differ = simulator.is_external and number != self.number
        due = self.sensing.due(context, sensors, is_external=may_differ)
        poses = sensor_poses(layout, static, moving, due) if due else []
        contacts = ContactPoints.none()
        if "contacts" in tables or not all(has_rays(pose.info) for pose in poses):
            contacts = simulator.read_contacts()
        readings = self.sensing.read(simulator, context, poses, contacts)
        ids = frozenset(info.id for info in sensors)
        moment = number, simulator.time, time.time()
        return TickState(*moment, static, moving, joints, contacts, readings, ids)

    def _update_flags(self, simulator: Simulator, *, same: bool) -> None:
        """Updates which bodies take part in collisions, and which are drawn."""
        disabled, hidden = simulator.disabled, simulator.hidden
        if disabled is self.disabled and hidden is self.hidden:
            return
        self.disabled, self.hidden = disabled, hidden
        if same:  # otherwise `_lay_out` resets all columns
            self._live["entities"].set_columns(self._flag_columns())

    def _sensors_to_read(
        self, layout: TableLayout, number: int, *, all_sensors: bool
    ) -> list[EntityInfo]:
        """Returns all sensors, or those that were requested by themselves not long ago."""
        self._requested_sensors = requested = {
            id: at for id, at in self._requested_sensors.items() if number - at <= FORGOTTEN_AFTER
        }
        if not (all_sensors or requested):
            return []
        sensors = [info for info in layout.entities if info.sensor is not None]
        return sensors if all_sensors else [info for info in sensors if info.id in requested]

    def _write_parts(self, name: str) -> None:
        """Writes the rows of links or shapes; of bodies that cannot move, once."""
        block = self._live[name].doubles("x", "zmax")[..., None]
        for group, poses in self.body_groups:
            write = group.write_links if name == "links" else group.write_shapes
            if self._written.get(name) is not poses:
                write(poses, block)
        self._written[name] = self._link_poses[0]

    def _publish(self, name: str) -> None:
        """Writes tick and time into a table, and publishes it."""
        table = self._live[name]
        table["tick"].fill(self.number)
        table["time"].fill(self.time)
        table.publish_unknown()

    def entities_with_nan(self, *, may_lack_velocities: bool = False) -> list[EntityInfo]:
        """Returns the entities with a pose, a box or a velocity that is not a number.

        Args:
            may_lack_velocities: whether velocities that no entity has do not count.
        """
        if self._link_poses and all(poses.are_finite for poses in self._link_poses):
            return []
        table = self._tables["entities"]
        if table.is_complete:
            return []
        unknown = np.isnan(table.doubles("x", "zmax"))
        velocities = unknown[len(POSE) : len(POSE) + len(TWIST)]
        velocities &= not (may_lack_velocities and velocities.all())
        rows = np.flatnonzero(unknown.any(axis=0))
        return [self.entities[row] for row in rows.tolist()]

    def _warn_of_unknown(self) -> None:
        """Warns, once for each entity, of poses and velocities that are not numbers."""
        for info in self.entities_with_nan() if self.warns_of_unknown else ():
            if info.id not in self._warned:
                self._warned.add(info.id)
                warn(
                    f"{info.name}: the simulator gives a pose or a velocity that is no number; "
                    "what depends on it is NULL",
                )
