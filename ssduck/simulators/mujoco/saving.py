"""Copies and saves MuJoCo simulations.

A compiled model cannot lose bodies. So a copy has the whole model, in which the bodies that were
not chosen neither collide nor pull at others, and are not described. The state is copied exactly if
the tick is the present one; else it is set from the poses and joints of the tick.

A compiled model does not tell its source. ssduck has that of the models that it loaded, and MuJoCo
that of the last model that it read from XML. What was written is compiled again and compared with
the model, so that a world is never saved as another one.
"""

from __future__ import annotations

import copy
import shutil
import tempfile
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from itertools import chain, count
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np

from ssduck.errors import UnsupportedError, warn
from ssduck.formatting import joined_names
from ssduck.geometry.poses import IDENTITY, multiply
from ssduck.simulators.backends import BodyToCopy, TickToCopy
from ssduck.simulators.interface import SCALAR_JOINTS, Simulator
from ssduck.simulators.model_xml import ASSETS, KIND_PREFIX, STATE_KEY, numbers_text
from ssduck.simulators.mujoco import interventions
from ssduck.simulators.mujoco.bodies import body_names, joint_numbers
from ssduck.simulators.mujoco.flexes import entity_roots
from ssduck.simulators.mujoco.library import all_digits, copied_data, mujoco
from ssduck.simulators.mujoco.simulator import MuJoCoSimulator

# The attributes of <compiler> that name the folders of the files of elements.
_FOLDERS = {"mesh": "meshdir", "skin": "meshdir", "hfield": "meshdir", "texture": "texturedir"}
# The attributes that are the name of a file.
_FILES = ("file", *(f"file{side}" for side in ("right", "left", "up", "down", "front", "back")))
# What is equal in both models, and what nearly.
_COUNTS = ("nq", "nv", "na", "nu", "nbody", "njnt", "ngeom", "nsite", "nmocap", "nmesh")
_EQUAL = (
    *("body_parentid", "jnt_type", "jnt_bodyid", "geom_type", "geom_bodyid", "geom_contype"),
    *("geom_conaffinity", "site_bodyid", "actuator_trntype", "actuator_trnid"),
)
_NEAR = (
    *("body_pos", "body_mass", "jnt_pos", "jnt_axis", "geom_pos", "geom_size"),
    *("site_pos", "site_size"),
)
_TOLERANCE = 1e-5


def write_model(model: Any, data: Any, spec: Any, kinds: Mapping[str, str], file: Path) -> None:
    """Writes a model with its present state as a key; the folder `ASSETS` beside it gets its files.

    Args:
        model: the model.
        data: its state.
        spec: the `mujoco.MjSpec` that the model was compiled from; None for that of the model that
            MuJoCo read last.
        kinds: the kinds of entities whose joints do not tell them, by the names of their roots.
        file: the file.
    """
    names = body_names(model)
    # What bodies hold is held by constraints like others in the file.
    welds = [
        {
            "body1": names[one],
            "body2": names[other],
            "relpose": numbers_text(model.eq_data[number, 3:10]),
        }
        for number, one, other in interventions.holds(model, data)
    ]
    # The welds for holding are there as they were when the model was compiled.
    plain, spare = copy.copy(model), interventions.spare_welds(model)
    plain.eq_obj1id[spare], plain.eq_obj2id[spare] = 1, 0
    plain.eq_data[spare, : len(interventions.IDLE)] = interventions.IDLE
    root = ET.fromstring(_source(plain, spec))  # noqa: S314  # MuJoCo wrote it
    _copy_files(root, Path(spec.modelfiledir) if spec is not None else None, file.parent / ASSETS)
    for part in root.iter("statistic"):
        part.attrib.pop("meaninertia", None)  # MuJoCo 4 writes it, and warns when it reads it
    _replace(root, "keyframe", "key", STATE_KEY, [_state(data)])
    texts = [{"name": KIND_PREFIX + name, "data": kind} for name, kind in kinds.items()]
    _replace(root, "equality", "weld", interventions.HOLD, welds)
    _replace(root, "custom", "text", KIND_PREFIX, texts)
    ET.indent(root)
    ET.ElementTree(root).write(file, encoding="utf-8")
    _check(model, file)


def _source(model: Any, spec: Any) -> str:
    """Returns the MJCF of a model."""
    if spec is not None:
        try:
            _copy_back(model, spec)
            with all_digits():
                text: str = spec.to_xml()
        except ValueError as error:
            raise UnsupportedError(f"MuJoCo cannot write the model: {error}") from error
        return text
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "last.xml"
        try:
            with all_digits():
                mujoco.mj_saveLastXML(str(path), model)
        except (mujoco.FatalError, ValueError) as error:
            raise UnsupportedError(f"{_UNKNOWN} ({error})") from error
        return path.read_text(encoding="utf-8")


_UNKNOWN = (
    "the source of this MuJoCo model is not known: ssduck.load keeps that of its worlds, and "
    "MuJoCo that of the last model that it read from XML; MjSpec.to_xml writes yours"
)


def _copy_back(model: Any, spec: Any) -> None:
    """Gives a specification the numbers that its model has by now."""
    if hasattr(spec, "copy_back"):  # MuJoCo 4
        spec.copy_back(model)
        return
    before = spec.compile()
    for number, body in enumerate(spec.bodies):  # ssduck changes where fixed ones are
        position, turn = model.body_pos[number], model.body_quat[number]
        if not np.array_equal(
            (*position, *turn), (*before.body_pos[number], *before.body_quat[number])
        ):
            body.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
            body.pos, body.quat = position, turn
    spec.compile()  # the text is that of what was compiled last


def _replace(
    root: ET.Element, section: str, tag: str, prefix: str, elements: Iterable[dict[str, str]]
) -> None:
    """Replaces the elements of a section whose names begin with a prefix, by their attributes."""
    parts = root.findall(section) or [ET.SubElement(root, section)]
    for part in parts:
        for element in part.findall(tag):
            if element.get("name", "").startswith(prefix):
                part.remove(element)
    parts[-1].extend(ET.Element(tag, attributes) for attributes in elements)
    for part in parts:
        if not len(part):
            root.remove(part)


def _state(data: Any) -> dict[str, str]:
    """Returns the attributes of the state as a key."""
    values = {
        "qpos": data.qpos,
        "qvel": data.qvel,
        "act": data.act,
        "ctrl": data.ctrl,
        "mpos": data.mocap_pos,
        "mquat": data.mocap_quat,
    }
    texts = {name: numbers_text(numbers) for name, numbers in values.items() if len(numbers)}
    return {"name": STATE_KEY, "time": numbers_text(data.time), **texts}


# -- files -----------------------------------------------------------------------------------


def _copy_files(root: ET.Element, folder: Path | None, assets: Path) -> None:
    """Copies the files that elements name, in a folder if it is known, and names the copies."""
    compilers = root.findall("compiler")
    settings = {key: value for part in compilers for key, value in part.items()}
    names: dict[Path, str] = {}
    for part in root.iterfind("asset/*"):
        if part.tag == "model" or (part.tag == "texture" and part.get("file", "").startswith("@")):
            raise UnsupportedError(f"a MuJoCo world with an element {part.tag!r} cannot be saved")
        inner = settings.get(_FOLDERS.get(part.tag, ""), settings.get("assetdir", ""))
        for attribute in _FILES:
            name = part.get(attribute)
            if not name:
                continue
            path = Path(inner) / name
            path = path if folder is None else folder / path
            if not path.is_absolute() or not path.is_file():
                raise UnsupportedError(
                    f"the file {name!r} of the MuJoCo model is not there any more, or in a folder "
                    "that MuJoCo does not tell; a world of ssduck.load knows its folder"
                )
            if path not in names:
                numbered = (f"{path.stem}_{number}{path.suffix}" for number in count(2))
                free = (n for n in chain([path.name], numbered) if n not in names.values())
                names[path] = next(free)
                assets.mkdir(exist_ok=True)
                shutil.copyfile(path, assets / names[path])
            if attribute == "file" and part.get("name") is None:
                part.set("name", path.stem)  # as it is named by default
            part.set(attribute, names[path])
    for part in compilers:
        for key in ("assetdir", "meshdir", "texturedir", "strippath"):
            part.attrib.pop(key, None)
    if names:
        compiler = compilers[0] if compilers else ET.SubElement(root, "compiler")
        compiler.set("assetdir", ASSETS)


# -- check -----------------------------------------------------------------------------------


def _check(model: Any, file: Path) -> None:
    try:
        again = mujoco.MjSpec.from_file(str(file)).compile()
    except ValueError as error:
        raise UnsupportedError(f"{file} cannot be read again: {error}") from error
    counts = [name for name in _COUNTS if getattr(model, name) != getattr(again, name)]
    if counts or body_names(model) != body_names(again):
        raise UnsupportedError(_UNKNOWN)
    for names, tolerance in ((_EQUAL, 0.0), (_NEAR, _TOLERANCE)):
        for name in names:
            one, other = getattr(model, name), getattr(again, name)
            if not np.allclose(one, other, rtol=tolerance, atol=tolerance, equal_nan=True):
                raise UnsupportedError(f"{_UNKNOWN}; {name} differs")


def excerpt(
    source: Simulator | None, originals: Sequence[BodyToCopy], tick: TickToCopy
) -> MuJoCoSimulator:
    """Starts a simulation of some bodies as they are at a tick; see `Backend.excerpt`."""
    if not isinstance(source, MuJoCoSimulator):
        raise UnsupportedError("a record holds no MuJoCo model: copy entities of the running world")
    earlier = [one.name for one in originals if not source.has(one.body)]
    if earlier:
        raise UnsupportedError(
            f"{joined_names(earlier)}: MuJoCo's model is another one by now, and cannot be copied "
            "as it was"
        )
    model = source.switched_on(source.model)
    data = copied_data(source.model, source.data, mujoco.MjData(model))
    chosen = {one.body.handle for one in originals}
    # Where everything is copied, so is what the world body shows.
    kept = {0, *chosen} if source.has_only(chosen) else chosen
    interventions.take_out(model, data, ~np.isin(entity_roots(model), list(kept)))
    now = source.read_link_poses(tuple(one.body for one in originals))
    states = np.concatenate([np.zeros((0, 13)), *(one.link_poses.states for one in originals)])
    if tick.time != source.time or not np.array_equal(now.states, states):
        _restore(model, data, originals, tick)
    return MuJoCoSimulator(
        lambda: (model, data),
        owned=True,
        part_names=source.part_names,
        names={one.body.handle: one.name for one in originals},
        kinds={one.body.handle: one.body.kind for one in originals},
        only=chosen,
        spec=source.spec,
        switched_off=(
            [body.handle for body in tick.disabled],
            [body.handle for body in tick.hidden],
        ),
    )


def _restore(model: Any, data: Any, originals: Sequence[BodyToCopy], tick: TickToCopy) -> None:
    """Sets the state from the poses and joints of a tick."""
    data.time = tick.time
    for original in originals:
        if original.body.handle:  # the world body does not move
            state = original.base_state
            # MuJoCo has the angular velocity of a free joint in the frame of the body.
            spin = original.link_poses.matrices[0].T @ state[10:]
            interventions.put_base(
                model, data, original.body.handle, state[:7], (*state[7:10], *spin)
            )
            _restore_joints(model, data, original)
    if model.nu:
        warn("the copy of an earlier or assumed tick has the present controls of actuators")
    mujoco.mj_forward(model, data)


def _restore_joints(model: Any, data: Any, original: BodyToCopy) -> None:
    """Sets the joints but a free one, whose pose is that of the base."""
    body = original.body
    counts = Counter(joint.link for joint in body.joints)
    for joint, index, (position, velocity) in zip(
        body.joints, joint_numbers(model, [body]), original.joints.tolist(), strict=True
    ):
        if joint.type in SCALAR_JOINTS and not np.isnan(position):
            data.qpos[model.jnt_qposadr[index]] = position
            data.qvel[model.jnt_dofadr[index]] = 0.0 if np.isnan(velocity) else velocity
        elif joint.type == "spherical" and counts[joint.link] == 1:
            _restore_ball(model, data, original, joint.link, index)
        elif joint.type != "free":
            raise UnsupportedError(
                f"{original.name}: the position of joint {joint.name!r} at {data.time:g} s is "
                "unknown: record the table of joints"
            )


def _restore_ball(model: Any, data: Any, original: BodyToCopy, link: int, joint: int) -> None:
    """Sets a ball joint from the orientations of its link and of the parent."""
    states, parent = original.link_poses.states, original.body.links[link].parent
    turn, spin = states[[link], 3:7], states[link, 10:]
    before = IDENTITY[None]
    if parent >= 0:
        before, spin = states[[parent], 3:7], spin - states[parent, 10:]
    fixed = multiply(before, model.body_quat[original.body.handle + link][None])
    back = fixed * np.array([1.0, -1.0, -1.0, -1.0])
    first, velocity = int(model.jnt_qposadr[joint]), int(model.jnt_dofadr[joint])
    data.qpos[first : first + 4] = multiply(back, turn)[0]
    data.qvel[velocity : velocity + 3] = original.link_poses.matrices[link].T @ spin
