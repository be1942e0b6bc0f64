"""Where the links of a robot are for many positions of its joints at once, and the other way.

Poses are homogeneous matrices (4, 4), metres, of link frames.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ssduck.geometry.arrays import Array, Flags, Indices
from ssduck.geometry.poses import rotation_matrices
from ssduck.simulators.interface import Body
from ssduck.world.entities import Entity

# Rounds of the inverse kinematics, its damping, and the longest step of a joint, rad.
ROUNDS = 40
DAMPING = 0.03
LONGEST = 0.4
# A solution is as near: metres, and radians.
NEAR = 5e-4
TRUE = 2e-3
# Weight of a radian against a metre.
TURN = 0.25


def poses(positions: Array, orientations: Array) -> Array:
    """Matrices (n, 4, 4) of positions (n, 3) and unit quaternions (n, 4), w, x, y, z."""
    matrices = np.zeros((len(positions), 4, 4))
    matrices[:, :3, :3] = rotation_matrices(orientations)
    matrices[:, :3, 3] = positions
    matrices[:, 3, 3] = 1.0
    return matrices


def inverse(pose: Array) -> Array:
    """The inverse of poses (..., 4, 4)."""
    found = np.zeros_like(pose)
    turn = np.swapaxes(pose[..., :3, :3], -1, -2)
    found[..., :3, :3] = turn
    found[..., :3, 3] = -(turn @ pose[..., :3, 3, None])[..., 0]
    found[..., 3, 3] = 1.0
    return found


@dataclass(frozen=True, eq=False)
class KinematicChain:
    """The links of a robot, and how its joints move them.

    Attributes:
        body: the robot.
        rest: (links, 4, 4), each link's pose in its parent's frame where its joint is at 0.
        names: of the joints that turn, in order; all arrays of positions are in this order.
        links: (joints,), which link each of them turns.
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
        """The chain of a robot, worked out from where its links are at this tick."""
        world = robot.world
        body = robot.body_of(world.snapshot.members[world.snapshot.rows[robot.id]], "plan for")
        states = robot.links
        now = poses(
            np.array([state.position for state in states]),
            np.array([state.orientation for state in states]),
        )
        rest = np.tile(np.eye(4), (len(states), 1, 1))
        turning = [joint for joint in body.joints if joint.type == "revolute"]
        angles = {state.name: state.position for state in robot.joints}
        for joint in body.joints:
            parent = body.links[joint.link].parent
            rest[joint.link] = inverse(now[parent]) @ now[joint.link]
            if joint.type == "revolute":
                back = _turns(np.array(joint.axis), np.array([-angles[joint.name]]))[0]
                rest[joint.link] = rest[joint.link] @ back
        bounds = [(-np.inf if j.lower is None else j.lower) for j in turning]
        tops = [(np.inf if j.upper is None else j.upper) for j in turning]
        links = np.array([joint.link for joint in turning], dtype=np.intp)
        names = tuple(joint.name for joint in turning)
        return cls(body, rest, names, links, np.array(bounds), np.array(tops))

    def link(self, name: str) -> int:
        """The number of a link."""
        return [link.name for link in self.body.links].index(name)

    def beyond(self, name: str) -> list[int]:
        """The numbers of a link and of all that hang on it."""
        found = {self.link(name)}
        for number, link in enumerate(self.body.links):
            if link.parent in found:
                found.add(number)
        return sorted(found)

    def columns(self, names: Sequence[str]) -> Indices:
        """Which positions are those of these joints."""
        return np.array([self.names.index(name) for name in names], dtype=np.intp)

    def now(self, robot: Entity) -> tuple[Array, Array]:
        """The base's pose (4, 4) and the joints' positions (joints,) at this tick."""
        base = poses(np.array([robot.position]), np.array([robot.orientation]))[0]
        angles = {state.name: state.position for state in robot.joints}
        return base, np.array([angles[name] for name in self.names])

    def frames(self, bases: Array, positions: Array, upto: int | None = None) -> Array:
        """Poses of all links in the world, (n, links, 4, 4).

        Args:
            bases: (n, 4, 4), of the base link's frame.
            positions: (n, joints), rad.
            upto: only those of this link and what it hangs on are told; others are 0.
        """
        count = len(positions)
        wanted = range(len(self.rest)) if upto is None else self._way_to(upto)
        found = np.zeros((count, len(self.rest), 4, 4))
        found[:, 0] = bases
        turning = {int(link): column for column, link in enumerate(self.links)}
        for joint in self.body.joints:
            if joint.link not in wanted:
                continue
            local = self.rest[joint.link]
            if joint.link in turning:
                local = local @ _turns(np.array(joint.axis), positions[:, turning[joint.link]])
            found[:, joint.link] = found[:, self.body.links[joint.link].parent] @ local
        return found

    def _way_to(self, link: int) -> set[int]:
        """A link and all that it hangs on."""
        found = set()
        while link >= 0:
            found.add(link)
            link = self.body.links[link].parent
        return found

    def reach(
        self, bases: Array, starts: Array, moving: Indices, link: int, point: Array, goals: Array
    ) -> tuple[Array, Flags]:
        """Joints that bring a point of a link somewhere, the link's z axis along a direction.

        Damped least squares (Wampler, Manipulator inverse kinematic solutions based on vector
        formulations and damped least-squares methods, 1986), for many at once; joints are kept
        within their limits. The link may turn about its z axis.

        Args:
            bases: (n, 4, 4).
            starts: (n, joints), where the search begins.
            moving: which joints may move.
            link: the link.
            point: (3,), in the link's frame.
            goals: (n, 6), where the point is to be, m, and the z axis' direction, of length 1.

        Returns:
            Positions (n, joints), and whether each is a solution (n,).
        """
        angles = starts.copy()
        axes = np.array([self.body.joints[self.links[c] - 1].axis for c in moving])
        links = self.links[moving]
        error = np.zeros((len(angles), 6))
        for _ in range(ROUNDS):
            frames = self.frames(bases, angles, link)
            here = frames[:, link, :3, 3] + frames[:, link, :3, :3] @ point
            z = frames[:, link, :3, 2]
            error[:, :3] = goals[:, :3] - here
            error[:, 3:] = TURN * _turn_between(z, goals[:, 3:])
            if _are_near(error).all():
                break
            turned = frames[:, links]
            about = np.einsum("njab,jb->nja", turned[..., :3, :3], axes)
            arms = here[:, None] - turned[..., :3, 3]
            jacobian = np.concatenate((np.cross(about, arms), TURN * about), axis=2)
            square = np.einsum("nja,njb->nab", jacobian, jacobian) + DAMPING**2 * np.eye(6)
            pull = np.linalg.solve(square, error[..., None])[..., 0]
            step = np.einsum("nja,na->nj", jacobian, pull)
            step = np.clip(step, -LONGEST, LONGEST)
            angles[:, moving] = np.clip(
                angles[:, moving] + step, self.lower[moving], self.upper[moving]
            )
        return angles, _are_near(error)


def _are_near(error: Array) -> Flags:
    near: Flags = (np.linalg.norm(error[:, :3], axis=1) < NEAR) & (
        np.linalg.norm(error[:, 3:], axis=1) < TURN * TRUE
    )
    return near


def _turn_between(z: Array, goal: Array) -> Array:
    """The rotation vectors (n, 3) that turn directions to others the shortest way, rad."""
    axis = np.cross(z, goal)
    sine = np.linalg.norm(axis, axis=1)
    angle = np.arctan2(sine, np.einsum("na,na->n", z, goal))
    # Opposite directions have no shortest way: any one will do.
    axis[sine < 1e-9] = np.array([1.0, 0.0, 0.0])
    sine[sine < 1e-9] = 1.0
    turn: Array = axis * (angle / sine)[:, None]
    return turn


def _turns(axis: Array, angles: Array) -> Array:
    """Rotations (n, 4, 4) about an axis of length 1, by Rodrigues' formula."""
    x, y, z = axis
    skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    sine, cosine = np.sin(angles)[:, None, None], np.cos(angles)[:, None, None]
    found = np.tile(np.eye(4), (len(angles), 1, 1))
    found[:, :3, :3] = np.eye(3) + sine * skew + (1.0 - cosine) * (skew @ skew)
    return found
