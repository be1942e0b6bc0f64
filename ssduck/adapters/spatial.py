"""Defines the spatial result forms: worlds, point clouds, meshes, glTF files, pictures."""

from __future__ import annotations

import sys
from collections import Counter
from typing import TYPE_CHECKING, Any

import numpy as np

from ssduck import validation
from ssduck.adapters.base import (
    SHAPES,
    WORLD_BYTES,
    Selection,
    check_file,
    form,
    replace_file,
    shapes_of,
)
from ssduck.adapters.marks import highlighted, marks_of
from ssduck.adapters.point_cloud import PointCloud, sample_points
from ssduck.errors import ArgumentError
from ssduck.geometry.solids import Solid
from ssduck.lazy import import_whole
from ssduck.world.world import World

if TYPE_CHECKING:
    import trimesh
    from PIL import Image


@form(
    "environment",
    help="A new, running world of the selected entities, in its own simulation.",
    needs="entities",
)
def environment(selection: Selection) -> World:
    """Returns a new, running world of the selected entities, and those of links.

    See `World.excerpt`.
    """
    selection.charge(WORLD_BYTES)
    return selection.world.excerpt([handle.entity for handle in selection.entities])


WORLDS = (environment,)


# In glTF, y points up and cameras look along -z.
_UPRIGHT = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
# The renderer's speed on a slow machine, and the memory that it and the outlines take.
PIXELS_PER_SECOND, BYTES_PER_PIXEL = 1_000_000, 128
# The same of random points.
POINTS_PER_SECOND, POINT_BYTES = 2_000_000, 250
_COLOURS = {
    "robot": (214, 120, 40, 255),
    "kinbody": (150, 160, 175, 255),
    "link": (120, 150, 200, 255),
}


@form(
    "points",
    help="Random points on the surfaces of shapes, in m, one for each square with the side "
    "spacing, in m.",
    needs="entities",
    tables=SHAPES,
)
def _points(selection: Selection, spacing: Any = 0.02, seed: Any = 0) -> PointCloud:
    placed = shapes_of(selection)
    ids = {entity.id: entity.full_name for entity in selection.entities}
    mean_distance = validation.length(spacing, "spacing")
    whole_seed = validation.integer_between(seed, "seed", 0, sys.maxsize)

    def check(count: float) -> None:
        selection.check_size(
            count, f"{count:,.0f} points", per_second=POINTS_PER_SECOND, bytes_each=POINT_BYTES
        )

    return sample_points(placed, ids, mean_distance, whole_seed, check)


@form("mesh", needs="entities", tables=SHAPES)
def _mesh(selection: Selection) -> trimesh.Scene:
    """A trimesh scene of the shapes in the world frame, in m, with a node for each shape."""
    import_whole("trimesh")
    from ssduck.adapters.mesh_scene import MeshScene

    placed = shapes_of(selection)
    scene = MeshScene(base_frame="world")
    entities = {entity.id: entity for entity in selection.entities}
    counts: Counter[int] = Counter()
    for (solid, position, matrix), owner in zip(placed, placed.owners.tolist(), strict=True):
        entity = entities[owner]
        surface = _triangles(solid)
        if surface is None:
            raise ArgumentError(f"{entity.full_name!r} has a plane, which is infinite; exclude it")
        surface.visual.face_colors = _COLOURS[entity.entity.kind]
        surface.metadata["entity"] = entity.full_name
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = matrix, position
        name = f"{entity.full_name}/{counts[owner]}"
        counts[owner] += 1
        scene.add_geometry(surface, node_name=name, geom_name=name, transform=pose)
    return scene


def _triangles(solid: Solid) -> Any:
    """Returns the triangles of a shape in its own frame; None for a plane."""
    import trimesh
    from trimesh import creation

    match solid.type:
        case "plane":
            return None
        case "sphere":
            mesh = creation.icosphere(subdivisions=3, radius=solid.radius)
            mesh.apply_translation(solid.core[0])
            return mesh
        case "capsule":
            mesh = creation.capsule(height=2.0 * solid.half_length, radius=solid.radius)
            # The origin of the capsule differs between versions of trimesh.
            mesh.apply_translation((0.0, 0.0, -mesh.bounds[:, 2].mean()))
            return mesh
        case "cylinder":
            return creation.cylinder(
                radius=solid.disc_radius, height=2.0 * solid.half_length, sections=64
            )
        case "ellipsoid":
            mesh = creation.icosphere(subdivisions=3)
            mesh.apply_scale(solid.semi_axes)
            return mesh
    return trimesh.Trimesh(solid.core, solid.faces, process=False)


@form(
    "glb",
    help="Writes the scene of AS mesh to a glTF file, with y up as viewers expect, and returns "
    "its path.",
    needs="entities",
    tables=SHAPES,
    writes=True,
)
def _glb(selection: Selection, path: Any) -> str:
    file = check_file(selection, path)
    scene: Any = _mesh.make(selection)
    if not scene.geometry:
        raise ArgumentError("no selected entity has shapes; a glTF file needs some")
    scene.apply_transform(_UPRIGHT)
    content = scene.export(file_type="glb")
    replace_file(file, lambda stream: stream.write(content))
    return str(file)


@form(
    "image",
    help="A picture of the scene in which all but the selected entities and links, or those whose "
    "names are selected, are faded; sensors appear as their bodies. Sizes in pixels.",
)
def _image(selection: Selection, width: Any = 960, height: Any = 720) -> Image.Image:
    size = (
        validation.integer_between(width, "width", 1, validation.MAX_PIXELS),
        validation.integer_between(height, "height", 1, validation.MAX_PIXELS),
    )
    selection.check_size(
        size[0] * size[1],
        f"{size[0]} x {size[1]} pixels",
        per_second=PIXELS_PER_SECOND,
        bytes_each=BYTES_PER_PIXEL,
    )
    world = selection.world
    for handle in selection.entities:
        if not handle.is_there:
            raise handle.removed()
    found = marks_of(world, selection.rows)
    if selection.rows and not found:
        raise ArgumentError(
            "no column holds an entity, a link, or the name of one; select them as obj(this), "
            "or as obj where there is one source"
        )
    return highlighted(world, found, *size)


SPATIAL = (_points, _mesh, _glb, _image)
