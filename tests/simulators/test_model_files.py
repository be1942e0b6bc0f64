"""SDF and MJCF files in scenes, compared with the same files loaded into PyBullet by hand."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pybullet
import pybullet_data
import pytest

import ssduck
from ssduck.errors import SceneError
from tests.support.models import mjcf_body, mjcf_of, sdf_link, sdf_model, sdf_of

LIBRARY = Path(pybullet_data.getDataPath())
POSITION, TURN = [1.0, 2.0, 3.0], [0.5, 0.5, 0.5, 0.5]  # w, x, y, z: x to y, y to z, z to x
POSE = f"position = {POSITION}\norientation = {TURN}\n"
HINGE = (
    '<joint name="j" type="revolute"><parent>base</parent><child>arm</child><axis>'
    "<xyz>0 1 0</xyz><limit><lower>-1</lower><upper>2</upper><effort>9</effort></limit></axis></joint>"
)
ARM = sdf_link("base") + f'<link name="arm"><pose>0 0 0.8 0 0 0</pose>{sdf_link("x")[15:]}' + HINGE
SDF = sdf_of(
    sdf_model("crate", pose="0 0 0.3 0 0 0.5"),
    sdf_model("crate", sdf_link(com="0 0.05 0.1 0 0 0", mass=2), pose="2 0 0.3 0.1 0.2 0.3"),
    sdf_model("Shelf 1", "<static>1</static>", sdf_link(), pose="4 0 1 0 0 0"),
    sdf_model("arm.model", ARM, pose="0 3 1 0 0 0"),
)
MJCF = mjcf_of(
    '<geom name="floor" type="plane" size="5 5 0.1"/>',
    '<geom type="box" size="0.5 0.5 0.1" pos="0 0 -1"/>',
    mjcf_body("cube", pos="0 0 1"),
    mjcf_body(pos="1 0 1", parts='<geom type="sphere" size="0.2"/>'),
    mjcf_body(
        "walker",
        pos="2 0 1",
        parts='<geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.1"/><body name="leg" pos="0 0 0.5">'
        '<joint name="hip" type="hinge" axis="0 1 0" limited="true" range="-40 40"/>'
        '<geom type="cylinder" size="0.1 0.2"/></body>',
    ),
    model="my lab",
)


@pytest.fixture
def load(write):
    """Loads a scene of one text with model files beside it; returns interpreter and world."""
    opened = []

    def loaded(text, **files):
        for name, content in files.items():
            write(name.replace("_", "."), content)
        ss = ssduck.load(write("room.toml", text))
        opened.append(ss)
        return ss, ss.call_variable("room")

    yield loaded
    for ss in opened:
        ss.close()


def client_of(world):
    return world.simulator.client


def states(client, bodies, get=pybullet.getDynamicsInfo):
    """What PyBullet returns of all links of some bodies."""
    return [
        [get(body, link, client) for link in range(-1, pybullet.getNumJoints(body, client))]
        for body in bodies
    ]


@pytest.mark.parametrize(("key", "file", "text"), [("sdf", "a.sdf", SDF), ("mjcf", "a.xml", MJCF)])
def test_the_bodies_of_a_file_are_those_of_pybullet(load, write, client, key, file, text):
    _, world = load(f'[[body]]\n{key} = "{file}"\nhold = false\n', **{file.replace(".", "_"): text})
    path = str(write(file, text))
    by_hand = {"sdf": pybullet.loadSDF, "mjcf": pybullet.loadMJCF}[key]
    bodies = by_hand(path, physicsClientId=client)
    assert len(world) == len(bodies)
    own = client_of(world)
    assert states(own, bodies) == states(client, bodies)
    assert states(own, bodies, pybullet.getAABB) == states(client, bodies, pybullet.getAABB)
    for entity, body in zip(world, bodies, strict=True):
        pose = pybullet.getBasePositionAndOrientation(body, client)
        assert pybullet.getBasePositionAndOrientation(body, own) == pose
        masses = [info[0] for info in states(client, [body])[0]]
        assert entity.mass == pytest.approx(sum(masses))
        if not any(np.isinf(entity.aabb[0])):
            boxes = np.array(states(client, [body], pybullet.getAABB)[0])
            assert entity.aabb[0] == pytest.approx(boxes[:, 0].min(axis=0), abs=0.041)
            assert entity.aabb[1] == pytest.approx(boxes[:, 1].max(axis=0), abs=0.041)


def test_the_names_of_sdf_bodies(load):
    _, world = load('[[body]]\nsdf = "a.sdf"\n', a_sdf=SDF)
    assert [(e.name, e.kind) for e in world] == [
        ("crate", "kinbody"),
        ("crate_2", "kinbody"),
        ("Shelf_1", "kinbody"),
        ("arm_model", "robot"),
    ]
    assert [joint.name for joint in world["arm_model"].joints] == ["j"]
    assert [link.name for link in world["arm_model"].links] == ["base", "arm"]


def test_the_names_of_mjcf_bodies(load, tmp_path):
    """The file names three of them; the others have the name of its model."""
    _, world = load('[[body]]\nmjcf = "a.xml"\n', a_xml=MJCF)
    names = ["floor", "my_lab", "cube", "my_lab_2", "walker"]
    assert [entity.name for entity in world] == names
    assert world["walker"].kind == "robot"
    with ssduck.load(tmp_path / "a.xml") as ss:  # a model by itself
        assert [entity.name for entity in ss.call_variable("a")] == names


def test_names_of_the_scene_come_first(load):
    text = (
        '[[body]]\nsdf = "a.sdf"\n[[body]]\nname = "left"\nsdf = "a.sdf"\n'
        '[[body]]\nname = "crate"\nbox = [1, 1, 1]\n[[body]]\nname = "only"\nsdf = "one.sdf"\n'
        '[[sensor]]\nname = "Shelf_1"\ntype = "contact_sensor"\non = "crate_2"\n'
    )
    _, world = load(text, a_sdf=SDF, one_sdf=sdf_of(sdf_model("x")))
    assert [entity.name for entity in world] == [
        "Shelf_1",
        *("crate_2", "crate_3", "Shelf_1_2", "arm_model"),
        *("left_crate", "left_crate_2", "left_Shelf_1", "left_arm_model"),
        "crate",
        "only",
    ]


@pytest.mark.parametrize(("key", "file", "text"), [("sdf", "a.sdf", SDF), ("mjcf", "a.xml", MJCF)])
def test_a_pose_moves_the_whole_file(load, write, key, file, text):
    files = {file.replace(".", "_"): text}
    _, plain = load(f'[[body]]\n{key} = "{file}"\n', **files)
    _, moved = load(f'[[body]]\n{key} = "{file}"\n{POSE}', **files)
    for one, other in zip(plain, moved, strict=True):
        x, y, z = one.position
        assert other.position == pytest.approx([z + 1, x + 2, y + 3], abs=1e-6)
        expected = np.array(quaternion_product(TURN, one.orientation))
        got = np.array(other.orientation)
        assert min(abs(got - expected).max(), abs(got + expected).max()) < 1e-6
        for mine, theirs in zip(one.links, other.links, strict=True):
            x, y, z = mine.position
            assert theirs.position == pytest.approx([z + 1, x + 2, y + 3], abs=1e-6)


def quaternion_product(p, q):
    (a, b, c, d), (e, f, g, h) = p, q
    return (
        a * e - b * f - c * g - d * h,
        a * f + b * e + c * h - d * g,
        a * g - b * h + c * e + d * f,
        a * h + b * g - c * f + d * e,
    )


@pytest.mark.parametrize("word", ["1", "true", " true ", "0", "false"])
def test_static_models_stay(load, word):
    model = sdf_model("m", f"<static>{word}</static>", sdf_link(), pose="0 0 1 0 0 0")
    arm = sdf_model("arm", f"<static>{word}</static>", ARM, pose="3 0 1 0 0 0")
    _, world = load('[[body]]\nsdf = "a.sdf"\n', a_sdf=sdf_of(model, arm))
    world.step(120)
    static = word.strip() in ("1", "true")
    for entity, mass in ((world["m"], 1), (world["arm"], 2)):
        assert (entity.position[2] == pytest.approx(1, abs=1e-9)) == static
        assert entity.mass == (mass - 1 if static else mass)


def test_all_bodies_of_a_file_can_be_fixed(load):
    text = 'floor = true\n[[body]]\nsdf = "a.sdf"\nfixed = true\nposition = [0, 0, 2]\n'
    _, world = load(text + '[[body]]\nname = "b"\nbox = [1, 1, 1]\n', a_sdf=SDF)
    before = {entity.name: entity.position for entity in world}
    world.step(120)
    for entity in world:
        if entity.name != "b":
            assert entity.position == pytest.approx(before[entity.name], abs=1e-9)


def test_joints_of_a_file(load):
    text = '[[body]]\nsdf = "a.sdf"\nfixed = true\njoints = { j = 0.5 }\n'
    _, world = load(text, a_sdf=SDF)
    (joint,) = world.step(60)["arm_model"].joints
    assert joint.position == pytest.approx(0.5, abs=0.02)


@pytest.mark.parametrize(("key", "file", "text"), [("sdf", "a.sdf", SDF), ("mjcf", "a.xml", MJCF)])
def test_a_saved_file_is_read_back(load, tmp_path, key, file, text):
    """As URDF files, with the same names, poses, masses and shapes."""
    scene = f'[[body]]\nname = "lab"\n{key} = "{file}"\n{POSE}'
    ss, world = load(scene, **{file.replace(".", "_"): text})
    world.step(10)
    world.save(tmp_path / "saved")
    shapes = "SELECT type, size_x, size_y, size_z, exact FROM shapes JOIN geometries ON geometry = geometries.id ORDER BY entity, shape"
    with ssduck.load(tmp_path / "saved") as copy:
        again = copy.call_variable("room")
        assert [e.name for e in again] == [e.name for e in world]
        for one, other in zip(world, again, strict=True):
            assert (other.kind, other.mass) == (one.kind, pytest.approx(one.mass))
            assert other.pose == pytest.approx(one.pose, abs=1e-6)
            assert other.velocity == pytest.approx(one.velocity, abs=1e-6)
        rows = zip(ss.sql(shapes).fetchall(), copy.sql(shapes).fetchall(), strict=True)
        for mine, theirs in rows:
            assert (
                theirs == pytest.approx(mine, abs=1e-6)
                if mine[0] != "hull"
                else theirs[0] == mine[0]
            )


@pytest.mark.parametrize(("key", "file", "text"), [("sdf", "a.sdf", SDF), ("mjcf", "a.xml", MJCF)])
def test_an_excerpt_of_a_file_goes_on_as_the_original(load, key, file, text):
    ss, world = load(f'[[body]]\n{key} = "{file}"\n{POSE}', **{file.replace(".", "_"): text})
    world.step(5)
    copy = ss.eval("SELECT this FROM room AS environment;")
    for one, other in zip(world.step(50), copy.step(50), strict=True):
        assert other.name == one.name
        assert other.pose == pytest.approx(one.pose, abs=1e-6)


def test_sensors_and_constraints_on_bodies_of_a_file(load):
    text = (
        '[[body]]\nsdf = "a.sdf"\n[[constraint]]\ntype = "fixed"\non = "crate"\n'
        'to = "Shelf_1"\n[[sensor]]\nname = "eye"\ntype = "range_finder"\non = "arm_model"\n'
        'link = "arm"\nmax_range = 3\n'
    )
    _, world = load(text, a_sdf=SDF)
    assert world["eye"].spec.on == "arm_model"
    assert pybullet.getNumConstraints(client_of(world)) == 1


ROOTS = sdf_of(sdf_model("two", sdf_link("a"), sdf_link("b")))
# (text of the scene, files, key, words of the reason, nearest right names)
MISTAKES = [
    ('[[body]]\nsdf = "b.sdf"', {}, "body[0].sdf", "there is no file 'b.sdf'", ()),
    ('[[body]]\nmjcf = "a.sdf"', {"a_sdf": SDF}, "body[0].mjcf", "in .mjcf or .xml", ("sdf",)),
    ('[[body]]\nsdf = "a.xml"', {"a_xml": MJCF}, "body[0].sdf", "end in .sdf", ("mjcf",)),
    ('[[body]]\nsdf = "a.sdf"', {"a_sdf": "no XML"}, "body[0].sdf", "cannot be loaded", ()),
    ('[[body]]\nsdf = "a.sdf"', {"a_sdf": ROOTS}, "body[0].sdf", "2 links without a parent (a", ()),
    ('[[body]]\nmjcf = "a.xml"', {"a_xml": "<mujoco"}, "body[0].mjcf", "cannot be loaded", ()),
    ('[[body]]\nsdf = "a.sdf"\nname = ""', {"a_sdf": SDF}, "body[0].name", "expected a text", ()),
    (
        '[[body]]\nsdf = "a.sdf"\nvelocity = [0, 0, 0, 0, 0, 0]',
        {"a_sdf": SDF},
        "body[0].velocity",
        "there is no such key",
        None,
    ),
    (
        '[[body]]\nsdf = "a.sdf"\njoints = { jj = 0 }',
        {"a_sdf": SDF},
        "body[0].joints.jj",
        "a.sdf has no such joint",
        ("j",),
    ),
    (
        '[[body]]\nsdf = "a.sdf"\n[[constraint]]\ntype = "fixed"\non = "crat"',
        {"a_sdf": SDF},
        "constraint[0].on",
        "the scene has no body 'crat'",
        None,
    ),
    (
        '[[body]]\nsdf = "a.sdf"\n[[sensor]]\nname = "s"\ntype = "contact_sensor"\non = "crat"',
        {"a_sdf": SDF},
        "",
        "'crat'",
        None,
    ),
]


@pytest.mark.parametrize(("text", "files", "key", "words", "nearest"), MISTAKES)
def test_mistakes(load, tmp_path, text, files, key, words, nearest):
    with pytest.raises(SceneError) as caught:
        load(text, **files)
    assert caught.value.message.startswith(f"{tmp_path / 'room.toml'}: {key}")
    assert words in caught.value.message
    if nearest is None:
        assert caught.value.suggestions or "velocity" in text
    else:
        assert caught.value.suggestions == nearest
