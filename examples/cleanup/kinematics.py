"""Computes forward and inverse kinematics of a robot for many joint positions at once.

Poses of link frames are homogeneous matrices (4, 4), in metres.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ssduck.geometry.arrays import Array, Flags, Indices
from ssduck.geometry.poses import rotation_matrices
from ssduck.simulators.interface import Body
from ssduck.world.entities import Entity

# Iterations of the inverse kinematics, its damping, and the largest step of a joint, rad.
ITERATIONS = 40
DAMPING = 0.03
MAX_STEP = 0.4
# The tolerances of solutions, m and rad.
POSITION_TOLERANCE = 5e-4
ANGLE_TOLERANCE = 2e-3
# The weight of a radian relative to a metre.
ANGLE_WEIGHT = 0.25


def poses(positions: Array, orientations: Array) -> Array:
    """Returns matrices (n, 4, 4) of positions (n, 3) and unit quaternions (n, 4), w, x, y, z."""
    matrices = np.zeros((len(positions), 4, 4))
    matrices[:, :3, :3] = rotation_matrices(orientations)
    matrices[:, :3, 3] = positions
    matrices[:, 3, 3] = 1.0
    return matrices


def inverse(pose: Array) -> Array:
    """Returns the inverses of poses (..., 4, 4)."""
    result = np.zeros_like(pose)
    turn = np.swapaxes(pose[..., :3, :3], -1, -2)
    result[..., :3, :3] = turn
    result[..., :3, 3] = -(turn @ pose[..., :3, 3, None])[..., 0]
    result[..., 3, 3] = 1.0
    return result


@dataclass(frozen=True, eq=False)
class KinematicChain:
    """The links of a robot and the joints between them.

    Attributes:
        body: the robot.
        rest: (links, 4, 4), the pose of each link in its parent's frame with the joint at 0.
        names: the names of the revolute joints; arrays of positions have this order.
        links: (joints,), the link that each joint moves.
        lower: (joints,), rad.
        upper: (joints,), rad.
    """

    body: Body
    rest: Array
    names: tuple[str, ...]
    links: Indices
    lower: Array
    upper: Array

    @classmethod
    def of(cls, robot: Entity) -> KinematicChain:
        """Returns the chain of a robot from the poses of its links at the current tick."""
        world = robot.world
        body = robot.body_of(world.snapshot.entities[world.snapshot.rows[robot.id]], "plan for")
        states = robot.links
        current = poses(
            np.array([state.position for state in states]),
            np.array([state.orientation for state in states]),
        )
        rest = np.tile(np.eye(4), (len(states), 1, 1))
        revolute = [joint for joint in body.joints if joint.type == "revolute"]
        angles = {state.name: state.position for state in robot.joints}
        for joint in body.joints:
            parent = body.links[joint.link].parent
            rest[joint.link] = inverse(current[parent]) @ current[joint.link]
            if joint.type == "revolute":
                back = _rotations(np.array(joint.axis), np.array([-angles[joint.name]]))[0]
                rest[joint.link] = rest[joint.link] @ back
        lower = [(-np.inf if j.lower is None else j.lower) for j in revolute]
        upper = [(np.inf if j.upper is None else j.upper) for j in revolute]
        links = np.array([joint.link for joint in revolute], dtype=np.intp)
        names = tuple(joint.name for joint in revolute)
        return cls(body, rest, names, links, np.array(lower), np.array(upper))

    def link(self, name: str) -> int:
        """Returns the index of a link."""
        return [link.name for link in self.body.links].index(name)

    def descendants(self, name: str) -> list[int]:
        """Returns the indices of a link and of all its descendants."""
        result = {self.link(name)}
        for number, link in enumerate(self.body.links):
            if link.parent in result:
                result.add(number)
        return sorted(result)

    def columns(self, names: Sequence[str]) -> Indices:
        """Returns the indices of joints in arrays of positions."""
        return np.array([self.names.index(name) for name in names], dtype=np.intp)

    def state(self, robot: Entity) -> tuple[Array, Array]:
        """Returns the base pose (4, 4) and joint positions (joints,) at the current tick."""
        base = poses(np.array([robot.position]), np.array([robot.orientation]))[0]
        angles = {state.name: state.position for state in robot.joints}
        return base, np.array([angles[name] for name in self.names])

    def frames(self, bases: Array, positions: Array, upto: int | None = None) -> Array:
        """Returns the poses of all links in the world, (n, links, 4, 4).

        Args:
            bases: (n, 4, 4), poses of the base link.
            positions: (n, joints), rad.
            upto: computes only this link and its ancestors; the others are 0.
        """
        count = len(positions)
        selected = range(len(self.rest)) if upto is None else self._ancestors(upto)
        result = np.zeros((count, len(self.rest), 4, 4))
        result[:, 0] = bases
        columns = {int(link): column for column, link in enumerate(self.links)}
        for joint in self.body.joints:
            if joint.link not in selected:
                continue
            local = self.rest[joint.link]
            if joint.link in columns:
                local = local @ _rotations(np.array(joint.axis), positions[:, columns[joint.link]])
            result[:, joint.link] = result[:, self.body.links[joint.link].parent] @ local
        return result

    def _ancestors(self, link: int) -> set[int]:
        """Returns the indices of a link and of its ancestors."""
        result = set()
        while link >= 0:
            result.add(link)
            link = self.body.links[link].parent
        return result

    def solve(
        self, bases: Array, starts: Array, moving: Indices, link: int, point: Array, goals: Array
    ) -> tuple[Array, Flags]:
        """Solves for joint positions that bring a point and the z axis of a link to goals.

        Uses damped least squares (Wampler, Manipulator inverse kinematic solutions based on
        vector formulations and damped least-squares methods, 1986), for many starts at once,
        within the joint limits. The rotation about the z axis of the link is free.

        Args:
            bases: (n, 4, 4), poses of the base link.
            starts: (n, joints), the initial positions.
            moving: the indices of the joints that may move.
            link: the index of the link.
            point: (3,), the point in the link's frame.
            goals: (n, 6), positions of the point, m, and unit directions of the z axis.

        Returns:
            Positions (n, joints), and whether each is a solution (n,).
        """
        angles = starts.copy()
        axes = np.array([self.body.joints[self.links[c] - 1].axis for c in moving])
        links = self.links[moving]
        error = np.zeros((len(angles), 6))
        for _ in range(ITERATIONS):
            frames = self.frames(bases, angles, link)
            reached = frames[:, link, :3, 3] + frames[:, link, :3, :3] @ point
            z = frames[:, link, :3, 2]
            error[:, :3] = goals[:, :3] - reached
            error[:, 3:] = ANGLE_WEIGHT * _rotation_between(z, goals[:, 3:])
            if _are_solved(error).all():
                break
            joint_frames = frames[:, links]
            axes_in_world = np.einsum("njab,jb->nja", joint_frames[..., :3, :3], axes)
            arms = reached[:, None] - joint_frames[..., :3, 3]
            jacobian = np.concatenate(
                (np.cross(axes_in_world, arms), ANGLE_WEIGHT * axes_in_world), axis=2
            )
            square = np.einsum("nja,njb->nab", jacobian, jacobian) + DAMPING**2 * np.eye(6)
            multipliers = np.linalg.solve(square, error[..., None])[..., 0]
            step = np.einsum("nja,na->nj", jacobian, multipliers)
            step = np.clip(step, -MAX_STEP, MAX_STEP)
            angles[:, moving] = np.clip(
                angles[:, moving] + step, self.lower[moving], self.upper[moving]
            )
        return angles, _are_solved(error)


def _are_solved(error: Array) -> Flags:
    solved: Flags = (np.linalg.norm(error[:, :3], axis=1) < POSITION_TOLERANCE) & (
        np.linalg.norm(error[:, 3:], axis=1) < ANGLE_WEIGHT * ANGLE_TOLERANCE
    )
    return solved


def _rotation_between(z: Array, goal: Array) -> Array:
    """Returns the shortest rotation vectors (n, 3) from directions to others, rad."""
    axis = np.cross(z, goal)
    sine = np.linalg.norm(axis, axis=1)
    angle = np.arctan2(sine, np.einsum("na,na->n", z, goal))
    # Between opposite directions any axis will do.
    axis[sine < 1e-9] = np.array([1.0, 0.0, 0.0])
    sine[sine < 1e-9] = 1.0
    turn: Array = axis * (angle / sine)[:, None]
    return turn


def _rotations(axis: Array, angles: Array) -> Array:
    """Returns rotations (n, 4, 4) about a unit axis, by Rodrigues' formula."""
    x, y, z = axis
    skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    sine, cosine = np.sin(angles)[:, None, None], np.cos(angles)[:, None, None]
    result = np.tile(np.eye(4), (len(angles), 1, 1))
    result[:, :3, :3] = np.eye(3) + sine * skew + (1.0 - cosine) * (skew @ skew)
    return result
