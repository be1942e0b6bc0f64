"""Placed shapes for the narrow phase."""

import numpy as np

from ssduck.geometry.bounds import BoundingBoxes
from ssduck.geometry.distance import CallCounter
from ssduck.geometry.narrow_phase import NarrowPhase
from ssduck.geometry.poses import rotation_matrices
from ssduck.geometry.shapes import Geometry, PlacedGeometry
from ssduck.geometry.solids import solid_of
from ssduck.geometry.tick_shapes import ShapeTable
from ssduck.geometry.tick_solids import ShapePlaces

STRAIGHT = (1.0, 0.0, 0.0, 0.0)


def box(x=1.0, y=1.0, z=1.0):
    return Geometry.primitive("box", (x, y, z))


def sphere(radius=0.5):
    return Geometry.primitive("sphere", (radius, 0, 0))


def cylinder(radius=0.5, length=1.0):
    return Geometry.primitive("cylinder", (radius, length, 0))


def capsule(radius=0.5, length=1.0):
    return Geometry.primitive("capsule", (radius, length, 0))


def plane(normal=(0, 0, 1)):
    return Geometry.primitive("plane", normal)


def mesh_of(geometry, *, inverted=False):
    """Returns the surface of a solid as a mesh."""
    surface = solid_of(geometry).surface
    faces = surface.faces[:, ::-1] if inverted else surface.faces
    return Geometry("mesh", (0, 0, 0), surface.vertices, np.ascontiguousarray(faces))


def narrow(*entities):
    """Returns the narrow phase of entities: lists of (geometry, position[, orientation])."""
    shapes = [(*one, STRAIGHT)[:3] for entity in entities for one in entity]
    starts = np.cumsum([0] + [len(entity) for entity in entities]).tolist()
    positions = np.array([position for _, position, _ in shapes], float).reshape(-1, 3)
    turns = np.array([turn for _, _, turn in shapes], float).reshape(-1, 4)
    placed = [
        PlacedGeometry(n, g, np.zeros(3), np.array(STRAIGHT)) for n, (g, _, _) in enumerate(shapes)
    ]
    with np.errstate(all="ignore"):
        unit = turns / np.linalg.norm(turns, axis=1)[:, None]
        boxes = (
            BoundingBoxes(placed, range(len(shapes)), len(shapes))
            .boxes(positions, rotation_matrices(unit))
            .T
        )
    solids = [solid_of(geometry) for geometry, _, _ in shapes]
    places = ShapePlaces(positions, turns, boxes)
    owners = np.repeat(np.arange(len(entities)), np.diff(starts))
    table = ShapeTable(solids, np.arange(len(shapes)), owners)
    return NarrowPhase(table, places, starts, CallCounter())
