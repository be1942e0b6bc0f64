"""Which cells shapes occupy, against FCL, closed forms and solid angles."""

import itertools

import fcl
import numpy as np
import pytest
import trimesh
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from ssduck.geometry.rasters import CELL_TOLERANCE, Raster, Rasterizer
from ssduck.geometry.shapes import Geometry
from ssduck.geometry.solids import PlacedSolids, solid_of
from tests.support.cases import sampled
from tests.support.pairs import windings

RNG = np.random.default_rng(7)
POINTS = RNG.normal(size=(20, 3)) * [0.3, 0.2, 0.25]
RASTER = Raster((-1.0, -1.0), 0.05, (40, 41))
CONVEX = {
    "box": Geometry.primitive("box", (0.5, 0.3, 0.7)),
    "sphere": Geometry.primitive("sphere", (0.4, 0, 0)),
    "cylinder": Geometry.primitive("cylinder", (0.3, 0.6, 0)),
    "disc": Geometry.primitive("cylinder", (0.4, 0.02, 0)),
    "rod": Geometry.primitive("cylinder", (0.03, 1.2, 0)),
    "capsule": Geometry.primitive("capsule", (0.2, 0.7, 0)),
    "ellipsoid": Geometry.primitive("ellipsoid", (0.45, 0.15, 0.3)),
    "hull": Geometry.hull(POINTS),
}
TURNS = {
    "upright": Rotation.identity(),
    "lying": Rotation.from_euler("x", 90, degrees=True),
    "lying across": Rotation.from_euler("y", 90, degrees=True),
    "tilted": Rotation.from_euler("xyz", [25, -40, 70], degrees=True),
    "hardly tilted": Rotation.from_euler("xy", [1e-5, 2e-5]),
    "along y, tilted": Rotation.from_euler("xy", [80, 3], degrees=True),
}
SLABS = [(-0.05, 0.15), (0.12, 0.121), (-2.0, 2.0), (-0.3, -0.29)]


def placed(*shapes):
    """PlacedSolids of geometries, places and turns."""
    geometries, places, turns = zip(*shapes, strict=True)
    count = len(shapes)
    matrices = np.array([turn.as_matrix() for turn in turns])
    boxes = np.tile([-5.0] * 3 + [5.0] * 3, (count, 1))
    solids = [solid_of(geometry) for geometry in geometries]
    return PlacedSolids(solids, np.array(places, float), matrices, boxes, np.arange(count))


def fcl_geometry(geometry):
    a, b, c = geometry.size
    match geometry.type:
        case "box":
            return fcl.Box(a, b, c)
        case "sphere":
            return fcl.Sphere(a)
        case "cylinder":
            return fcl.Cylinder(a, b)
        case "capsule":
            return fcl.Capsule(a, b)
        case "ellipsoid":
            return fcl.Ellipsoid(a, b, c)
    hull = ConvexHull(geometry.vertices)
    faces = np.concatenate([[3, *face] for face in hull.simplices])
    return fcl.Convex(geometry.vertices, len(hull.simplices), faces)


def met_by_fcl(geometry, place, turn, low, high, larger):
    """The cells that FCL finds to meet a shape, each wider by so much at each side."""
    thing = fcl.CollisionObject(
        fcl_geometry(geometry), fcl.Transform(turn.as_matrix(), np.array(place, float))
    )
    side = RASTER.size + 2 * larger
    cell = fcl.CollisionObject(fcl.Box(side, side, high - low + 2 * larger), fcl.Transform())
    found = np.zeros(RASTER.shape, bool)
    for i, x in enumerate(RASTER.centres(0)):
        for j, y in enumerate(RASTER.centres(1)):
            cell.setTransform(fcl.Transform(np.array([x, y, (low + high) / 2])))
            found[i, j] = fcl.collide(cell, thing) > 0
    return found


@sampled("turn", TURNS, every=2)
@pytest.mark.parametrize("kind", CONVEX)
def test_convex_shapes_meet_the_cells_that_fcl_says(kind, turn):
    geometry, place = CONVEX[kind], [0.013, -0.027, 0.031]
    slicer = Rasterizer(placed((geometry, place, TURNS[turn])))
    for low, high in SLABS:
        cells = slicer.cells(RASTER, low, high)
        arguments = geometry, place, TURNS[turn], low, high
        # FCL is true to about 1e-6 m, in places to 1e-4
        assert not (cells & ~met_by_fcl(*arguments, 2e-4)).any(), (low, high)
        assert not (met_by_fcl(*arguments, -2e-4) & ~cells).any(), (low, high)
    assert slicer.cells(RASTER, -2, 2).any()


@pytest.mark.parametrize("height", [0.0, 0.25, 0.399999, 0.4])
def test_discs_are_exact(height):
    """A square meets a disc if its nearest point is nearer to the middle than the radius."""
    centre, radius = np.array([0.02, -0.013]), np.sqrt(0.4**2 - height**2)
    sphere = placed((CONVEX["sphere"], [*centre, 0.0], Rotation.random(rng=3)))
    x, y = (
        np.maximum(abs(RASTER.centres(axis) - centre[axis]) - RASTER.size / 2, 0) for axis in (0, 1)
    )
    met = np.hypot(x[:, None], y) <= radius
    assert np.array_equal(Rasterizer(sphere).cells(RASTER, height, height), met)
    upright = placed(
        (Geometry.primitive("cylinder", (radius, 1, 0)), [*centre, 0.1], TURNS["upright"])
    )
    assert np.array_equal(Rasterizer(upright).cells(RASTER, height, height), met)


@pytest.mark.parametrize("angle", [0, 10, 45, 89.5, 90, 200])
def test_turned_boxes_are_exact(angle):
    """Two rectangles meet unless an axis of one of them separates them."""
    turn = Rotation.from_euler("z", angle, degrees=True)
    box = placed((CONVEX["box"], [0.021, 0.034, 0.0], turn))
    corners = turn.apply([[x, y, 0] for x in (-0.25, 0.25) for y in (-0.15, 0.15)])[:, :2] + [
        0.021,
        0.034,
    ]
    axes = np.vstack((np.eye(2), turn.as_matrix()[:2, :2].T))
    x, y = np.meshgrid(RASTER.centres(0), RASTER.centres(1), indexing="ij")
    centres = np.stack((x, y), axis=2)
    met = np.ones(RASTER.shape, bool)
    for axis in axes:
        middle, half = centres @ axis, abs(axis).sum() * RASTER.size / 2
        spread = corners @ axis
        met &= (middle - half < spread.max() - 1e-9) & (middle + half > spread.min() + 1e-9)
    assert np.array_equal(Rasterizer(box).cells(RASTER, 0.1, 0.1), met)


TINY = 1e-6


@pytest.mark.parametrize("off", [-TINY, 0.0, TINY])
@pytest.mark.parametrize("side", range(4))
def test_the_sides_of_a_box(side, off):
    """A box that fills 3 x 4 cells; one of its sides a little in, at or beyond the cells' edge."""
    low, high = np.array([0.2, 0.3]), np.array([0.5, 0.7])
    if side < 2:
        low[side] -= off
    else:
        high[side - 2] += off
    size, middle = high - low, (low + high) / 2
    raster = Raster((0.0, 0.0), 0.1, (10, 10))
    box = Geometry.primitive("box", (*size, 1.0))
    cells = Rasterizer(placed((box, [*middle, 0.0], Rotation.identity()))).cells(raster, 0.0, 0.0)
    first, last = np.array([2, 3]), np.array([4, 6])
    if off > 0 and side < 2:
        first[side] -= 1
    elif off > 0:
        last[side - 2] += 1
    expected = np.zeros((10, 10), bool)
    expected[first[0] : last[0] + 1, first[1] : last[1] + 1] = True
    assert np.array_equal(cells, expected)


@pytest.mark.parametrize(
    ("low", "high", "reach", "met"),
    [
        (0.5, 0.5, -CELL_TOLERANCE, True),  # at the top, which is a part of the shape
        (0.5 + TINY, 0.6, -CELL_TOLERANCE, False),
        (0.5 - TINY, 0.6, -CELL_TOLERANCE, True),
        (-0.9, -0.5, -CELL_TOLERANCE, True),
        (-0.9, -0.5 - TINY, -CELL_TOLERANCE, False),
        (0.5, 0.6, CELL_TOLERANCE, False),  # a cube that it only touches
        (0.5 - TINY, 0.6, CELL_TOLERANCE, True),
        (-0.6, -0.5, CELL_TOLERANCE, False),
    ],
)
@pytest.mark.parametrize("kind", ["box", "cylinder", "mesh"])
def test_the_top_and_the_bottom(kind, low, high, reach, met):
    shapes = {
        "box": Geometry.primitive("box", (0.4, 0.4, 1.0)),
        "cylinder": Geometry.primitive("cylinder", (0.2, 1.0, 0)),
        "mesh": prism([(-0.2, -0.2), (0.2, -0.2), (0.2, 0.0), (0, 0), (0, 0.2), (-0.2, 0.2)], 0.5),
    }
    slicer = Rasterizer(placed((shapes[kind], [0, 0, 0], Rotation.identity())))
    assert slicer.cells(RASTER, low, high, min_overlap=reach).any() == met


# -- meshes ---------------------------------------------------------------------------------------


def prism(outline, half, *, lids=True):
    """A mesh of walls along an outline, from -half to half along z, with lids or without."""
    n = len(outline)
    ring = np.array(outline, float)
    vertices = np.vstack([np.column_stack((ring, np.full(n, z))) for z in (-half, half)])
    faces = []
    for i in range(n):
        j = (i + 1) % n
        faces += [[i, j, j + n], [i, j + n, i + n]]
    if lids:  # a fan, from the fourth corner: that of an L that all others are seen from
        for k in range(n - 2):
            a, b, c = 3 % n, (4 + k) % n, (5 + k) % n
            faces += [[c, b, a], [a + n, b + n, c + n]]
    return Geometry("mesh", (0, 0, 0), vertices, np.array(faces, np.int32))


ELL = [(-0.5, -0.5), (0.5, -0.5), (0.5, 0.0), (0.0, 0.0), (0.0, 0.5), (-0.5, 0.5)]


def test_a_closed_mesh_is_solid():
    raster = Raster((-0.7, -0.7), 0.1, (14, 14))
    x, y = np.meshgrid(raster.centres(0), raster.centres(1), indexing="ij")
    inside = (abs(x) < 0.5) & (abs(y) < 0.5) & ~((x > 0) & (y > 0))
    mesh = prism(ELL, 0.4)
    assert solid_of(mesh).type == "mesh"
    assert solid_of(mesh).is_closed
    slicer = Rasterizer(placed((mesh, [0, 0, 0], Rotation.identity())))
    for low, high in ((0.0, 0.0), (0.4, 0.4), (-1, 1), (0.39, 2)):
        assert np.array_equal(slicer.cells(raster, low, high), inside), (low, high)


def test_an_open_mesh_is_its_walls():
    raster = Raster((-0.75, -0.75), 0.1, (15, 15))
    mesh = prism(ELL, 0.4, lids=False)
    cells = Rasterizer(placed((mesh, [0, 0, 0], Rotation.identity()))).cells(raster, 0.1, 0.1)
    x, y = np.meshgrid(raster.centres(0), raster.centres(1), indexing="ij")
    on = lambda a, b: abs(a - b) < 0.04  # noqa: E731
    walls = (on(abs(x), 0.5) & (abs(y) < 0.54)) | (on(abs(y), 0.5) & (abs(x) < 0.54))
    walls &= ~((x > 0.04) & (y > 0.04))
    walls |= (on(x, 0) & (y > -0.04) & (y < 0.54)) | (on(y, 0) & (x > -0.04) & (x < 0.54))
    assert np.array_equal(cells, walls)


@pytest.mark.parametrize("off", [-TINY, 0.0, TINY])
def test_a_wall_between_two_cells_is_in_both(off):
    """What has no thickness is somewhere, even exactly on an edge."""
    wall = Geometry(
        "mesh",
        (0, 0, 0),
        np.array([[0, -0.2, -1], [0, 0.2, -1], [0, 0, 2.0]]),
        np.array([[0, 1, 2]], np.int32),
    )
    raster = Raster((-0.1, -0.1), 0.1, (2, 2))
    cells = Rasterizer(placed((wall, [off, 0, 0], Rotation.identity()))).cells(raster, 0.0, 0.0)
    assert cells.any(axis=1).tolist() == [off <= 0, off >= 0]


@pytest.mark.slow
@sampled("turn", ["upright", "lying", "tilted"], every=3)
@pytest.mark.parametrize("height", [0.0, 0.11])
def test_a_torus(turn, height):
    torus = trimesh.creation.torus(0.5, 0.2, major_sections=16, minor_sections=8)
    mesh = Geometry("mesh", (0, 0, 0), np.array(torus.vertices), np.array(torus.faces, np.int32))
    place = [0.01, 0.02, 0.03]
    raster = Raster((-0.8, -0.8), 0.05, (32, 33))
    cells = Rasterizer(placed((mesh, place, TURNS[turn]))).cells(raster, height, height)
    triangles = TURNS[turn].apply(torus.vertices)[torus.faces] + place
    near = np.array([-0.499, 0, 0.499]) * raster.size
    inside = np.zeros((9, *raster.shape), bool)
    for k, (dx, dy) in enumerate(itertools.product(near, near)):
        x, y = np.meshgrid(raster.centres(0) + dx, raster.centres(1) + dy, indexing="ij")
        points = np.column_stack((x.ravel(), y.ravel(), np.full(x.size, height)))
        inside[k] = (windings(points, triangles) > 0.5).reshape(raster.shape)
    met, full = inside.any(axis=0), inside.all(axis=0)
    assert full.sum() > 20
    assert (met & ~full).sum() > 20
    assert not (met & ~cells).any()
    # Between the points that were looked at there are slivers; they are beside what is met.
    slivers = cells & ~met
    assert slivers.sum() <= 0.1 * met.sum()
    beside = np.pad(met, 1)
    beside = beside[2:, 1:-1] | beside[:-2, 1:-1] | beside[1:-1, 2:] | beside[1:-1, :-2]
    assert not (slivers & ~beside).any()


def test_planes_are_solid():
    up = Geometry.primitive("plane", (0, 0, 1))
    slicer = Rasterizer(placed((up, [0, 0, 0.2], Rotation.identity())))
    assert slicer.cells(RASTER, 0.2, 0.2).all()
    assert not slicer.cells(RASTER, 0.2 + TINY, 0.3).any()
    assert not slicer.cells(RASTER, 0.2, 0.3, min_overlap=CELL_TOLERANCE).any()
    steep = Rasterizer(
        placed((Geometry.primitive("plane", (1, 0, 0)), [0.05, 0, 0], Rotation.identity()))
    )
    assert np.array_equal(steep.cells(RASTER, 0, 0).all(axis=1), RASTER.centres(0) < 0.05)


def test_nothing_and_points():
    empty = Rasterizer(PlacedSolids.empty())
    assert not empty.cells(RASTER, -1, 1).any()
    point = placed((Geometry.primitive("sphere", (0, 0, 0)), [0.01, 0.01, 0], Rotation.identity()))
    assert Rasterizer(point).cells(RASTER, 0, 0).sum() == 1
    flat = placed(
        (Geometry.hull([[0, 0, 0], [0.2, 0, 0], [0, 0.2, 0]]), [0.01, 0.01, 0], Rotation.identity())
    )
    assert Rasterizer(flat).cells(RASTER, 0, 0).sum() == 15


def test_bunches_change_nothing(monkeypatch):
    shapes = [(CONVEX["hull"], RNG.uniform(-0.5, 0.5, 3), Rotation.random(rng=k)) for k in range(9)]
    shapes += [(prism(ELL, 0.3), RNG.uniform(-0.5, 0.5, 3), Rotation.random(rng=9))]
    whole = Rasterizer(placed(*shapes)).cells(RASTER, -0.1, 0.1)
    monkeypatch.setattr("ssduck.geometry.rasters.PAIRS_AT_ONCE", 7)
    assert np.array_equal(Rasterizer(placed(*shapes)).cells(RASTER, -0.1, 0.1), whole)
    alone = [Rasterizer(placed(shape)).cells(RASTER, -0.1, 0.1) for shape in shapes]
    assert np.array_equal(np.any(alone, axis=0), whole)
