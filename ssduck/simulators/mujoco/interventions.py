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
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from ssduck.errors import StateError, UnsupportedError
from ssduck.geometry.arrays import Array, Flags, Indices
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
_WELD = int(mujoco.mjtEq.mjEQ_WELD)
# The data of a weld that holds nothing: an anchor, a pose as x y z w x y z, the scale of torques.
IDLE = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)


# -- switches --------------------------------------------------------------------------------


@dataclass(eq=False)
class Switches:
    """The bodies of a model whose collisions are off, and those that are hidden."""

    model: Any
    disabled: frozenset[Body] = frozenset()
    hidden: frozenset[Body] = frozenset()
    _saved: dict[tuple[str, Body], dict[str, tuple[Indices, Array]]] = field(default_factory=dict)

    @property
    def disabled_geoms(self) -> Indices:
        """The geoms, then the flexes, that would collide if their bodies were not disabled."""
        saved = [self._saved["enable", body] for body in self.disabled]
        geoms = [parts["geom_contype"][0] for parts in saved]
        flexes = [parts["flex_contype"][0] + self.model.ngeom for parts in saved]
        return np.concatenate([np.zeros(0, np.intp), *geoms, *flexes])

    def enable(self, body: Body, on: bool) -> None:
        """Switches the collisions of a body on or off."""
        if on != (body in self.disabled):
            return
        if on:
            self._restore("enable", body)
            self.disabled -= {body}
            return
        model = self.model
        numbers = colliding_geoms(model)
        numbers = numbers[np.isin(model.geom_bodyid[numbers], numbers_of(body))]
        pairs = np.isin(model.pair_geom1, numbers) | np.isin(model.pair_geom2, numbers)
        self._set("enable", body, ("geom_contype", "geom_conaffinity"), numbers, 0)
        are_of_body = np.isin(np.arange(model.nbody), numbers_of(body))
        flexes = flexes_on(model, are_of_body)
        self._set("enable", body, ("flex_contype", "flex_conaffinity"), flexes, 0)
        self._set("enable", body, ("pair_margin",), np.flatnonzero(pairs), NEVER)
        self.disabled |= {body}

    def show(self, body: Body, on: bool) -> None:
        """Shows or hides a body."""
        if on != (body in self.hidden):
            return
        if on:
            self._restore("show", body)
            self.hidden -= {body}
            return
        model = self.model
        for part, owners in (("geom", model.geom_bodyid), ("site", model.site_bodyid)):
            numbers = np.flatnonzero(np.isin(owners, numbers_of(body)))
            self._set("show", body, (f"{part}_matid",), numbers, -1)
            self._set("show", body, (f"{part}_rgba",), numbers, 0.0)
        self.hidden |= {body}

    def _set(
        self, action: str, body: Body, names: Collection[str], numbers: Indices, value: float
    ) -> None:
        saved = self._saved.setdefault((action, body), {})
        for name in names:
            array = getattr(self.model, name)
            saved[name] = numbers, array[numbers].copy()
            array[numbers] = value

    def _restore(self, action: str, body: Body) -> None:
        _write(self.model, self._saved.pop((action, body)))

    def switched_on(self, model: Any) -> Any:
        """Returns a copy of a copy of the model, in which all bodies collide and are drawn."""
        copied = copy.copy(model)
        for saved in self._saved.values():
            _write(copied, saved)
        return copied


def _write(model: Any, saved: Mapping[str, tuple[Indices, Array]]) -> None:
    for name, (numbers, values) in saved.items():
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
    of_geoms = is_gone[model.geom_bodyid]
    model.geom_contype[of_geoms] = model.geom_conaffinity[of_geoms] = 0
    model.geom_rgba[of_geoms, 3] = 0.0
    of_flexes = flexes_on(model, is_gone)
    model.flex_contype[of_flexes] = model.flex_conaffinity[of_flexes] = 0
    model.flex_rgba[of_flexes, 3] = 0.0
    model.geom_matid[of_geoms] = -1
    model.pair_margin[of_geoms[model.pair_geom1] | of_geoms[model.pair_geom2]] = NEVER
    model.site_rgba[is_gone[model.site_bodyid], 3] = 0.0
    model.site_matid[is_gone[model.site_bodyid]] = -1
    of_dofs = is_gone[model.dof_bodyid]
    data.qvel[of_dofs] = 0.0
    model.body_gravcomp[is_gone] = 1.0
    for number in range(model.neq):
        if any(is_gone[body] for body in _bodies_of_constraint(model, number)):
            data.eq_active[number] = 0


def _bodies_of_constraint(model: Any, number: int) -> list[int]:
    """Returns the bodies that an equality constraint connects, as far as it names any."""
    object_type = int(model.eq_objtype[number])
    owners = {
        int(mujoco.mjtObj.mjOBJ_BODY): np.arange(model.nbody),
        int(mujoco.mjtObj.mjOBJ_JOINT): model.jnt_bodyid,
        int(mujoco.mjtObj.mjOBJ_SITE): model.site_bodyid,
    }.get(object_type)
    if owners is None:
        return []
    ends = (int(model.eq_obj1id[number]), int(model.eq_obj2id[number]))
    return [int(owners[end]) for end in ends if end >= 0]


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
    names = (name_of(model, mujoco.mjtObj.mjOBJ_EQUALITY, n, "") for n in range(model.neq))
    return [
        n
        for n, name in enumerate(names)
        if name.startswith(HOLD) and int(model.eq_type[n]) == _WELD
    ]


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
            raise UnsupportedError(
                f"{place} has no {servo} actuator{_others(model, number)}; write to data.ctrl "
                "what the actuators of your model take"
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
    return [
        n
        for n in range(len(model.actuator_trntype))
        if int(model.actuator_trntype[n]) in kinds and int(model.actuator_trnid[n, 0]) == joint
    ]


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
    object_type = mujoco.mjtObj.mjOBJ_ACTUATOR
    return mujoco.mj_id2name(model, object_type, actuator) or f"actuator_{actuator}"


def _others(model: Any, joint: int) -> str:
    names = [repr(_name(model, actuator)) for actuator in _actuators(model, joint)]
    return f"; it has {', '.join(names)}" if names else ""
