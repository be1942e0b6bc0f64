"""Poses against scipy's rotations, boxes against support functions, and mesh files."""

import math
import struct
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from ssduck.errors import ArgumentError
from ssduck.geometry.bounds import BoundingBoxes
from ssduck.geometry.mesh_files import load_hulls, load_mesh
from ssduck.geometry.poses import IDENTITY, compose, invert, rotation_matrices
from ssduck.geometry.shapes import Geometry, PlacedGeometry
from tests.support.pairs import Shape, reach
from tests.support.urdf import box_obj

coordinates = st.floats(-50.0, 50.0)
vectors = st.tuples(coordinates, coordinates, coordinates).map(np.array)
quaternions = (
    st.tuples(*[st.floats(-1.0, 1.0)] * 4)
    .map(np.array)
    .filter(lambda q: np.linalg.norm(q) > 0.1)
    .map(lambda q: q / np.linalg.norm(q))
)


def of(quaternion):
    """scipy's rotation of w, x, y, z."""
    return Rotation.from_quat(np.roll(quaternion, -1))


def turned(seed, count=1):
    """Random unit quaternions (n, 4)."""
    return np.roll(Rotation.random(count, random_state=seed).as_quat(), 1, axis=1)


# -- poses ------------------------------------------------------------------------------------


@pytest.mark.slow
@given(quaternions)
def test_rotation_matrices(quaternion):
    matrix = rotation_matrices(quaternion[None])[0]
    assert matrix == pytest.approx(of(quaternion).as_matrix(), abs=1e-14)


@pytest.mark.slow
@given(vectors, quaternions, vectors, quaternions, vectors)
def test_compose_is_one_pose_after_the_other(position, orientation, inner, turn, point):
    outer_position, outer_turn = compose(position[None], orientation[None], inner[None], turn[None])
    by_two = of(orientation).apply(of(turn).apply(point) + inner) + position
    by_one = of(outer_turn[0]).apply(point) + outer_position[0]
    assert by_one == pytest.approx(by_two, abs=1e-11)


@pytest.mark.slow
@given(vectors, quaternions)
def test_invert_undoes_a_pose(position, orientation):
    pose = position[None], orientation[None]
    place, turn = compose(*invert(*pose), *pose)
    assert place[0] == pytest.approx(np.zeros(3), abs=1e-12)
    assert rotation_matrices(turn)[0] == pytest.approx(np.eye(3), abs=1e-14)


# -- boxes ------------------------------------------------------------------------------------

BOX = Geometry.primitive("box", (0.4, 0.2, 1.0))
SPHERE = Geometry.primitive("sphere", (0.3, 0, 0))
CAPSULE = Geometry.primitive("capsule", (0.1, 0.7, 0))
CYLINDER = Geometry.primitive("cylinder", (0.25, 0.6, 0))
ELLIPSOID = Geometry.primitive("ellipsoid", (0.3, 0.1, 0.2))
PLANE = Geometry.primitive("plane", (0, 0, 1))
HULL = Geometry.hull(np.random.default_rng(5).normal(size=(40, 3)))
FLAT = Geometry.hull([[x, y, 0.0] for x in range(4) for y in range(4)])
MESH = replace(
    Geometry.hull([[0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 3]]),
    type="mesh",
    faces=np.array([[0, 1, 2], [0, 1, 3], [0, 2, 3]], dtype=np.int32),
)


def test_a_size_of_other_than_three_numbers_is_an_error():
    with pytest.raises(ArgumentError, match="size of a sphere has three numbers, not 1: of a s"):
        Geometry.primitive("sphere", [0.1])


SOLID = {
    "box": BOX,
    "sphere": SPHERE,
    "capsule": CAPSULE,
    "cylinder": CYLINDER,
    "ellipsoid": ELLIPSOID,
    "hull": HULL,
    "flat hull": FLAT,
    "mesh": MESH,
}


def boxed(shapes, groups, count, positions, orientations):
    """The boxes as (groups, 2, 3): lower and upper corners."""
    boxes = BoundingBoxes(shapes, groups, count).boxes(positions, rotation_matrices(orientations))
    return boxes.T.reshape(-1, 2, 3)


def reached(shape, place, turn):
    """The lower and the upper corner of a shape at a pose, by its support function."""
    placed = Shape(shape.type, shape, place, turn)
    axes = np.eye(3)
    return [[-reach(placed, -axis) for axis in axes], [reach(placed, axis) for axis in axes]]


# Cyclic turns of the axes, and any.
UPRIGHT = [IDENTITY, np.array([0.5, 0.5, 0.5, 0.5]), np.array([0.5, -0.5, -0.5, -0.5])]
TURNS = [*UPRIGHT, *turned(0, 6)]


@pytest.mark.parametrize("name", SOLID)
@pytest.mark.parametrize("number", range(len(TURNS)))
def test_box_of_a_shape_is_as_far_as_the_shape_reaches(name, number):
    """Turned in its frame, and in a frame that is turned."""
    frame, place = np.random.default_rng(number).normal(size=(2, 3))
    for frame_turn, turn in ((IDENTITY, TURNS[number]), (TURNS[-1 - number], TURNS[number])):
        placed = PlacedGeometry(0, SOLID[name], place, turn)
        found = boxed([placed], [0], 1, frame[None], frame_turn[None])[0]
        whole = np.roll((of(frame_turn) * of(turn)).as_quat(), 1)
        expected = reached(SOLID[name], frame + of(frame_turn).apply(place), whole)
        assert found == pytest.approx(np.array(expected), abs=1e-12)


def scattered(seed):
    """Shapes of all kinds on three frames, in five groups of which one is empty."""
    rng = np.random.default_rng(seed)
    kinds = list(SOLID.values())
    chosen = [kinds[index] for index in rng.integers(0, len(kinds), 25)]
    frames = rng.integers(0, 3, 25)
    groups = rng.choice([0, 1, 3, 4], 25)
    shapes = [
        PlacedGeometry(int(frame), shape, rng.normal(size=3), turn)
        for frame, shape, turn in zip(frames, chosen, turned(seed, 25), strict=True)
    ]
    return shapes, groups.tolist(), rng.normal(size=(3, 3)), turned(seed + 100, 3)


@pytest.mark.parametrize("seed", range(8))
def test_box_of_a_group_is_that_of_its_shapes(seed):
    shapes, groups, positions, orientations = scattered(seed)
    found = boxed(shapes, groups, 5, positions, orientations)
    each = boxed(shapes, range(25), 25, positions, orientations)
    for group in set(groups):
        members = [row for row, owner in enumerate(groups) if owner == group]
        assert found[group][0] == pytest.approx(each[members, 0].min(axis=0), abs=1e-12)
        assert found[group][1] == pytest.approx(each[members, 1].max(axis=0), abs=1e-12)
    for empty in set(range(5)) - set(groups):
        assert found[empty].tolist() == [[math.inf] * 3, [-math.inf] * 3]


@pytest.mark.parametrize("seed", range(3))
def test_the_same_boxes_for_one_pose_after_another(seed):
    """The results of a `BoundingBoxes` do not depend on the poses that it saw before."""
    shapes, groups, positions, orientations = scattered(seed)
    boxer = BoundingBoxes(shapes, groups, 5)
    boxer.boxes(positions + 7.0, rotation_matrices(turned(9, 3)))
    again = boxer.boxes(positions, rotation_matrices(orientations)).T.reshape(-1, 2, 3)
    assert again.tolist() == boxed(shapes, groups, 5, positions, orientations).tolist()


@pytest.mark.parametrize("count", [0, 1, 3])
def test_groups_without_shapes(count):
    found = boxed([], [], count, np.zeros((2, 3)), np.tile(IDENTITY, (2, 1)))
    assert found.tolist() == [[[math.inf] * 3, [-math.inf] * 3]] * count


def test_a_frame_that_is_nowhere_has_no_box_and_spoils_no_other():
    shapes = [
        PlacedGeometry(frame, shape, np.zeros(3), IDENTITY)
        for frame, shape in ((0, BOX), (1, CYLINDER), (2, SPHERE), (1, PLANE))
    ]
    for lost in range(2):
        poses = np.zeros((3, 3)), np.tile(IDENTITY, (3, 1))
        poses[lost][1] = np.nan
        found = boxed(shapes, range(4), 4, *poses)
        assert np.isnan(found).any(axis=(1, 2)).tolist() == [False, True, False, True]


# (normal in the frame, orientation of the frame, corners of the box of a plane through (1, 2, 3))
INF = math.inf
HALF = math.sqrt(0.5)
PLANES = [
    ((0, 0, 1), (1, 0, 0, 0), [[-INF] * 3, [INF, INF, 3]]),
    ((0, 0, -1), (1, 0, 0, 0), [[-INF, -INF, 3], [INF] * 3]),
    ((1, 0, 0), (1, 0, 0, 0), [[-INF] * 3, [1, INF, INF]]),
    ((0, -1, 0), (1, 0, 0, 0), [[-INF, 2, -INF], [INF] * 3]),
    ((0, 0, 1), (HALF, HALF, 0, 0), [[-INF, 2, -INF], [INF] * 3]),
    ((0, 0, 1), (HALF, 0, HALF, 0), [[-INF] * 3, [1, INF, INF]]),
    # A plane that is tilted, be it little, reaches everywhere.
    ((HALF, 0, HALF), (1, 0, 0, 0), [[-INF] * 3, [INF] * 3]),
    ((0, 0, 1), (math.cos(1e-3), math.sin(1e-3), 0, 0), [[-INF] * 3, [INF] * 3]),
    ((1.1e-9, 0, 1), (1, 0, 0, 0), [[-INF] * 3, [INF] * 3]),
    ((0.9e-9, 0, 1), (1, 0, 0, 0), [[-INF] * 3, [INF, INF, 3]]),
]


@pytest.mark.parametrize(("normal", "turn", "corners"), PLANES)
def test_box_of_a_plane(normal, turn, corners):
    plane = PlacedGeometry(0, Geometry.primitive("plane", normal), np.zeros(3), IDENTITY)
    found = boxed([plane], [0], 1, np.array([[1.0, 2.0, 3.0]]), np.array([turn]))
    assert found[0] == pytest.approx(np.array(corners, dtype=float), abs=1e-12)


def test_a_plane_and_a_box_above_it_in_one_group():
    plane = PlacedGeometry(0, PLANE, np.zeros(3), IDENTITY)
    box = PlacedGeometry(0, BOX, np.array([0.0, 0.0, 4.0]), IDENTITY)
    found = boxed([plane, box], [0, 0], 2, np.zeros((1, 3)), IDENTITY[None])
    assert found[0].tolist() == [[-INF] * 3, [INF, INF, 4.5]]
    assert found[1].tolist() == [[INF] * 3, [-INF] * 3]


def test_a_hull_of_no_points_has_no_box():
    shapes = [PlacedGeometry(0, shape, np.zeros(3), IDENTITY) for shape in (Geometry.hull([]), BOX)]
    found = boxed(shapes, [0, 1], 2, np.zeros((1, 3)), IDENTITY[None])
    assert found[0].tolist() == [[INF] * 3, [-INF] * 3]
    assert found[1].tolist() == [[-0.2, -0.1, -0.5], [0.2, 0.1, 0.5]]


@pytest.mark.parametrize("count", [1, 7, 8, 9, 15, 16, 17, 100])
def test_hulls_of_few_and_of_many_points(count):
    """Points are turned in bunches: the last one is not to be lost, nor a bunch to be mixed up."""
    points = np.random.default_rng(count).normal(size=(count, 3))
    shapes = [
        PlacedGeometry(0, Geometry.hull(points), np.zeros(3), IDENTITY),
        PlacedGeometry(1, Geometry.hull(points[::-1] * 2), np.zeros(3), IDENTITY),
    ]
    turns = turned(count, 2)
    found = boxed(shapes, [0, 1], 2, np.zeros((2, 3)), turns)
    for row, factor in ((0, 1), (1, 2)):
        world = of(turns[row]).apply(points * factor)
        assert found[row] == pytest.approx(
            np.array([world.min(axis=0), world.max(axis=0)]), abs=1e-12
        )


# -- equal geometries --------------------------------------------------------------------------

DIFFERENT = {
    **SOLID,
    "plane": PLANE,
    "another box": Geometry.primitive("box", (0.4, 0.2, 1.0 + 1e-15)),
    "a cylinder as a capsule": replace(CYLINDER, type="capsule"),
    "a hull of the mesh's points": Geometry.hull(MESH.vertices),
    "the mesh less a face": replace(MESH, faces=MESH.faces[:2]),
    "the mesh with a face turned": replace(MESH, faces=MESH.faces[:, ::-1].copy()),
}


def test_geometries_have_equal_keys_if_they_are_equal():
    keys = {shape.key for shape in DIFFERENT.values()}
    assert len(keys) == len(DIFFERENT)
    for shape in DIFFERENT.values():
        copy = replace(shape, vertices=shape.vertices.copy(), faces=shape.faces.copy())
        assert copy.key == shape.key


# -- mesh files -------------------------------------------------------------------------------

TETRAHEDRON = "v 0 0 0\nv 1 0 0\nv 0 2 0\nv 0 0 3\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"


def binary_stl(triangles):
    body = b"".join(
        struct.pack("<12fH", 0, 0, 0, *[x for corner in triangle for x in corner], 0)
        for triangle in triangles
    )
    return b"\0" * 80 + struct.pack("<I", len(triangles)) + body


def test_the_triangles_of_an_obj_file(write):
    mesh = load_mesh(write("a.obj", TETRAHEDRON), (1.0, 1.0, 1.0))
    assert mesh.type == "mesh"
    assert mesh.vertices.tolist() == [[0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 3]]
    assert mesh.faces.tolist() == [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]


OBJ_FACES = [
    ("f 1 2 3", [[0, 1, 2]]),
    ("f 1/5 2/6 3/7", [[0, 1, 2]]),
    ("f 1/5/9 2/6/9 3/7/9", [[0, 1, 2]]),
    ("f 1//9 2//9 3//9", [[0, 1, 2]]),
    ("f -4 -3 -2", [[0, 1, 2]]),
    ("f 1 2 3 4", [[0, 1, 2], [0, 2, 3]]),
    ("f 1 2 3 4 # a comment, and a line", [[0, 1, 2], [0, 2, 3]]),
    ("usemtl red\nf 1 2 3\nusemtl blue\nf 2 3 4", [[0, 1, 2], [1, 2, 3]]),
]


@pytest.mark.parametrize(("faces", "triangles"), OBJ_FACES)
def test_the_ways_to_write_an_obj_face(write, faces, triangles):
    text = (
        "# a cloud\nv 0 0 0\nv 1 0 0\nv 0 2 0 1.0\nv 0 0 3 0.5 0.5 0.5\nvn 0 0 1\nvt 0 1\n" + faces
    )
    assert load_mesh(write("a.obj", text), (1.0, 1.0, 1.0)).faces.tolist() == triangles


def test_a_mesh_is_scaled_along_its_axes(write):
    path = write("a.obj", TETRAHEDRON)
    assert load_mesh(path, (2.0, 3.0, -1.0)).vertices.tolist() == [
        [0, 0, 0],
        [2, 0, 0],
        [0, 6, 0],
        [0, 0, -3],
    ]
    (hull,) = load_hulls(path, (2.0, 3.0, -1.0))
    assert sorted(hull.vertices.tolist()) == [[0, 0, -3], [0, 0, 0], [0, 6, 0], [2, 0, 0]]


@pytest.mark.parametrize("separator", ["o", "g"])
def test_each_object_of_an_obj_file_is_a_hull(write, separator):
    first, second = box_obj((0, 0, 0), (1, 1, 1)), box_obj((5, 5, 5), (6, 7, 8), first=8)
    path = write("two.obj", f"{separator} a\n{first}{separator} b\n{second}")
    hulls = load_hulls(path, (1.0, 1.0, 1.0))
    assert [hull.type for hull in hulls] == ["hull", "hull"]
    spans = [
        (hull.vertices.min(axis=0).tolist(), hull.vertices.max(axis=0).tolist()) for hull in hulls
    ]
    assert spans == [([0, 0, 0], [1, 1, 1]), ([5, 5, 5], [6, 7, 8])]
    assert len(load_mesh(path, (1.0, 1.0, 1.0)).vertices) == 16


def test_points_that_no_face_uses_are_not_in_the_hull(write):
    (hull,) = load_hulls(
        write("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 9 9 9\nf 1 2 3\n"), (1.0, 1.0, 1.0)
    )
    assert sorted(hull.vertices.tolist()) == [[0, 0, 0], [0, 1, 0], [1, 0, 0]]


def test_an_stl_file(tmp_path):
    path = tmp_path / "a.stl"
    path.write_bytes(
        binary_stl([[(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(0, 0, 0), (1, 0, 0), (0, 0, 2)]])
    )
    mesh = load_mesh(path, (1.0, 1.0, 10.0))
    assert len(mesh.faces) == 2
    assert mesh.vertices.max(axis=0).tolist() == [1, 1, 20]
    (hull,) = load_hulls(path, (1.0, 1.0, 10.0))
    assert hull.vertices.max(axis=0).tolist() == [1, 1, 20]


# (file name, its text, words of the complaint)
DAMAGED = [
    ("empty.obj", "", "has no triangles"),
    ("points.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\n", "has no triangles"),
    ("names.obj", "o a\no b\n", "has no triangles"),
    ("letters.obj", "v 0 0 x\nf 1 1 1\n", "cannot be read as a mesh"),
    ("missing.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 4\n", "a missing vertex"),
    ("before.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf -4 1 2\n", "a missing vertex"),
    ("nan.obj", "v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "no finite number"),
    ("inf.obj", "v 0 0 inf\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "no finite number"),
    ("empty.stl", "", "cannot be read as a mesh|has no triangles"),
    ("text.stl", "this is no mesh", "cannot be read as a mesh|has no triangles"),
    ("mesh.nonsense", "this is no mesh", "cannot be read as a mesh"),
]


@pytest.mark.parametrize(("name", "text", "words"), DAMAGED)
@pytest.mark.parametrize("load", [load_mesh, load_hulls])
def test_a_damaged_file_is_refused_by_name(write, load, name, text, words):
    path = write(name, text)
    with pytest.raises(ValueError, match=words) as caught:
        load(path, (1.0, 1.0, 1.0))
    assert str(path) in str(caught.value)


@pytest.mark.parametrize("load", [load_mesh, load_hulls])
def test_a_file_that_is_not_there(tmp_path, load):
    with pytest.raises(ValueError, match=r"absent\.obj cannot be read: No such file"):
        load(tmp_path / "absent.obj", (1.0, 1.0, 1.0))


def test_a_file_is_read_once_until_it_is_written_anew(write):
    path = write("a.obj", TETRAHEDRON)
    first = load_mesh(path, (1.0, 1.0, 1.0))
    assert load_mesh(path, (1.0, 1.0, 1.0)) is first
    assert load_mesh(path, (2.0, 1.0, 1.0)) is not first
    write("a.obj", TETRAHEDRON + "f 1 2 3\n")
    assert len(load_mesh(path, (1.0, 1.0, 1.0)).faces) == len(first.faces) + 1
