"""Sets the controls of actuators to move joints.

MuJoCo has no motors of joints. An actuator of a joint turns its control into a force: a position
actuator pulls the joint towards a position, a velocity actuator towards a velocity.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal, TypeAlias

from ssduck.errors import StateError, UnsupportedError
from ssduck.simulators.interface import Joint, MotorTarget
from ssduck.simulators.mujoco.library import mujoco

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
