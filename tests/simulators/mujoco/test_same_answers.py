"""The same scenes in MuJoCo and in PyBullet: contacts, sensors and all result forms."""

import numpy as np
import pytest

import ssduck
from ssduck.adapters.registry import all_adapters
from tests.support.bodies import solid
from tests.support.two_simulators import differences, in_mujoco, in_pybullet, parts_of, same

mujoco, pybullet = pytest.importorskip("mujoco"), pytest.importorskip("pybullet")

# -- contacts -----------------------------------------------------------------------------------

# Boxes on each other, and one that touches nothing: (name, half size, position, mass). Beside them, a
# clamp: a plate that is fixed, and one that slides down on a thing.
STAGE = [
    ("table", (0.5, 0.5, 0.1), (0.0, 0.0, 0.1), 0.0),
    ("crate", (0.1, 0.1, 0.1), (0.0, 0.0, 0.3), 2.0),
    ("slab", (0.08, 0.08, 0.02), (0.0, 0.0, 0.42), 0.5),
    ("thing", (0.05, 0.05, 0.05), (1.0, 0.0, 1.06), 0.5),
    ("lonely", (0.1, 0.1, 0.1), (2.0, 0.0, 3.0), 0.0),
]
CLAMP = """<body name="clamp" pos="1 0 1"><geom type="box" size=".2 .2 .01" friction="0.5"/>
  <body name="jaw" pos="0 0 .14"><joint name="down" type="slide" axis="0 0 1"/>
    <geom type="box" size=".2 .2 .02" mass="1" friction="0.5"/></body></body>"""
STEP = 1 / 240


def stage_in_mujoco():
    bodies = "".join(
        f'<body name="{name}" pos="{x} {y} {z}">{"<freejoint/>" if mass else ""}'
        f'<geom type="box" size="{a} {b} {c}" mass="{mass or 1}" friction="0.5"/></body>'
        for name, (a, b, c), (x, y, z), mass in STAGE
    )
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><option timestep="{STEP}"/><worldbody>{bodies}{CLAMP}</worldbody></mujoco>'
    )
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, 480)
    return model, data


def stage_in_pybullet(client):
    names = {}
    for name, half, place, mass in STAGE:
        names[solid(client, pybullet.GEOM_BOX, mass, place, halfExtents=half)] = name
    plates = [
        pybullet.createCollisionShape(
            pybullet.GEOM_BOX, halfExtents=(0.2, 0.2, height), physicsClientId=client
        )
        for height in (0.01, 0.02)
    ]
    clamp = pybullet.createMultiBody(
        0, plates[0], -1, [1, 0, 1], linkMasses=[1], linkCollisionShapeIndices=plates[1:],
        linkVisualShapeIndices=[-1], linkPositions=[[0, 0, 0.14]], linkOrientations=[[0, 0, 0, 1]],
        linkInertialFramePositions=[[0, 0, 0]], linkInertialFrameOrientations=[[0, 0, 0, 1]],
        linkParentIndices=[0], linkJointAxis=[[0, 0, 1]],
        linkJointTypes=[pybullet.JOINT_PRISMATIC], physicsClientId=client,
    )  # fmt: skip
    pybullet.setJointMotorControl2(
        clamp, 0, pybullet.VELOCITY_CONTROL, force=0, physicsClientId=client
    )
    names[clamp] = "clamp"
    pybullet.setGravity(0, 0, -9.81, physicsClientId=client)
    for _ in range(480):
        pybullet.stepSimulation(physicsClientId=client)
    return names


@pytest.fixture(scope="module")
def stages():
    client = pybullet.connect(pybullet.DIRECT)
    with ssduck.Interpreter(recording=None) as ss:
        names = stage_in_pybullet(client)
        ss.add_variable("p", ssduck.World.attach(client, names))
        ss.add_variable("m", ssduck.World.attach(*stage_in_mujoco()))
        yield ss
    pybullet.disconnect(client)


@pytest.mark.slow
def test_contacts_agree(stages):
    """Things at rest: solvers share out a force in their own ways, not its sum."""
    ss = stages
    both = "FROM a=SIM, b=SIM WHERE id(a) != id(b) ORDER BY id(a), id(b);"
    for relation in (
        "inContact(a, b)",
        "hasContact(a, b)",
        "grasped(a, b)",
        "on(a, b)",
        "restsOn(a, b)",
        "touching(a, b)",
    ):
        assert differences(ss, f"SELECT id(a) AS a, id(b) AS b, {relation} AS r {both}") == []
    for world in "pm":
        assert ss.eval(f"grasped({world}.clamp, {world}.thing);") is True
        assert ss.eval(f"contactForce({world}.clamp, {world}.thing);") == pytest.approx(
            (1 + 1.5) * 9.81, rel=0.02
        )
        assert ss.eval(f"contactForce({world}.table, {world}.crate);") == pytest.approx(
            2.5 * 9.81, rel=0.02
        )
        assert ss.eval(f"contactForce({world}.crate, {world}.slab);") == pytest.approx(
            0.5 * 9.81, rel=0.02
        )
        assert ss.eval(f"contactForce({world}.crate, {world}.lonely);") == 0.0
        # What the slab and the table do to the crate carries its weight.
        assert ss.eval(f"force({world}.crate);") == pytest.approx([0, 0, 2 * 9.81], abs=0.4)
        assert ss.eval(f"torque({world}.slab);") == pytest.approx([0, 0, 0], abs=0.1)
        assert ss.eval(f"force({world}.lonely);") == [0.0, 0.0, 0.0]


# -- sensors and forms --------------------------------------------------------------------------

SENSORS = {
    "laser": (
        "planar_laser",
        {"min_angle": -180, "max_angle": 180, "resolution": 1, "max_range": 3},
    ),
    "scanner": ("lidar", {"resolution": 4, "layers": 9, "max_range": 3}),
    "finder": ("range_finder", {"max_range": 3}),
    "camera": ("depth_camera", {"width": 40, "height": 30, "fov": 70, "max_range": 3}),
    "skin": ("contact_sensor", {}),
}


@pytest.fixture(scope="module")
def heaps():
    """Both worlds of a heap of turned shapes, with sensors on the arm.

    The shapes of PyBullet have margins: its rays miss others.
    """
    parts, client = parts_of(1), pybullet.connect(pybullet.DIRECT)
    with ssduck.Interpreter(recording=None) as ss:
        names = in_pybullet(parts, client, margins=True)
        handles = {name: handle for handle, name in names.items()}
        hulls = {handles[p.name]: (p.vertices, None) for p in parts if p.kind == "mesh"}
        ss.add_variable("p", ssduck.World.attach(client, names, shapes=hulls))
        ss.add_variable("m", ssduck.World.attach(in_mujoco(parts), names={0: "floor"}))
        for world in "pm":
            for name, (type, settings) in SENSORS.items():
                # Above the arm, looking along +y at the heap.
                pose = {"position": (0, 0.15, 0.1), "orientation": (0.5**0.5, 0, 0, 0.5**0.5)}
                ss[world].add_sensor(type, "arm", name, **pose, **settings)
        yield ss
    pybullet.disconnect(client)


@pytest.mark.slow
def test_sensors_agree(heaps):
    """Rays that graze an edge may see what is behind it in one of the two."""
    ss, seen = heaps, 0
    query = (
        "SELECT id(s) AS s, id(e) AS e, isSensing(s, e) AS sees, sensingAmount(s, e) AS share "
        "FROM s=SIM, e=SIM WHERE isSensor(s) AND NOT isSensor(e) ORDER BY id(s), id(e);"
    )
    for one, other in zip(*(ss.eval(query.replace("SIM", world)) for world in "pm"), strict=True):
        assert (one["s"], one["e"]) == (other["s"], other["e"])
        assert other["share"] == pytest.approx(one["share"], abs=0.02), one
        if one["share"] > 0.02:
            assert one["sees"]
            assert other["sees"], one
            seen += 1
    assert seen > 10
    for name in SENSORS:
        found = [
            {ss[world].entity(id).name for id in ss.eval(f"sensingEnvIDs({world}.{name});")}
            for world in "pm"
        ]
        assert len(found[0] ^ found[1]) <= 1, name


ROWS = "SELECT id, round(x, 5) AS x, round(z, 5) AS z FROM SIM WHERE isKinbody(this) AND z < 2 ORDER BY id AS {};"
OBJECTS = "SELECT obj(this) FROM SIM WHERE isKinbody(this) AND id != 'floor' AS {};"
PAIRS = "SELECT above(a.this, b.this) FROM a=SIM, b=SIM WHERE above(a.this, b.this) AS {};"


def plain(value):
    """The content of a frame, a table, a graph or a grid as Python's own values."""
    for method in ("to_pylist", "to_dicts"):
        if hasattr(value, method):
            return getattr(value, method)()
    if hasattr(value, "to_dict"):
        return value.to_dict("records")
    if hasattr(value, "edges"):
        return sorted(map(str, value.nodes)), sorted(map(str, value.edges))
    return value


def bounds(scene):
    return np.asarray(scene.bounds).tolist()


def cloud(points):
    return [*points.points.min(axis=0), *points.points.max(axis=0), len(points) / 1e4]


def poses(world):
    found = sorted((entity.name, *entity.position) for entity in world)
    world.close()
    return found


# The query of each form, the part of the result that is compared, and how exactly.
FORMS = {
    "dict": (ROWS.format("dict"), plain, 0),
    "list": (ROWS.format("list"), plain, 0),
    "value": ("SELECT round(x, 5) FROM SIM WHERE id == 'box_5' AS value;", plain, 0),
    "table": (ROWS.format("table"), str, 0),
    "arrow": (ROWS.format("arrow"), plain, 0),
    "df": (ROWS.format("df"), plain, 0),
    "polars": (ROWS.format("polars"), plain, 0),
    "numpy": (ROWS.format("numpy"), np.ndarray.tolist, 0),
    "json": (ROWS.format("json"), plain, 0),
    "csv": (ROWS.format("csv"), plain, 0),
    "markdown": (ROWS.format("markdown"), plain, 0),
    "records": (ROWS.format("records"), plain, 0),
    "prolog": (PAIRS.format("prolog"), plain, 0),
    "asp": (PAIRS.format("asp"), plain, 0),
    "graph": (PAIRS.format("graph"), plain, 0),
    "dot": (PAIRS.format("dot"), plain, 0),
    "occupancygrid": (OBJECTS.format("occupancygrid(0.5, 0.05)"), np.asarray, 1e-3),
    "roombaGrid": (OBJECTS.format("roombaGrid(0.4, 0.1)"), np.asarray, 1e-3),
    "voxelgrid": (OBJECTS.format("voxelgrid(0.1)"), np.asarray, 1e-3),
    "sensorgrid": (
        "SELECT obj(this) FROM SIM WHERE isSensor(this) AS sensorgrid(0.5, 0.1, [[-1, -1], [1, 1]]);",
        np.asarray,
        1e-2,
    ),
    "plane": (
        "SELECT z(this) FROM SIM WHERE isKinbody(this) AS plane('XY', [-1, -1], [10, 10, 0.2]);",
        lambda grid: np.asarray(grid).ravel().tolist(),
        0,
    ),
    "points": (OBJECTS.format("points(0.02)"), cloud, 2e-2),
    "mesh": (OBJECTS.format("mesh"), bounds, 0),
    "environment": (OBJECTS.format("environment"), poses, 0),
}
# Files, which are compared below; and pictures, which each simulator draws in its own way (see
# test_pictures).
OTHER_FORMS = {"parquet", "glb", "image"}


def test_every_form_is_compared():
    names = {form.names[0] for form in all_adapters()}
    assert names - OTHER_FORMS == set(FORMS)


@pytest.mark.parametrize("form", FORMS)
def test_forms_agree(heaps, form, recwarn):
    program, part, share = FORMS[form]
    one, other = (part(heaps.eval(program.replace("SIM", world))) for world in "pm")
    if isinstance(one, np.ndarray):  # a cell at the edge of a shape may differ
        assert one.shape == other.shape
        assert (one != other).mean() <= share
        assert (one != 0).any()
    elif share:
        assert other == pytest.approx(one, abs=share)
    elif isinstance(one, str):
        assert other.replace("m.", "p.") == one
    else:
        assert same(one, other), (one, other)


@pytest.mark.slow
def test_files_agree(heaps, tmp_path):
    import trimesh
    from pyarrow import parquet

    for world in "pm":
        heaps.eval(ROWS.replace("SIM", world).format(f"parquet('{tmp_path / world}.parquet')"))
        heaps.eval(OBJECTS.replace("SIM", world).format(f"glb('{tmp_path / world}.glb')"))
    one, other = (parquet.read_table(tmp_path / f"{world}.parquet").to_pylist() for world in "pm")
    assert one == other
    one, other = (trimesh.load(tmp_path / f"{world}.glb") for world in "pm")
    assert len(one.geometry) == len(other.geometry) == 10
    assert np.asarray(one.bounds) == pytest.approx(np.asarray(other.bounds), abs=1e-5)
