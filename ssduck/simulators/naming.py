"""Names of bodies that follow from the names in model files."""

from __future__ import annotations

import re
from collections.abc import Container
from itertools import count

# Endings of model and mesh files, which some models have in their names.
_FILE_ENDING = re.compile(r"\.(?:urdf|sdf|mjcf|xml|xacro|world|obj|stl|dae)$", re.IGNORECASE)


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


def unique_name(name: str, taken: Container[str]) -> str:
    """Returns a name, with the first free number from 2 if it is taken.

    >>> unique_name("cup", ["cup", "cup_2"])
    'cup_3'
    """
    if name not in taken:
        return name
    return next(n for n in (f"{name}_{i}" for i in count(2)) if n not in taken)
