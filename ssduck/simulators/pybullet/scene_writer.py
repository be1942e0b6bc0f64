"""Describes a PyBullet client that ssduck filled as a scene, and writes its models."""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain, count
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np

from ssduck.simulators.backends import BodyToCopy, TickToCopy
from ssduck.simulators.interface import SCALAR_JOINTS, Body
from ssduck.simulators.pybullet.introspection import constraints_of, model_of
from ssduck.simulators.pybullet.scene_loader import solver_settings
from ssduck.simulators.pybullet.simulator import PyBulletSimulator
from ssduck.simulators.pybullet.urdf import unique_names, write_model
from ssduck.simulators.scenes import BodySpec, ConstraintSpec, Engine, Scene

# Models lie in folders of their own there.
MODELS = "models"
_BASE = np.array([0])
# What a mesh's file, or that of its material, names in its lines.
_NAMED = re.compile(r"^\s*(?:mtllib|map_\w+)\s+(.+?)\s*$", re.MULTILINE)


def scene_of(
    simulator: PyBulletSimulator, originals: Sequence[BodyToCopy], tick: TickToCopy, folder: Path
) -> Scene:
    """Describes a simulation as a scene without sensors; writes its models into a folder."""
    told = simulator.parameters()
    gravity = tuple(told[f"gravityAcceleration{axis}"] for axis in "XYZ")
    models = _ModelWriter(simulator, folder)
    names = {original.body.handle: original for original in originals}
    return Scene(
        name="world",
        path=folder,
        gravity=gravity,
        timestep=told["fixedTimeStep"],
        time=tick.time,
        bodies=tuple(models.spec_of(original, tick) for original in originals),
        constraints=tuple(_constraints(simulator.client, names)),
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
    """The models of a scene that is saved.

    Attributes:
        simulator: what has the bodies.
        folder: of the scene.
        copies: of files that are copied, the copies.
    """

    simulator: PyBulletSimulator
    folder: Path
    copies: dict[Path, Path | None] = field(default_factory=dict)

    def spec_of(self, original: BodyToCopy, tick: TickToCopy) -> BodySpec:
        """Returns the scene's entry of a body."""
        body, states = original.body, original.joints
        origin = self.simulator.loaded.origins.get(body.handle)
        copy = None if origin is None else self._copied(origin.spec.model)
        if origin is not None and copy is not None:
            model, fixed, own_inertia = copy, origin.spec.fixed, origin.spec.own_inertia
        else:
            told = model_of(self.simulator, body)
            stem = original.name
            model = write_model(told, self._new_folder(stem), _file_name(stem))
            fixed, own_inertia = False, True
        names = unique_names(joint.name for joint in body.joints)
        settable = [n for n, joint in enumerate(body.joints) if joint.type in SCALAR_JOINTS]
        positions = {names[n]: float(states[n, 0]) for n in settable}
        held = self.simulator.loaded.held.get(body.handle, {})
        targets = {names[link - 1]: target for link, target in held.items()}
        link_poses = original.link_poses
        base = link_poses.states_at(link_poses.positions[:1], _BASE)[0].tolist()
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
            hold=bool(held) or not settable,
            held={name: at for name, at in targets.items() if at != positions[name]},
            enabled=body not in tick.disabled,
            visible=body not in tick.hidden,
            own_inertia=own_inertia,
        )

    def _copied(self, file: Path) -> Path | None:
        """Returns a copy of a URDF file and its meshes; None if it cannot be copied."""
        if file not in self.copies:
            self.copies[file] = self._copy(file)
        return self.copies[file]

    def _copy(self, file: Path) -> Path | None:
        if file.suffix.lower() != ".urdf" or not file.is_file():
            return None
        needed = _needed(file)
        if needed is None:
            return None
        folder = self._new_folder(file.stem)
        for name in (file.relative_to(file.parent), *needed):
            target = folder / name
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(file.parent / name, target)
        return folder / file.name

    def _new_folder(self, name: str) -> Path:
        taken = {path.name for path in (self.folder / MODELS).glob("*")}
        plain = _file_name(name)
        others = (f"{plain}_{number}" for number in count(2))
        folder = self.folder / MODELS / next(n for n in chain([plain], others) if n not in taken)
        folder.mkdir(parents=True)
        return folder


def _needed(file: Path) -> list[Path] | None:
    """Returns the files that a URDF file refers to, relative to its folder.

    None if some lie elsewhere.
    """
    try:
        root = ET.parse(file).getroot()  # noqa: S314  # PyBullet has read it
    except ET.ParseError:  # which PyBullet does not mind
        return None
    waiting = [Path(str(part.get("filename"))) for part in root.iter() if part.get("filename")]
    found: dict[Path, None] = {}
    while waiting:
        name = waiting.pop()
        if name in found:
            continue
        if name.is_absolute() or ".." in name.parts or not (file.parent / name).is_file():
            return None
        found[name] = None
        if name.suffix.lower() in (".obj", ".mtl"):
            text = (file.parent / name).read_text(encoding="utf-8", errors="replace")
            others = (name.parent / other for other in _NAMED.findall(text))
            # PyBullet draws a mesh without its material if that is not there.
            waiting += [other for other in others if (file.parent / other).is_file()]
    return list(found)


def _file_name(name: str) -> str:
    """Returns a name with only letters, digits, - and _."""
    return re.sub(r"[^\w-]+", "_", name) or "body"
