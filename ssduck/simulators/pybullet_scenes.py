"""Loading a scene's models into a PyBullet client."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import Any, cast

import numpy as np

from ssduck.errors import SceneError, nearest
from ssduck.geometry import compose
from ssduck.scenes import BodySpec, Scene
from ssduck.simulators import SETTABLE, Joint, Kind, Motor
from ssduck.simulators.pybullet_bodies import joint_of, wxyz, xyzw
from ssduck.simulators.pybullet_console import captured, pybullet

# Stands before each of Bullet's messages, which do not end in a new line.
_MARK = re.compile(r"b3(?:Error|Warning)\[[^]]*\]:")


def load_models(scene: Scene, client: int) -> tuple[dict[int, str], dict[int, Kind]]:
    """Fill a new client with a scene.

    Returns:
        The names and the kinds that the scene gives, by PyBullet body number.

    Raises:
        SceneError: a model cannot be loaded: file, key and reason.
    """
    pybullet.setTimeStep(scene.timestep, client)
    pybullet.setGravity(*scene.gravity, physicsClientId=client)
    if scene.elastic:
        pybullet.setPhysicsEngineParameter(
            # Slow contacts bounce, too; none is begun before shapes meet, which would brake
            # them, nor pushed apart afterwards, which would speed them up.
            restitutionVelocityThreshold=0.0,
            contactBreakingThreshold=1e-6,
            contactERP=0.0,
            physicsClientId=client,
        )
    names: dict[int, str] = {}
    kinds: dict[int, Kind] = {}
    for index, spec in enumerate(scene.bodies):
        # A model that is loaded by itself has no entry in a scene's file.
        place = f"{scene.path}: body[{index}]." if spec.name else ""
        for handle in _load_model(spec, place, client):
            if spec.name:
                names[handle] = spec.name
            if spec.kind:
                kinds[handle] = spec.kind
            _set_joints(handle, spec, place, client)
            if any(spec.velocity):
                linear, angular = spec.velocity[:3], spec.velocity[3:]
                pybullet.resetBaseVelocity(handle, linear, angular, client)
            if scene.elastic:
                _make_elastic(handle, client)
    # Contacts and rays of the first tick are of where things are now.
    pybullet.performCollisionDetection(client)
    return names, kinds


def _make_elastic(handle: int, client: int) -> None:
    """Let a body lose no energy: neither where it meets something nor in between."""
    for link in range(-1, pybullet.getNumJoints(handle, client)):
        pybullet.changeDynamics(
            handle,
            link,
            restitution=1.0,
            lateralFriction=0.0,
            spinningFriction=0.0,
            rollingFriction=0.0,
            linearDamping=0.0,
            angularDamping=0.0,
            physicsClientId=client,
        )


def _load_model(spec: BodySpec, place: str, client: int) -> Sequence[int]:
    """Load a model file; an SDF or MJCF file may hold several bodies."""
    file = str(spec.model)
    suffix = spec.model.suffix.lower()
    with captured() as lines:
        try:
            if suffix == ".urdf":
                return (_load_urdf(spec, file, client),)
            load = pybullet.loadSDF if suffix == ".sdf" else pybullet.loadMJCF
            return cast("Sequence[int]", load(file, physicsClientId=client))
        except pybullet.error as error:
            failure = error
    said = [part.strip() for part in _MARK.split(" ".join(lines)) if part.strip()]
    reason = "; ".join(said) or str(failure)
    where = f"{place}urdf: " if place else ""
    raise SceneError(f"{where}{file} cannot be loaded: {reason}") from failure


def _load_urdf(spec: BodySpec, file: str, client: int) -> int:
    handle = pybullet.loadURDF(
        file,
        useFixedBase=spec.fixed,
        # Cylinders stay cylinders; PyBullet would make prisms of them.
        flags=pybullet.URDF_USE_IMPLICIT_CYLINDER,
        physicsClientId=client,
    )
    # loadURDF's own position is that of the root's centre of mass or of its link frame
    # according to its flags; placing the link frame here leaves no doubt.
    dynamics = pybullet.getDynamicsInfo(handle, -1, client)
    position, orientation = compose(
        np.array([spec.position]),
        np.array([spec.orientation]),
        np.array([dynamics[3]]),
        wxyz(np.array([dynamics[4]])),
    )
    pybullet.resetBasePositionAndOrientation(
        handle, position[0].tolist(), xyzw(orientation)[0].tolist(), client
    )
    return int(handle)


def _set_joints(handle: int, spec: BodySpec, place: str, client: int) -> None:
    """Set the initial joint positions, and let motors hold joints with limits where they are.

    A joint that the scene does not set is at 0, or at its limit next to 0. Joints without
    limits are wheels and the like; their motors hold them at velocity 0.
    """
    count = pybullet.getNumJoints(handle, client)
    joints = [joint_of(pybullet.getJointInfo(handle, index, client)) for index in range(count)]
    for name, value in spec.joints.items():
        _check_joint(name, value, joints, f"{place}joints.{name}: {spec.model.name}")
    for joint in joints:
        if joint.type not in SETTABLE:
            continue
        value = spec.joints.get(joint.name, _next_to_zero(joint))
        pybullet.resetJointState(handle, joint.link - 1, value, 0.0, client)
        hold_joint(handle, joint, value, client)


def hold_joint(handle: int, joint: Joint, value: float, client: int) -> None:
    """Let a joint's motor hold it there; one without limits is held at velocity 0."""
    position = None if joint.lower is None else value
    set_motor(handle, joint.link, Motor(position, 0.0, joint.max_effort or 0.0, None), client)


def set_motor(handle: int, link: int, motor: Motor, client: int) -> None:
    """Let the motor of a link's joint act so from the next step on."""
    bounds: dict[str, Any] = {} if motor.speed is None else {"maxVelocity": motor.speed}
    target: dict[str, Any] = (
        {"controlMode": pybullet.VELOCITY_CONTROL, "targetVelocity": motor.velocity}
        if motor.position is None
        else {"controlMode": pybullet.POSITION_CONTROL, "targetPosition": motor.position}
    )
    pybullet.setJointMotorControl2(
        handle, link - 1, force=motor.effort, physicsClientId=client, **target, **bounds
    )


def _check_joint(name: str, value: float, joints: Sequence[Joint], place: str) -> None:
    """Complain of a joint that cannot be set so."""
    known = {joint.name: joint for joint in joints}
    if name not in known:
        raise SceneError(f"{place} has no such joint", suggestions=nearest(name, known))
    joint = known[name]
    if joint.type not in SETTABLE:
        raise SceneError(f"{place}: a {joint.type} joint has no position")
    low, high = _range(joint)
    if not low <= value <= high:
        raise SceneError(f"{place}: {value:g} is not from {low:g} to {high:g}, the joint's limits")


def _range(joint: Joint) -> tuple[float, float]:
    if joint.lower is None or joint.upper is None:
        return -math.inf, math.inf
    return joint.lower, joint.upper


def _next_to_zero(joint: Joint) -> float:
    low, high = _range(joint)
    return min(max(0.0, low), high)
