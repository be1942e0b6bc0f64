"""A MuJoCo model and its data as a `Simulator`.

MuJoCo's state is in arrays, which a tick copies: no call for each body is needed. Velocities are
stated at the subtree's centre of mass in MuJoCo (`cvel`); ssduck moves them to the body frames.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from ssduck.errors import ProgramWarning, SimulatorError, UnsupportedError, warn
from ssduck.formatting import joined_names
from ssduck.geometry.arrays import Array, Indices
from ssduck.geometry.margins import Margins
from ssduck.simulators.clock import Clock
from ssduck.simulators.interface import (
    SCALAR_JOINTS,
    Body,
    CameraView,
    ContactPoints,
    Kind,
    LinkPoses,
    MotorTarget,
    RayHits,
)
from ssduck.simulators.mujoco import interventions
from ssduck.simulators.mujoco.bodies import (
    ModelContent,
    ModelReader,
    is_same,
    joint_numbers,
    link_masses,
    number_of,
    numbers_of,
)
from ssduck.simulators.mujoco.contacts import (
    ContactReader,
    margin_content,
    margins_of,
)
from ssduck.simulators.mujoco.flexes import entity_roots
from ssduck.simulators.mujoco.library import copied_data, mujoco
from ssduck.simulators.mujoco.readings import LinkReader, RayCaster
from ssduck.simulators.mujoco.rendering import draw, segment, view_of
from ssduck.simulators.partial import PartialSimulator
from ssduck.simulators.recognition import Source
from ssduck.simulators.scenes import Camera

# The numbers of root bodies of which collisions are off, and of those that are hidden.
SwitchedOff: TypeAlias = tuple[Collection[int], Collection[int]]

# The number of lists of bodies whose readers stay prepared.
_PREPARED = 4


class MuJoCoSimulator(PartialSimulator):
    """A MuJoCo model and its data as a `Simulator`.

    Args:
        source: returns the model and the data as they are now.
        owned: whether ssduck made them; else the user steps and changes them.
        names: names of entities by the number or the name of the root body, instead of MuJoCo's.
        kinds: kinds of entities, likewise.
        only: the numbers of the root bodies of the entities to describe; None for all.
        forward: whether each tick has the poses, velocities and contacts that follow from the
            joint positions of its time. MuJoCo's own are those at the beginning of the last step.
        spec: the `mujoco.MjSpec` that the model was compiled from; None if it is not known.
        switched_off: the numbers of the root bodies of which collisions are off at first, and of
            those that are hidden.
        part_names: names of links and joints, instead of MuJoCo's.
    """

    backend = "mujoco"
    keeps_time = True

    def __init__(
        self,
        source: Source,
        *,
        owned: bool,
        names: Mapping[int | str, str] | None = None,
        kinds: Mapping[int | str, Kind] | None = None,
        only: Collection[int] | None = None,
        forward: bool = False,
        spec: Any = None,
        switched_off: SwitchedOff = ((), ()),
        part_names: Mapping[str, str] | None = None,
    ) -> None:
        self.is_external = not owned
        self._source = source
        self._names, self._kinds, self._only = names, kinds, only
        self._forward = forward
        self.spec, self.part_names = spec, part_names
        self.model, self.data = source()
        self._switches = interventions.Switches(self.model)
        # What is to be switched off when the bodies are described first.
        self._switched_off: SwitchedOff = switched_off
        # A copy of the data in which the derived quantities are computed; None until needed.
        self._copy: Any = None
        self._state: Any = self.data
        # What the bodies were described from, and the bodies.
        self._described: tuple[Any, ModelContent] | None = None
        self._bodies: list[Body] = []
        self._link_readers: list[LinkReader] = []
        self._ray_caster: RayCaster | None = None
        self._joint_rows: tuple[tuple[Body, ...], Array, Indices, Indices] | None = None
        # The geoms and flexes that the shapes of the bodies are of.
        self._parts: dict[Body, Indices] = {}
        # What the margins followed from, and those of some bodies that were read then.
        self._margins: tuple[bytes, list[Body], Margins] | None = None
        self._contact_reader = ContactReader(self.model)
        self._warned: set[str] = set()
        self._is_closed = False
        self.episode = 0
        self._episodes = EpisodeClock(self.data)
        # Those of the joints at the last tick.
        self._positions = self.data.qpos.tobytes()

    # -- bodies ---------------------------------------------------------------------------

    def describe(self) -> tuple[list[Body], list[Body]] | None:
        # A body of a new model stays the same if nothing about it changed.
        self._refresh()
        model, known = self.model, self._described
        if known is not None and known[0] is model and known[1].is_present():
            return None
        disabled = self._switches.disabled_geoms
        reader = ModelReader(model, self._names, self._kinds, self._only, disabled, self.part_names)
        before = {body.handle: body for body in self._bodies}
        described = reader.bodies()
        bodies = [
            old if (old := before.get(body.handle)) and is_same(old, body) else body
            for body in described
        ]
        added = [body for body in bodies if before.get(body.handle) is not body]
        kept = set(bodies)
        gone = [body for body in self._bodies if body not in kept]
        self._described, self._bodies = (model, ModelContent(model)), bodies
        self._ray_caster = None
        self._link_readers, self._joint_rows, self._margins = [], None, None
        parts = [reader.parts[body] for body in described]
        self._parts = dict(zip(bodies, parts, strict=True))
        inexact = (body.name for body in added if body.has_stand_ins and not body.bends)
        boxed = [name for name in inexact if name not in self._warned]
        if boxed:
            self._warned.update(boxed)
            warn(
                f"{joined_names(boxed)}: bounding boxes are used instead of shapes that ssduck "
                "does not know (signed distance fields are such), which have "
                "exact = false in the table of shapes"
            )
        (uncollided, hidden), self._switched_off = self._switched_off, ((), ())
        for body in added:
            if body.handle in uncollided:
                self.enable(body, False)
            if body.handle in hidden:
                self.show(body, False)
        return (added, gone) if added or gone else None

    def switched_on(self, model: Any) -> Any:
        """Returns a copy of a copy of the model, in which all bodies collide and are drawn."""
        return self._switches.switched_on(model)

    def has(self, body: Body) -> bool:
        """Checks whether the present model has a body."""
        return any(one is body for one in self._bodies)

    def has_only(self, handles: Collection[int]) -> bool:
        """Checks whether the present model has no other bodies than some."""
        return self._only is None and all(body.handle in handles for body in self._bodies)

    def _refresh(self) -> None:
        """Finds the present model and data, and the derived quantities of the tick."""
        if self._is_closed:
            raise SimulatorError("the world is closed; load or attach the world again")
        before, (self.model, self.data) = self.model, self._source()
        is_new = self.model is not before
        if self._episodes.begins(self.data, self.timestep, is_new=is_new):
            self.episode += 1
        if is_new:
            self._switches = interventions.Switches(self.model)
            self._contact_reader = ContactReader(self.model)
        self._positions = self.data.qpos.tobytes()
        # The first number is 0 in data whose poses MuJoCo never computed, or reset since.
        if not self._forward and self.data.xquat[0, 0]:
            self._state = self.data
            return
        if self._copy is None or self._copy.model is not self.model:
            self._copy = mujoco.MjData(self.model)
        # The user's data remains as it is, to the last bit.
        self._copy = copied_data(self.model, self.data, self._copy)
        mujoco.mj_forward(self.model, self._copy)
        self._state = self._copy

    def has_moved_on(self, sample: Sequence[Body]) -> bool:  # noqa: ARG002
        model, data = self._source()
        return (
            model is not self.model
            or float(data.time) != self._episodes.last
            or data.qpos.tobytes() != self._positions
        )

    def begin_episode(self) -> None:
        self._episodes.begin()

    # -- state ----------------------------------------------------------------------------

    @property
    def time(self) -> float:
        return float(self.data.time) + self._episodes.offset

    @property
    def timestep(self) -> float:
        return float(self.model.opt.timestep)

    @property
    def clock(self) -> Clock:
        return Clock(self.timestep, self.time)

    def read_link_poses(self, bodies: tuple[Body, ...]) -> LinkPoses:
        reader = next((one for one in self._link_readers if one.bodies is bodies), None)
        if reader is None:
            reader = LinkReader(self.model, bodies)
            self._link_readers = [reader, *self._link_readers[: _PREPARED - 1]]
        return reader.read(self._state)

    def read_joints(self, bodies: Sequence[Body]) -> Array:
        # The effort is the force of the actuators on the joint in the last step.
        known = self._joint_rows
        if known is None or known[0] != tuple(bodies):
            numbers = joint_numbers(self.model, bodies)
            types = [joint.type for body in bodies for joint in body.joints]
            is_scalar = np.array([type in SCALAR_JOINTS for type in types], dtype=bool)
            positions = self.model.jnt_qposadr[numbers].astype(np.intp)
            velocities = self.model.jnt_dofadr[numbers].astype(np.intp)
            unknown = np.where(is_scalar, 0.0, np.nan)[:, None]
            known = self._joint_rows = tuple(bodies), unknown, positions, velocities
        _, unknown, positions, velocities = known
        state = self._state
        columns = state.qpos[positions], state.qvel[velocities], state.qfrc_actuator[velocities]
        values: Array = np.stack(columns, axis=1) + unknown
        return values

    def read_masses(self, bodies: Sequence[Body]) -> list[list[float]]:
        masses = link_masses(self.model)
        present = set(self._bodies)
        return [
            masses[list(numbers_of(body))].tolist() + body.masses[body.rigid_count :]
            if body in present
            else body.masses
            for body in bodies
        ]

    def read_margins(self, bodies: Sequence[Body]) -> Margins:
        content, known = margin_content(self.model), self._margins
        if known is not None and known[0] == content and known[1] == bodies:
            return known[2]
        margins, parts = margins_of(self.model), self._parts
        if parts.keys() >= set(bodies):
            places = [np.zeros(0, np.intp), *(parts[body] for body in bodies)]
            of_bodies = margins.take(np.concatenate(places))
        else:
            known_ones = (margins.numbers[parts[b]] if b in parts else b.margins for b in bodies)
            of_bodies = Margins(np.concatenate([np.zeros(0), *known_ones]))
        self._margins = content, list(bodies), of_bodies
        return of_bodies

    def read_contacts(self) -> ContactPoints:
        return self._contact_reader.read(self._state, self._only)

    def step(self, count: int) -> None:
        self._refresh()
        mujoco.mj_step(self.model, self.data, count)

    def cast_rays(self, starts: Array, ends: Array, through: Indices) -> RayHits:
        if self._ray_caster is None:
            self._ray_caster = RayCaster(self.model, self._only)
        return self._ray_caster.cast(self._state, starts, ends, through)

    # -- pictures -------------------------------------------------------------------------

    def render(
        self, camera: Camera, width: int, height: int, *, shadow: bool
    ) -> npt.NDArray[np.uint8]:
        return draw(self.model, self._state, view_of(camera, width, height), shadow=shadow)

    def segment(self, camera: Camera, width: int, height: int) -> tuple[Indices, Indices]:
        return segment(self.model, self._state, view_of(camera, width, height))

    def photograph(self, view: CameraView) -> npt.NDArray[np.uint8]:
        return draw(self.model, self._state, view, shadow=False)

    # -- changes --------------------------------------------------------------------------

    def place(self, body: Body, position: Array, orientation: Array) -> None:
        model, data, root = self.model, self.data, body.handle
        base_joints = [joint for joint in body.joints if joint.link == 0]
        if root == 0:
            raise UnsupportedError("the world body does not move")
        if base_joints and base_joints[0].type != "free":
            names = joined_names([joint.name for joint in base_joints])
            raise UnsupportedError(f"the base of {body.name!r} moves by its joints: set {names}")
        interventions.put_base(model, data, root, np.concatenate((position, orientation)))
        mujoco.mj_forward(model, data)

    def set_joints(self, body: Body, positions: Mapping[int, float]) -> None:
        # Position actuators of a simulation that ssduck made hold the new positions.
        numbers = joint_numbers(self.model, [body])
        model, data = self.model, self.data
        for index, position in positions.items():
            data.qpos[model.jnt_qposadr[numbers[index]]] = position
            data.qvel[model.jnt_dofadr[numbers[index]]] = 0.0
        if not self.is_external:
            interventions.hold_positions(
                model, data, {int(numbers[n]): p for n, p in positions.items()}
            )
        mujoco.mj_forward(model, data)

    def drive(self, body: Body, motors: Mapping[int, MotorTarget]) -> None:
        numbers = joint_numbers(self.model, [body])
        targets = {
            int(numbers[index]): (body.joints[index], motor) for index, motor in motors.items()
        }
        interventions.drive(self.model, self.data, body.name, targets)

    def has_constraint(self, body: Body, other: Body) -> bool:
        return bool(self._holds(body, other))

    def add_constraint(self, body: Body, link: int, other: Body) -> None:
        interventions.hold(self.model, self.data, self._state, number_of(body, link), other.handle)

    def remove_constraint(self, body: Body, other: Body) -> None:
        self.data.eq_active[self._holds(body, other)] = 0

    def _holds(self, body: Body, other: Body) -> list[int]:
        """Returns the welds by which links of a body hold another."""
        welds = interventions.holds(self.model, self.data)
        return [n for n, one, held in welds if one in numbers_of(body) and held == other.handle]

    @property
    def disabled(self) -> frozenset[Body]:
        return self._switches.disabled

    @property
    def hidden(self) -> frozenset[Body]:
        return self._switches.hidden

    def enable(self, body: Body, on: bool) -> None:
        self._switches.enable(body, on)
        # It has the same shapes as before.
        self._described = (self.model, ModelContent(self.model))
        self._ray_caster = None

    def show(self, body: Body, on: bool) -> None:
        self._switches.show(body, on)

    def remove(self, body: Body) -> None:
        interventions.take_out(self.model, self.data, entity_roots(self.model) == body.handle)
        self._only = {one.handle for one in self._bodies if one is not body}
        self._described = self._ray_caster = None

    def close(self) -> None:
        self._is_closed = True


# MuJoCo's warnings of a state that it resets: `mj_resetData`, then a count of 1.
_UNSTABLE = [
    int(mujoco.mjtWarning.mjWARN_BADQPOS),
    int(mujoco.mjtWarning.mjWARN_BADQVEL),
    int(mujoco.mjtWarning.mjWARN_BADQACC),
]


class EpisodeClock:
    """Tells a reset, which begins an episode, from a time that falls within one.

    An episode begins with another model, and with a time that has fallen. It does not where MuJoCo
    itself reset an unstable state, nor if the user calls `begin_episode` at each reset, as
    `QueryWrapper` does. There time goes on, as that of a simulator without such a reset does.
    """

    def __init__(self, data: Any) -> None:
        self.last, self.offset = float(data.time), 0.0
        self._unstable = _unstable_states(data)
        # The simulated time between the last two ticks.
        self._interval = 0.0
        self._is_told = self._is_reset = False

    def begin(self) -> None:
        """Lets the next tick begin an episode; from now on, the user says where episodes begin."""
        self._is_told = self._is_reset = True

    def begins(self, data: Any, timestep: float, *, is_new: bool) -> bool:
        """Notes a tick; returns whether it begins an episode."""
        before, self.last = self.last, float(data.time)
        known, self._unstable = self._unstable, _unstable_states(data)
        is_reset, self._is_reset = self._is_reset, False
        has_fallen, is_same_time = self.last < before, self.last == before
        is_unstable = self._unstable > 0 and (
            has_fallen or (is_same_time and self._unstable != known)
        )
        if is_new or is_reset or (has_fallen and not is_unstable and not self._is_told):
            self.offset = 0.0
            return True
        if has_fallen or is_unstable:
            # MuJoCo's time goes on from that of the last tick.
            time = before + self.offset
            self.offset = time + (self._interval or max(self.last, timestep)) - self.last
            reason = "the simulation was reset without begin_episode()"
            if is_unstable:
                reason = "MuJoCo reset a state that was unstable (a smaller timestep may help)"
            warn(
                f"MuJoCo's time fell to {self.last:g} s within an episode, after {time:g} s: "
                f"{reason}. The episode goes on, and its time too",
                ProgramWarning,
            )
        elif not is_same_time:
            self._interval = self.last - before
        return False


def _unstable_states(data: Any) -> int:
    """Returns how many unstable states MuJoCo has counted since its last reset."""
    counts = data.warning.number
    return sum(int(counts[kind]) for kind in _UNSTABLE)
