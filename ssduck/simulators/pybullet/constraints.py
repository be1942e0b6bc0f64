"""Fixed constraints between a link of a body and another body."""

from __future__ import annotations

from ssduck.simulators.pybullet.console import pybullet
from ssduck.simulators.pybullet.scene_loader import create_constraint
from ssduck.simulators.scenes import ConstraintSpec


def add_fixed_constraint(client: int, on: tuple[int, int], to: int) -> None:
    """Connects the base of a body to a link, as they are, by a fixed constraint.

    Args:
        client: the client.
        on: the number of a body, and PyBullet's index of its link; -1 is the base.
        to: the number of the other body.
    """
    # A constraint connects the frames of two centres of mass.
    handle, link = on
    com_pose = (
        pybullet.getBasePositionAndOrientation(handle, client)
        if link < 0
        else pybullet.getLinkState(handle, link, 0, 1, client)[:2]
    )
    other = pybullet.getBasePositionAndOrientation(to, client)
    position, (x, y, z, w) = pybullet.multiplyTransforms(
        *pybullet.invertTransform(*com_pose), *other
    )
    spec = ConstraintSpec("fixed", on="", position=position, orientation=(w, x, y, z))
    create_constraint(spec, on, (to, -1), client)


def fixed_constraints(client: int, on: int, to: int) -> list[int]:
    """Returns the numbers of the fixed constraints between a body and the base of another."""
    numbers = [
        pybullet.getConstraintUniqueId(index, physicsClientId=client)
        for index in range(pybullet.getNumConstraints(client))
    ]
    return [
        number
        for number in numbers
        for info in [pybullet.getConstraintInfo(number, client)]
        if (info[0], info[2], info[3], info[4]) == (on, to, -1, pybullet.JOINT_FIXED)
    ]
