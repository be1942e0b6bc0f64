"""Writes the poses of SDF files as PyBullet reads them: relative to the model, in radians.

Measured with PyBullet 3.2.7. It takes poses of links for poses in the model, whatever they are
relative to, and leaves out that of the base link. It turns a joint about the origin of its child,
and takes the axis for one in the frame of the child.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from typing import TypeAlias
from xml.etree import ElementTree as ET

import numpy as np

from ssduck.errors import SceneError
from ssduck.geometry.arrays import Array
from ssduck.geometry.poses import IDENTITY, compose, invert, multiply, rotation_matrices
from ssduck.simulators.model_xml import number_in, numbers_text, roll_pitch_yaw

# A pose: a position (1, 3), and an orientation (1, 4) as w, x, y, z.
Pose: TypeAlias = tuple[Array, Array]
# An element, the path of its child, and the text that this gets; None if the child goes.
_Change: TypeAlias = tuple[ET.Element, str, str | None]

# The names of the frame that a model or a world itself is.
_OWN = ("", "__model__", "world", "__root__")
# What a pose is relative to, in SDF 1.7 and before.
_RELATIVE = ("relative_to", "frame")
_FRAMES = ("link", "joint", "frame", "model")
# Until this version, axes are in the frame of the model.
_AXES_OF_MODELS = 1.4


class _UnknownFrameError(Exception):
    """A pose is relative to a frame that is not there, or to itself."""


def place_frames(root: ET.Element) -> None:
    """Writes all poses and axes of an SDF file as PyBullet reads them.

    What is relative to a frame that is not there stays as it is.
    """
    world = root.find("world")
    scope = root if world is None else world
    version = (*_numbers(root.get("version")), 1.7)[0]
    changes: list[_Change] = []  # all are read before the first is written
    for model in scope.findall("model"):
        frames = _Frames.of(model)
        for part in (*model, model):
            with suppress(_UnknownFrameError, RecursionError):
                if part is model:
                    changes += _change_of_model(scope, model, frames)
                elif part.tag == "link":
                    changes += _changes_of_link(part, frames)
                elif part.tag == "joint" and part.get("name"):
                    changes += _changes_of_joint(part, frames, version)
    for owner, path, text in changes:
        child = owner.find(path)
        if text is None:
            assert child is not None
            owner.remove(child)
            continue
        if owner.tag == "model":
            owner.attrib.pop("placement_frame", None)
        if child is None:
            child = ET.Element(path)
            owner.insert(0, child)
        child.clear()
        child.text = text


@dataclass(frozen=True)
class _Frames:
    """The frames of a model, or of a world."""

    parts: dict[str, ET.Element]
    places: dict[str, Pose] = field(default_factory=dict)

    @classmethod
    def of(cls, scope: ET.Element) -> _Frames:
        return cls({part.get("name", ""): part for part in scope if part.tag in _FRAMES})

    def __getitem__(self, name: str) -> Pose:
        if name in _OWN:
            return _identity()
        if name not in self.places:
            self.places[name] = (np.full((1, 3), np.nan), IDENTITY[None])  # until it is known
            self.places[name] = self._place(name)
        if np.isnan(self.places[name][0]).any():
            raise _UnknownFrameError(name)
        return self.places[name]

    def _place(self, name: str) -> Pose:
        part = self.parts.get(name)
        if part is None:
            raise _UnknownFrameError(name)
        default = _child_of(part) if part.tag == "joint" else part.get("attached_to", "")
        return compose(*self[_relative_to(part) or default], *_pose_of(part))


def _change_of_model(scope: ET.Element, model: ET.Element, frames: _Frames) -> Iterator[_Change]:
    """Yields the change that puts the base link, which PyBullet takes for the model, in place."""
    children = {_child_of(joint) for joint in model.findall("joint")}
    names = [link.get("name", "") for link in model.findall("link")]
    roots = [name for name in names if name not in children]
    position, turn = base = frames[roots[0] if len(roots) == 1 else ""]
    place = frames[model.get("placement_frame", "")]
    is_moved = position.any() or turn[0, 1:].any() or model.get("placement_frame")
    if is_moved or not _is_plain(model):
        around = _Frames.of(scope)[_relative_to(model)]
        pose = compose(*compose(*compose(*around, *_pose_of(model)), *invert(*place)), *base)
        yield model, "pose", _text_of(pose)


def _changes_of_link(link: ET.Element, frames: _Frames) -> Iterator[_Change]:
    own = frames[link.get("name", "")]
    if not _is_plain(link):
        yield link, "pose", _text_of(own)
    for part in link:
        if part.tag in ("collision", "visual", "inertial") and not _is_plain(part):
            name = _relative_to(part)
            within = compose(*invert(*own), *frames[name]) if name else _identity()
            yield part, "pose", _text_of(compose(*within, *_pose_of(part)))


def _changes_of_joint(joint: ET.Element, frames: _Frames, version: float) -> Iterator[_Change]:
    """Yields the changes that give an axis in the frame of the child, and remove the pose."""
    child = frames[_child_of(joint)]
    position, turn = compose(*invert(*child), *frames[joint.get("name", "")])
    axis = joint.find("axis/xyz")
    direction = np.zeros(3)
    if axis is not None:
        numbers = _numbers(axis.text)
        if len(numbers) != 3 or not np.isfinite(numbers).all():
            return
        of_model = joint.findtext("axis/use_parent_model_frame", str(version <= _AXES_OF_MODELS))
        is_of_model = of_model.strip().lower() in ("1", "true")
        frame = axis.get("expressed_in") or ("__model__" if is_of_model else "")
        if frame:
            turn = multiply(invert(*child)[1], frames[frame][1])
        direction = rotation_matrices(turn)[0] @ numbers
        if axis.attrib or np.abs(direction - numbers).max() > 1e-12:
            yield joint, "axis/xyz", numbers_text(direction)
    if joint.find("pose") is not None:
        beside = np.linalg.norm(np.cross(position[0], direction)) > 1e-9
        if not beside or joint.get("type") not in ("revolute", "continuous"):
            yield joint, "pose", None


def _child_of(joint: ET.Element) -> str:
    return (joint.findtext("child") or "").strip()


def _is_plain(part: ET.Element) -> bool:
    """Checks whether PyBullet reads the pose of an element as it is meant."""
    pose = part.find("pose")
    if pose is None or len(pose):  # which is an error
        return True
    is_told = any(pose.get(key) for key in (*_RELATIVE, "degrees", "rotation_format"))
    return not is_told and bool((pose.text or "").split())


def _relative_to(part: ET.Element) -> str:
    pose = part.find("pose")
    names = () if pose is None else (pose.get(key, "") for key in _RELATIVE)
    return next((name for name in names if name), "")


def _pose_of(part: ET.Element) -> Pose:
    """Returns the pose of an element in the frame that it is relative to."""
    pose = part.find("pose")
    numbers = [] if pose is None else _numbers(pose.text)
    if pose is None or not numbers:
        return _identity()
    is_quaternion = pose.get("rotation_format") == "quat_xyzw"
    count = 7 if is_quaternion else 6
    if len(numbers) != count and not len(pose):
        raise SceneError(
            f"the <pose> of {part.get('name')!r} has {len(numbers)} numbers, not {count}"
        )
    if not np.isfinite(numbers).all():
        raise _UnknownFrameError
    position = np.array([numbers[:3]])
    if is_quaternion:
        quaternion = np.roll(numbers[3:], 1)[None]
        return position, quaternion / np.linalg.norm(quaternion)
    in_degrees = pose.get("degrees", "").strip().lower() in ("1", "true")
    # Roll, pitch and yaw, one after the other about the axes of the model.
    turns = np.zeros((3, 1, 4))
    for axis, angle in enumerate(np.radians(numbers[3:]) if in_degrees else numbers[3:]):
        turns[axis, 0, 0], turns[axis, 0, axis + 1] = math.cos(angle / 2), math.sin(angle / 2)
    return position, multiply(turns[2], multiply(turns[1], turns[0]))


def _identity() -> Pose:
    return np.zeros((1, 3)), IDENTITY[None]


def _text_of(pose: Pose) -> str:
    return numbers_text([*pose[0][0], *roll_pitch_yaw(pose[1][0])])


def _numbers(text: str | None) -> list[float]:
    """Returns the numbers of a text; NaN for words that are none."""
    numbers = map(number_in, (text or "").split())
    return [math.nan if number is None else number for number in numbers]
