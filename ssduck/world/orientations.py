"""Reads the orientations that users give: quaternions of either order, and rotations of SciPy."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol, TypeAlias, runtime_checkable

import numpy as np

from ssduck import validation
from ssduck.errors import ArgumentError, ProgramWarning, warn
from ssduck.geometry.arrays import Array
from ssduck.simulators.kinematics import unit

# Quaternions differ by less if they are the same.
_SAME = 1e-6


@runtime_checkable
class ScipyRotation(Protocol):
    """What `scipy.spatial.transform.Rotation` has."""

    def as_quat(self) -> Array:
        """Returns the quaternion, x, y, z, w."""


Orientation: TypeAlias = Sequence[float] | Array | ScipyRotation


def orientation_of(
    orientation: Orientation | None,
    wxyz: Sequence[float] | None,
    xyzw: Sequence[float] | None,
    now: Sequence[float],
    name: str,
) -> Array:
    """Returns the unit quaternion w, x, y, z, (4,), that a user gives.

    Args:
        orientation: a quaternion w, x, y, z, of which a warning tells if it is probably one of the
            other order; or a rotation of SciPy.
        wxyz: a quaternion w, x, y, z.
        xyzw: a quaternion x, y, z, w.
        now: the present orientation w, x, y, z, which is returned if none is given.
        name: the name of the entity, for errors.

    Raises:
        ArgumentError: two are given, or there are not four numbers.
        StateError: a number is not finite, or all are 0.
    """
    given = [value for value in (orientation, wxyz, xyzw) if value is not None]
    if len(given) > 1:
        raise ArgumentError(f"{name}: give one of orientation, wxyz and xyzw")
    (value,) = given or [now]
    is_xyzw = xyzw is not None or isinstance(value, ScipyRotation)
    numbers_given = value.as_quat() if isinstance(value, ScipyRotation) else value
    quaternion = unit(validation.finite_array(numbers_given, 4, f"{name}: orientation"), name)
    if is_xyzw:
        return np.roll(quaternion, 1)
    if orientation is not None and _is_probably_xyzw(quaternion, np.asarray(now)):
        numbers = "[" + ", ".join(f"{number:g}" for number in np.asarray(value)) + "]"
        warn(
            f"{name}: {numbers} is read as w, x, y, z; quaternions of PyBullet and SciPy are "
            f"x, y, z, w: write xyzw={numbers} for one of these, else wxyz={numbers}",
            ProgramWarning,
        )
    return quaternion


def _is_probably_xyzw(quaternion: Array, now: Array) -> bool:
    """Checks whether x, y, z, w is the likelier order: as now, or about one axis."""
    other = np.roll(quaternion, 1)
    if _is_same(quaternion, other) or _is_same(quaternion, now):
        return False
    return _is_same(other, now) or (_axes(other) <= 1 < _axes(quaternion))


def _is_same(one: Array, other: Array) -> bool:
    """Checks whether two unit quaternions are the same rotation."""
    return bool(min(np.abs(one - other).max(), np.abs(one + other).max()) < _SAME)


def _axes(quaternion: Array) -> int:
    """Returns about how many axes of the world a rotation w, x, y, z turns."""
    return int((np.abs(quaternion[1:]) > _SAME).sum())
