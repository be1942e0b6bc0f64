"""The shapes of MuJoCo's geoms, compared with its rays and contacts."""

import numpy as np
import pytest

import ssduck

mujoco = pytest.importorskip("mujoco")

FIELD = """<mujoco><asset><hfield name="hills" nrow="4" ncol="6" size="1.5 0.8 0.5 0.2"/></asset>
<worldbody><body name="land" pos=".3 -.2 .1" euler="10 20 30"><geom type="hfield" hfield="hills"/></body>
<body name="ball" pos="0 0 1"><freejoint/><geom size=".05" margin="0.5"/></body></worldbody></mujoco>"""


@pytest.fixture(scope="module")
def hills():
    model = mujoco.MjModel.from_xml_string(FIELD)
    model.hfield_data[:] = np.random.default_rng(2).uniform(0, 1, 24)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
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


def test_ellipsoids_have_boxes_instead(recwarn):
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><body name="egg" pos="0 0 1"><geom type="ellipsoid" size=".1 .2 .3"/>'
        "</body></worldbody></mujoco>"
    )
    with pytest.warns(UserWarning, match="egg: bounding boxes are used instead"):
        world = ssduck.World.attach(model, mujoco.MjData(model))
    low, high = world["egg"].aabb
    assert np.subtract(high, low) == pytest.approx([0.2, 0.4, 0.6])
    world.request_tables(["shapes"])
    assert world.snapshot.tables["shapes"].arrow["exact"].to_pylist() == [False]
