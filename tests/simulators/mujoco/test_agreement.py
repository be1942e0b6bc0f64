"""The same scenes in MuJoCo and in PyBullet: every relation has the same answers."""

import numpy as np
import pytest

import ssduck
from ssduck.sql.relations.registry import RELATIONS
from tests.support.two_simulators import differences, in_mujoco, in_pybullet, parts_of

mujoco, pybullet = pytest.importorskip("mujoco"), pytest.importorskip("pybullet")


@pytest.fixture(
    scope="module", params=[0, *(pytest.param(n, marks=pytest.mark.long) for n in (1, 2, 3))]
)
def worlds(request):
    """An interpreter with the two worlds, and MuJoCo's model and data."""
    parts = parts_of(request.param)
    client = pybullet.connect(pybullet.DIRECT)
    model, data = in_mujoco(parts)
    with ssduck.Interpreter(recording=None) as ss:
        names = in_pybullet(parts, client)
        # The hulls that PyBullet makes of the corners are up to 5e-5 m smaller.
        handles = {name: handle for handle, name in names.items()}
        hulls = {handles[p.name]: (p.vertices, None) for p in parts if p.kind == "mesh"}
        ss.add_variable("p", ssduck.World.attach(client, names, shapes=hulls))
        ss.add_variable("m", ssduck.World.attach(model, data, {0: "floor"}))
        yield ss, model, data
    pybullet.disconnect(client)


PAIRS = (
    "distance(a, b)", "above(a, b)", "below(a, b)", "within(a, b)", "overlaps(a, b)", "collides(a, b)",
    "collides(a, b, 0.05)", "penetration(a, b)", "clearance(a, b)", "touching(a, b)", "near(a, b, 0.1)",
    "touching(a, b, 0.05)", "on(a, b)", "onTop(a, b)", "supports(a, b)", "inside(a, b)",
    "contains(a, b)", "enclosed(a, b)", "nextTo(a, b)", "collision(a, b)",
    "leftOf(a, b, SIM.box_5)", "behind(a, b, SIM.arm)", "rightOf(a, b, SIM.arm)",
    "inFrontOf(a, b, SIM.box_5)", "restsOn(a, b)", "positionIn(a, b)",
)  # fmt: skip
SINGLE = (
    "name(this)", "type(this)", "kind(this)", "isRobot(this)", "isSensor(this)", "isKinbody(this)",
    "robot(this)", "sensor(this)", "kinbody(this)", "isVisible(this)", "position(this)", "positionOf(this)",
    "orientation(this)", "pose(this)", "pos(this)", "posX(this)", "posY(this)", "posZ(this)", "quat(this)",
    "rot(this)", "volume(this)", "mass(this)", "hasBody(this)", "isTriMesh(this)", "isEllipsoid(this)",
    "velocity(this)", "speed(this)", "angularSpeed(this)", "tilt(this)", "upright(this)", "upright(this, 0.5)",
    "settled(this)", "fitsBox(this, [-1.0, -1.0, 0.0], [1.0, 1.0, 1.5])",
    "time(this)", "timeOf(this)", "gravityMode(this)",
    "x(this)", "y(this)", "z(this)", "aabbVolume(this)", "solidVolume(this)", "aabb(this)",
    "isEnabled(this)", "isSphere(this)", "isPlane(this)", "isBox(this)", "isCapsule(this)", "isCylinder(this)",
    "inBox(this, [-0.5, -0.5, 0.0], [0.5, 0.5, 1.0])", "inSphere(this, [0.0, 0.0, 0.5], 0.6)",
    "joint(SIM.arm, 'joint1')", "linearVelocity(this)", "angularVelocity(this)",
)  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("source", ["SIM", "links(SIM)"])
def test_all_relations_of_pairs_agree(worlds, source):
    ss, _, _ = worlds
    selected = ", ".join(f"{relation} AS r{n}" for n, relation in enumerate(PAIRS))
    places = "x(a) AS xa, z(a) AS za, x(b) AS xb, z(b) AS zb"
    query = (
        f"SELECT {places}, {selected} FROM a={source}, b={source} WHERE x(a) != x(b) "
        "ORDER BY x(a), x(b);"
    )
    assert differences(ss, query) == []


# What is compared by other tests, or belongs to a world and not to its scene.
ELSEWHERE = {
    "nearestPoints": "of parallel faces many points are nearest: tests/geometry",
    "inContact": "test_same_contacts.test_contacts_agree",
    "hasContact": "test_same_contacts.test_contacts_agree",
    "contactForce": "test_same_contacts.test_contacts_agree",
    "grasped": "test_same_contacts.test_contacts_agree",
    "force": "test_same_contacts.test_contacts_agree",
    "torque": "test_same_contacts.test_contacts_agree",
    "isSensing": "test_rays_agree: by the rays that a simulator casts",
    "sensingAmount": "test_rays_agree: by the rays that a simulator casts",
    "sensingEnvIDs": "test_rays_agree: by the rays that a simulator casts",
    "contactGap": "it depends on the simulator's margins: tests/logic/test_margins",
    "isOpen": "test_saving.test_drawers_agree",
    "isClosed": "test_saving.test_drawers_agree",
    "openness": "test_saving.test_drawers_agree",
    "id": "in each of these queries",
    "obj": "handles belong to a world",
    "environmentID": "numbers of a world",
    "tick": "the ticks of a world",
}


def test_every_relation_is_compared():
    compared = {relation[: relation.index("(")] for relation in (*PAIRS, *SINGLE)}
    assert compared | set(ELSEWHERE) >= {
        relation.usage.partition("(")[0] for relation in RELATIONS.values()
    }


@pytest.mark.slow
def test_all_relations_of_entities_agree(worlds):
    ss, _, _ = worlds
    selected = ", ".join(f"{relation} AS r{n}" for n, relation in enumerate(SINGLE))
    assert differences(ss, f"SELECT id(this) AS name, {selected} FROM SIM;") == []


@pytest.mark.parametrize("seed", range(2))
def test_rays_agree(seed):
    """From outside, from within shapes, and through a body; Bullet's rays are less exact.

    Bullet's rays miss shapes without a margin, and hit a capsule that they begin in at once.
    """
    parts, client, rng = parts_of(seed), pybullet.connect(pybullet.DIRECT), np.random.default_rng(7)
    handles = in_pybullet(parts, client, margins=True)
    worlds = [
        ssduck.World.attach(client, handles),
        ssduck.World.attach(in_mujoco(parts), names={0: "floor"}),
    ]
    origins = rng.uniform((-0.8, -0.8, 0.1), (0.8, 0.8, 1.2), (40, 3))
    origins = np.vstack(
        (origins, [p.position for p in parts if p.kind in {"box", "sphere", "mesh"}])
    )
    starts = np.repeat(origins, 12, axis=0)
    ends = starts + rng.normal(size=starts.shape)
    found = []
    for world in worlds:
        names = {info.body.handle: info.name for info in world.snapshot.entities}
        (arm,) = (handle for handle, name in names.items() if name == "arm")
        hits = world.simulator.cast_rays(starts, ends, np.full(len(starts), arm))
        found.append(
            (np.array([names.get(int(handle), "") for handle in hits.bodies]), hits.fractions)
        )
    pybullet.disconnect(client)
    (bodies, fractions), (others, other_fractions) = found
    compared = fractions > 0.0
    assert compared.mean() > 0.9
    assert (bodies == others)[compared].mean() > 0.99  # the others graze an edge
    assert len({*others}) > 8
    assert "arm" not in others
    same_body = compared & (bodies == others)
    errors = np.abs(fractions - other_fractions)[same_body]
    assert (np.quantile(errors, [0.5, 0.98]) < [1e-9, 0.01]).all()


def test_clearance_is_the_distance_that_mujoco_computes(worlds):
    """MuJoCo's own distance of two convex shapes, to its tolerance."""
    ss, model, data = worlds
    rows = ss.eval(
        "SELECT id(a) AS a, id(b) AS b, clearance(a, b) AS c FROM a=m, b=m WHERE id(a) < id(b);"
    )
    compared = 0
    for row in rows:
        if "floor" in row.values() or "arm" in row.values():
            continue
        geoms = [int(model.body_geomadr[model.body(row[side]).id]) for side in "ab"]
        expected = mujoco.mj_geomDistance(model, data, *geoms, 10.0, None)
        compared += 1
        assert row["c"] == pytest.approx(max(expected, 0.0), abs=2e-5), row
    assert compared == 45
