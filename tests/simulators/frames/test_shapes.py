"""Shapes are PyBullet's."""

import math
import warnings

import numpy as np
import pybullet
import pytest
from scipy.spatial.transform import Rotation

import ssduck
from ssduck.formatting import MAX_NAMED
from tests.support.arm import ARM, HIGH, LOW, POSE, unsettle
from tests.support.bodies import solid
from tests.support.framed import LIBRARY, asked, base_state, link_states, matrix, rows, same_turn
from tests.support.urdf import box_obj, collision, link, robot

# -- shapes --------------------------------------------------------------------------------------


def test_shapes_are_where_pybullet_has_them(client, write):
    handle = pybullet.loadURDF(
        str(write("arm.urdf", ARM)),
        flags=pybullet.URDF_USE_IMPLICIT_CYLINDER,
        physicsClientId=client,
    )
    unsettle(client, handle, seed=21)
    world = asked(ssduck.World.attach(client), "shapes")
    states = link_states(client, handle)
    coms = [pybullet.getBasePositionAndOrientation(handle, client), *(s[:2] for s in states)]
    expected = []
    for number, (position, turn) in enumerate(coms):
        for data in pybullet.getCollisionShapeData(handle, number - 1, client):
            place = matrix(turn).apply(data[5]) + position
            expected.append((number, place, (matrix(turn) * matrix(data[6])).as_quat(), data[2]))
    poses = rows(world, "shapes", POSE)
    arrow = world.snapshot.tables["shapes"].arrow
    assert arrow["link"].to_pylist() == [e[0] for e in expected] == [0, 0, 1, 2, 4]
    assert poses[:, :3] == pytest.approx(np.array([e[1] for e in expected]), abs=1e-9)
    assert same_turn(poses[:, 3:], np.array([e[2] for e in expected]))
    assert arrow["shape"].to_pylist() == [0, 1, 2, 3, 4]
    known = {row["id"]: row for row in world.snapshot.tables["geometries"].arrow.to_pylist()}
    found = [known[number] for number in arrow["geometry"].to_pylist()]
    sizes = [(g["type"], *(g[f"size_{axis}"] for axis in "xyz")) for g in found]
    assert sizes == [
        ("box", 0.4, 0.2, 0.1),
        ("cylinder", 0.1, 0.5, 0.0),
        ("capsule", 0.05, 0.4, 0.0),
        ("sphere", 0.07, 0.0, 0.0),
        ("cylinder", 0.15, 0.04, 0.0),
    ]


def shapes_of(world, name):
    """Of each shape of an entity: its type, and its box, (2, 3)."""
    arrow = world.snapshot.tables["shapes"].arrow
    known = {row["id"]: row for row in world.snapshot.tables["geometries"].arrow.to_pylist()}
    mine = arrow["entity"].to_numpy() == world[name].id
    types = [known[number]["type"] for number in arrow["geometry"].to_numpy()[mine].tolist()]
    boxes = rows(world, "shapes", LOW + HIGH, name).reshape(-1, 2, 3)
    return list(zip(types, boxes, strict=True))


def test_equal_geometries_are_one_row(client, write):
    path = str(write("arm.urdf", ARM))
    for _ in range(3):
        pybullet.loadURDF(path, physicsClientId=client)
    tables = ssduck.World.attach(client).snapshot.tables
    assert tables["shapes"].count == 15
    assert tables["geometries"].count == 5


@pytest.fixture
def pieces(write):
    """Two boxes in one file, and one in another."""
    write("one.obj", box_obj((0, 0, 0), (1, 2, 3)))
    first = box_obj((0, 0, 0), (1, 1, 1), name="a")
    write("two.obj", first + box_obj((3, 0, 0), (4, 1, 1), first=8, name="b"))


# The mesh elements of a link, in order; each as (file, concave), and the types that come of them.
LINKS = [
    ([("one", False)], ["hull"]),
    ([("two", False)], ["hull", "hull"]),
    ([("one", True)], ["mesh"]),
    ([("one", False), ("one", False)], ["hull", "hull"]),
    ([("two", False), ("one", False)], ["hull", "hull", "hull"]),
    ([("one", False), ("two", False), ("one", False)], ["hull", "hull", "hull", "hull"]),
    ([("one", False), ("one", True)], ["hull", "mesh"]),
    ([("two", True), ("one", False)], ["mesh", "hull"]),
    ([("two", True), ("two", False), ("one", True)], ["mesh", "hull", "hull", "mesh"]),
]


@pytest.mark.parametrize(("elements", "types"), LINKS)
def test_meshes_of_a_link_are_hulls_or_surfaces_as_its_file_says(
    client, write, pieces, elements, types
):
    """Whichever of several they are: PyBullet tells of the first one's corners only."""
    parts = [
        collision(
            f'<mesh filename="{file}.obj" scale="0.5 0.4 0.3"/>',
            xyz=(number, 2 * number, 0.5),
            rpy=(0.1 * number, 0.2, 0.3),
        ).replace("<mesh", '<mesh concave="yes"' if concave else "<mesh")
        for number, (file, concave) in enumerate(elements)
    ]
    if any(concave for _, concave in elements):
        parts = [
            part.replace("<collision", '<collision concave="yes"', 1) if "concave" in part else part
            for part in parts
        ]
    model = robot(
        link("a", mass=0, com=(0.1, 0.2, 0.3), rpy=(0.3, 0.2, 0.1), shapes="".join(parts))
    )
    handle = pybullet.loadURDF(
        str(write("m.urdf", model)), [1, 2, 3], [0.5, 0.5, 0.5, 0.5], physicsClientId=client
    )
    world = asked(ssduck.World.attach(client, names={handle: "model"}), "shapes")
    found = shapes_of(world, "model")
    assert [kind for kind, _ in found] == types
    low = np.min([box[0] for _, box in found], axis=0)
    high = np.max([box[1] for _, box in found], axis=0)
    own_low, own_high = pybullet.getAABB(handle, -1, client)
    assert np.all(own_low <= low + 1e-4)
    assert np.all(own_high >= high - 1e-4)
    assert np.all(high - low > 0.3 * np.subtract(own_high, own_low))


def test_a_mesh_given_by_points_is_their_hull(client):
    corners = np.random.default_rng(4).normal(size=(30, 3))
    shape = pybullet.createCollisionShape(
        pybullet.GEOM_MESH,
        vertices=corners.tolist(),
        meshScale=[1, 2, 3],
        collisionFramePosition=[0.1, 0.2, 0.3],
        collisionFrameOrientation=[0.5, 0.5, 0.5, 0.5],
        physicsClientId=client,
    )
    turn = Rotation.random(random_state=2)
    pybullet.createMultiBody(
        1.0,
        shape,
        basePosition=[1, 2, 3],
        baseOrientation=turn.as_quat(),
        baseInertialFramePosition=[0.4, 0.5, 0.6],
        physicsClientId=client,
    )
    world = asked(ssduck.World.attach(client), "shapes")
    inner = Rotation.from_quat([0.5, 0.5, 0.5, 0.5]).apply(corners * [1, 2, 3]) + np.array(
        [0.1, 0.2, 0.3]
    )
    _, origin, frame = base_state(client, 0)
    points = frame.apply(inner) + origin
    box = rows(world, "entities", LOW + HIGH)[0]
    expected = np.concatenate((points.min(axis=0), points.max(axis=0)))
    assert box == pytest.approx(expected, abs=1e-3)  # PyBullet rounds the corners of hulls
    assert [kind for kind, _ in shapes_of(world, world.snapshot.entities[0].name)] == ["hull"]


@pytest.mark.parametrize(
    ("normal", "corners"),
    [
        ([0, 0, 1], [[-math.inf] * 3, [math.inf, math.inf, 3]]),
        ([0, 2, 0], [[-math.inf] * 3, [math.inf, 2, math.inf]]),
        ([1, 1, 0], [[-math.inf] * 3, [math.inf] * 3]),
    ],
)
def test_planes_are_endless(client, normal, corners):
    solid(client, pybullet.GEOM_PLANE, 0, [1, 2, 3], planeNormal=normal)
    world = ssduck.World.attach(client)
    assert rows(world, "entities", LOW + HIGH).reshape(2, 3).tolist() == corners


# -- shapes that PyBullet does not tell ----------------------------------------------------------


def heightfield(client):
    return solid(
        client,
        pybullet.GEOM_HEIGHTFIELD,
        0,
        meshScale=[1, 1, 1],
        heightfieldData=[0.0, 1.0] * 8,
        numHeightfieldRows=4,
        numHeightfieldColumns=4,
    )


def rigid_mesh(client):
    shape = pybullet.createCollisionShape(
        pybullet.GEOM_MESH, fileName=str(LIBRARY / "duck_vhacd.obj"), physicsClientId=client
    )
    return pybullet.createMultiBody(1, shape, useMaximalCoordinates=True, physicsClientId=client)


def soft(client):
    return pybullet.loadSoftBody(str(LIBRARY / "bunny.obj"), physicsClientId=client)


@pytest.mark.parametrize("make", [heightfield, soft])
def test_a_box_stands_in_for_a_shape_that_pybullet_does_not_tell(client, make, capfd):
    handle = make(client)
    capfd.readouterr()
    with pytest.warns(UserWarning, match="strange: ") as told:
        world = ssduck.World.attach(client, names={handle: "strange"})
    shapes, *velocity = (str(one.message) for one in told)
    assert shapes.startswith("strange: PyBullet does not give back all shapes")
    assert len(velocity) == (make is soft)  # which is unknown
    low, high = pybullet.getAABB(handle, -1, client)
    assert rows(world, "entities", LOW)[0] == pytest.approx(np.array(low), abs=1e-6)
    assert rows(world, "entities", HIGH)[0] == pytest.approx(np.array(high), abs=1e-6)
    assert capfd.readouterr() == ("", "")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        world.step(2)  # it is said once


def test_what_pybullet_saves_needs_no_box(client):
    handle = rigid_mesh(client)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        world = asked(ssduck.World.attach(client, names={handle: "strange"}), "shapes")
    low, high = (np.array(corner) for corner in pybullet.getAABB(handle, -1, client))
    found = shapes_of(world, "strange")
    assert {kind for kind, _ in found} == {"hull"}
    boxes = np.array([box for _, box in found])
    # PyBullet's own box is wider by a margin of at most 4 cm.
    for own, told in ((boxes[:, 0].min(axis=0), low), (-boxes[:, 1].max(axis=0), -high)):
        assert (own >= told - 1e-6).all()
        assert (own <= told + 0.041).all()


@pytest.mark.slow
def test_many_bodies_are_one_warning(client):
    for _ in range(MAX_NAMED + 3):
        heightfield(client)
    with pytest.warns(UserWarning, match=r"body_0, body_1, .*, body_49 and 3 more: ") as said:
        ssduck.World.attach(client, names={n: f"body_{n}" for n in range(MAX_NAMED + 3)})
    assert len(said) == 1


def test_drawn_capsules_are_exact_where_they_are_the_shapes(client):
    """Capsules of URDF files, which look the same to PyBullet's client, need no boxes."""
    pybullet.loadURDF(str(LIBRARY / "humanoid/humanoid.urdf"), physicsClientId=client)
    world = ssduck.World.attach(client, names={0: "humanoid"})
    types = [kind for kind, _ in shapes_of(asked(world, "shapes"), "humanoid")]
    assert sorted(set(types)) == ["box", "capsule", "sphere"]
