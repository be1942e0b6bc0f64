"""Describes a PyBullet client that ssduck filled as a scene, and writes its models."""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from xml.etree import ElementTree as ET

from ssduck.simulators.backends import BodyToCopy, TickToCopy
from ssduck.simulators.interface import SCALAR_JOINTS, Body
from ssduck.simulators.model_xml import unique_names
from ssduck.simulators.naming import unique_name
from ssduck.simulators.pybullet.introspection import constraints_of, model_of
from ssduck.simulators.pybullet.scene_loader import gravity_of, solver_settings
from ssduck.simulators.pybullet.simulator import PyBulletSimulator
from ssduck.simulators.pybullet.urdf import write_model
from ssduck.simulators.scene_bodies import BodySpec, Primitive
from ssduck.simulators.scenes import ConstraintSpec, Engine, Scene

# The folder of the models; each model has a folder of its own there.
MODELS = "models"
# References to other files in the lines of a mesh file or a material file.
_FILE_REFERENCE = re.compile(r"^\s*(?:mtllib|map_\w+)\s+(.+?)\s*$", re.MULTILINE)


def scene_of(
    simulator: PyBulletSimulator, originals: Sequence[BodyToCopy], tick: TickToCopy, folder: Path
) -> Scene:
    """Describes a simulation as a scene without sensors; writes its models into a folder."""
    parameters = simulator.parameters()
    models = _ModelWriter(simulator, folder)
    by_handle = {original.body.handle: original for original in originals}
    return Scene(
        name="world",
        path=folder,
        gravity=gravity_of(parameters),
        timestep=parameters["fixedTimeStep"],
        time=tick.time,
        bodies=tuple(models.spec_of(original, tick) for original in originals),
        constraints=tuple(_constraints(simulator.client, by_handle)),
        engine=Engine(**solver_settings(simulator.client)),
        elastic=simulator.loaded.elastic,
    )


def _constraints(client: int, originals: Mapping[int, BodyToCopy]) -> Iterator[ConstraintSpec]:
    for spec, (on, link), (to, to_link) in constraints_of(client):
        other = originals.get(to)
        yield replace(
            spec,
            on=originals[on].name,
            link=_link_name(originals[on].body, link),
            to=None if other is None else other.name,
            to_link=None if other is None else _link_name(other.body, to_link),
        )


def _link_name(body: Body, link: int) -> str | None:
    """Returns the name that a link has in a scene; None for the base."""
    return None if link < 0 else unique_names(part.name for part in body.links)[link + 1]


@dataclass(eq=False)
class _ModelWriter:
    """Writes the models of a saved scene."""

    simulator: PyBulletSimulator
    folder: Path
    copies: dict[Path, Path | None] = field(default_factory=dict)  # None for what cannot be copied

    def spec_of(self, original: BodyToCopy, tick: TickToCopy) -> BodySpec:
        """Returns the scene's entry of a body."""
        body, states = original.body, original.joints
        origin = self.simulator.loaded.origins.get(body.handle)
        copy = None if origin is None else self._copy_of(origin.spec)
        if origin is not None and copy is not None:
            model: Path | Primitive = copy
            fixed, own_inertia = origin.spec.fixed, origin.spec.own_inertia
        else:
            stem = original.name
            description = model_of(self.simulator, body)
            model = write_model(description, self._new_folder(stem), _file_name(stem))
            fixed, own_inertia = False, True
        names = unique_names(joint.name for joint in body.joints)
        settable = [n for n, joint in enumerate(body.joints) if joint.type in SCALAR_JOINTS]
        positions = {names[n]: float(states[n, 0]) for n in settable}
        motors = self.simulator.loaded.motor_positions.get(body.handle, {})
        targets = {names[link - 1]: target for link, target in motors.items()}
        base = original.base_state.tolist()
        return BodySpec(
            name=original.name,
            kind=body.kind,  # type: ignore[arg-type]  # no sensor has a body
            model=model,
            position=tuple(base[:3]),
            orientation=tuple(base[3:7]),
            fixed=fixed,
            joints=positions,
            velocity=(0.0,) * 6 if fixed else tuple(base[7:]),
            joint_velocities={names[n]: float(states[n, 1]) for n in settable if states[n, 1]},
            hold=bool(motors) or not settable,
            held={name: target for name, target in targets.items() if target != positions[name]},
            enabled=body not in tick.disabled,
            visible=body not in tick.hidden,
            own_inertia=own_inertia,
        )

    def _copy_of(self, spec: BodySpec) -> Path | Primitive | None:
        """Returns a copy of a URDF file and its meshes, or a primitive; None if there is none."""
        file = spec.model
        if isinstance(file, Primitive):
            return file
        if file not in self.copies:
            self.copies[file] = self._copy(file)
        return self.copies[file]

    def _copy(self, file: Path) -> Path | None:
        if file.suffix.lower() != ".urdf" or not file.is_file():
            return None
        references = _referenced_files(file)
        if references is None:
            return None
        folder = self._new_folder(file.stem)
        for name in (file.relative_to(file.parent), *references):
            target = folder / name
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(file.parent / name, target)
        return folder / file.name

    def _new_folder(self, name: str) -> Path:
        existing = {path.name for path in (self.folder / MODELS).glob("*")}
        folder = self.folder / MODELS / unique_name(_file_name(name), existing)
        folder.mkdir(parents=True)
        return folder


def _referenced_files(file: Path) -> list[Path] | None:
    """Returns the files that a URDF file refers to, in its folder; None if some are elsewhere."""
    try:
        root = ET.parse(file).getroot()  # noqa: S314  # PyBullet has read it
    except ET.ParseError:  # PyBullet may read it all the same
        return None
    queue = [Path(str(part.get("filename"))) for part in root.iter() if part.get("filename")]
    references: dict[Path, None] = {}
    while queue:
        name = queue.pop()
        if name in references:
            continue
        if name.is_absolute() or ".." in name.parts or not (file.parent / name).is_file():
            return None
        references[name] = None
        if name.suffix.lower() in (".obj", ".mtl"):
            text = (file.parent / name).read_text(encoding="utf-8", errors="replace")
            others = (name.parent / other for other in _FILE_REFERENCE.findall(text))
            # PyBullet draws a mesh without its material if the material is missing.
            queue += [other for other in others if (file.parent / other).is_file()]
    return list(references)


def _file_name(name: str) -> str:
    """Returns a name with only letters, digits, - and _."""
    return re.sub(r"[^\w-]+", "_", name) or "body"
