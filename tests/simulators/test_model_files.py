"""SDF and MJCF files in scenes, compared with the same files loaded into PyBullet by hand."""

import subprocess
import sys
from xml.etree import ElementTree as ET

import numpy as np
import pybullet
import pytest
from scipy.spatial.transform import Rotation

import ssduck
from ssduck.errors import SceneError
from ssduck.simulators.pybullet.model_files import IGNORED
from tests.support import urdf
from tests.support.bodies import client_of
from tests.support.cases import sampled
from tests.support.models import mjcf_body, mjcf_of, sdf_link, sdf_model, sdf_of

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
    before='<compiler angle="degree"/>',
)


def states(client, bodies, get=pybullet.getDynamicsInfo):
    """What PyBullet returns of all links of some bodies."""
    return [
        [get(body, link, client) for link in range(-1, pybullet.getNumJoints(body, client))]
        for body in bodies
    ]


@pytest.mark.slow
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


@pytest.mark.slow
def test_the_names_of_mjcf_bodies(load, tmp_path):
    """The file names three of them; the others have the name of its model."""
    _, world = load('[[body]]\nmjcf = "a.xml"\n', a_xml=MJCF)
    names = ["floor", "my_lab", "cube", "my_lab_2", "walker"]
    assert [entity.name for entity in world] == names
    assert world["walker"].kind == "robot"
    with ssduck.load(tmp_path / "a.xml", simulator="pybullet") as ss:  # a model by itself
        assert [entity.name for entity in ss.call_variable("a")] == names


@pytest.mark.slow
def test_the_names_of_mjcf_bodies_with_joints_to_the_world(load):
    """PyBullet puts a base without a name before them."""
    hinge, slide = '<joint type="hinge" axis="0 1 0"/>', '<joint type="slide" axis="1 0 0"/>'
    shape = '<geom type="sphere" size="0.1"/>'
    hand = f'<body name="hand" pos="0 0 1">{shape}</body>'
    text = mjcf_of(
        *(f'<body name="{side}">{hinge}{slide}{shape}{hand}</body>' for side in ("left", "right")),
        f"<body>{hinge}{shape}{hand}</body>",
        before='<compiler angle="degree"/>',
        model="arms",
    )
    _, world = load('[[body]]\nmjcf = "a.xml"\n', a_xml=text)
    assert [entity.name for entity in world] == ["left", "right", "arms"]


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


@pytest.mark.slow
@pytest.mark.parametrize(("key", "file", "text"), [("sdf", "a.sdf", SDF), ("mjcf", "a.xml", MJCF)])
def test_a_pose_moves_the_whole_file(load, write, key, file, text):
    files = {file.replace(".", "_"): text}
    _, plain = load(f'[[body]]\n{key} = "{file}"\n', **files)
    _, moved = load(f'[[body]]\n{key} = "{file}"\n{POSE}', **files)
    for one, other in zip(plain, moved, strict=True):
        x, y, z = one.position
        assert other.position == pytest.approx([z + 1, x + 2, y + 3], abs=1e-6)
        expected = rotation(TURN) * rotation(one.orientation)
        assert (rotation(other.orientation) * expected.inv()).magnitude() < 1e-6
        for mine, theirs in zip(one.links, other.links, strict=True):
            x, y, z = mine.position
            assert theirs.position == pytest.approx([z + 1, x + 2, y + 3], abs=1e-6)


def rotation(orientation):
    return Rotation.from_quat(orientation, scalar_first=True)


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


@pytest.mark.slow
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


@pytest.mark.slow
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


@pytest.mark.slow
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


# -- what PyBullet ignores -----------------------------------------------------------------------

FALL = mjcf_of(
    '<geom type="plane" size="5 5 0.1"/>',
    '<body name="b" pos="0 0 0.5"{body}><geom type="box" name="g" size="0.2 0.1 0.3"{geom}/>{in_body}'
    '<body name="k" pos="0 0 0.6"><joint name="h" type="hinge" axis="0 1 0" limited="true" '
    'range="-40 40"{joint}/><geom type="box" size="0.1 0.1 0.3"/></body></body>{in_world}',
    before='<compiler angle="degree"/>',
    after="{end}",
)
FALL_SDF = (
    sdf_of(
        "{in_world}",
        sdf_model(
            "r",
            "{in_model}",
            sdf_link("base", extra="{in_link}"),
            '<link name="arm"><pose{pose}>0 0 0.8 0 0 0</pose>' + sdf_link("x")[15:],
            HINGE.replace("<xyz", "<xyz{xyz}")
            .replace("</limit>", "</limit>{in_axis}")
            .replace("</joint>", "{in_joint}</joint>"),
            pose="0 0 1 0 0 0",
        ),
    )
    .replace("</collision>", "{in_collision}</collision>", 1)
    .replace('"r">', '"r"{model}>', 1)
)
FALL_URDF = (
    '<robot name="r"><link name="a"><inertial><mass value="1"/><inertia ixx="0.1" ixy="0" ixz="0" '
    'iyy="0.1" iyz="0" izz="0.1"/></inertial></link><link name="b"><inertial><origin xyz="0.3 0 0"/>'
    '<mass value="1"/><inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial>'
    '{in_link}</link><joint name="j" type="revolute"><parent link="a"/><child link="b"/>'
    '<axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="1" velocity="1"/>{in_joint}</joint>'
    "{end}</robot>"
)
SLOTS = ("body", "geom", "joint", "in_body", "in_world", "end", "in_model", "in_link", "in_axis")
SLOTS += ("in_joint", "in_collision", "pose", "xyz", "model")
OTHER = sdf_model("other")
# (format, slot of the text, the part, words of the warning)
PARTS = [
    ("mjcf", "end", '<include file="x.xml"/>', "<include>"),
    ("mjcf", "end", '<actuator><motor joint="h"/></actuator>', "<actuator>"),
    ("mjcf", "end", '<sensor><jointpos joint="h"/></sensor>', "<sensor>"),
    ("mjcf", "end", '<tendon><fixed name="t"/></tendon>', "<tendon>"),
    ("mjcf", "end", '<equality><weld body1="b"/></equality>', "<equality>"),
    ("mjcf", "end", '<contact><exclude body1="b" body2="k"/></contact>', "<contact>"),
    ("mjcf", "end", '<keyframe><key qpos="1"/></keyframe>', "<keyframe>"),
    ("mjcf", "end", '<option gravity="0 0 1" timestep="0.5"/>', "<option>"),
    ("mjcf", "end", '<size nkey="1"/>', "<size>"),
    ("mjcf", "end", "<extension/>", "<extension>"),
    ("mjcf", "end", "<deformable/>", "<deformable>"),
    ("mjcf", "in_world", '<light pos="0 0 3"/>', "<light>"),
    ("mjcf", "in_body", '<camera name="c"/>', "<camera> of c"),
    ("mjcf", "in_body", '<composite type="grid"/>', "<composite> of b"),
    ("mjcf", "in_body", '<flexcomp name="f"/>', "<flexcomp> of f"),
    ("mjcf", "in_world", f"<frame>{mjcf_body('q')}</frame>", "<frame>"),
    ("mjcf", "in_world", f"<replicate>{mjcf_body('q')}</replicate>", "<replicate>"),
    ("mjcf", "in_body", '<attach model="m"/>', "<attach> of b"),
    ("mjcf", "in_body", '<plugin instance="m"/>', "<plugin> of b"),
    *(("mjcf", "body", f' euler="{v}"', "<body euler> of b") for v in ("0 90 0", "0 0 1")),
    ("mjcf", "body", ' axisangle="0 1 0 90"', "<body axisangle> of b"),
    ("mjcf", "body", ' zaxis="1 0 0"', "<body zaxis> of b"),
    ("mjcf", "body", ' xyaxes="0 1 0 1 0 0"', "<body xyaxes> of b"),
    ("mjcf", "body", ' mocap="true"', "<body mocap> of b"),
    ("mjcf", "body", ' gravcomp="1"', "<body gravcomp> of b"),
    ("mjcf", "geom", ' euler="0 90 0"', "<geom euler> of g"),
    ("mjcf", "geom", ' zaxis="1 0 0"', "<geom zaxis> of g"),
    ("mjcf", "geom", ' xyaxes="0 1 0 1 0 0"', "<geom xyaxes> of g"),
    ("mjcf", "geom", ' mass="3"', "<geom mass> of g"),
    ("mjcf", "geom", ' density="5"', "<geom density> of g"),
    *(
        ("mjcf", "joint", f' {name}="3"', f"<joint {name}> of h")
        for name in ("damping", "stiffness", "armature", "frictionloss", "springref", "ref")
    ),
    ("sdf", "in_world", "<include><uri>model://x</uri></include>", "<include>"),
    ("sdf", "in_world", '<light name="sun" type="point"/>', "<light> of sun"),
    ("sdf", "in_link", '<sensor name="s" type="ray"/>', "<sensor> of s"),
    ("sdf", "in_model", '<plugin name="p" filename="f"/>', "<plugin> of p"),
    ("sdf", "in_world", '<actor name="a"/>', "<actor> of a"),
    ("sdf", "in_world", "<physics><max_step_size>0.1</max_step_size></physics>", "<physics>"),
    ("sdf", "in_model", '<gripper name="g"/>', "<gripper> of g"),
    (
        "sdf",
        "in_collision",
        "<surface><friction><ode><mu>0.1</mu></ode></friction></surface>",
        "<surface> of c",
    ),
    ("sdf", "in_model", OTHER, "<model> of other"),
    ("sdf", "in_joint", "<pose>0 0 0.5 0 0 0</pose>", "<pose> of j"),
    ("sdf", "in_joint", "<axis2><xyz>1 0 0</xyz></axis2>", "<axis2> of j"),
    ("sdf", "in_axis", "<dynamics><friction>5</friction></dynamics>", "<friction> of j"),
    ("sdf", "in_link", "<velocity_decay><linear>9</linear></velocity_decay>", "<velocity_decay>"),
    ("sdf", "in_model", "<self_collide>1</self_collide>", "<self_collide> of r"),
    ("sdf", "in_world", "<gravity>0 0 1</gravity>", "<gravity>"),
    ("sdf", "in_world", "<wind><linear_velocity>9 0 0</linear_velocity></wind>", "<wind>"),
    ("sdf", "in_world", '<state world_name="w"/>', "<state>"),
    *(
        ("sdf", "pose", f' {name}="nowhere"', f"<pose {name}> of arm")
        for name in ("relative_to", "frame")
    ),
    ("sdf", "xyz", ' expressed_in="nowhere"', "<xyz expressed_in> of j"),
    ("sdf", "model", ' placement_frame="nowhere"', "<model placement_frame> of r"),
    (
        "sdf",
        "in_link",
        "<visual name='v'><geometry><mesh><uri>a.obj</uri><submesh><name>x</name></submesh></mesh>"
        "</geometry></visual>",
        "<submesh> of v",
    ),
    ("urdf", "in_joint", '<mimic joint="k"/>', "<mimic> of j"),
    ("urdf", "end", '<transmission name="t"/>', "<transmission> of t"),
    ("urdf", "end", '<gazebo reference="a"><selfCollide>1</selfCollide></gazebo>', "<gazebo>"),
    ("urdf", "in_link", '<sensor name="s"/>', "<sensor> of s"),
    ("urdf", "end", '<ros2_control name="c"/>', "<ros2_control> of c"),
    ("urdf", "in_joint", '<safety_controller k_velocity="1"/>', "<safety_controller> of j"),
    ("urdf", "in_joint", '<dynamics friction="9"/>', "<dynamics friction> of j"),
]
TEXTS = {"mjcf": FALL, "sdf": FALL_SDF, "urdf": FALL_URDF}
FILES = {"mjcf": "a.xml", "sdf": "a.sdf", "urdf": "a.urdf"}
LOADERS = {"mjcf": pybullet.loadMJCF, "sdf": pybullet.loadSDF, "urdf": pybullet.loadURDF}


def filled(format, slot="", part=""):
    """The text of a file with a part in a slot."""
    return TEXTS[format].format(**{name: part if name == slot else "" for name in SLOTS})


def motion(path, format):
    """Where PyBullet has the links after some steps, with the bodies' properties."""
    client = pybullet.connect(pybullet.DIRECT)
    pybullet.setGravity(0, 0, -9.81, physicsClientId=client)
    bodies = LOADERS[format](str(path), physicsClientId=client)
    bodies = (bodies,) if format == "urdf" else bodies
    for body in bodies:
        for joint in range(pybullet.getNumJoints(body, client)):
            pybullet.setJointMotorControl2(
                body, joint, pybullet.VELOCITY_CONTROL, force=0, physicsClientId=client
            )
            pybullet.resetJointState(body, joint, 0.1, physicsClientId=client)
    for _ in range(120):
        pybullet.stepSimulation(client)
    found = [pybullet.getBasePositionAndOrientation(body, client) for body in bodies]
    found += states(client, bodies) + states(client, bodies, pybullet.getAABB)
    pybullet.disconnect(client)
    return found


@pytest.mark.parametrize(("format", "slot", "part", "words"), PARTS)
def test_an_ignored_part_is_warned_of(load, write, format, slot, part, words):
    """PyBullet moves the bodies as if the part were not there."""
    for folder in ("plain", "part"):
        write(f"{folder}/a.obj", urdf.box_obj((0, 0, 0), (1, 1, 1)))
    plain = motion(write("plain/" + FILES[format], filled(format)), format)
    text = filled(format, slot, part)
    assert part in text
    assert motion(write("part/" + FILES[format], text), format) == plain
    with pytest.warns(UserWarning, match="PyBullet ignores") as caught:
        load(f'[[body]]\nname = "one"\n{format} = "part/{FILES[format]}"\nfixed = true\n')
    (warning,) = caught
    message = str(warning.message)
    assert f"part/{FILES[format]} (one" in message
    assert f": PyBullet ignores {words}" in message


def test_all_entries_of_the_table_are_tested():
    entries = {(format, path) for format, paths in IGNORED.items() for path in paths}
    assert len(entries) <= len(PARTS) + 1  # a second world has a test of its own
    tested = {words.partition(" of ")[0].strip("<>") for _, _, _, words in PARTS} | {"world"}
    for _, path in entries:
        tag = path.rpartition("/")[2].removesuffix("[2]")
        assert tag.replace("[@", " ").rstrip("]") in tested, path


@pytest.mark.slow
@pytest.mark.parametrize("format", TEXTS)
def test_a_file_without_such_parts_is_not_warned_of(load, format, recwarn):
    load(
        f'[[body]]\nname = "a"\nfixed = true\n{format} = "{FILES[format]}"\n',
        **{FILES[format].replace(".", "_"): filled(format)},
    )
    for text in (' mass="0"', ' euler="0 0 0"', ' density="0.0"'):
        load('[[body]]\nmjcf = "b.xml"\nfixed = true\n', b_xml=filled("mjcf", "geom", text))
    assert not recwarn.list


@pytest.mark.slow
def test_other_warnings_about_files(load):
    """What MuJoCo reads otherwise, what PyBullet says, and each file once."""
    body = mjcf_body(
        "b", parts='<geom type="ellipsoid" size="1 1 1"/><geom type="sphere" size="1"/>'
    )
    wall = '<body name="wall"><geom type="box" size="1 1 1"/></body>'
    entry = '[[body]]\nmjcf = "a.xml"\n'
    with pytest.warns(UserWarning, match="leaves wall free; MuJoCo") as caught:
        load(entry + entry, a_xml=mjcf_of(body, wall))
    (warning,) = caught
    assert "a.xml (b, wall, b_2, wall_2): PyBullet leaves wall free; " in str(warning.message)
    assert "unhandled geom type 'ellipsoid'" in str(warning.message)
    hinge = '<body name="b"><joint name="h" range="-90 90"/><geom type="box" size="1 1 1"/></body>'
    with pytest.warns(UserWarning, match="takes angles for radians without <compiler>"):
        load(entry, a_xml=mjcf_of(hinge))
    worlds = sdf_of(sdf_model("a")).replace("</sdf>", '<world name="w2"></world></sdf>')
    with pytest.warns(UserWarning, match="PyBullet ignores <world>"):
        load('[[body]]\nsdf = "a.sdf"\n', a_sdf=worlds)
    xacro = (
        '<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:include filename="x"/>'
    )
    with pytest.warns(UserWarning, match="PyBullet ignores <xacro:include>"):
        load('[[body]]\nname = "a"\nurdf = "a.urdf"\n', a_urdf=xacro + '<link name="l"/></robot>')
    floating = filled("urdf").replace("revolute", "floating")
    with pytest.warns(UserWarning, match="ignores the motion of floating joints of j"):
        load('[[body]]\nname = "a"\nurdf = "a.urdf"\n', a_urdf=floating)


def test_meshes_that_are_skipped(load):
    """PyBullet loads the rest of an MJCF file; a URDF or SDF file is an error."""
    parts = '<geom type="mesh" mesh="c"/><geom type="sphere" size="1"/>'
    asset = '<asset><mesh name="c" file="no.obj"/></asset>'
    with pytest.warns(UserWarning, match=r"a.xml \(m\): cannot find 'no.obj' .*type 'mesh'"):
        load('[[body]]\nmjcf = "a.xml"\n', a_xml=mjcf_of(mjcf_body(parts=parts), before=asset))
    mesh = "<mesh><uri>no.obj</uri></mesh>"
    with pytest.raises(SceneError, match=r"body\[0\].sdf: .*cannot find 'no.obj'"):
        load('[[body]]\nsdf = "a.sdf"\n', a_sdf=sdf_of(sdf_model("m", sdf_link(geometry=mesh))))


@pytest.mark.slow
def test_an_excerpt_of_part_of_a_file_has_the_order_of_the_world(load):
    text = '[[body]]\nsdf = "a.sdf"\n' + "".join(
        f'[[body]]\nname = "box_{number}"\nbox = [1, 1, 1]\nposition = [0, 0, {5 + 2 * number}]\n'
        for number in range(4)
    )
    _, world = load(text, a_sdf=SDF)
    world.remove("crate_2")
    for copy in (world.excerpt(world), world.excerpt(["box_1", "crate", "box_3", "arm_model"])):
        kept = [entity.name for entity in world if entity.name in {e.name for e in copy}]
        assert [entity.name for entity in copy] == kept
        assert [e.position for e in copy] == [world[name].position for name in kept]


def test_an_excerpt_does_not_warn_again(load, recwarn):
    with pytest.warns(UserWarning, match="<joint ref>"):
        ss, world = load('[[body]]\nmjcf = "a.xml"\n', a_xml=filled("mjcf", "joint", ' ref="1"'))
    ss.eval("SELECT this FROM room AS environment;")
    world.what_if({})
    assert not recwarn.list


# -- what is wrong -------------------------------------------------------------------------------


def test_unread_parts_may_be_odd(load):
    """They do not crash PyBullet."""
    sdf = filled("sdf", "in_link", '<sensor name=""><pose/></sensor>')
    with pytest.warns(UserWarning, match="<sensor>"):
        load('[[body]]\nsdf = "a.sdf"\n', a_sdf=sdf)
    part = '<transmission name="t"><joint name="j"/></transmission>'
    with pytest.warns(UserWarning, match="<transmission> of t"):
        load('[[body]]\nname = "a"\nurdf = "a.urdf"\n', a_urdf=filled("urdf", "end", part))


def damaged(text):
    """Yields a file with each element, text and attribute missing or empty."""
    count = len(list(ET.fromstring(text).iter()))  # noqa: S314  # a text of this file

    def variant(number, change):
        root = ET.fromstring(text)  # noqa: S314
        change(root, list(root.iter())[number])
        return ET.tostring(root, encoding="unicode")

    def remove(root, part):
        for parent in root.iter():
            if part in list(parent):
                parent.remove(part)

    def blank(_, part):
        part.text = ""

    for number in range(count):
        yield variant(number, remove)
        yield variant(number, blank)
        for key in list(ET.fromstring(text).iter())[number].attrib:  # noqa: S314
            yield variant(number, lambda _, part, key=key: part.attrib.pop(key))
            yield variant(number, lambda _, part, key=key: part.set(key, ""))


LOAD_ALL = """
import sys, warnings
from pathlib import Path
from ssduck.errors import SceneError
from ssduck.simulators.pybullet import backend
from ssduck.simulators.scenes import find_scene
warnings.simplefilter("ignore")
for path in sorted(Path(sys.argv[1]).iterdir()):
    print(path.name, flush=True)
    try:
        backend.load(find_scene(path)).close()
    except SceneError:
        pass
"""


@pytest.mark.slow
@sampled("format", TEXTS, every=len(TEXTS))
def test_no_damaged_file_crashes_the_process(tmp_path, format):
    ending = FILES[format].rpartition(".")[2]
    for number, text in enumerate(damaged(filled(format))):
        (tmp_path / f"m{number}.{ending}").write_text(text, encoding="utf-8")
    command = [sys.executable, "-c", LOAD_ALL, str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, (done.stdout.split()[-1], done.stderr[-500:])
    assert len(done.stdout.split()) > 50


NAMELESS = urdf.robot(urdf.link("a"), urdf.link("b"), urdf.joint("", "fixed", "a", "b"))
ROOTS = sdf_of(sdf_model("two", sdf_link("a"), sdf_link("b")))
# (text of the scene, files, key, words of the reason, nearest right names)
MISTAKES = [
    ('[[body]]\nsdf = "b.sdf"', {}, "body[0].sdf", "there is no file 'b.sdf'", ()),
    ('[[body]]\nmjcf = "a.sdf"', {"a_sdf": SDF}, "body[0].mjcf", "in .mjcf or .xml", ("sdf",)),
    ('[[body]]\nsdf = "a.xml"', {"a_xml": MJCF}, "body[0].sdf", "end in .sdf", ("mjcf",)),
    ('[[body]]\nsdf = "a.sdf"', {"a_sdf": ROOTS}, "body[0].sdf", "2 links without a parent (a", ()),
    *(
        ('[[body]]\nsdf = "a.sdf"', {"a_sdf": text}, "body[0].sdf", words, ())
        for text, words in [
            (sdf_of(sdf_model("m", "<static></static>", sdf_link())), "a <static> is empty"),
            (SDF.replace("<mass>1.0</mass>", "<mass> </mass>"), "a <mass> is empty"),
            (SDF.replace('name="base"', 'name=""'), "a <link> has an empty name"),
            (SDF.replace('type="revolute"', ""), "the joint 'j' has no type"),
        ]
    ),
    *(
        ('[[body]]\nmjcf = "a.xml"', {"a_xml": text}, "body[0].mjcf", words, ())
        for text, words in [
            (MJCF.replace('name="cube"', 'name=""'), "a <body> has an empty name"),
            (MJCF.replace('range="-40 40"', ""), "the limited joint 'hip' has no range"),
            (MJCF.replace('size="0.2"', ""), "a <geom> of the type 'sphere' has no size"),
        ]
    ),
    (
        '[[body]]\nname = "u"\nurdf = "a.urdf"',
        {"a_urdf": NAMELESS},
        "body[0].urdf",
        "a <joint> has an empty",
        (),
    ),
    (
        '[[body]]\nsdf = "a.sdf"',
        {"a_sdf": sdf_of("<include><uri>model://x</uri></include>")},
        "body[0].sdf",
        "no body is in it; PyBullet ignores <include>",
        (),
    ),
    ('[[body]]\nmjcf = "a.xml"', {"a_xml": mjcf_of()}, "body[0].mjcf", "no body is in it", ()),
    ('[[body]]\nsdf = "a.sdf"\nname = ""', {"a_sdf": SDF}, "body[0].name", "expected a text", ()),
    (
        '[[body]]\nsdf = "a.sdf"\nvelocity = [0, 0, 0, 0, 0, 0]',
        {"a_sdf": SDF},
        "body[0].velocity",
        "a body with 'sdf' has no such key",
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
        "sensor[0].on",
        "there is no body 'crat'",
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


def test_what_pybullet_goes_on_without_is_no_part_of_an_error(load):
    """A model file with a mistake behind two things that PyBullet only mentions."""
    link = "<link name='l'><collision name='c'><geometry><mesh><uri>no.obj</uri></mesh></geometry>"
    text = f"<sdf version='1.6'><model name='a'>{link}</collision></link></model></sdf>"
    with pytest.raises(SceneError, match=r"cannot be loaded: .*no\.obj") as caught:
        load('[[body]]\nsdf = "a.sdf"\n', a_sdf=text)
    assert "continuing without" not in str(caught.value)
    assert "using mass=" not in str(caught.value)
