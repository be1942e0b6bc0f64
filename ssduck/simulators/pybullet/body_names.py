"""Names of the bodies of a client that ssduck did not fill."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import PurePath

from ssduck.simulators.naming import (
    body_name,
    name_by_file,
    names_a_file,
    tells_nothing,
    unique_name,
)
from ssduck.simulators.pybullet.console import pybullet


def names_of(
    client: int, handles: Sequence[int], added: Sequence[int], given: Mapping[int, str]
) -> dict[int, str]:
    """Returns names of new bodies, not yet unique but for those that are given.

    A body has the name of its model. The name of the mesh of its base is better where the two
    disagree and the model's name may not be meant: it tells nothing, it is that of a file, or
    another body has it with another mesh. PyBullet does not tell the files of models.

    Args:
        client: the client that has the bodies.
        handles: PyBullet's numbers of all bodies.
        added: those of the new ones.
        given: names by number, which count.
    """
    models = {h: pybullet.getBodyInfo(h, client)[1].decode(errors="replace") for h in handles}
    sharing: dict[str, list[int]] = {}
    for handle, model in models.items():
        sharing.setdefault(model, []).append(handle)

    def name(handle: int) -> str:
        model = models[handle]
        own = body_name(model)
        mesh = _base_mesh(client, handle) if own else ""
        if mesh and (by_mesh := name_by_file(model, PurePath(mesh))) != own:
            others = sharing[model]
            if (
                tells_nothing(model)
                or names_a_file(model)
                or any(_base_mesh(client, other) != mesh for other in others)
            ):
                return by_mesh
        return own or f"body_{handle}"

    return {h: given.get(h) or unique_name(name(h), given.values()) for h in added}


def _base_mesh(client: int, handle: int) -> str:
    """Returns the file of the first mesh that is drawn of the base of a body; empty if none is."""
    entries = pybullet.getVisualShapeData(handle, physicsClientId=client)
    meshes = (entry[4] for entry in entries if entry[1] == -1 and entry[2] == pybullet.GEOM_MESH)
    return str(next(meshes, b"").decode(errors="replace"))
