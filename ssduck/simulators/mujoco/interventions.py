"""Switches the collisions of bodies on and off, hides, removes, connects and drives them.

A compiled model cannot lose or get parts. So a body that does not collide has geoms that meet
nothing, a hidden one is transparent, and a removed one is both and left out of all descriptions. To
connect bodies, welds are needed that the model has already: inactive ones whose names begin with
`HOLD`. ssduck adds some to the models that it loads.

MuJoCo has no motors of joints. An actuator of a joint turns its control into a force: a position
actuator pulls the joint towards a position, a velocity actuator towards a velocity.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from ssduck.errors import StateError, UnsupportedError
from ssduck.geometry.arrays import Flags, Indices
from ssduck.geometry.poses import compose, invert
from ssduck.simulators.interface import Body, Joint, MotorTarget
from ssduck.simulators.mujoco.bodies import colliding_geoms, name_of, numbers_of
from ssduck.simulators.mujoco.flexes import flexes_on
from ssduck.simulators.mujoco.library import mujoco

# The beginning of the names of welds that connect what `Entity.hold` holds.
HOLD = "ssduck_hold"
# The number of them that a model gets when it is loaded.
SPARE_WELDS = 8
# A margin at which no two shapes meet.
NEVER = -1e9
# The data of a weld that holds nothing: an anchor, a pose as x y z w x y z, the scale of torques.
IDLE = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)


# -- switches --------------------------------------------------------------------------------


@dataclass(eq=False)
class Switches:
    """The bodies of a model whose collisions are off, and those that are hidden."""

    model: Any
    disabled: frozenset[Body] = frozenset()
    hidden: frozenset[Body] = frozenset()
    _saved: dict[tuple[_Off, Body], list[_Numbers]] = field(default_factory=dict)

    @property
    def disabled_geoms(self) -> Indices:
        """The geoms, then the flexes, that would collide if their bodies were not disabled."""
        saved = [number for body in self.disabled for number in self._saved[_uncollided, body]]
        geoms = [numbers for name, numbers, _ in saved if name == "geom_contype"]
        flexes = [
            numbers + self.model.ngeom for name, numbers, _ in saved if name == "flex_contype"
        ]
        return np.concatenate([np.zeros(0, np.intp), *geoms, *flexes])

    def enable(self, body: Body, on: bool) -> None:
        """Switches the collisions of a body on or off."""
        self.disabled = self._switched(_uncollided, self.disabled, body, on)

    def show(self, body: Body, on: bool) -> None:
        """Shows or hides a body."""
        self.hidden = self._switched(_undrawn, self.hidden, body, on)

    def _switched(
        self, numbers_off: _Off, off: frozenset[Body], body: Body, on: bool
    ) -> frozenset[Body]:
        """Switches a body on or off; returns the bodies that are off then."""
        if on != (body in off):
            return off
        if on:
            _write(self.model, self._saved.pop((numbers_off, body)))
            return off - {body}
        changes = list(
            numbers_off(self.model, np.isin(np.arange(self.model.nbody), numbers_of(body)))
        )
        self._saved[numbers_off, body] = [
            (name, numbers, getattr(self.model, name)[numbers]) for name, numbers, _ in changes
        ]
        _write(self.model, changes)
        return off | {body}

    def switched_on(self, model: Any) -> Any:
        """Returns a copy of a copy of the model, in which all bodies collide and are drawn."""
        copied = copy.copy(model)
        for saved in self._saved.values():
            _write(copied, saved)
        return copied


# The name of an array of a model, some places in it, and what is to be there.
_Numbers: TypeAlias = tuple[str, Indices, Any]
# Yields what switches something off for bodies of a model, by flags (bodies,).
_Off: TypeAlias = Callable[[Any, Flags], Iterator[_Numbers]]


def _uncollided(model: Any, bodies: Flags) -> Iterator[_Numbers]:
    geoms = colliding_geoms(model)
    geoms = geoms[bodies[model.geom_bodyid[geoms]]]
    for part, numbers in (("geom", geoms), ("flex", flexes_on(model, bodies))):
        yield f"{part}_contype", numbers, 0
        yield f"{part}_conaffinity", numbers, 0
    pairs = np.isin(model.pair_geom1, geoms) | np.isin(model.pair_geom2, geoms)
    yield "pair_margin", np.flatnonzero(pairs), NEVER


def _undrawn(model: Any, bodies: Flags) -> Iterator[_Numbers]:
    for part, owners in (("geom", model.geom_bodyid), ("site", model.site_bodyid)):
        numbers = np.flatnonzero(bodies[owners])
        yield f"{part}_matid", numbers, -1
        yield f"{part}_rgba", numbers, 0.0
    yield "flex_rgba", flexes_on(model, bodies), 0.0


def _write(model: Any, changes: Iterable[_Numbers]) -> None:
    for name, numbers, values in changes:
        getattr(model, name)[numbers] = values


# -- poses -----------------------------------------------------------------------------------


def put_base(
    model: Any, data: Any, root: int, pose: ArrayLike, velocity: ArrayLike = (0.0,) * 6
) -> None:
    """Puts a root body at a pose (7,), by its free joint, as a mocap body or in the model.

    The velocity (6,) of a free joint is that of the body in the world, m/s, and the angular one in
    the frame of the body, rad/s. A base with other joints stays: these place it.
    """
    numbers = np.asarray(pose)
    joint, mocap = int(model.body_jntadr[root]), int(model.body_mocapid[root])
    if mocap >= 0:
        data.mocap_pos[mocap], data.mocap_quat[mocap] = numbers[:3], numbers[3:]
    elif joint < 0:
        model.body_pos[root], model.body_quat[root] = numbers[:3], numbers[3:]
    elif int(model.jnt_type[joint]) == int(mujoco.mjtJoint.mjJNT_FREE):
        first, speed = int(model.jnt_qposadr[joint]), int(model.jnt_dofadr[joint])
        data.qpos[first : first + 7] = numbers
        data.qvel[speed : speed + 6] = velocity


# -- removal ---------------------------------------------------------------------------------


def take_out(model: Any, data: Any, is_gone: Flags) -> None:
    """Takes bodies, (bodies,) flags of whole trees, out of all interactions, and hides them."""
    _write(model, (*_uncollided(model, is_gone), *_undrawn(model, is_gone)))
    data.qvel[is_gone[model.dof_bodyid]] = 0.0
    model.body_gravcomp[is_gone] = 1.0
    owners = {
        int(mujoco.mjtObj.mjOBJ_BODY): np.arange(model.nbody),
        int(mujoco.mjtObj.mjOBJ_JOINT): model.jnt_bodyid,
        int(mujoco.mjtObj.mjOBJ_SITE): model.site_bodyid,
    }
    for kind, of_parts in owners.items():
        # The last flag stands for the number -1, for none.
        are_gone = np.append(is_gone[of_parts], False)
        rows = np.flatnonzero(model.eq_objtype == kind)
        are_cut = are_gone[model.eq_obj1id[rows]] | are_gone[model.eq_obj2id[rows]]
        data.eq_active[rows[are_cut]] = 0


# -- holding ---------------------------------------------------------------------------------


def add_spare_welds(spec: Any) -> None:
    """Adds inactive welds to a specification, for `Entity.hold`."""
    bodies = list(spec.bodies)[1:]  # without the world body
    if not bodies:
        return
    if not bodies[0].name:
        bodies[0].name = "body_1"  # as ssduck names it
    for number in range(SPARE_WELDS):
        weld = spec.add_equality()
        weld.name = f"{HOLD}_{number}"
        weld.type, weld.objtype = mujoco.mjtEq.mjEQ_WELD, mujoco.mjtObj.mjOBJ_BODY
        weld.name1, weld.active = bodies[0].name, False
        weld.data[: len(IDLE)] = IDLE


def spare_welds(model: Any) -> list[int]:
    """Returns the numbers of the welds by which bodies can be held."""
    welds = np.flatnonzero(model.eq_type == int(mujoco.mjtEq.mjEQ_WELD)).tolist()
    kind = mujoco.mjtObj.mjOBJ_EQUALITY
    return [n for n in welds if name_of(model, kind, n, "").startswith(HOLD)]


def holds(model: Any, data: Any) -> Iterator[tuple[int, int, int]]:
    """Yields the welds that hold bodies: their numbers, the holding bodies, the held ones."""
    for number in spare_welds(model):
        if data.eq_active[number]:
            yield number, int(model.eq_obj1id[number]), int(model.eq_obj2id[number])


def hold(model: Any, data: Any, poses: Any, holding: int, held: int) -> None:
    """Welds two bodies, by their numbers, together as they are in other data, `poses`."""
    welds = spare_welds(model)
    free = [number for number in welds if not data.eq_active[number]]
    if not free:
        used = f"all {len(welds)} of the model hold something" if welds else "the model has none"
        raise UnsupportedError(
            f"MuJoCo's models have a fixed number of welds, and {used}: release something, or "
            f"declare <weld name='{HOLD}' body1='…' active='false'/> in the model"
        )
    number = free[0]
    position, turn = compose(
        *invert(poses.xpos[holding][None], poses.xquat[holding][None]),
        poses.xpos[held][None],
        poses.xquat[held][None],
    )
    model.eq_obj1id[number], model.eq_obj2id[number] = holding, held
    model.eq_objtype[number] = int(mujoco.mjtObj.mjOBJ_BODY)
    model.eq_data[number, : len(IDLE)] = [*IDLE[:3], *position[0], *turn[0], IDLE[-1]]
    data.eq_active[number] = 1


Servo: TypeAlias = Literal["position", "velocity"]
# The fraction by which the gains of a servo may differ.
_TOLERANCE = 1e-9


def drive(
    model: Any, data: Any, entity: str, targets: Mapping[int, tuple[Joint, MotorTarget]]
) -> None:
    """Sets the controls of position and velocity actuators of joints, by MuJoCo's numbers."""
    controls = {}
    for number, (joint, target) in targets.items():
        place = f"{entity}: joint {joint.name!r}"
        servo: Servo = "velocity" if target.position is None else "position"
        if target.effort != (joint.max_effort or 0.0):
            raise UnsupportedError(
                f"{place}: the greatest effort of an actuator is that of its model"
            )
        actuator = _actuator(model, number, servo)
        if actuator is None:
            names = [repr(_name(model, other)) for other in _actuators(model, number)]
            others = f"; it has {', '.join(names)}" if names else ""
            raise UnsupportedError(
                f"{place} has no {servo} actuator{others}; write to data.ctrl what the actuators "
                "of your model take"
            )
        value = target.velocity if target.position is None else target.position
        value *= float(model.actuator_gear[actuator, 0])
        control = _controls(model, actuator)[0]
        low, high = model.actuator_ctrlrange[control].tolist()
        if model.actuator_ctrllimited[control] and not low <= value <= high:
            raise StateError(
                f"{place}: the control {value:g} is not from {low:g} to {high:g}, the range of the "
                f"actuator {_name(model, actuator)!r}"
            )
        controls[control] = value
    for control, value in controls.items():
        data.ctrl[control] = value


def hold_positions(model: Any, data: Any, positions: Mapping[int, float]) -> None:
    """Makes position actuators hold joints at positions, by MuJoCo's numbers of the joints."""
    for number, position in positions.items():
        actuator = _actuator(model, number, "position")
        if actuator is not None:
            control = _controls(model, actuator)[0]
            data.ctrl[control] = position * model.actuator_gear[actuator, 0]


def _actuators(model: Any, joint: int) -> list[int]:
    """Returns the actuators that act on a joint alone."""
    kinds = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
    are_on = np.isin(model.actuator_trntype, kinds) & (model.actuator_trnid[:, 0] == joint)
    numbers: list[int] = np.flatnonzero(are_on).tolist()
    return numbers


def _controls(model: Any, actuator: int) -> range:
    """Returns the controls of an actuator: before MuJoCo 4 each has one, with its number."""
    if not hasattr(model, "actuator_ctrladr"):
        return range(actuator, actuator + 1)
    first = int(model.actuator_ctrladr[actuator])
    return range(first, first + int(model.actuator_ctrlnum[actuator]))


def _actuator(model: Any, joint: int, servo: Servo) -> int | None:
    """Returns the first position or velocity actuator of a joint; None if it has none."""
    return next((n for n in _actuators(model, joint) if _servo(model, n) == servo), None)


def _servo(model: Any, actuator: int) -> Servo | None:
    """Returns what the control of an actuator sets; None for a force or something else."""
    is_affine = int(model.actuator_biastype[actuator]) == int(mujoco.mjtBias.mjBIAS_AFFINE)
    is_fixed = int(model.actuator_gaintype[actuator]) == int(mujoco.mjtGain.mjGAIN_FIXED)
    gain = float(model.actuator_gainprm[actuator, 0])
    if not (is_affine and is_fixed and gain) or len(_controls(model, actuator)) != 1:
        return None
    _, stiffness, damping = model.actuator_biasprm[actuator, :3].tolist()
    if abs(stiffness + gain) <= _TOLERANCE * abs(gain):
        return "position"
    if not stiffness and abs(damping + gain) <= _TOLERANCE * abs(gain):
        return "velocity"
    return None


def _name(model: Any, actuator: int) -> str:
    return name_of(model, mujoco.mjtObj.mjOBJ_ACTUATOR, actuator, "actuator")
