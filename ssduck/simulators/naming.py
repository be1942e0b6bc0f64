"""Names of bodies that follow from the names in model files."""

from __future__ import annotations

import re
from collections.abc import Collection, Container
from itertools import count
from pathlib import PurePath

# Endings of model and mesh files, which some models have in their names.
_FILE_ENDING = re.compile(r"\.(?:urdf|sdf|mjcf|xml|xacro|world|obj|stl|dae)$", re.IGNORECASE)
# Words that files have in common, and that tell nothing of what is in them.
_COMMON_WORDS = {
    *("urdf", "sdf", "scene", "main", "robot", "model", "models", "object", "objects", "body"),
    *("base", "link", "mesh", "meshes", "visual", "collision", "textured"),
}


def body_name(model_name: str) -> str:
    """Returns a name for a body by the name of its model; empty if that has no letter or digit.

    The name is an identifier, so that programs can write `world.name`. A file is named without its
    folder and ending.

    >>> [body_name(text) for text in ("cube.urdf", "Amazon Pod", "parts/part0.obj", "3d-mouse")]
    ['cube', 'Amazon_Pod', 'part0', 'body_3d_mouse']
    """
    if model_name.isidentifier():
        return model_name
    stem = _FILE_ENDING.sub("", model_name)
    if stem != model_name:
        stem = re.split(r"[/\\]", stem)[-1]
    name = re.sub(r"_*\W[\W_]*", "_", stem).strip("_")
    return name if name.isidentifier() or not name else f"body_{name}"


def names_a_file(model_name: str) -> bool:
    """Checks whether the name of a model is that of a file, such as the one that it began as."""
    return _FILE_ENDING.search(model_name) is not None


def tells_nothing(name: str) -> bool:
    """Checks whether a name has only words that files have in common.

    >>> [name for name in ("urdf_robot", "link_0", "robot_arm") if tells_nothing(name)]
    ['urdf_robot', 'link_0']
    """
    return not _words(name)


def is_made_up(name: str, names: Collection[str]) -> bool:
    """Checks whether a name tells nothing, or was made unique among names by a number.

    >>> [name for name in ("cup", "cup_2", "body_0", "arm_1") if is_made_up(name, ["cup", "cup_2"])]
    ['cup_2', 'body_0']
    """
    base = name.rstrip("0123456789")
    return tells_nothing(name) or (base.endswith("_") and base != name and base[:-1] in names)


def name_by_file(model_name: str, file: PurePath) -> str:
    """Returns a name for a body by the name of its model, or by its file where these disagree.

    Names in model files are often those of the files that they were copied from. The name of a
    model counts if the name or the folder of its file has a word of it, or if the file's name tells
    nothing.

    >>> files = [PurePath("duck.urdf"), PurePath("kuka/arm_1.urdf"), PurePath("a/model.urdf")]
    >>> [name_by_file("Kuka Arm", file) for file in files]
    ['duck', 'Kuka_Arm', 'Kuka_Arm']
    """
    said = [*_words(file.stem), *_words(file.parent.name)]
    agrees = any(
        one == other or (min(len(one), len(other)) > 2 and (one in other or other in one))
        for one in _words(model_name)
        for other in said
    )
    return body_name(model_name if agrees or tells_nothing(file.stem) else file.stem)


def _words(name: str) -> list[str]:
    """Returns the words of a name that tell something, without numbers."""
    parts = re.sub(r"([a-z])([A-Z])", r"\1 \2", _FILE_ENDING.sub("", name)).lower()
    return [word for word in re.findall(r"[^\W\d_]+", parts) if word not in _COMMON_WORDS]


def unique_name(name: str, taken: Container[str]) -> str:
    """Returns a name, with the first free number from 2 if it is taken.

    >>> unique_name("cup", ["cup", "cup_2"])
    'cup_3'
    """
    if name not in taken:
        return name
    return next(n for n in (f"{name}_{i}" for i in count(2)) if n not in taken)
