"""Shapes that are what the simulator has, and marks where they are not."""

import warnings
from collections import Counter
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pybullet
import pybullet_data
import pytest
import trimesh
from scipy.spatial import ConvexHull

import ssduck
from ssduck.geometry.poses import rotation_matrices
from ssduck.geometry.shapes import height_field
from ssduck.recording.spec import Recording
from ssduck.schema import RECORDABLE
from tests.support.bodies import solid
from tests.support.cases import sampled
from tests.support.models import sdf_link, sdf_model, sdf_of

LIBRARY = Path(pybullet_data.getDataPath())
TETRA = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.123456789012345, 0.2, 1.0]]
SIDES = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]


def exact_key(client, **how):
    """An attached world, of which nothing is warned."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return ssduck.World.attach(client, **how)


def body_of(world, handle):
    return next(m.body for m in world.snapshot.entities if m.body and m.body.handle == handle)


def depth(geometry, point):
    """How far a point is outside a shape, less than 0 inside; an oracle by closed forms."""
    a, b, c = geometry.size
    x, y, z = point
    match geometry.type:
        case "sphere":
            return np.linalg.norm(point) - a
        case "capsule":
            return np.linalg.norm([x, y, z - np.clip(z, -b / 2, b / 2)]) - a
        case "plane":
            return float(np.dot(point, (a, b, c)))
        case "box":
            outside = np.abs(point) - np.array([a, b, c]) / 2
            return np.linalg.norm(np.maximum(outside, 0)) + min(outside.max(), 0)
        case "hull":
            return (ConvexHull(geometry.vertices).equations @ [x, y, z, 1.0]).max()
        case "cylinder":
            outside = np.array([np.hypot(x, y) - a, abs(z) - b / 2])
            return np.linalg.norm(np.maximum(outside, 0)) + min(outside.max(), 0)
    raise AssertionError(geometry.type)


def depths(world, handle, link, point):
    """That of each shape of a link at a point of the world."""
    body = body_of(world, handle)
    frames = world.simulator.read_link_poses((body,))
    local = frames.matrices[link].T @ (np.array(point) - frames.positions[link])
    return [
        depth(
            shape.geometry,
            rotation_matrices(shape.orientation[None])[0].T @ (local - shape.position),
        )
        for shape in body.shapes
        if shape.frame == link
    ]


# -- model files that have shapes which PyBullet does not tell ----------------------------------


MODELS = sorted(path.name for path in (LIBRARY / "mjcf").glob("*.xml"))
# What Bullet takes off all convex shapes: those that are thinner it casts rays at wrongly, and
# tells wrong distances of.
MARGIN = 0.04


@sampled("model", MODELS, every=3)
def test_shapes_of_mjcf_files_are_where_rays_meet_them(client, model):
    """PyBullet's own rays are the oracle: what they end on is a surface."""
    handles = pybullet.loadMJCF(str(LIBRARY / "mjcf" / model), physicsClientId=client)
    world = exact_key(client)
    assert all(shape.exact for handle in handles for shape in body_of(world, handle).shapes)
    rng = np.random.default_rng(len(model))
    starts, ends = [], []
    for handle in handles:
        for link in range(-1, pybullet.getNumJoints(handle, client)):
            # What collides with nothing is met by no ray.
            pybullet.setCollisionFilterGroupMask(handle, link, 1, -1, client)
            low, high = np.clip(pybullet.getAABB(handle, link, client), -2.0, 2.0)
            target = rng.uniform(low, high, (8, 3))
            aside = rng.normal(size=(8, 3)) + [0, 0, 0.5]
            starts += list(target + 3 * aside)
            ends += list(target - 3 * aside)
    hits = pybullet.rayTestBatch(starts, ends, physicsClientId=client)
    met = [(body, link + 1, point) for body, link, _, point, _ in hits if body >= 0]
    compared = 0
    for body, link, point in met:
        own = [s.geometry for s in body_of(world, body).shapes if s.frame == link]
        if any(g.type == "capsule" and g.size[0] < MARGIN for g in own):
            continue
        # Its edges are round for rays, and an MJCF file's cylinders are prisms.
        edges = any(g.type in ("box", "cylinder") for g in own)
        assert np.abs(depths(world, body, link, point)).min() < (6e-3 if edges else 1e-3)
        compared += 1
    assert compared >= 3


SDF_SHAPES = {
    "box": "<box><size>0.4 0.2 0.6</size></box>",
    "sphere": "<sphere><radius>0.3</radius></sphere>",
    "capsule": "<capsule><radius>0.1</radius><length>0.5</length></capsule>",
    "cylinder": "<cylinder><radius>0.2</radius><length>0.5</length></cylinder>",
    "plane": "<plane><normal>0 0 1</normal><size>3 3</size></plane>",
    "mesh": "<mesh><uri>wedge.obj</uri><scale>1 1 2</scale></mesh>",
}
WEDGE = "v 0 0 0\nv 0.5 0 0\nv 0 0.5 0\nv 0 0 0.5\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"


@pytest.mark.parametrize(
    "kinds",
    [
        *((kind,) for kind in SDF_SHAPES),
        ("box", "cylinder"),
        ("cylinder", "sphere", "cylinder"),
        ("mesh", "cylinder", "capsule"),
        ("mesh", "mesh", "box"),
    ],
)
def test_shapes_of_sdf_files_are_where_rays_meet_them(client, write, kinds):
    """On links whose centre of mass has a pose of its own; the second link hangs on the first."""
    write("wedge.obj", WEDGE)
    collisions = "".join(
        f'<collision name="c{n}"><pose>{1.5 * n} 0.1 0.2 0.3 0.2 0</pose>'
        f"<geometry>{SDF_SHAPES[kind]}</geometry></collision>"
        for n, kind in enumerate(kinds)
    )
    inertial = sdf_link(com="0.1 0.05 0.1 0.1 0.2 0").partition("<collision")[0]
    text = sdf_of(sdf_model("m", f"{inertial}{collisions}</link>", pose="0.2 0 1 0 0 0.5"))
    (handle,) = pybullet.loadSDF(str(write("m.sdf", text)), physicsClientId=client)
    world = exact_key(client)
    shapes = body_of(world, handle).shapes
    types = {"cylinder": "hull", "mesh": "hull"}  # PyBullet makes prisms of cylinders
    assert [s.geometry.type for s in shapes] == [types.get(kind, kind) for kind in kinds]
    assert all(shape.exact for shape in shapes)
    pybullet.performCollisionDetection(client)
    rng = np.random.default_rng(len(kinds))
    low, high = np.clip(pybullet.getAABB(handle, -1, client), -6.0, 6.0)
    target = rng.uniform(low, high, (400, 3))
    aside = rng.normal(size=(400, 3)) + [0, 0, 0.5]
    starts, ends = list(target + 9 * aside), list(target - 9 * aside)
    hits = pybullet.rayTestBatch(starts, ends, physicsClientId=client)
    met = [point for body, _, _, point, _ in hits if body >= 0]
    assert len(met) > 30
    gaps = np.array([np.abs(depths(world, handle, 0, point)).min() for point in met])
    assert gaps.max() < 6e-3  # edges are round for rays
    assert np.median(gaps) < 1.01e-3  # the margin of hulls


@pytest.mark.parametrize("model", MODELS)
def test_capsules_of_mjcf_files_are_as_they_are_written(client, model):
    """A second oracle, of thin ones, too: the file itself."""
    tree = ET.parse(LIBRARY / "mjcf" / model)  # noqa: S314  # a file of PyBullet's
    written = Counter()
    for geom in tree.iter("geom"):
        if geom.get("type") == "capsule" and geom.get("fromto") and geom.get("size"):
            ends = np.array(geom.get("fromto").split(), dtype=float).reshape(2, 3)
            radius = float(geom.get("size").split()[0])
            written[radius, round(float(np.linalg.norm(ends[1] - ends[0])), 6)] += 1
    pybullet.loadMJCF(str(LIBRARY / "mjcf" / model), physicsClientId=client)
    bodies = [member.body for member in exact_key(client).snapshot.entities]
    shapes = [shape.geometry for body in bodies for shape in body.shapes]
    found = Counter(
        (round(g.size[0], 6), round(g.size[1], 6)) for g in shapes if g.type == "capsule"
    )
    assert written <= found


def test_numbers_of_files_are_kept_as_they_are_written(client):
    """PyBullet saves single floats; 0.08 is not to become 0.07999999821186066."""
    pybullet.loadMJCF(str(LIBRARY / "mjcf" / "ant.xml"), physicsClientId=client)
    (body,) = [m.body for m in exact_key(client).snapshot.entities]
    leg = next(shape for shape in body.shapes if shape.frame == 1)
    assert leg.geometry.size == (0.08, pytest.approx(0.2 * 2**0.5, abs=1e-15), 0.0)
    assert leg.position == pytest.approx([0.1, 0.1, 0.0], abs=1e-8)


# -- what createCollisionShape makes -------------------------------------------------------------


def concave(client, scale=(1, 1, 1)):
    mesh = {"vertices": TETRA, "indices": np.ravel(SIDES).tolist(), "meshScale": scale}
    return solid(client, pybullet.GEOM_MESH, 0, [1, 2, 3], **mesh)


@pytest.mark.parametrize("scale", [(1, 1, 1), (0.5, 2, 3)])
def test_concave_meshes_are_read_to_the_last_digit(client, scale):
    handle = concave(client, scale)
    (shape,) = body_of(exact_key(client), handle).shapes
    assert (shape.geometry.type, shape.exact) == ("mesh", True)
    corners = {tuple(corner) for corner in shape.geometry.vertices.tolist()}
    assert corners == {tuple((np.array(corner) * scale).tolist()) for corner in TETRA}
    made = trimesh.Trimesh(shape.geometry.vertices, shape.geometry.faces, process=False)
    assert made.is_watertight  # corners are shared: it is solid
    assert abs(made.volume) == pytest.approx(np.prod(scale) / 6)


def rigid(client, kind, **how):
    shape = pybullet.createCollisionShape(kind, physicsClientId=client, **how)
    return pybullet.createMultiBody(1.0, shape, useMaximalCoordinates=True, physicsClientId=client)


@pytest.mark.parametrize(
    ("kind", "how", "expected"),
    [
        (pybullet.GEOM_BOX, {"halfExtents": [0.1, 0.2, 0.3]}, ("box", (0.2, 0.4, 0.6))),
        (pybullet.GEOM_BOX, {"halfExtents": [0.01, 0.2, 0.003]}, ("box", (0.02, 0.4, 0.006))),
        (pybullet.GEOM_SPHERE, {"radius": 0.15}, ("sphere", (0.15, 0, 0))),
        (pybullet.GEOM_CAPSULE, {"radius": 0.1, "height": 0.3}, ("capsule", (0.1, 0.3, 0))),
        (pybullet.GEOM_CYLINDER, {"radius": 0.1, "height": 0.3}, ("cylinder", (0.1, 0.3, 0))),
    ],
)
def test_rigid_bodies_are_read_too(client, kind, how, expected):
    handle, turn = rigid(client, kind, **how), [0.1, 0.7, 0.5, 0.5]
    pybullet.resetBasePositionAndOrientation(handle, [1, 2, 3], turn, client)
    pybullet.resetBaseVelocity(handle, [1, 2, 3], [4, 5, 6], client)
    world = exact_key(client)
    (entity,) = world
    assert entity.pose == pytest.approx([turn[3], *turn[:3], 1, 2, 3], abs=1e-6)
    assert entity.velocity == pytest.approx([1, 2, 3, 4, 5, 6])
    (shape,) = body_of(world, handle).shapes
    assert shape.geometry.type == expected[0]
    assert shape.geometry.size == pytest.approx(expected[1], abs=1e-7)


def test_what_is_drawn_otherwise_is_not_believed(client):
    """A link that is drawn as a capsule is not thereby one."""
    drawn = pybullet.createVisualShape(
        pybullet.GEOM_CAPSULE, radius=0.12, length=0.3, physicsClientId=client
    )
    solid = pybullet.createCollisionShape(
        pybullet.GEOM_CAPSULE, radius=0.1, height=0.3, physicsClientId=client
    )
    handle = pybullet.createMultiBody(1.0, solid, drawn, physicsClientId=client)
    (shape,) = body_of(exact_key(client), handle).shapes
    assert shape.geometry.size == pytest.approx((0.1, 0.3, 0.0), abs=1e-7)


def test_bodies_in_one_place_are_told_apart(client):
    """All at the origin, of one name, mass and number of links."""
    handles = [concave(client, (size, size, size)) for size in (1, 2, 3)]
    world = exact_key(client)
    heights = [body_of(world, h).shapes[0].geometry.vertices[:, 2].max() for h in handles]
    assert heights == [1.0, 2.0, 3.0]
    pybullet.removeBody(handles[0], client)
    later = concave(client, (4, 4, 4))
    world.tick()
    assert body_of(world, later).shapes[0].geometry.vertices[:, 2].max() == 4.0


def test_reading_changes_nothing(client):
    """Neither what PyBullet tells of contacts afterwards, nor how it goes on."""

    def run(attached):
        own = pybullet.connect(pybullet.DIRECT)
        pybullet.setGravity(0, 0, -9.8, own)
        pybullet.loadMJCF(str(LIBRARY / "mjcf" / "capsule_fromtoX.xml"), physicsClientId=own)
        concave(own)
        rigid(own, pybullet.GEOM_SPHERE, radius=0.2)
        world = exact_key(own) if attached else None
        for _ in range(60):
            pybullet.stepSimulation(own)
        found = []
        for index in range(pybullet.getNumBodies(own)):
            handle = pybullet.getBodyUniqueId(index, own)
            found.append(pybullet.getBasePositionAndOrientation(handle, own))
            for link in range(-1, pybullet.getNumJoints(handle, own)):
                found += [pybullet.getDynamicsInfo(handle, link, own)[1]]
        del world
        pybullet.disconnect(own)
        return found

    assert run(attached=True) == run(attached=False)


# -- shapes that the caller gives -----------------------------------------------------------------

HEIGHTS = (np.random.default_rng(3).random(20) * 0.6).tolist()
SCALE = [0.5, 0.4, 1.3]


def field(client, orientation=(0, 0, 0, 1)):
    return solid(
        client,
        pybullet.GEOM_HEIGHTFIELD,
        0,
        [1, 2, 3],
        orientation,
        meshScale=SCALE,
        heightfieldData=HEIGHTS,
        numHeightfieldRows=5,
        numHeightfieldColumns=4,
    )


def test_a_height_field_is_where_rays_meet_it(client):
    turn = pybullet.getQuaternionFromEuler([0.3, 0.2, 0.1])
    handle = field(client, turn)
    world = exact_key(client, shapes={handle: height_field(HEIGHTS, 5, 4, SCALE)})
    (shape,) = body_of(world, handle).shapes
    matrix = np.array(pybullet.getMatrixFromQuaternion(turn)).reshape(3, 3)
    corners = (shape.geometry.vertices @ matrix.T + [1, 2, 3])[shape.geometry.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    rng = np.random.default_rng(4)
    places = np.column_stack((rng.uniform(0.2, 1.8, 200), rng.uniform(1.6, 2.4, 200)))
    starts, ends = (np.column_stack((places, np.full(200, z))).tolist() for z in (9.0, -3.0))
    hits = pybullet.rayTestBatch(starts, ends, physicsClientId=client)
    met = np.array([point for body, _, _, point, _ in hits if body == handle])
    assert len(met) > 150
    # Each is in the plane of a triangle, and in that triangle.
    offsets = np.einsum("nti,ti->nt", met[:, None] - corners[None, :, 0], normals)
    edges = np.roll(corners, -1, axis=1) - corners
    inward = np.cross(normals[:, None], edges)
    sides = np.einsum("ntei,tei->nte", met[:, None, None] - corners[None], inward)
    on = (np.abs(offsets) < 1e-9) & (sides.min(axis=2) > -1e-9)
    assert on.any(axis=1).all()


@pytest.mark.parametrize(
    ("heights", "rows", "columns", "scale", "told"),
    [
        (HEIGHTS, 4, 4, SCALE, "heights are to be 4 times 4"),
        ([*HEIGHTS[:-1], float("nan")], 5, 4, SCALE, "finite"),
        (["x"] * 20, 5, 4, SCALE, "finite"),
        ([0.0, 1.0], 1, 2, SCALE, "2 rows"),
        (HEIGHTS, 5, 4, [1, 2], "scale is to be three"),
    ],
)
def test_height_fields_that_cannot_be(heights, rows, columns, scale, told):
    with pytest.raises(ssduck.SelectScriptError, match=told):
        ssduck.height_field(heights, rows, columns, scale)


def given_forms(tmp_path):
    mesh = trimesh.Trimesh(TETRA, SIDES, process=False)
    file = tmp_path / "tetra.obj"
    file.write_text(mesh.export(file_type="obj", digits=17))
    return {
        "trimesh": (mesh, "mesh"),
        "pair": ((TETRA, SIDES), "mesh"),
        "list": ([TETRA, SIDES], "mesh"),
        "arrays": ((np.array(TETRA), np.array(SIDES, dtype=np.uint8)), "mesh"),
        "hull": ((TETRA, None), "hull"),
        "path": (file, "mesh"),
        "text": (str(file), "mesh"),
        "several": ([(TETRA, SIDES), mesh, (TETRA, None)], "mesh"),
    }


@pytest.mark.parametrize(
    "form", ["trimesh", "pair", "list", "arrays", "hull", "path", "text", "several"]
)
@pytest.mark.parametrize("key", [0, (0, -1), np.int64(0)])
def test_a_caller_may_give_the_shapes(client, tmp_path, form, key):
    handle = field(client)
    assert handle == 0
    value, kind = given_forms(tmp_path)[form]
    world = exact_key(client, shapes={key: value})
    shapes = body_of(world, handle).shapes
    assert [s.exact for s in shapes] == [True] * (3 if form == "several" else 1)
    assert shapes[0].geometry.type == kind
    assert np.sort(shapes[0].geometry.vertices, axis=0) == pytest.approx(np.sort(TETRA, axis=0))
    low, high = shapes[0].geometry.vertices.min(axis=0), shapes[0].geometry.vertices.max(axis=0)
    box = world["body_0"].aabb
    assert np.array(box) == pytest.approx(np.array([low, high]) + [1, 2, 3])


def test_one_of_several_shapes_may_be_given(client):
    shape = pybullet.createCollisionShapeArray(
        [pybullet.GEOM_BOX, pybullet.GEOM_SPHERE],
        halfExtents=[[1, 1, 1], [0, 0, 0]],
        radii=[0, 0.5],
        physicsClientId=client,
    )
    pybullet.createMultiBody(1.0, shape, physicsClientId=client)
    world = exact_key(client, shapes={(0, -1, 1): (TETRA, SIDES)})
    assert [s.geometry.type for s in body_of(world, 0).shapes] == ["box", "mesh"]
    with pytest.raises(ssduck.SelectScriptError, match="has no shape 2: it has 2 shapes, from 0"):
        ssduck.World.attach(client, shapes={(0, -1, 2): (TETRA, SIDES)})


def test_what_was_said_of_a_body_is_not_said_of_the_next_one(client):
    field(client)
    world = exact_key(client, shapes={0: (TETRA, SIDES)})
    pybullet.removeBody(0, client)
    world.tick()
    field(client)
    with pytest.warns(UserWarning, match="PyBullet does not give back all shapes"):
        world.tick()


@pytest.mark.parametrize(
    ("key", "value", "told"),
    [
        (7, (TETRA, SIDES), "PyBullet has no body 7; its bodies: 0"),
        ((0, 3), (TETRA, SIDES), r"body 0 has no link 3; its links: -1 \(the base\) to -1"),
        ((0, -2), (TETRA, SIDES), "no link -2"),
        ((0, -1, -1), (TETRA, SIDES), "no shape -1"),
        ((0, -1, 4), (TETRA, SIDES), "no shape 4"),
        ("table", (TETRA, SIDES), "is no key"),
        (True, (TETRA, SIDES), "is no key"),
        (1.0, (TETRA, SIDES), "is no key"),
        ((), (TETRA, SIDES), "is no key"),
        ((0, -1, 0, 0), (TETRA, SIDES), "is no key"),
        (0, None, "no mesh"),
        (0, [], "no mesh"),
        (0, 3.5, "no mesh"),
        (0, (TETRA,), "no mesh"),
        (0, ([[0, 0]], SIDES), r"vertices must be numbers \(n, 3\)"),
        (0, ([["a", 0, 0]] * 3, SIDES), "vertices must be"),
        (0, (TETRA[:2], SIDES), "at least three"),
        (0, ([*TETRA[:3], [0, 0, float("inf")]], SIDES), "vertex 3 is not finite"),
        (0, (TETRA, [[0, 1]]), "faces must be"),
        (0, (TETRA, []), "faces must be"),
        (0, (TETRA, [[0, 1, 4]]), "face 0 is .*; the vertices have the numbers 0 to 3"),
        (0, (TETRA, [[0, 1, 2], [0, 1, -1]]), "face 1 is"),
        (0, (TETRA, [[0, 1, 1.5]]), "face 0 is"),
        (0, (TETRA, [[0, 1, float("nan")]]), "face 0 is"),
        (0, "no such file.obj", "cannot be read"),
    ],
)
def test_shapes_that_cannot_be(client, key, value, told):
    field(client)
    with pytest.raises(ssduck.SelectScriptError, match=told):
        ssduck.World.attach(client, shapes={key: value})


def test_two_keys_for_one_link(client):
    field(client)
    with pytest.raises(ssduck.SelectScriptError, match="another key"):
        ssduck.World.attach(client, shapes={0: (TETRA, SIDES), (0, -1): (TETRA, SIDES)})


# -- the mark of what is not exact ------------------------------------------------------------------


@pytest.fixture
def marked(client):
    """An interpreter with a world of a box and a height field, for which a box stands in."""
    solid(client, pybullet.GEOM_BOX, 1.0, [0, 0, 9], halfExtents=[0.1] * 3)
    ramp = field(client)
    with pytest.warns(UserWarning, match="ramp: .*exact = false in the table of shapes"):
        world = ssduck.World.attach(client, names={0: "cube", ramp: "ramp"})
    with ssduck.Interpreter() as ss:
        ss.add_variable("sim", world)
        yield ss


MARKS = (
    "SELECT DISTINCT e.name, s.exact FROM {0}.shapes{1} s "
    "JOIN {0}.entities e ON e.id = s.entity ORDER BY ALL"
)


def test_the_mark_is_a_column(marked):
    expected = [("cube", True), ("ramp", False)]
    assert marked.sql(MARKS.format("sim", "")).fetchall() == expected
    marked.add_variable("other", marked.call_variable("sim").what_if({}))
    assert marked.sql(MARKS.format("other", "")).fetchall() == expected


@pytest.mark.slow
@sampled("changed", [False, True], every=2)
@sampled("kind", ["folder", "file"], every=2)
def test_records_keep_the_mark(marked, tmp_path, kind, changed):
    expected = [("cube", True), ("ramp", False)]
    world = marked.call_variable("sim")
    path = tmp_path / ("run" if kind == "folder" else "run.duckdb")
    with ssduck.Interpreter(":memory:" if kind == "folder" else path, recording=None) as ss:
        ss.add_variable("sim", world)
        ss.record("sim", Recording(tables=RECORDABLE, changed=changed))
        world.step(3)
        assert ss.sql(MARKS.format("sim", "_history")).fetchall() == expected
        if kind == "folder":
            ss.export(path)
    with ssduck.open(path) as ss:
        assert ss.sql(MARKS.format("sim", "")).fetchall() == expected
        assert ss.sql(MARKS.format("sim", "_history")).fetchall() == expected
        assert ss.sql("SELECT exact FROM sim.shapes_model ORDER BY 1").fetchall() == [
            (False,),
            (True,),
        ]
        assert "not exact" in ss.eval("EXPLAIN SELECT near(this, this, 1) FROM sim;")


@sampled(
    ("query", "relations"),
    [
        ("SELECT id FROM sim WHERE near(this, this, 1)", "near"),
        (
            "SELECT clearance(a.this, b.this), above(a.this, b.this) FROM a = sim, b = sim",
            "clearance, above",
        ),
        ("SELECT volume FROM sim", "volume"),
        ("SELECT s.volume FROM s = sim", "volume"),
        ("SELECT onTop(a.this, b.this) FROM a = sim, b = sim", "onTop"),
        ("SELECT id FROM sim WHERE isRobot(this) AND distance(this, this) < 1", None),
        ("SELECT position(this) FROM sim", None),
    ],
    every=3,
)
@pytest.mark.parametrize("row_by_row", [False, True])
def test_explain_says_where_an_answer_is_not_exact(marked, query, relations, row_by_row):
    ss = ssduck.Interpreter(row_by_row=row_by_row)
    ss.add_variable("sim", marked.call_variable("sim"))
    line = f"-- not exact: {relations} where boxes stand in for shapes: ramp of sim"
    said = ss.eval(f"EXPLAIN {query};")
    assert (line in said.splitlines()) is (relations is not None)
    assert ("not exact" in said) is (relations is not None)


@pytest.mark.slow
def test_nothing_is_said_where_all_is_exact():
    with ssduck.load("kitchen") as ss:
        assert "not exact" not in ss.eval(
            "EXPLAIN SELECT id FROM kitchen WHERE near(this, this, 1);"
        )
        assert ss.sql("SELECT DISTINCT exact FROM shapes").fetchall() == [(True,)]
