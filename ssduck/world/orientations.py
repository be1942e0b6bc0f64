"""Reads the orientations that users give: quaternions of either order, and rotations of SciPy."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
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
    known: Iterable[Sequence[float]] | None = None,
) -> Array:
    """Returns the unit quaternion w, x, y, z, (4,), that a user gives.

    Args:
        orientation: a quaternion w, x, y, z, of which a warning tells if it may be one of the other
            order; or a rotation of SciPy.
        wxyz: a quaternion w, x, y, z.
        xyzw: a quaternion x, y, z, w.
        now: the present orientation w, x, y, z, which is returned if none is given.
        name: the name of the entity, for errors.
        known: in a simulator of quaternions x, y, z, w, the only ones that are surely w, x, y, z:
            those that ssduck tells now. Elsewhere None: a warning tells of probable ones only.
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
    if orientation is not None and _may_be_xyzw(quaternion, np.asarray(now), known):
        # Without the numbers, Python shows it once in each place.
        warn(
            f"{name}: the orientation, a list of four numbers, is read as w, x, y, z; quaternions "
            "of PyBullet and SciPy are x, y, z, w: write xyzw=[…] for one of these, else wxyz=[…]",
            ProgramWarning,
        )
    return quaternion


def _may_be_xyzw(quaternion: Array, now: Array, known: Iterable[Sequence[float]] | None) -> bool:
    """Checks whether x, y, z, w may be the order, or, if none are known, is the likelier one."""
    other = np.roll(quaternion, 1)
    if _is_same(quaternion, other) or _is_same(quaternion, now):
        return False
    if _is_same(other, now):
        return True
    if known is None:
        return _axes(other) <= 1 < _axes(quaternion)
    return not any(_is_same(quaternion, np.asarray(each)) for each in known)


def _is_same(one: Array, other: Array) -> bool:
    """Checks whether two unit quaternions are the same rotation."""
    return bool(min(np.abs(one - other).max(), np.abs(one + other).max()) < _SAME)


def _axes(quaternion: Array) -> int:
    """Returns about how many axes of the world a rotation w, x, y, z turns."""
    return int((np.abs(quaternion[1:]) > _SAME).sum())
