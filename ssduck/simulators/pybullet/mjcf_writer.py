"""Writes bodies of PyBullet as an MJCF file, which MuJoCo loads, with their meshes beside it.

A body is a tree below the world body, fixed to it or with a free joint. Names of links and joints
are unique in MJCF: a link or a joint whose name another body has gets the name of its body in
front. Links of one body do not collide with each other, as in PyBullet. What has no counterpart is
left out, with a warning that names the bodies.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np

from ssduck.errors import warn
from ssduck.formatting import joined_names
from ssduck.geometry.arrays import Array
from ssduck.geometry.poses import IDENTITY, compose, invert, multiply, turn_to
from ssduck.geometry.shapes import Geometry, PlacedGeometry
from ssduck.geometry.solids import solid_of
from ssduck.simulators.backends import BodyToCopy, TickToCopy
from ssduck.simulators.interface import SCALAR_JOINTS
from ssduck.simulators.model_xml import (
    ASSETS,
    KIND_PREFIX,
    MJCF_SIZES,
    STATE_KEY,
    add_part,
    obj_text,
    unique_names,
)
from ssduck.simulators.naming import unique_name
from ssduck.simulators.pybullet.introspection import model_of, visual_shapes
from ssduck.simulators.pybullet.scene_loader import constraints_of
from ssduck.simulators.pybullet.simulator import PyBulletSimulator

# MuJoCo refuses parts that move with less mass, kg, or less moment of inertia, kg m².
_MIN_MASS, _MIN_INERTIA = 1e-6, 1e-10
# MuJoCo's groups of geoms: those that are drawn, and those that only collide, which are not.
_DRAWN, _COLLIDING = "2", "3"
# What does not collide.
_PASSED: dict[str, Any] = {"contype": "0", "conaffinity": "0"}
_GREY = (0.7, 0.7, 0.7, 1.0)
# Bodies with a mass of 0 do not move in PyBullet.
_JOINTS = {"revolute": "hinge", "prismatic": "slide", "spherical": "ball"}


def write_mjcf(
    simulator: PyBulletSimulator, originals: Sequence[BodyToCopy], tick: TickToCopy, file: Path
) -> None:
    """Writes the bodies of a simulation as they are at a tick; meshes into a folder beside."""
    writer = _Writer(simulator, tick, file.parent / ASSETS)
    for original in originals:
        _Tree(writer, original).write()
    writer.add_constraints(originals)
    writer.write(file)
    for difference, names in writer.differences.items():
        warn(f"{joined_names(list(names))}: {difference}")


@dataclass(eq=False)
class _Writer:
    """An MJCF document that grows body by body."""

    simulator: PyBulletSimulator
    tick: TickToCopy
    folder: Path  # of the meshes
    # What is different in MuJoCo, with the names of the bodies.
    differences: dict[str, dict[str, None]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.root = ET.Element("mujoco", model="world")
        add_part(self.root, "compiler", angle="radian", meshdir=ASSETS)
        scene = self.simulator.settings()
        add_part(self.root, "option", timestep=scene.timestep, gravity=scene.gravity)
        tags = ("asset", "worldbody", "contact", "equality", "custom")
        sections = (add_part(self.root, tag) for tag in tags)
        self.assets, self.world, self.contact, self.equality, self.custom = sections
        add_part(self.world, "light", pos="0 0 5", dir="0 0 -1", directional="true")
        self.names: dict[str, set[str]] = {"body": set(), "joint": set()}
        self.links: dict[tuple[int, int], str] = {}
        self.positions: list[float] = []
        self.velocities: list[float] = []
        self.meshes: dict[str, str] = {}

    def note(self, name: str, difference: str) -> None:
        """Notes what is different in MuJoCo about a body."""
        self.differences.setdefault(difference, {})[name] = None

    def name(self, kind: str, owner: str, name: str) -> str:
        """Returns a name that no other part of a kind has."""
        used = self.names[kind]
        own, longer = (unique_names([text])[0] for text in (name, f"{owner}_{name}"))
        chosen = unique_name(longer, used) if own in used else own
        used.add(chosen)
        return chosen

    def mesh(self, geometry: Geometry, inertia: str) -> str:
        """Returns the name of a mesh, which is written once."""
        if geometry.key not in self.meshes:
            name = f"mesh_{len(self.meshes) + 1}"
            self.folder.mkdir(exist_ok=True)
            surface = solid_of(geometry).surface
            text = obj_text(surface.vertices, surface.faces)
            (self.folder / f"{name}.obj").write_text(text, encoding="utf-8")
            add_part(self.assets, "mesh", name=name, file=f"{name}.obj", inertia=inertia)
            self.meshes[geometry.key] = name
        return self.meshes[geometry.key]

    def add_constraints(self, originals: Sequence[BodyToCopy]) -> None:
        """Adds fixed constraints as welds."""
        by_handle = {original.body.handle: original for original in originals}
        for _, spec, (on, link), (to, to_link) in constraints_of(self.simulator.client):
            if spec.type != "fixed":
                self.note(by_handle[on].name, f"its {spec.type} constraint is left out")
                continue
            ends = {"body1": self.links[on, link + 1]}
            other = np.zeros((1, 3)), IDENTITY[None]
            if to in by_handle:
                ends["body2"] = self.links[to, to_link + 1]
                other = _pose(by_handle[to], to_link + 1)
            position, turn = compose(*invert(*_pose(by_handle[on], link + 1)), *other)
            add_part(self.equality, "weld", **ends, relpose=[*position[0], *turn[0]])

    def write(self, file: Path) -> None:
        """Writes the document, with the state of the tick as a key."""
        state = {"qpos": self.positions, "qvel": self.velocities}
        state = {name: numbers for name, numbers in state.items() if numbers}
        keys = add_part(self.root, "keyframe")
        add_part(keys, "key", name=STATE_KEY, time=self.tick.time, **state)
        for part in [part for part in self.root if not len(part) and not part.attrib]:
            self.root.remove(part)
        ET.indent(self.root)
        ET.ElementTree(self.root).write(file, encoding="utf-8")


def _pose(original: BodyToCopy, link: int) -> tuple[Array, Array]:
    poses = original.link_poses
    return poses.positions[[link]], poses.states[[link], 3:7]


class _Tree:
    """A body as a tree of an MJCF document."""

    def __init__(self, writer: _Writer, original: BodyToCopy) -> None:
        self._writer, self._original, self._body = writer, original, original.body
        self._model = model_of(writer.simulator, original.body)
        self._is_disabled = original.body in writer.tick.disabled
        visuals = visual_shapes(writer.simulator, original.body)
        self._visuals = [] if original.body in writer.tick.hidden else visuals
        owner, links = original.name, [link.name or "link" for link in self._body.links[1:]]
        self._names = [writer.name("body", owner, name) for name in (owner, *links)]
        joints = unique_names(joint.name for joint in self._body.joints)
        self._joint_names = [writer.name("joint", owner, name) for name in joints]
        for number, name in enumerate(self._names):
            writer.links[self._body.handle, number] = name

    def write(self) -> None:
        """Adds the body to the document."""
        joints = self._body.joints
        self._write_link(self._writer.world, 0)
        for number, name in enumerate(self._names):
            for other in self._names[:number]:
                add_part(self._writer.contact, "exclude", body1=other, body2=name)
        is_robot = any(joint.type in _JOINTS for joint in joints)
        if self._body.kind != ("robot" if is_robot else "kinbody"):
            name = KIND_PREFIX + self._original.name
            add_part(self._writer.custom, "text", name=name, data=self._body.kind)
        if self._is_disabled:
            self._note("its collisions are off, so that MuJoCo's world has no shapes of it")
        if any(joint.max_effort for joint in joints if joint.type in SCALAR_JOINTS):
            self._note("its motors are left out: friction brakes its joints instead")

    def _note(self, difference: str) -> None:
        self._writer.note(self._original.name, difference)

    def _write_link(self, parent: ET.Element, number: int) -> None:
        if number:
            positions, turns = self._model.zero_poses
            pose = positions[number - 1], turns[number - 1]
        else:
            pose = _pose(self._original, 0)
        element = add_part(parent, "body", name=self._names[number], pos=pose[0], quat=pose[1])
        moves = self._add_joint(element, number) if number else self._add_free_joint(element)
        self._add_inertial(element, number, moves=moves)
        self._add_geoms(element, number)
        for child, link in enumerate(self._body.links):
            if link.parent == number:
                self._write_link(element, child)

    def _add_joint(self, element: ET.Element, number: int) -> bool:
        """Adds the joint of a link; returns whether it moves relative to its parent."""
        joint, states = self._body.joints[number - 1], self._original.joints[number - 1]
        if joint.type not in _JOINTS:
            if joint.type != "fixed":
                self._note(f"its {joint.type} joint {joint.name!r} is fixed")
            return False
        name, kind = self._joint_names[number - 1], _JOINTS[joint.type]
        values: dict[str, Any] = {}
        if joint.type not in SCALAR_JOINTS:  # the pose of the link has the present turn
            self._writer.positions += IDENTITY.tolist()
            self._writer.velocities += [0.0] * 3
        else:
            position, velocity = (0.0 if math.isnan(n) else n for n in states[:2].tolist())
            self._writer.positions.append(position)
            self._writer.velocities.append(velocity)
            values |= {"axis": joint.axis, "damping": self._model.damping[number - 1]}
            if joint.lower is not None and joint.upper is not None:
                values |= {"limited": "true", "range": (joint.lower, joint.upper)}
            if effort := joint.max_effort:
                values |= {"actuatorfrclimited": "true", "actuatorfrcrange": (-effort, effort)}
                values["frictionloss"] = effort
        add_part(element, "joint", name=name, type=kind, **values)
        return True

    def _add_free_joint(self, element: ET.Element) -> bool:
        if not self._body.links[0].mass:
            return False
        add_part(element, "freejoint")
        state = self._original.base_state
        self._writer.positions += state[:7].tolist()
        # MuJoCo has the angular velocity in the frame of the body.
        spin = self._original.link_poses.matrices[0].T @ state[10:]
        self._writer.velocities += [*state[7:10].tolist(), *spin.tolist()]
        return True

    def _add_inertial(self, element: ET.Element, number: int, *, moves: bool) -> None:
        mass, inertia = self._body.links[number].mass, self._model.inertias[number]
        if moves and (mass < _MIN_MASS or inertia.min() < _MIN_INERTIA):
            mass, inertia = max(mass, _MIN_MASS), np.maximum(inertia, _MIN_INERTIA)
            self._note("links without mass or inertia have very little")
        largest = float(inertia.max(initial=0.0))
        if largest > (room := float(inertia.sum()) - largest):
            # No rigid body has such moments, which MuJoCo refuses.
            inertia = np.minimum(inertia, max(room, _MIN_INERTIA))
            self._note("the largest moment of inertia of a link is the sum of the others")
        if mass:
            pos, quat = (part[number] for part in self._model.com)
            add_part(element, "inertial", pos=pos, quat=quat, mass=mass, diaginertia=inertia)

    def _add_geoms(self, element: ET.Element, number: int) -> None:
        friction = self._model.contacts[number].get("lateral_friction", 0.5)
        colliding: dict[str, Any] = {"group": _COLLIDING, "friction": (friction, 0.005, 0.0001)}
        if self._is_disabled:
            colliding |= _PASSED
        for shape in self._body.shapes:
            if shape.frame == number:
                if shape.exact is False:
                    self._note("its bounding box stands for shapes that PyBullet does not give")
                self._add_geom(element, shape, colliding)
        for visual in self._visuals:
            if visual.frame == number:
                colour = visual.colour or _GREY
                drawn = _PASSED | {"group": _DRAWN, "mass": "0", "rgba": colour}
                self._add_geom(element, visual, drawn)

    def _add_geom(
        self, element: ET.Element, shape: PlacedGeometry, more: Mapping[str, Any]
    ) -> None:
        geometry, turn = shape.geometry, shape.orientation
        form: dict[str, Any] = {"type": geometry.type}
        if factors := MJCF_SIZES.get(geometry.type):
            form["size"] = [n * part for n, part in zip(geometry.size, factors, strict=False)]
        elif geometry.type == "plane":
            form["size"] = "0 0 1"
            turn = multiply(turn, turn_to(geometry.size))
            if self._body.links[0].mass:
                self._note("a plane that moves is left out")
                return
        else:
            mesh = self._mesh(geometry, is_drawn=more["group"] == _DRAWN)
            if mesh is None:
                self._note("a flat hull is left out")
                return
            form = {"type": "mesh", "mesh": mesh}
        add_part(element, "geom", **form, pos=shape.position, quat=turn, **more)

    def _mesh(self, geometry: Geometry, *, is_drawn: bool) -> str | None:
        """Returns the name of a mesh; None for one that would collide, and is flat."""
        if is_drawn:
            return self._writer.mesh(geometry, "shell")
        if not solid_of(geometry).is_convex:
            self._note("MuJoCo collides the hull of its mesh")
            geometry = Geometry.hull(geometry.vertices)
        return self._writer.mesh(geometry, "convex") if solid_of(geometry).volume else None
