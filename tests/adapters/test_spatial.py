"""Forms of space: AS points, mesh, glb, image."""

import math

import numpy as np
import pybullet
import pytest
import trimesh

import ssduck
from ssduck.adapters import spatial
from ssduck.adapters.marks import OUTLINE, Marks
from ssduck.errors import ArgumentError, LimitError, ProgramWarning
from ssduck.schema import LINK_FACTOR
from ssduck.simulators.scenes import Camera
from tests.support.bodies import create_linked_body, solid

TURN = pybullet.getQuaternionFromEuler([0.3, -0.7, 1.1])
PLACE = [0.5, -0.25, 1.0]


def off_a_box(p, n):
    return np.abs(p / [0.2, 0.3, 0.4]).max(axis=1) - 1.0


def off_a_ball(p, n):
    return np.linalg.norm(p, axis=1) - 0.25


def off_a_cylinder(p, n):
    off = np.linalg.norm(p[:, :2], axis=1) - 0.2
    return np.maximum(off, np.abs(p[:, 2]) - 0.35)


def off_a_capsule(p, n):
    near = np.clip(p[:, 2], -0.3, 0.3)
    return np.linalg.norm(p - np.stack((0 * near, 0 * near, near), axis=1), axis=1) - 0.15


# name, PyBullet's shape, area, how far a point in its frame is off the surface
SHAPES = [
    ("box", {"kind": pybullet.GEOM_BOX, "halfExtents": [0.2, 0.3, 0.4]}, 8 * 0.26, off_a_box),
    ("ball", {"kind": pybullet.GEOM_SPHERE, "radius": 0.25}, 4 * math.pi * 0.0625, off_a_ball),
    (
        "cylinder",
        {"kind": pybullet.GEOM_CYLINDER, "radius": 0.2, "height": 0.7},
        2 * math.pi * 0.2 * 0.9,
        off_a_cylinder,
    ),
    (
        "capsule",
        {"kind": pybullet.GEOM_CAPSULE, "radius": 0.15, "height": 0.6},
        2 * math.pi * 0.15 * 0.9,
        off_a_capsule,
    ),
]


@pytest.fixture(scope="module")
def shapes():
    """A world of one body of each kind, all turned alike, and a plane."""
    client = pybullet.connect(pybullet.DIRECT)
    names = {}
    for name, shape, _, _ in SHAPES:
        names[solid(client, mass=1.0, place=PLACE, turn=TURN, **shape)] = name
    names[solid(client, pybullet.GEOM_PLANE, 0.0)] = "floor"
    with ssduck.Interpreter() as ss:
        ss.add_variable("world", ssduck.World.attach(client, names=names))
        yield ss
    pybullet.disconnect(client)


def selected(name, form):
    return f"SELECT obj FROM world WHERE id(this) == '{name}' AS {form};"


@pytest.mark.parametrize(("name", "shape", "area", "off"), SHAPES, ids=[s[0] for s in SHAPES])
def test_points_lie_on_the_surface_spread_evenly(shapes, name, shape, area, off):
    cloud = shapes.eval(selected(name, "points(0.01)"))
    matrix = np.array(pybullet.getMatrixFromQuaternion(TURN)).reshape(3, 3)
    points, normals = (cloud.points - PLACE) @ matrix, cloud.normals @ matrix
    assert np.abs(off(points, normals)).max() < 1e-9
    assert len(cloud) == pytest.approx(area / 0.01**2, abs=1.0)
    assert np.linalg.norm(normals, axis=1) == pytest.approx(1.0)
    # A little way along the normal is outside, and against it inside.
    assert (off(points + 1e-4 * normals, normals) > 0).all()
    assert (off(points - 1e-4 * normals, normals) < 0).all()
    # Evenly: each half of it by a plane through the middle has half of the points, to 4 sigma.
    for axis in np.eye(3):
        upper = (points @ axis > 0).sum()
        assert abs(upper - len(cloud) / 2) < 4 * math.sqrt(len(cloud)) / 2


def test_the_caps_and_the_side_of_a_cylinder_get_their_shares(shapes):
    cloud = shapes.eval(selected("cylinder", "points(0.01)"))
    matrix = np.array(pybullet.getMatrixFromQuaternion(TURN)).reshape(3, 3)
    upright = np.abs((cloud.normals @ matrix)[:, 2]) > 0.5
    share = 0.2 / (0.2 + 0.7)
    assert abs(upright.mean() - share) < 4 * math.sqrt(share * (1 - share) / len(cloud))


def test_the_same_seed_gives_the_same_points(shapes):
    first, again, other = (
        shapes.eval(selected("box", f"points(0.05, seed={seed})")).points for seed in (1, 1, 2)
    )
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


def test_whose_points_they_are(shapes, tmp_path):
    query = "SELECT obj FROM world WHERE id(this) != 'floor' AS points(0.05);"
    cloud = shapes.eval(query)
    assert cloud.names == tuple(name for name, *_ in SHAPES)
    assert sum(len(cloud.of(name)) for name in cloud.names) == len(cloud)
    assert np.asarray(cloud).shape == (len(cloud), 3)
    assert repr(cloud) == f"<PointCloud: {len(cloud):,} points of 4 entities>"
    loaded = trimesh.load(cloud.save(tmp_path / "cloud.ply"))
    assert loaded.vertices == pytest.approx(cloud.points, abs=1e-6)
    with pytest.raises(ArgumentError, match="no points of 'boks'"):
        cloud.of("boks")
    with pytest.raises(ArgumentError, match=r"cloud\.nothing"):
        cloud.save(tmp_path / "cloud.nothing")


def test_nothing_selected_has_no_points(shapes):
    for form in ("points", "mesh"):
        found = shapes.eval(f"SELECT obj FROM world WHERE False AS {form};")
        assert len(found.points if form == "points" else found.geometry) == 0


BAD = [
    ("floor", "points", "a plane is infinite"),
    ("floor", "mesh", "'floor' has a plane, which is infinite"),
    ("box", "points(0)", "spacing is above 0 m, not 0"),
    ("box", "points('near')", "spacing is a number, not 'near'"),
    ("box", "points(0.02, -1)", "seed is a whole number from 0"),
    ("box", "points(0.0001)", "208,000,000 points are more than 20,000,000"),
    ("box", "points(1e-200)", "points are more than 20,000,000"),
    ("box", "glb('no/such/folder/box.glb')", "No such file"),
    ("box", "glb(3)", "the file must be a path in quotes, not 3"),
    ("nobody", "glb('x.glb')", "no selected entity has shapes"),
    ("box", "image(0)", "width is a whole number from 1 to 8192, not 0"),
    ("box", "image(10, 2.5)", "height is a whole number"),
]


@pytest.mark.parametrize(("name", "form", "message"), BAD)
def test_errors(shapes, name, form, message):
    with pytest.raises(ArgumentError, match=message):
        shapes.eval(selected(name, form))


def test_a_mesh_is_where_the_body_is(shapes):
    world = shapes.call_variable("world")
    scene = shapes.eval("SELECT obj FROM world WHERE id(this) != 'floor' AS mesh;")
    assert set(scene.geometry) == {f"{name}/0" for name, *_ in SHAPES}
    for name, _, area, _ in SHAPES:
        (own,) = shapes.eval(selected(name, "mesh")).dump()
        assert own.is_watertight
        assert own.area == pytest.approx(area, rel=0.01)
        low, high = world[name].aabb
        # A round shape's facets are a little inside.
        assert own.bounds == pytest.approx(np.array([low, high]), abs=0.003)
        assert own.metadata["entity"] == name
    (box,) = shapes.eval(selected("box", "mesh")).dump()
    assert box.volume == pytest.approx(0.4 * 0.6 * 0.8, rel=1e-9)


def test_a_glb_stands_upright(shapes, tmp_path):
    path = tmp_path / "box.glb"
    assert shapes.eval(selected("box", f"glb('{path}')")) == str(path)
    loaded = trimesh.load(path)
    (low, high) = np.array(shapes.call_variable("world")["box"].aabb)
    # y of the file is up: x, z, -y
    assert loaded.bounds[0] == pytest.approx([low[0], low[2], -high[1]], abs=1e-6)
    assert loaded.bounds[1] == pytest.approx([high[0], high[2], -low[1]], abs=1e-6)


def test_a_glb_that_cannot_be_written_leaves_what_was_there(shapes, tmp_path):
    path = tmp_path / "kept.glb"
    path.write_text("kept")
    for query in (
        f"SELECT obj FROM world GROUP BY id AS glb('{path}');",
        f"SELECT obj FROM world AS glb('{path}');",  # a plane
        selected("box", f"glb('{tmp_path}')"),
    ):
        with pytest.raises(ArgumentError):
            shapes.eval(query)
    assert path.read_text() == "kept"
    assert list(tmp_path.iterdir()) == [path]


# -- pictures ------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    ("limits", "most"),
    [
        ({"seconds": 2.0}, 2_000_000),
        ({"memory": 128_000_000}, 1_000_000),
        ({"seconds": 2.0, "memory": 10**9}, 2_000_000),
    ],
)
def test_pictures_beyond_the_limits_are_refused_before_they_are_rendered(limits, most, monkeypatch):
    rendered = []
    monkeypatch.setattr(
        spatial, "highlighted", lambda _world, _entities, *size: rendered.append(size)
    )
    with ssduck.load("hall", limits=ssduck.Limits(**limits), recording=None) as ss:
        with pytest.raises(LimitError, match=f"1001 x {most // 1000} pixels .* {most:,}, which"):
            ss.eval(f"SELECT obj FROM hall AS image(1001, {most // 1000});")
        assert not rendered
        ss.eval(f"SELECT obj FROM hall AS image(1000, {most // 1000});")
    assert rendered == [(1000, most // 1000)]


ROBOTS = "SELECT obj FROM {} WHERE isRobot(this) AS image(240, 180);"


def outlined(picture):
    return (np.asarray(picture) == OUTLINE).all(axis=2)


@pytest.mark.parametrize(("name", "seen"), [("fridge", 1200), ("cooker", 400)])
def test_the_units_of_the_two_cameras_are_seen_as_theirs(ss, name, seen):
    """Though they collide as parts of the kitchen, and the cameras are 1 cm."""
    world = ss.call_variable("kitchen")
    assert (world.segmentation(240, 180) == world[name].id).sum() > seen
    low, high = map(np.array, world[name].aabb)
    assert high - low == pytest.approx([0.01] * 3)


@pytest.mark.slow
def test_a_picture_shows_what_is_selected(ss):
    world = ss.call_variable("kitchen")
    picture = ss.eval(ROBOTS.format("kitchen"))
    assert picture.size == (240, 180)
    shown = world.segmentation(240, 180)
    robots = np.isin(shown, [e.id for e in world if e.kind == "robot"])
    assert robots.sum() > 200
    plain = world.render(240, 180)
    assert np.array_equal(np.asarray(picture)[robots], plain[robots])
    faded = ~robots & ~outlined(picture)
    assert np.asarray(picture)[faded].min() > 125  # half way to white
    # grey: red, green and blue are equal
    assert np.ptp(np.asarray(picture)[faded].astype(int), axis=1).max() == 0
    assert outlined(picture).any()


@pytest.mark.slow
def test_what_is_no_longer_there_is_in_no_form_of_space(shapes):
    twin = shapes.call_variable("world").excerpt(["box"])
    with ssduck.Interpreter() as ss:
        ss.add_variable("twin", twin)
        ss.add_variable("box", twin["box"])
        twin.remove("box")
        for form in ("points", "mesh", "image(64, 48)"):
            with pytest.raises(
                ssduck.SelectScriptError, match=f"AS {form[:4]}.*'box' is no longer"
            ):
                ss.eval(f"SELECT to(box, 'gone') FROM [1] AS {form};")
    twin.close()


@pytest.fixture(scope="module")
def row():
    """A base and two links side by side, with y to the right of the picture, and a ball above."""
    client = pybullet.connect(pybullet.DIRECT)
    box = pybullet.createCollisionShape(
        pybullet.GEOM_BOX, halfExtents=[0.2] * 3, physicsClientId=client
    )
    three = create_linked_body(
        client, 0, box, basePosition=[0, -1, 0], linkPositions=[[0, 1, 0], [0, 1, 0]]
    )
    above = solid(client, pybullet.GEOM_SPHERE, 0, [0, 0, 1], radius=0.2)
    with ssduck.Interpreter(recording=None) as ss:
        world = ssduck.World.attach(client, names={three: "three", above: "ball"})
        world.camera = Camera(eye=(4.0, 0.0, 0.0), target=(0.0, 0.0, 0.0), fov=50.0)
        ss.add_variable("row", world)
        yield ss
    pybullet.disconnect(client)


def test_segmentation_by_links(row):
    """Each link is where it is: from left to right."""
    world = row.call_variable("row")
    segments = world.segmentation(80, 60, links=True)
    ids = [id for (id,) in row.sql("SELECT id FROM links ORDER BY entity, link")]
    middles = [np.argwhere(segments == id)[:, 1].mean() for id in ids]
    focal = 30 / math.tan(math.radians(25))
    near = [39.5 + focal * y / 4 for y in (-1, 0, 1, 0)]
    assert middles == pytest.approx(near, abs=2.0)
    assert set(np.unique(segments).tolist()) == {0, *ids}
    assert np.array_equal(segments % LINK_FACTOR, world.segmentation(80, 60))


# Rows in which links stand, and the columns of the picture that stand out.
NAMED_LINKS = {
    "SELECT obj FROM links(row) WHERE name = 'link1' AS image(80, 60);": [0.0],
    "SELECT name FROM links(row) WHERE y > 0.5 AS image(80, 60);": [1.0],
    "SELECT id(this) FROM links(row) WHERE y > -0.5 AND z < 0.5 AS image(80, 60);": [0.0, 1.0],
    "SELECT id(this) FROM row WHERE id(this) == 'three' AS image(80, 60);": [-1.0, 0.0, 1.0],
    "SELECT ['three.link2', 3] FROM [1], row LIMIT 1 AS image(80, 60);": [1.0],
}


@pytest.mark.parametrize("program", NAMED_LINKS)
def test_links_and_names_stand_out_in_pictures(row, program):
    picture = np.asarray(row.eval(program))
    focal = 30 / math.tan(math.radians(25))
    at = [round(39.5 + focal * y / 4) for y in (-1.0, 0.0, 1.0)]
    is_marked = [bool((picture[:, x - 7 : x + 8] == OUTLINE).all(axis=2).any()) for x in at]
    assert is_marked == [y in NAMED_LINKS[program] for y in (-1.0, 0.0, 1.0)]


def test_names_are_those_of_entities_then_full_ones_then_of_links(row):
    world = row.call_variable("row")
    three, ball = world["three"].id, world["ball"].id
    marks = Marks(world)
    assert marks.of(["three", 1.5, None]) == [(three, -1)]
    assert marks.of(["three.link1"]) == [(three, 1)]
    assert marks.of([["link2", {"a": "ball"}]]) == [(three, 2), (ball, -1)]
    assert marks.of(["nothing"]) == []


def test_a_link_name_that_entities_share_stands_out_in_none(row):
    world = row.call_variable("row")
    ball = world["ball"].id
    marks = Marks(world)
    told = "'link0' is a link of three, ball, and stands out in none: .* as in 'three.link0'"
    with pytest.warns(ProgramWarning, match=told) as caught:
        assert marks.of(["link0"]) == []
    assert len(caught) == 1
    assert marks.of(["ball", "link0"]) == [(ball, -1), (ball, 0)]
    assert marks.of(["ball.link0"]) == [(ball, 0)]


def test_a_picture_of_no_entity_says_what_to_select(row):
    with pytest.raises(ArgumentError, match="no column holds an entity, a link, or the name of"):
        row.eval("SELECT z FROM row AS image(80, 60);")


@pytest.mark.slow
def test_a_sensor_is_shown_by_its_body(ss):
    laser = (
        "SELECT obj FROM kitchen WHERE id(this) == 'barrett_4918_laser_scaner' AS image(160, 120);"
    )
    body = "SELECT obj FROM kitchen WHERE id(this) == 'barrett_4918' AS image(160, 120);"
    assert np.array_equal(np.asarray(ss.eval(laser)), np.asarray(ss.eval(body)))


@pytest.mark.slow
def test_a_picture_of_a_recorded_tick():
    with ssduck.load("kitchen") as ss:
        world = ss.call_variable("kitchen")
        before = np.asarray(ss.eval(ROBOTS.format("kitchen")))
        world["roomba_625x"].move([1.0, -1.0, 0.17])
        world.step(3)
        now = np.asarray(ss.eval(ROBOTS.format("kitchen")))
        assert not np.array_equal(before, now)
        past = np.asarray(ss.eval(ROBOTS.format("kitchen{0.0}")))
        assert (np.abs(past.astype(int) - before).max(axis=2) > 8).mean() < 0.01


@pytest.mark.slow
def test_a_picture_of_a_record_is_that_of_the_simulation(tmp_path):
    query = "SELECT obj FROM kitchen WHERE id == 'fridge' AS image(320, 240);"
    with ssduck.load("kitchen") as ss:
        expected = np.asarray(ss.eval(query).convert("RGB"), int)
        ss.export(tmp_path / "run")
    with ssduck.open(tmp_path / "run") as record:
        found = np.asarray(record.eval(query).convert("RGB"), int)
    assert np.mean(np.abs(found - expected) > 8) < 0.01


@pytest.mark.slow
def test_a_record_of_mujoco_is_drawn_with_joints_that_pybullet_has_not(tmp_path):
    mujoco = pytest.importorskip("mujoco")
    model = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><geom type='plane' size='2 2 1'/><body name='ball' pos='0 0 .5'>"
        "<freejoint/><geom size='.2' rgba='1 0 0 1'/></body><body name='door' pos='1 0 .5'>"
        "<joint axis='0 0 1' pos='.3 0 0'/><joint type='slide' axis='1 0 0'/>"
        "<geom type='box' size='.3 .05 .4' rgba='0 0 1 1'/></body></worldbody></mujoco>"
    )
    with ssduck.Interpreter() as ss:
        ss.add_variable("sim", ssduck.World.attach(model, mujoco.MjData(model)))
        ss.export(tmp_path / "run")
    with ssduck.open(tmp_path / "run") as record:
        picture = record.eval("SELECT obj FROM sim AS image(320, 240);")
    pixels = np.asarray(picture.convert("RGB"), int)
    for colour in (0, 2):  # the ball is red, the door blue
        others = np.delete(pixels, colour, axis=2).max(axis=2)
        assert 200 < (pixels[:, :, colour] > others + 60).sum() < 20_000
