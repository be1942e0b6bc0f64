"""Finds the parts of model files that PyBullet ignores.

Each entry was measured with PyBullet 3.2.7: a body moves as if its file did not have the part.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from types import MappingProxyType
from xml.etree import ElementTree as ET

from ssduck.formatting import joined_names

# Where the ignored elements are, in ElementTree's XPath, by format. Attributes are in brackets.
IGNORED: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "urdf": (
            ".//mimic",
            ".//transmission",
            ".//gazebo",
            ".//sensor",
            ".//ros2_control",
            ".//safety_controller",
            ".//dynamics[@friction]",
        ),
        "sdf": (
            ".//include",
            ".//light",
            ".//sensor",
            ".//plugin",
            ".//actor",
            ".//physics",
            ".//gripper",
            ".//surface",
            ".//model/model",
            ".//joint/pose",
            ".//axis2",
            ".//axis/dynamics/friction",
            ".//velocity_decay",
            ".//self_collide",
            "./world/gravity",
            "./world/wind",
            "./world/state",
            "./world[2]",
            ".//submesh",
            ".//pose[@relative_to]",
            ".//pose[@frame]",
            ".//xyz[@expressed_in]",
            ".//model[@placement_frame]",
        ),
        "mjcf": (
            *("./include", "./actuator", "./sensor", "./tendon", "./equality", "./contact"),
            *("./keyframe", "./option", "./size", "./extension", "./deformable"),
            *(".//light", ".//camera", ".//composite", ".//flexcomp", ".//frame", ".//replicate"),
            *(".//attach", ".//plugin"),
            *(f".//body[@{turn}]" for turn in ("euler", "axisangle", "zaxis", "xyaxes")),
            *(f".//geom[@{turn}]" for turn in ("euler", "zaxis", "xyaxes")),
            *(f".//geom[@{name}]" for name in ("mass", "density")),
            *(f".//body[@{name}]" for name in ("mocap", "gravcomp")),
            *(f".//joint[@{name}]" for name in ("damping", "stiffness", "armature")),
            *(f".//joint[@{name}]" for name in ("frictionloss", "springref", "ref")),
        ),
    }
)
# The number of named owners of a part in a message.
_MAX_OWNERS = 3
# Values of parts without effect.
_NO_EFFECT = {"0", "0.0", "false"}


def ignored_parts(format: str, root: ET.Element) -> list[str]:
    """Returns the parts of a model file that PyBullet ignores, in words.

    Args:
        format: one of `MODEL_FILES`.
        root: the root element of the file.
    """
    parents = {child: parent for parent in root.iter() for child in parent}
    found = []
    for path in IGNORED[format]:
        _, bracket, attribute = path.partition("[@")
        key = attribute.rstrip("]")
        parts = [part for part in root.iterfind(path) if _has_effect(part, key)]
        if parts:
            what = f"<{parts[0].tag} {key}>" if bracket else f"<{parts[0].tag}>"
            found.append(what + _of_owners(parts, parents))
    macros = {part.tag for part in root.iter() if part.tag.startswith("xacro:")}
    found += [f"<{macro}>" for macro in sorted(macros)]
    if format == "urdf":
        floating = [joint for joint in root.iterfind("joint") if joint.get("type") == "floating"]
        found += ["the motion of floating joints" + _of_owners(floating, {})] if floating else []
    return found


def _has_effect(part: ET.Element, key: str) -> bool:
    """Checks whether a part, or an attribute of it, says more than the default."""
    text = part.get(key, "") if key else part.text or ""
    words = text.split()
    return not _NO_EFFECT.issuperset(words) if words else not key


def _of_owners(parts: Iterable[ET.Element], parents: Mapping[ET.Element, ET.Element]) -> str:
    """Returns the names of what has some parts, in words."""
    names = dict.fromkeys(name for part in parts if (name := named_owner(part, parents)))
    return f" of {joined_names(list(names), _MAX_OWNERS)}" if names else ""


def named_owner(part: ET.Element, parents: Mapping[ET.Element, ET.Element]) -> str:
    """Returns the name of the nearest named element that has a part, or is it; else nothing."""
    while part.tag in ("robot", "world") or not part.get("name"):
        if part not in parents:
            return ""
        part = parents[part]
    return str(part.get("name"))


def free_bodies(root: ET.Element) -> list[str]:
    """Returns the names of the bodies of an MJCF file that are fixed in MuJoCo, free in PyBullet.

    They have no joint to the world.
    """
    bodies = [body for world in root.iterfind("worldbody") for body in world.iterfind("body")]
    return [
        body.get("name") or "a body without a name"
        for body in bodies
        if body.find("joint") is None
        and body.find("freejoint") is None
        and body.find("geom") is not None
    ]


def has_unknown_angles(root: ET.Element) -> bool:
    """Checks whether PyBullet takes the angles of an MJCF file for radians, MuJoCo for degrees."""
    return root.find("compiler") is None and any(
        joint.get("range") is not None and joint.get("type", "hinge") == "hinge"
        for joint in root.iter("joint")
    )
