"""Writes bodies of PyBullet as an MJCF file, which MuJoCo loads, with their meshes beside it.

A body is a tree below the world body, fixed to it or with a free joint. Names of links and joints
are unique in MJCF: a link or a joint whose name another body has gets the name of its body in
front. Links of one body do not collide with each other, as in PyBullet. What has no counterpart is
left out, with a warning that names the bodies.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np

from ssduck.errors import warn
from ssduck.formatting import joined_names
from ssduck.geometry.arrays import Array
from ssduck.geometry.poses import IDENTITY, compose, invert, multiply, turn_to
from ssduck.geometry.shapes import Geometry
from ssduck.geometry.solids import solid_of
from ssduck.simulators.backends import BodyToCopy, TickToCopy
from ssduck.simulators.interface import SCALAR_JOINTS, Joint, VisualShape
from ssduck.simulators.mjcf import KIND_PREFIX, STATE_KEY
from ssduck.simulators.pybullet.introspection import constraints_of, model_of, visual_shapes
from ssduck.simulators.pybullet.simulator import PyBulletSimulator
from ssduck.simulators.pybullet.urdf import BodyModel, unique_names

# The folder of the meshes, beside the file.
ASSETS = "assets"
# MuJoCo refuses parts that move with less mass, kg, or less moment of inertia, kg m².
_MIN_MASS, _MIN_INERTIA = 1e-6, 1e-10
# MuJoCo's groups of geoms: those that are drawn, and those that only collide, which are not.
_DRAWN, _COLLIDING = "2", "3"
_GREY = (0.7, 0.7, 0.7, 1.0)
# Bodies with a mass of 0 do not move in PyBullet.
_JOINTS = {"revolute": "hinge", "prismatic": "slide", "spherical": "ball"}


def write_mjcf(
    simulator: PyBulletSimulator, originals: Sequence[BodyToCopy], tick: TickToCopy, file: Path
) -> None:
    """Writes the bodies of a simulation as they are at a tick.

    Args:
        simulator: the simulator that has the bodies.
        originals: the bodies.
        tick: the time of the tick and its flags.
        file: the MJCF file; the folder `ASSETS` beside it gets the meshes.

    Raises:
        UnsupportedError: a body is soft.
    """
    writer = _Writer(simulator, tick, file.parent / ASSETS)
    for original in originals:
        writer.add(original)
    writer.add_constraints(originals)
    writer.write(file)
    for difference, names in writer.differences.items():
        warn(f"{joined_names(names)}: {difference}")


@dataclass(eq=False)
class _Writer:
    """An MJCF document that grows body by body.

    Attributes:
        simulator: the simulator of the bodies.
        tick: the tick.
        folder: the folder of the meshes.
        differences: what is different in MuJoCo, with the names of the bodies.
    """

    simulator: PyBulletSimulator
    tick: TickToCopy
    folder: Path
    differences: dict[str, list[str]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.root = ET.Element("mujoco", model="world")
        parameters = self.simulator.parameters()
        gravity = [parameters[f"gravityAcceleration{axis}"] for axis in "XYZ"]
        ET.SubElement(self.root, "compiler", angle="radian", meshdir=ASSETS)
        timestep = _text(parameters["fixedTimeStep"])
        ET.SubElement(self.root, "option", timestep=timestep, gravity=_texts(gravity))
        self.assets = ET.SubElement(self.root, "asset")
        self.world = ET.SubElement(self.root, "worldbody")
        light = {"pos": "0 0 5", "dir": "0 0 -1", "directional": "true"}
        ET.SubElement(self.world, "light", light)
        self.contact = ET.SubElement(self.root, "contact")
        self.equality = ET.SubElement(self.root, "equality")
        self.custom = ET.SubElement(self.root, "custom")
        self.names: dict[str, set[str]] = {}
        self.links: dict[tuple[int, int], str] = {}
        self.positions: list[float] = []
        self.velocities: list[float] = []
        self.meshes: dict[str, str] = {}

    def note(self, name: str, difference: str) -> None:
        """Notes what is different in MuJoCo about a body."""
        names = self.differences.setdefault(difference, [])
        if name not in names:
            names.append(name)

    def name(self, kind: str, owner: str, name: str) -> str:
        """Returns a name that no other part of a kind has."""
        used = self.names.setdefault(kind, set())
        for candidate in (name, f"{owner}_{name}"):
            if candidate not in used:
                break
        else:
            candidate = unique_names([*used, f"{owner}_{name}"])[-1]
        used.add(candidate)
        return candidate

    def add(self, original: BodyToCopy) -> None:
        """Adds a body."""
        _Tree(self, original).write()

    def mesh(self, geometry: Geometry, inertia: str) -> str:
        """Returns the name of a mesh, which is written once."""
        if geometry.key not in self.meshes:
            name = f"mesh_{len(self.meshes) + 1}"
            self.folder.mkdir(exist_ok=True)
            surface = solid_of(geometry).surface
            lines = ["v " + _texts(corner) for corner in surface.vertices]
            lines += ["f " + " ".join(str(int(n) + 1) for n in face) for face in surface.faces]
            (self.folder / f"{name}.obj").write_text("\n".join(lines) + "\n", encoding="utf-8")
            mesh = {"name": name, "file": f"{name}.obj", "inertia": inertia}
            ET.SubElement(self.assets, "mesh", mesh)
            self.meshes[geometry.key] = name
        return self.meshes[geometry.key]

    def add_constraints(self, originals: Sequence[BodyToCopy]) -> None:
        """Adds fixed constraints as welds."""
        names = {original.body.handle: original.name for original in originals}
        poses = {
            original.body.handle: np.hstack(
                (original.link_poses.positions, original.link_poses.states[:, 3:7])
            )
            for original in originals
        }
        for spec, (on, link), (to, to_link) in constraints_of(self.simulator.client):
            if spec.type != "fixed":
                self.note(names[on], f"its {spec.type} constraint is left out")
                continue
            weld = {"body1": self.links[on, link + 1]}
            one, other = poses[on][link + 1], np.array([0.0, 0.0, 0.0, *IDENTITY])
            if to in names:
                weld["body2"] = self.links[to, to_link + 1]
                other = poses[to][to_link + 1]
            inverse = invert(one[None, :3], one[None, 3:])
            position, turn = compose(*inverse, other[None, :3], other[None, 3:])
            weld["relpose"] = _texts([*position[0], *turn[0]])
            ET.SubElement(self.equality, "weld", weld)

    def write(self, file: Path) -> None:
        """Writes the document, with the state of the tick as a key."""
        keys = ET.SubElement(self.root, "keyframe")
        state = {"qpos": _texts(self.positions), "qvel": _texts(self.velocities)}
        state = {name: text for name, text in state.items() if text}
        ET.SubElement(keys, "key", {"name": STATE_KEY, "time": _text(self.tick.time), **state})
        for part in [part for part in self.root if not len(part) and not part.attrib]:
            self.root.remove(part)
        ET.indent(self.root)
        ET.ElementTree(self.root).write(file, encoding="utf-8")


class _Tree:
    """A body as a tree of an MJCF document.

    Args:
        writer: the document.
        original: the body.
    """

    def __init__(self, writer: _Writer, original: BodyToCopy) -> None:
        self._writer, self._original = writer, original
        self._body = original.body
        self._model: BodyModel = model_of(writer.simulator, original.body)
        self._is_disabled = original.body in writer.tick.disabled
        visuals = visual_shapes(writer.simulator, original.body)
        self._visuals = [] if original.body in writer.tick.hidden else visuals
        names = [link.name or "link" for link in self._body.links[1:]]
        owner = original.name
        self._names = [writer.name("body", owner, name) for name in (owner, *names)]
        names = unique_names(joint.name for joint in self._body.joints)
        self._joint_names = [writer.name("joint", owner, name) for name in names]
        for number, name in enumerate(self._names):
            writer.links[self._body.handle, number] = name

    def write(self) -> None:
        """Adds the body to the document."""
        joints = self._body.joints
        self._write_link(self._writer.world, 0)
        links = self._names
        for number, name in enumerate(links):
            for other in links[:number]:
                ET.SubElement(self._writer.contact, "exclude", body1=other, body2=name)
        is_robot = any(joint.type in _JOINTS for joint in joints)
        if self._body.kind != ("robot" if is_robot else "kinbody"):
            text = {"name": KIND_PREFIX + self._original.name, "data": str(self._body.kind)}
            ET.SubElement(self._writer.custom, "text", text)
        if self._is_disabled:
            self._note("its collisions are off, so that MuJoCo's world has no shapes of it")
        if any(joint.max_effort for joint in joints if joint.type in SCALAR_JOINTS):
            self._note("its motors are left out: friction brakes its joints instead")

    def _note(self, difference: str) -> None:
        self._writer.note(self._original.name, difference)

    def _write_link(self, parent: ET.Element, number: int) -> None:
        element = ET.SubElement(parent, "body", name=self._names[number])
        self._add_pose(element, number)
        moves = self._add_joints(element, number)
        self._add_inertial(element, number, moves=moves)
        self._add_geoms(element, number)
        for child, link in enumerate(self._body.links):
            if link.parent == number:
                self._write_link(element, child)

    def _add_pose(self, element: ET.Element, number: int) -> None:
        if number:
            positions, turns = self._model.zero_poses
            position, turn = positions[number - 1], turns[number - 1]
        else:
            position = self._original.link_poses.positions[0]
            turn = self._original.link_poses.states[0, 3:7]
        element.set("pos", _texts(position))
        element.set("quat", _texts(turn))

    def _add_joints(self, element: ET.Element, number: int) -> bool:
        """Adds the joints of a link; returns whether it moves relative to its parent."""
        if not number:
            return self._add_free_joint(element)
        joint, states = self._body.joints[number - 1], self._original.joints[number - 1]
        kind = _JOINTS.get(joint.type)
        if kind is None:
            if joint.type != "fixed":
                self._note(f"its {joint.type} joint {joint.name!r} is fixed")
            return False
        values = {"name": self._joint_names[number - 1], "type": kind}
        if joint.type in SCALAR_JOINTS:
            values |= self._scalar_joint(joint, number - 1)
            position, velocity = (0.0 if np.isnan(value) else float(value) for value in states[:2])
            self._writer.positions.append(position)
            self._writer.velocities.append(velocity)
        else:  # the pose of the link has the present turn
            self._writer.positions += IDENTITY.tolist()
            self._writer.velocities += [0.0] * 3
        ET.SubElement(element, "joint", values)
        return True

    def _add_free_joint(self, element: ET.Element) -> bool:
        if not self._body.links[0].mass:
            return False
        ET.SubElement(element, "freejoint")
        poses = self._original.link_poses
        state = poses.states_at(poses.positions[:1], np.zeros(1, np.intp))[0]
        self._writer.positions += state[:7].tolist()
        # MuJoCo has the angular velocity in the frame of the body.
        spin = poses.matrices[0].T @ state[10:]
        self._writer.velocities += [*state[7:10].tolist(), *spin.tolist()]
        return True

    def _scalar_joint(self, joint: Joint, number: int) -> dict[str, str]:
        values = {"axis": _texts(joint.axis), "damping": _text(self._model.damping[number])}
        if joint.lower is not None and joint.upper is not None:
            values |= {"limited": "true", "range": _texts((joint.lower, joint.upper))}
        if joint.max_effort:
            limit = (-joint.max_effort, joint.max_effort)
            values |= {"actuatorfrclimited": "true", "actuatorfrcrange": _texts(limit)}
            values["frictionloss"] = _text(joint.max_effort)
        return values

    def _add_inertial(self, element: ET.Element, number: int, *, moves: bool) -> None:
        mass = self._body.links[number].mass
        inertias = self._model.inertias
        inertia = np.zeros(3) if inertias is None else np.array(inertias[number])
        if moves and (mass < _MIN_MASS or inertia.min() < _MIN_INERTIA):
            mass, inertia = max(mass, _MIN_MASS), np.maximum(inertia, _MIN_INERTIA)
            self._note("links without mass or inertia have very little")
        largest = float(inertia.max(initial=0.0))
        if largest > (room := float(inertia.sum()) - largest):
            # No rigid body has such moments, which MuJoCo refuses.
            inertia = np.minimum(inertia, max(room, _MIN_INERTIA))
            self._note("the largest moment of inertia of a link is the sum of the others")
        if not mass:
            return
        position, turn = self._model.com[0][number], self._model.com[1][number]
        values = {"pos": _texts(position), "quat": _texts(turn), "mass": _text(mass)}
        ET.SubElement(element, "inertial", {**values, "diaginertia": _texts(inertia)})

    def _add_geoms(self, element: ET.Element, number: int) -> None:
        contacts = self._model.contacts[number]
        friction = contacts.get("lateral_friction", 0.5)
        for shape in self._body.shapes:
            if shape.frame == number:
                if shape.exact is False:
                    self._note("its bounding box stands for shapes that PyBullet does not give")
                collision = {"group": _COLLIDING, "friction": _texts((friction, 0.005, 0.0001))}
                if self._is_disabled:
                    collision |= {"contype": "0", "conaffinity": "0"}
                pose = shape.position, shape.orientation
                self._add_geom(element, shape.geometry, pose, collision)
        for visual in self._visuals:
            if visual.link == number:
                self._add_visual(element, visual)

    def _add_visual(self, element: ET.Element, visual: VisualShape) -> None:
        drawn = {"contype": "0", "conaffinity": "0", "group": _DRAWN, "mass": "0"}
        drawn["rgba"] = _texts(visual.colour or _GREY)
        self._add_geom(element, visual.geometry, (visual.position, visual.orientation), drawn)

    def _add_geom(
        self,
        element: ET.Element,
        geometry: Geometry,
        pose: tuple[Array, Array],
        more: Mapping[str, str],
    ) -> None:
        position, turn = pose
        values: dict[str, str] = {"type": geometry.type}
        a, b, c = geometry.size
        is_drawn = more["group"] == _DRAWN
        match geometry.type:
            case "box":
                values["size"] = _texts((a / 2, b / 2, c / 2))
            case "sphere":
                values["size"] = _text(a)
            case "cylinder" | "capsule":
                values["size"] = _texts((a, b / 2))
            case "ellipsoid":
                values["size"] = _texts((a, b, c))
            case "plane":
                values["size"] = "0 0 1"
                turn = multiply(turn, turn_to((a, b, c)))
                if self._body.links[0].mass:
                    self._note("a plane that moves is left out")
                    return
            case "hull" | "mesh":
                solid = solid_of(geometry)
                if not is_drawn and not solid.is_convex:
                    self._note("MuJoCo collides the hull of its mesh")
                    geometry = Geometry.hull(geometry.vertices)
                    solid = solid_of(geometry)
                if not is_drawn and not solid.volume:
                    self._note("a flat hull is left out")
                    return
                inertia = "shell" if is_drawn else "convex"
                values |= {"type": "mesh", "mesh": self._writer.mesh(geometry, inertia)}
        values |= {"pos": _texts(position), "quat": _texts(turn)}
        ET.SubElement(element, "geom", {**values, **more})


def _text(number: Any) -> str:
    return repr(float(number))


def _texts(numbers: Iterable[Any]) -> str:
    return " ".join(map(_text, numbers))
