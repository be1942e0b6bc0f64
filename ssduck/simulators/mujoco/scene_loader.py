"""Makes one MuJoCo model of a scene's bodies: URDF files, primitives and the floor.

MuJoCo reads each URDF file; its tree then becomes a body of the model. As with PyBullet, a base
moves freely unless it is fixed or has no mass, links of one body do not collide with each other,
and motors hold the joints. Names of links and joints are unique in MuJoCo's model, in which the
base of a body has its name, and a part whose name another body has gets the name of its body in
front; in the world, they have the names of the file.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from itertools import combinations
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np

from ssduck.errors import SceneError, UnsupportedError, warn
from ssduck.formatting import joined_names
from ssduck.geometry.poses import rotation_matrices, turn_to, unit_quaternions
from ssduck.simulators.interface import SCALAR_JOINTS, Body
from ssduck.simulators.kinematics import check_joints, position_nearest_zero
from ssduck.simulators.model_xml import MJCF_SIZES, parse_tolerantly
from ssduck.simulators.mujoco.bodies import ModelReader
from ssduck.simulators.mujoco.interventions import add_spare_welds, hold_positions
from ssduck.simulators.mujoco.library import mujoco
from ssduck.simulators.mujoco.simulator import MuJoCoSimulator
from ssduck.simulators.naming import name_by_file, unique_name
from ssduck.simulators.scene_bodies import FLOOR, BodySpec, Primitive
from ssduck.simulators.scenes import Engine, Scene

# MuJoCo's groups of geoms: those that are drawn, and those that only collide, which are not.
_DRAWN, _COLLIDING = 2, 3
# The suffixes of the meshes that MuJoCo reads.
_MESHES = (".obj", ".stl", ".msh")
# The sliding friction of a link that states none, and the friction against rolling.
_FRICTION, _OTHER_FRICTION = 0.5, (0.005, 0.0001)
# What meshes at rest keep apart, as PyBullet's do, for which scenes are laid out, m.
_MARGIN = 0.001
# A motor has its greatest effort at this distance from its position, rad or m, or at this
# difference from its velocity, rad/s or m/s. It goes back in this time, s, many steps: then it is
# stable however light the link is.
_GIVES_WAY, _DELAY = 0.02, 0.05
_SCALAR = (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)


def load_bodies(scene: Scene) -> MuJoCoSimulator:
    """Starts a simulation of the bodies of a scene."""
    _check_supported(scene)
    builder = _Builder({"world", FLOOR, *(str(body.name) for body in scene.bodies if body.name)})
    spec = builder.spec
    spec.option.timestep, spec.option.gravity = scene.timestep, scene.gravity
    for entry, place in scene.entries:
        builder.add(entry, place)
    if builder.undrawn:
        listed = joined_names(sorted(builder.undrawn))
        warn(f"{scene.path}: MuJoCo reads no such meshes, which are not drawn: {listed}")
    add_spare_welds(spec)
    try:
        model = spec.compile()
    except (ValueError, RuntimeError, MemoryError, mujoco.FatalError) as error:
        raise SceneError(f"{scene.path} cannot be loaded: {error}") from error
    data = mujoco.MjData(model)
    data.time = scene.time
    described = ModelReader(model, None, None, part_names=builder.part_names).bodies()
    by_name = {body.name: body for body in described}
    for entry, name, place in builder.entries:
        _begin(entry, place, by_name[name], model, data)
    mujoco.mj_forward(model, data)
    entries = [(entry, by_name[name]) for entry, name, _ in builder.entries]
    return MuJoCoSimulator(
        lambda: (model, data),
        owned=True,
        spec=spec,
        kinds={body.name: entry.kind for entry, body in entries if entry.kind},
        switched_off=(
            [body.handle for entry, body in entries if not entry.enabled],
            [body.handle for entry, body in entries if not entry.visible],
        ),
        part_names=builder.part_names,
    )


def _check_supported(scene: Scene) -> None:
    """Raises an error for what a scene has that MuJoCo's model does not get."""
    sources = {body.source for body in scene.bodies}
    reasons = {
        "elastic = true": scene.elastic,
        "an engine": scene.engine != Engine(),
        "constraints": bool(scene.constraints),
        "an SDF file": "sdf" in sources,
        "an MJCF file beside other things": "mjcf" in sources,
    }
    found = [reason for reason, applies in reasons.items() if applies]
    if found:
        raise UnsupportedError(
            f"{scene.path}: MuJoCo loads scenes of URDF files and primitives, and MJCF files by "
            f"themselves; this scene has {joined_names(found)}: describe everything in one MJCF "
            "file, or load the scene with PyBullet; World.save(folder, 'mujoco') writes a scene of "
            "PyBullet as MJCF"
        )


@dataclass(eq=False)
class _Builder:
    """A specification that grows body by body."""

    taken: set[str]  # names, with those that are still to come
    # The entries of the scene, with the names of their bases in the model, and their places.
    entries: list[tuple[BodySpec, str, str]] = field(default_factory=list)
    undrawn: set[str] = field(default_factory=set)  # files of meshes
    # The names of links and joints in their files, by those in the model.
    part_names: dict[str, str] = field(default_factory=dict)
    _meshes: dict[tuple[str, tuple[float, ...]], str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.spec = mujoco.MjSpec()
        compiler = self.spec.compiler
        compiler.degree, compiler.balanceinertia = False, True
        # MuJoCo refuses parts that move with less mass, kg, or less moment of inertia, kg m².
        compiler.boundmass, compiler.boundinertia = 1e-6, 1e-10
        # Motors are stiff.
        self.spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        self.spec.worldbody.add_light(pos=[0, 0, 5], dir=[0, 0, -1])

    def add(self, spec: BodySpec, place: str) -> None:
        """Adds a body; its place is for errors."""
        prefix = f"{len(self.entries)}/"  # of names, until they are made unique
        if isinstance(spec.model, Primitive):
            name, root = str(spec.name), self.spec.worldbody.add_body()
            _add_shape(root, spec.model)
            mass = 0.0 if spec.fixed else spec.model.mass
        else:
            own_name, root = self._read(spec.model, place, prefix)
            name = spec.name or unique_name(own_name, self.taken)
            mass = root.mass
        root.pos, root.quat = spec.position, spec.orientation
        if not spec.fixed and mass:
            root.add_freejoint()
        links = [root, *root.find_all("body")]
        for part in (*links, *(joint for joint in root.find_all("joint") if joint.name)):
            own = part.name.removeprefix(prefix) or name
            if own in self.taken and part is not root:
                part.name = unique_name(f"{name}_{own}", self.taken)
            else:
                part.name = name if part is root else own
            self.taken.add(part.name)
            self.part_names[part.name] = own
        if spec.hold:
            for joint in root.find_all("joint"):
                self._add_motor(joint)
        for one, other in combinations(links, 2):
            exclusion = self.spec.add_exclude()
            exclusion.bodyname1, exclusion.bodyname2 = one.name, other.name
        self.entries.append((spec, name, place))

    def _read(self, file: Path, place: str, prefix: str) -> tuple[str, Any]:
        """Reads a URDF file; returns its name, and the root of its tree, which is in the model."""
        try:
            tree = parse_tolerantly(file.read_bytes())
            _find_meshes(tree, file, self.undrawn)
            compiler = _child(_child(tree, "mujoco"), "compiler")
            compiler.attrib |= dict.fromkeys(("fusestatic", "discardvisual", "strippath"), "false")
            spec = mujoco.MjSpec.from_string(ET.tostring(tree, encoding="unicode"))
        except (OSError, ET.ParseError, ValueError, RuntimeError, MemoryError) as error:
            key = "urdf: " if place else ""
            raise SceneError(f"{place}{key}{file} cannot be loaded: {error}") from error
        meshes = {mesh.name: self._mesh(mesh.file, mesh.scale) for mesh in spec.meshes}
        for mesh in list(spec.meshes):
            spec.delete(mesh) if hasattr(spec, "delete") else mesh.delete()  # MuJoCo 3.3.0
        root = self.spec.worldbody.add_frame().attach_body(spec.worldbody.first_body(), prefix, "")
        frictions = {
            f"{prefix}{link.get('name')}": float(found.get("value", _FRICTION))
            for link in tree.iter("link")
            if (found := link.find("contact/lateral_friction")) is not None
        }
        for link in (root, *root.find_all("body")):
            for geom in link.geoms:
                if geom.meshname:
                    geom.meshname = meshes[geom.meshname.removeprefix(prefix)]
                    geom.margin = _MARGIN
                if geom.contype or geom.conaffinity:
                    friction = frictions.get(link.name, _FRICTION)
                    geom.group, geom.friction = _COLLIDING, (friction, *_OTHER_FRICTION)
                else:
                    geom.group, geom.mass = _DRAWN, 0.0
        return name_by_file(tree.get("name", ""), file) or file.stem, root

    def _mesh(self, file: str, scale: Iterable[float]) -> str:
        """Returns the name of a mesh, which the model has once."""
        key = file, tuple(map(float, scale))
        if key not in self._meshes:
            name = unique_name(Path(file).stem, self._meshes.values())
            mesh = self.spec.add_mesh()
            mesh.name, mesh.file, mesh.scale = name, file, key[1]
            # A mesh may be flat, or have no inside.
            mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX
            self._meshes[key] = name
        return self._meshes[key]

    def _add_motor(self, joint: Any) -> None:
        """Adds a motor that holds a joint with limits, and brakes one without."""
        effort = float(joint.actfrcrange[1])
        if effort <= 0.0 or joint.type not in _SCALAR:
            return
        motor, gain = self.spec.add_actuator(), effort / _GIVES_WAY
        motor.name, motor.target = joint.name, joint.name
        motor.trntype = mujoco.mjtTrn.mjTRN_JOINT
        # The joint limits the effort: the solver stays implicit.
        motor.gaintype, motor.biastype = mujoco.mjtGain.mjGAIN_FIXED, mujoco.mjtBias.mjBIAS_AFFINE
        motor.gainprm[0] = gain
        has_limits = joint.range[0] < joint.range[1]
        motor.biasprm[:3] = (0, -gain, -gain * _DELAY) if has_limits else (0, 0, -gain)


def _add_shape(body: Any, primitive: Primitive) -> None:
    geom, material = body.add_geom(), primitive.material
    geom.type = getattr(mujoco.mjtGeom, f"mjGEOM_{primitive.type.upper()}")
    if primitive.type == "plane":
        geom.size, geom.quat = (0, 0, 1), turn_to(primitive.size)
    else:
        sizes = zip(primitive.size, MJCF_SIZES[primitive.type], strict=True)
        geom.size = (*(n * part for n, part in sizes), 0, 0)[:3]
        geom.mass = primitive.mass
    geom.rgba = material.colour
    geom.friction = material.friction, material.spinning_friction, material.rolling_friction
    if material.rolling_friction or material.spinning_friction:
        geom.condim = 6


def _find_meshes(root: ET.Element, file: Path, undrawn: set[str]) -> None:
    """Lets the meshes of a URDF file be found, and leaves out what MuJoCo cannot draw."""
    for link in root.iter("link"):
        for visual in link.findall("visual"):
            mesh = visual.find("geometry/mesh")
            name = "" if mesh is None else mesh.get("filename", "")
            if name and Path(name).suffix.lower() not in _MESHES:
                undrawn.add(name)
                link.remove(visual)
    for mesh in root.iter("mesh"):
        name = mesh.get("filename", "")
        places = [folder / (name.partition("://")[2] or name) for folder in file.parents]
        found = next((path for path in places if path.is_file()), places[0])
        mesh.set("filename", str(found))


def _child(element: ET.Element, tag: str) -> ET.Element:
    """Returns the child of an element, which it gets if it has none."""
    found = element.find(tag)
    return ET.SubElement(element, tag) if found is None else found


def _begin(spec: BodySpec, place: str, body: Body, model: Any, data: Any) -> None:
    """Puts a body into its initial state."""
    check_joints(spec, [joint for joint in body.joints if joint.type != "free"], place)
    for joint in body.joints:
        if joint.type in SCALAR_JOINTS:
            number = int(model.body_jntadr[body.handle + joint.link])
            value = spec.joints.get(joint.name, position_nearest_zero(joint))
            data.qpos[model.jnt_qposadr[number]] = value
            data.qvel[model.jnt_dofadr[number]] = spec.joint_velocities.get(joint.name, 0.0)
            hold_positions(model, data, {number: spec.held.get(joint.name, value)})
    if any(joint.type == "free" for joint in body.joints):
        first = int(model.body_dofadr[body.handle])
        turn = rotation_matrices(unit_quaternions(np.array([spec.orientation])))[0]
        # MuJoCo has the angular velocity in the frame of the body.
        data.qvel[first : first + 3] = spec.velocity[:3]
        data.qvel[first + 3 : first + 6] = turn.T @ spec.velocity[3:]
