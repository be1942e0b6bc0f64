"""Flexes of MuJoCo: cloths, ropes and soft bodies.

The vertices of a flex are fixed to bodies, of which most move by themselves; or its form follows
from a few nodes, which are fixed to bodies likewise. A flex that moves is one entity. MuJoCo
collides its elements; as shapes it has spheres about the vertices, or about the nodes.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from ssduck.geometry.arrays import Array, Flags, Indices
from ssduck.geometry.poses import IDENTITY
from ssduck.geometry.shapes import Geometry, PlacedGeometry
from ssduck.simulators.mujoco.library import mujoco


@dataclass(frozen=True, eq=False)
class Flex:
    """A flex of a model."""

    number: int  # its number
    first: int  # the number of its first vertex among those of all flexes
    # (vertices,), the body of each vertex; -1 for one that is pinned to the world, or that follows
    # from nodes.
    bodies: Indices
    nodes: Indices  # (nodes,), the body of each node
    elements: Indices  # (elements, corners), the vertices of each element

    @classmethod
    def of(cls, model: Any, number: int) -> Self:
        """Returns a flex of a model."""
        first, corners = int(model.flex_vertadr[number]), int(model.flex_dim[number]) + 1
        bodies = model.flex_vertbodyid[_run(model, "vert", number)].astype(np.intp)
        if bodies.any():
            bodies[bodies == 0] = -1
        start, count = int(model.flex_elemdataadr[number]), int(model.flex_elemnum[number])
        elements = model.flex_elem[start : start + count * corners].reshape(count, corners)
        nodes = model.flex_nodebodyid[_run(model, "node", number)].astype(np.intp)
        return cls(number, first, bodies, nodes, elements.astype(np.intp))

    def nearest(self, data: Any, points: Array, elements: Indices, vertices: Indices) -> Indices:
        """Returns the bodies of the vertices or nodes that contacts are nearest to, (n,).

        Args:
            data: the data.
            points: (n, 3), the points of the contacts.
            elements: (n,), the elements in contact; -1 for none.
            vertices: (n,), the vertices in contact, where there is no element.
        """
        of_element = self.elements[elements]
        corners = np.where(elements[:, None] >= 0, of_element, vertices[:, None])
        bodies, places = self.bodies[corners], data.flexvert_xpos[self.first + corners]
        if len(self.nodes):
            bodies = np.broadcast_to(self.nodes, (len(points), len(self.nodes)))
            places = data.xpos[bodies]
        distances = np.where(bodies < 0, np.inf, np.linalg.norm(places - points[:, None], axis=2))
        nearest: Indices = np.take_along_axis(bodies, distances.argmin(axis=1)[:, None], 1)[:, 0]
        return nearest


def flexes_of(model: Any) -> list[Flex]:
    """Returns the flexes of a model."""
    return [Flex.of(model, number) for number in range(model.nflex)]


def _run(model: Any, part: str, number: int) -> slice:
    """Returns the place of the vertices or nodes of a flex among those of all."""
    first = int(getattr(model, f"flex_{part}adr")[number])
    return slice(first, first + int(getattr(model, f"flex_{part}num")[number]))


def entity_roots(model: Any) -> Indices:
    """Returns the first body of the entity of each body, (bodies,).

    It is the root of its tree. The trees of a flex are one entity, unless others are between them.
    """
    entities: Indices = np.arange(model.nbody)
    trees = model.body_rootid.astype(np.intp)
    for roots in _trees_of_flexes(model).values():
        entities[roots] = roots[0]
    found: Indices = entities[trees]
    return found


def flex_names(model: Any) -> dict[int, str]:
    """Returns the names of the flexes that are entities, by the first body."""
    kind = mujoco.mjtObj.mjOBJ_FLEX
    return {
        int(roots[0]): mujoco.mj_id2name(model, kind, number) or f"flex_{number}"
        for number, roots in _trees_of_flexes(model).items()
    }


def _trees_of_flexes(model: Any) -> dict[int, Indices]:
    """Returns the roots of the trees of each flex that has several, one after the other."""
    found: dict[int, Indices] = {}
    trees = model.body_rootid.astype(np.intp)
    for flex in flexes_of(model):
        bodies = np.concatenate((flex.bodies, flex.nodes))
        roots = np.unique(trees[bodies[bodies > 0]])
        taken = np.concatenate([np.zeros(0, np.intp), *found.values()])
        is_together = len(roots) > 1 and np.array_equal(
            roots, np.unique(trees[roots[0] : roots[-1] + 1])
        )
        if is_together and not np.isin(roots, taken).any():
            found[flex.number] = roots
    return found


def flexes_on(model: Any, bodies: Flags) -> Indices:
    """Returns the numbers of the flexes that have vertices or nodes on some bodies."""
    parts = ((flex.number, np.concatenate((flex.bodies, flex.nodes))) for flex in flexes_of(model))
    on = [number for number, of_flex in parts if bodies[of_flex[of_flex >= 0]].any()]
    return np.array(on, np.intp)


def flex_shapes(
    model: Any, disabled: Indices | None = None
) -> Iterator[tuple[int, int, PlacedGeometry]]:
    """Yields the spheres about the vertices or nodes of flexes that collide.

    Each with its body and the number of its flex after all geoms; the margin is 0, the link 0.
    """
    collides = (model.flex_contype | model.flex_conaffinity) != 0
    if disabled is not None:
        collides[disabled[disabled >= model.ngeom] - model.ngeom] = True
    for flex in flexes_of(model):
        number = flex.number
        if not collides[number]:
            continue
        part, bodies = ("node", flex.nodes) if len(flex.nodes) else ("vert", flex.bodies)
        places = getattr(model, f"flex_{part}")[_run(model, part, number)]
        sphere = Geometry.primitive("sphere", (float(model.flex_radius[number]), 0, 0))
        for body, place in zip(bodies.tolist(), places, strict=True):
            if body >= 0:
                shape = PlacedGeometry(0, sphere, place.copy(), IDENTITY, exact=False)
                yield body, model.ngeom + number, shape
