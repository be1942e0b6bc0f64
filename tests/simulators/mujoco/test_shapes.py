"""The shapes of MuJoCo's geoms, compared with its rays and contacts."""

import numpy as np
import pytest
import trimesh

import ssduck
from ssduck.geometry.shapes import Geometry
from tests.support.mjcf import simulated
from tests.support.warned import heard

mujoco = pytest.importorskip("mujoco")

FIELD = """<mujoco><asset><hfield name="hills" nrow="4" ncol="6" size="1.5 0.8 0.5 0.2"/></asset>
<worldbody><body name="land" pos=".3 -.2 .1" euler="10 20 30"><geom type="hfield" hfield="hills"/></body>
<body name="ball" pos="0 0 1"><freejoint/><geom size=".05" margin="0.5"/></body></worldbody></mujoco>"""


@pytest.fixture(scope="module")
def hills():
    model, data = simulated(FIELD)
    model.hfield_data[:] = np.random.default_rng(2).uniform(0, 1, 24)
    return ssduck.World.attach(model, data), model, data


def surface(world):
    """The triangles of the field, in the world."""
    (info,) = [info for info in world.snapshot.entities if info.name == "land"]
    (shape,) = info.body.shapes
    assert shape.exact
    frame = world.simulator.data.body("land")
    vertices = shape.geometry.vertices @ frame.xmat.reshape(3, 3).T + frame.xpos
    return vertices[shape.geometry.faces]


def first_hit(triangles, start, direction):
    """The distance to the first triangle that a ray meets, by Moeller and Trumbore."""
    a, one, other = (
        triangles[:, 0],
        triangles[:, 1] - triangles[:, 0],
        triangles[:, 2] - triangles[:, 0],
    )
    across = np.cross(direction, other)
    scale = np.einsum("ij,ij->i", one, across)
    offset = start - a
    u = np.einsum("ij,ij->i", offset, across) / scale
    lifted = np.cross(offset, one)
    v = lifted @ direction / scale
    distance = np.einsum("ij,ij->i", other, lifted) / scale
    hits = distance[(u >= 0) & (v >= 0) & (u + v <= 1) & (distance > 0)]
    return hits.min(initial=np.inf)


def test_a_height_field_is_where_rays_meet_it(hills):
    """From all sides: the surface, the walls and the bottom."""
    world, model, data = hills
    triangles, rng, met = surface(world), np.random.default_rng(0), 0
    centre, geom = data.body("land").xpos, np.zeros(1, np.int32)
    # Versions of MuJoCo differ in whether rays also return the normals of what they hit.
    normal = (None,) if "normal:" in mujoco.mj_ray.__doc__ else ()
    for _ in range(400):
        start = rng.normal(size=3)
        start = centre + 4 * start / np.linalg.norm(start)
        direction = centre + rng.uniform(-0.9, 0.9, 3) - start
        direction /= np.linalg.norm(direction)
        found = mujoco.mj_ray(
            model, data, start, direction, None, 1, model.body("ball").id, geom, *normal
        )
        expected = first_hit(triangles, start, direction)
        assert found == pytest.approx(expected if np.isfinite(expected) else -1, abs=1e-6)
        met += np.isfinite(expected)
    assert 100 < met < 400


def test_a_height_field_is_a_closed_solid(hills):
    world, _, _ = hills
    triangles = surface(world)
    enclosed = (
        np.einsum("ij,ij->i", triangles[:, 0], np.cross(triangles[:, 1], triangles[:, 2])).sum() / 6
    )
    with ssduck.Interpreter(recording=None) as ss:
        ss.add_variable("w", world)
        assert ss.eval("solidVolume(w.land);") == pytest.approx(enclosed)
    assert enclosed > 3.0 * 1.6 * 0.2  # more than the part below 0


@pytest.mark.slow
def test_the_clearance_of_a_height_field_is_that_of_contacts(hills):
    """MuJoCo's contacts begin at the margin; the nearest prism gives the distance."""
    world, model, data = hills
    rng, compared = np.random.default_rng(1), 0
    for _ in range(40):
        data.qpos[:3] = data.body("land").xpos + rng.uniform((-1, -0.6, 0.3), (1, 0.6, 0.9))
        mujoco.mj_forward(model, data)
        world.tick()
        if not data.ncon or data.contact.dist.min() < 1e-3:
            continue
        with ssduck.Interpreter(recording=None) as ss:
            ss.add_variable("w", world)
            found = ss.eval("clearance(w.land, w.ball);")
        compared += 1
        assert found == pytest.approx(data.contact.dist.min(), abs=1e-5)
    assert compared > 10


EGGS = """<mujoco><worldbody>
<geom name="floor" type="plane" size="0 0 1"/>
{bodies}
<body name="nest" pos="0.1 0.2 0.3"><site name="inside" type="ellipsoid" size=".3 .2 .1"/>
  <geom type="box" size=".4 .4 .01" pos="0 0 -.2"/></body></worldbody></mujoco>"""
SIZES = {"ellipsoid": 3, "box": 3, "sphere": 1, "capsule": 2, "cylinder": 2}


@pytest.fixture(scope="module")
def eggs():
    """Ellipsoids among other shapes, which overlap in places."""
    rng = np.random.default_rng(4)

    def numbers(values):
        return " ".join(repr(float(value)) for value in values)

    bodies = "".join(
        f'<body name="{kind}_{n}" pos="{numbers(rng.uniform((-0.5, -0.5, 0.3), (0.5, 0.5, 1.0)))}" '
        f'quat="{numbers(rng.normal(size=4))}"><freejoint/>'
        f'<geom type="{kind}" size="{numbers(rng.uniform(0.05, 0.3, SIZES[kind]))}"/></body>'
        for n, kind in enumerate(["ellipsoid"] * 5 + list(SIZES))
    )
    model, data = simulated(EGGS.format(bodies=bodies))
    with ssduck.Interpreter(recording=None) as ss:
        ss.add_variable("w", ssduck.World.attach(model, data, names={0: "floor"}))
        yield ss, model, data


@pytest.mark.slow
def test_ellipsoids_are_ellipsoids(eggs):
    ss, model, _ = eggs
    found = ss.eval("SELECT id, solidVolume(this) AS volume FROM w WHERE isEllipsoid(this);")
    assert len(found) == 6
    for row in found:
        size = model.geom(model.body(row["id"]).geomadr[0]).size
        assert row["volume"] == pytest.approx(4 / 3 * np.pi * size.prod())
    assert not ss.sql("SELECT * FROM w.shapes WHERE NOT exact").fetchall()


def test_boxes_of_ellipsoids_are_exact(eggs):
    """The greatest coordinate along an axis, by many points of the surface."""
    ss, model, data = eggs
    rng = np.random.default_rng(0)
    ball = rng.normal(size=(50_000, 3))
    ball /= np.linalg.norm(ball, axis=1)[:, None]
    for name in ss.eval("SELECT id FROM w WHERE isEllipsoid(this) AS list;"):
        body = data.body(name)
        size = model.geom(model.body(name).geomadr[0]).size
        points = ball * size @ body.xmat.reshape(3, 3).T + body.xpos
        box = np.array(ss["w"][name].aabb)
        for found, of_points, sign in (
            (box[0], points.min(axis=0), -1),
            (box[1], points.max(axis=0), 1),
        ):
            room = sign * (found - of_points)
            assert (room >= 0).all()
            assert (room < 3e-4).all()


@pytest.mark.slow
def test_the_clearance_of_ellipsoids_is_the_distance_that_mujoco_computes(eggs):
    """Of separate shapes, to MuJoCo's tolerance; of overlapping ones MuJoCo's depth is greater."""
    ss, model, data = eggs
    rows = ss.eval(
        "SELECT id(a) AS a, id(b) AS b, clearance(a, b) AS c, penetration(a, b) AS p "
        "FROM a=w, b=w WHERE isEllipsoid(a) AND id(a) != id(b) AND id(b) != 'nest' AND NOT isPlane(b);"
    )
    apart = 0
    for row in rows:
        geoms = [int(model.body_geomadr[model.body(row[side]).id]) for side in "ab"]
        expected = mujoco.mj_geomDistance(model, data, *geoms, 10.0, None)
        if expected > 1e-3:
            apart += 1
            assert row["c"] == pytest.approx(expected, abs=5e-5), row
        elif expected < -1e-3:
            assert 0.0 < row["p"] <= -expected + 1e-4, row
    assert apart > 20
    assert len(rows) - apart > 3


@pytest.mark.slow
@pytest.mark.parametrize(
    ("lift", "aside", "expected"),
    [
        (0.0, 0.0, True),
        (9e-4, 0.0, True),
        (1.1e-3, 0.0, False),
        (0.0, 0.35, True),
        (0.0, 0.51, False),
    ],
)
def test_an_egg_lies_on_a_table(lift, aside, expected):
    """Turned in any way, it reaches down by the root of n C n, with C of its half lengths."""
    rng, size = np.random.default_rng(8), np.array([0.05, 0.08, 0.12])
    model, data = simulated(
        '<mujoco><worldbody><body name="table"><geom type="box" size=".5 .5 .1"/></body>'
        '<body name="egg"><freejoint/><geom type="ellipsoid" size=".05 .08 .12"/></body>'
        "</worldbody></mujoco>"
    )
    with ssduck.Interpreter(recording=None) as ss:
        world = ss.add_variable("w", ssduck.World.attach(model, data, forward=True))
        for _ in range(10):
            turn = rng.normal(size=4)
            data.qpos[3:] = turn / np.linalg.norm(turn)
            mujoco.mj_forward(model, data)
            axes = data.body("egg").xmat.reshape(3, 3) * size
            data.qpos[:3] = aside, 0.0, 0.1 + np.linalg.norm(axes[2]) + lift
            world.tick()
            assert ss.eval("on(w.table, w.egg);") is expected
            assert ss.eval("SELECT id FROM w WHERE on(w.table, this) AS list;") == (
                ["egg"] if expected else []
            )
            if not aside:
                assert ss.eval("clearance(w.table, w.egg);") == pytest.approx(lift, abs=1e-7)


def test_an_ellipsoid_is_a_region(eggs):
    """A site's region: points inside and outside, on each axis."""
    ss, _, _ = eggs
    assert ss.sql("SELECT region, region_x, region_z FROM w.sites").fetchall() == [
        ("ellipsoid", pytest.approx(0.3), pytest.approx(0.1))
    ]
    box = ss.eval("aabb(w.nest.inside);")
    assert np.subtract(box[1::2], box[::2]) == pytest.approx([0.6, 0.4, 0.2])


def test_points_of_an_ellipsoid_are_spread_evenly_on_it(eggs):
    """As many on each side of a plane as the triangles of a fine mesh have area there."""
    ss, model, data = eggs
    body, geom = data.body("ellipsoid_0"), model.geom(model.body("ellipsoid_0").geomadr[0])
    cloud = ss.eval("SELECT obj(this) FROM w WHERE id = 'ellipsoid_0' AS points(0.005);")
    points = (cloud.points - body.xpos) @ body.xmat.reshape(3, 3) / geom.size
    assert np.abs(np.linalg.norm(points, axis=1) - 1).max() < 1e-12
    normals = cloud.normals @ body.xmat.reshape(3, 3)
    gradients = points / geom.size
    gradients /= np.linalg.norm(gradients, axis=1)[:, None]
    assert np.abs(normals - gradients).max() < 1e-12
    mesh = trimesh.creation.icosphere(subdivisions=5)
    mesh.apply_scale(geom.size)
    assert len(points) * 0.005**2 == pytest.approx(mesh.area, rel=0.01)
    ends = np.abs(mesh.triangles_center / geom.size) > 0.7
    for axis in range(3):
        share = mesh.area_faces[ends[:, axis]].sum() / mesh.area
        found = (np.abs(points[:, axis]) > 0.7).mean()
        assert found == pytest.approx(share, abs=4 / np.sqrt(len(points)))


def test_signed_distance_fields_have_boxes_instead():
    """They need a plugin: a box that is called one is such a geom to ssduck."""
    model, data = simulated(
        '<mujoco><worldbody><body name="egg" pos="0 0 1"><geom type="box" size=".1 .2 .3"/>'
        "</body></worldbody></mujoco>"
    )
    model.geom_type[0] = int(mujoco.mjtGeom.mjGEOM_SDF)
    with pytest.warns(UserWarning, match="egg: bounding boxes are used instead"):
        world = ssduck.World.attach(model, data)
    low, high = world["egg"].aabb
    assert np.subtract(high, low) == pytest.approx([0.2, 0.4, 0.6])
    world.request_tables(["shapes"])
    assert world.snapshot.tables["shapes"].arrow["exact"].to_pylist() == [False]


@pytest.mark.slow
def test_a_recorded_ellipsoid_stays_one_and_pybullet_copies_a_hull(tmp_path):
    pytest.importorskip("pybullet")
    model, data = simulated(
        '<mujoco><worldbody><geom name="floor" type="plane" size="0 0 1"/><body name="egg" '
        'pos="0 0 1"><freejoint/><geom type="ellipsoid" size=".1 .2 .3"/></body></worldbody></mujoco>'
    )
    with ssduck.Interpreter(recording=None) as ss:
        ss.add_variable("w", ssduck.World.attach(model, data))
        ss.record_to(tmp_path / "record")
        ss["w"].step(5)
        box = np.array(ss["w"]["egg"].aabb)
    with ssduck.open(tmp_path / "record") as record:
        assert record.eval("SELECT id FROM w WHERE isEllipsoid(this) AS list;") == ["egg"]
        assert np.array_equal(record["w"]["egg"].aabb, box)
        copy, told = heard(lambda: record.eval("SELECT obj(this) FROM w AS environment;"))
        assert any("egg: PyBullet has no ellipsoids" in text for text in told)
        assert np.array(copy["egg"].aabb) == pytest.approx(box, abs=1e-3)
        copy.close()


def test_pictures_have_the_triangles_of_an_ellipsoid():
    """Of `ssduck render`: on the surface, lit by its normals, and all of it."""
    pytest.importorskip("moderngl")
    from ssduck.render.canvas import triangles

    size = np.array([0.1, 0.2, 0.3])
    corners = triangles(Geometry.primitive("ellipsoid", size))
    points, normals = corners[:, :3], corners[:, 3:]
    assert np.abs(np.linalg.norm(points / size, axis=1) - 1).max() < 1e-12
    gradients = points / size**2
    gradients /= np.linalg.norm(gradients, axis=1)[:, None]
    assert (gradients * normals).sum(axis=1).min() > 0.999
    a, b, c = points.reshape(-1, 3, 3).swapaxes(0, 1)
    volume = np.einsum("ij,ij->", a, np.cross(b, c)) / 6
    assert volume == pytest.approx(4 / 3 * np.pi * size.prod(), rel=0.01)
