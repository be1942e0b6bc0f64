"""Scene files: what they say, and what is said of a wrong one: file, key, reason, nearest name."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pybullet
import pytest

import ssduck
from ssduck.errors import SceneError, UnknownNameError
from ssduck.simulators.scenes import Camera, Scene, find_scene, read_scene, shipped_scenes
from tests.support.models import mjcf_body, mjcf_of, sdf_model, sdf_of
from tests.support.urdf import collision, joint, link, robot

ROOT = Path(__file__).resolve().parents[2]


LIMIT = '<limit lower="{}" upper="{}" effort="5" velocity="2"/>'
CUP = robot(link("cup", shapes=collision('<box size="0.1 0.1 0.1"/>')), name="cup")
ARM = robot(
    link("base"),
    link("upper"),
    link("rail"),
    link("tip"),
    link("wheel"),
    joint("swing", "revolute", "base", "upper", axis=(1, 0, 0), limit=LIMIT.format(-1, 2)),
    joint("slide", "prismatic", "upper", "rail", limit=LIMIT.format(0.5, 0.8)),
    joint("weld", "fixed", "rail", "tip", xyz=(0, 0, 1)),
    joint("roll", "continuous", "base", "wheel"),
    name="arm",
)


@pytest.fixture
def scene(write):
    """Writes a scene file beside the models `cup.urdf` and `arm.urdf`, and tells its path."""
    write("cup.urdf", CUP)
    write("arm.urdf", ARM)
    return lambda text, name="room.toml": write(name, text)


def failure(act):
    """The SceneError that it raises."""
    with pytest.raises(SceneError) as caught:
        act()
    return caught.value


# -- what a file says --------------------------------------------------------------------------

FULL = """
name = "room"
description = ""
gravity = [0, 1, -2.5]
timestep = 0.01

[camera]
eye = [1, 2, 3]
target = [0, 0, 1]
fov = 35

[[body]]
name = "one"
urdf = "cup.urdf"

[[body]]
name = "two"
kind = "robot"
urdf = "arm.urdf"
position = [1, 2, 3.5]
orientation = [0, 0.6, 0, 0.8]
fixed = true
joints = { swing = 0.5, slide = 0.625 }

[[sensor]]
name = "eye"
type = "depth_camera"
on = "two"
link = "upper"
position = [0, 0, 1]
orientation = [0, 1, 0, 0]
period = 0.5
max_range = 3
width = 64
height = 48
fov = 60
"""


def test_all_that_a_file_can_say(scene):
    found = read_scene(scene(FULL))
    assert (found.name, found.description, found.gravity) == ("room", "", (0.0, 1.0, -2.5))
    assert found.timestep == 0.01
    assert found.camera == Camera((1.0, 2.0, 3.0), (0.0, 0.0, 1.0), 35.0)
    one, two = found.bodies
    assert (one.name, one.kind, one.model.name, one.fixed) == ("one", None, "cup.urdf", False)
    assert (one.position, one.orientation, one.joints) == ((0, 0, 0), (1, 0, 0, 0), {})
    assert (two.kind, two.position, two.fixed) == ("robot", (1.0, 2.0, 3.5), True)
    assert two.orientation == pytest.approx((0, 0.6, 0, 0.8))
    assert two.joints == {"swing": 0.5, "slide": 0.625}
    (eye,) = found.sensors
    assert (eye.name, eye.type, eye.on, eye.link) == ("eye", "depth_camera", "two", "upper")
    assert (eye.position, eye.orientation) == ((0, 0, 1), (0, 1, 0, 0))
    assert (eye.period, eye.max_range) == (0.5, 3.0)
    assert eye.settings == {"width": 64.0, "height": 48.0, "fov": 60.0}


def test_what_a_file_need_not_say(scene):
    found = read_scene(scene(""))
    assert found == Scene(name="room", path=found.path)
    assert found.timestep == 1.0 / 240.0


# (the file's place, what the scene is then called)
NAMES = [
    ("garden.toml", "garden"),
    ("garden/scene.toml", "garden"),
    ("my garden-2.toml", "my_garden_2"),
    ("2nd.toml", "world_2nd"),
]


@pytest.mark.parametrize(("place", "name"), NAMES)
def test_a_scene_without_a_name_is_called_as_its_file(write, monkeypatch, tmp_path, place, name):
    path = write(place, "")
    assert read_scene(path).name == name
    monkeypatch.chdir(path.parent)
    assert read_scene(Path(path.name)).name == name


@pytest.mark.slow
def test_a_world_is_what_its_scene_says(scene):
    with ssduck.load(scene(FULL)) as ss:
        world = ss.call_variable("room")
        assert [(e.name, e.kind) for e in world] == [
            ("eye", "sensor"),
            ("one", "kinbody"),
            ("two", "robot"),
        ]
        two = world["two"]
        assert two.position == pytest.approx([1, 2, 3.5])
        assert two.orientation == pytest.approx([0, 0.6, 0, 0.8])
        assert two.mass == 4.0  # five links of 1 kg, of which the base is fixed
        joints = {state.name: state for state in two.joints}
        assert joints["swing"].position == pytest.approx(0.5)
        assert joints["slide"].position == pytest.approx(0.625)
        assert world.time == 0.0
        assert world.step(50).time == 0.5


def test_bodies_fall_as_the_scene_says(scene):
    """From rest, n steps of semi-implicit Euler: a dt^2 n (n + 1) / 2."""
    text = 'gravity = [0, 1, -2.5]\ntimestep = 0.01\n[[body]]\nname = "c"\nurdf = "cup.urdf"\n'
    with ssduck.load(scene(text)) as ss:
        cup = ss.call_variable("room").step(20)["c"]
        fall = 0.01**2 * 20 * 21 / 2
        # PyBullet damps velocities a little.
        assert cup.position == pytest.approx([0, fall, -2.5 * fall], rel=2e-2, abs=1e-12)


@pytest.mark.slow
def test_joints_begin_where_they_may_and_stay_there(scene):
    text = '[[body]]\nname = "arm"\nurdf = "arm.urdf"\nfixed = true\njoints = {swing = 0.25}\n'
    with ssduck.load(scene(text)) as ss:
        world = ss.call_variable("room")
        expected = {"swing": 0.25, "slide": 0.5, "weld": 0.0, "roll": 0.0}
        assert {j.name: j.position for j in world["arm"].joints} == pytest.approx(expected)
        world.step(240)
        assert {j.name: j.position for j in world["arm"].joints} == pytest.approx(
            expected, abs=0.02
        )


BALL = robot(link("ball", shapes=collision('<sphere radius="0.1"/>')), name="ball")
BALLS = """
gravity = [0, 0, 0]
{}
[[body]]
name = "left"
urdf = "ball.urdf"
velocity = [1, 0, 0, 0, 0, 2]
[[body]]
name = "right"
urdf = "ball.urdf"
position = [0.5, 0, 0]
velocity = [-0.5, 0.25, 0, 0, 0, 0]
"""


@pytest.mark.slow
@pytest.mark.parametrize("elastic", [True, False])
def test_bodies_of_an_elastic_scene_lose_no_energy(write, elastic):
    """Two balls of one mass that meet head-on exchange their speeds along the line of centres."""
    write("ball.urdf", BALL)
    text = BALLS.replace("0.25", "0") if elastic else BALLS
    with ssduck.load(write("room.toml", text.format("elastic = true" if elastic else ""))) as ss:
        room = ss.call_variable("room")
        assert room["left"].velocity == pytest.approx([1, 0, 0, 0, 0, 2])
        room.step(120)
        after = [*room["left"].velocity, *room["right"].velocity]
        expected = [-0.5, 0, 0, 0, 0, 2, 1, 0, 0, 0, 0, 0]
        assert (after == pytest.approx(expected, abs=1e-6)) == elastic


# -- the manual -------------------------------------------------------------------------------


SIDE = collision('<cylinder radius="0.04" length="0.1"/>', xyz=(0, 0, 0.05))
STANDING_CUP = robot(link("cup", com=(0, 0, 0.05), mass=0.2, shapes=SIDE), name="cup")


@pytest.mark.slow
def test_the_manuals_example_is_a_scene(write):
    page = (ROOT / "docs" / "reference" / "scenes.md").read_text(encoding="utf-8")
    (toml,) = re.findall(r"^```toml\n(.*?)^```", page, re.MULTILINE | re.DOTALL)
    write("cup.urdf", STANDING_CUP)
    with ssduck.load(write("room.toml", toml)) as ss:
        room = ss.call_variable("room").step(240)
        assert [e.name for e in room] == ["watcher", "floor", "crate", "cup", "ball"]
        assert room["crate"].position == pytest.approx([0, 0, 0.2], abs=1e-3)
        assert room["cup"].position == pytest.approx([0.05, 0, 0.4], abs=0.01)  # it stands
        assert room["ball"].position[0] > 0.9
        assert room["watcher"].ranges == pytest.approx([0.16], abs=0.01)  # from it to the cup
    write("shelves.sdf", sdf_of(sdf_model("shelf"), sdf_model("shelf"), sdf_model("end board")))
    write("arms.xml", mjcf_of(mjcf_body("arm"), mjcf_body("tool")))
    files = "[[body]]\nsdf = 'shelves.sdf'\nposition = [2, 0, 0]\n"
    files += "[[body]]\nname = 'left'\nmjcf = 'arms.xml'\n"
    with ssduck.load(write("files.toml", files)) as ss:
        names = [e.name for e in ss.call_variable("files")]
        assert names == ["shelf", "shelf_2", "end_board", "left_arm", "left_tool"]


# -- what is wrong with a file -----------------------------------------------------------------

BODY = '[[body]]\nname = "a"\nurdf = "cup.urdf"\n'
SENSOR = BODY + '[[sensor]]\nname = "s"\non = "a"\ntype = "range_finder"\nmax_range = 1.0\n'
CAMERA = SENSOR.replace("range_finder", "depth_camera") + "width = 64\nheight = 48\nfov = 50\n"
LASER = SENSOR.replace("range_finder", "planar_laser") + (
    "min_angle = -45\nmax_angle = 45\nresolution = 1\n"
)
LIDAR = SENSOR.replace("range_finder", "lidar")
TOUCH = SENSOR.replace("range_finder", "contact_sensor").replace("max_range = 1.0\n", "")
HUGE = "1" + "0" * 400
# (text, key, words of the reason, nearest right names)
MISTAKES = [
    # top level
    ("nam = 'x'", "nam", "there is no such key", ("name",)),
    (
        "scene = 'a.xml'\nsuccess = '1'",
        "scene",
        "the file of a task, no scene: its scene is 'a.xml'",
        (),
    ),
    ("name = 'a room'", "name", "'a room' is no name", ()),
    ("name = 3", "name", "expected a text, found 3", ()),
    ("name = ''", "name", "expected a text, found ''", ()),
    ("gravity = 9.81", "gravity", "expected 3 finite numbers (x, y, z), found 9.81", ()),
    ("gravity = [0, 0]", "gravity", "expected 3 finite numbers", ()),
    ("gravity = [0, 0, nan]", "gravity", "expected 3 finite numbers", ()),
    ("gravity = [0, 0, true]", "gravity", "expected 3 finite numbers", ()),
    (f"gravity = [0, 0, {HUGE}]", "gravity", "expected 3 finite numbers", ()),
    ("timestep = 0", "timestep", "0 is not above 0", ()),
    ("timestep = -0.1", "timestep", "-0.1 is not above 0", ()),
    ("timestep = inf", "timestep", "expected a finite number, found inf", ()),
    ("timestep = '1'", "timestep", "expected a finite number, found '1'", ()),
    ("elastic = 1", "elastic", "expected true or false, found 1", ()),
    ("timestep = true", "timestep", "expected a finite number, found True", ()),
    # the camera
    ("camera = 3", "camera", "expected a table, found 3", ()),
    ("[camera]\neyes = [0, 0, 0]", "camera.eyes", "there is no such key", ("eye",)),
    ("[camera]\neye = [0, 0, inf]", "camera.eye", "expected 3 finite numbers", ()),
    ("[camera]\nfov = 0", "camera.fov", "0 is not above 0", ()),
    ("[camera]\nfov = 180", "camera.fov", "180 is not below 180", ()),
    ("[camera]\neye = [0, 0, 0.5]", "camera.target", "is where the camera is", ()),
    # bodies
    ("body = 3", "body", "expected tables, written [[body]], found 3", ()),
    ("body = [3]", "body", "expected tables, written [[body]]", ()),
    ("[body]\nname = 'a'", "body", "expected tables, written [[body]]", ()),
    ("[[bodies]]\nname = 'a'", "bodies", "there is no such key", ("body",)),
    ("[[body]]\nurdf = 'cup.urdf'", "body[0].name", "missing", ()),
    ("[[body]]\nnam = 'a'\nurdf = 'cup.urdf'", "body[0].name", "missing, but there is 'nam'", ()),
    ("[[body]]\nname = ''\nurdf = 'cup.urdf'", "body[0].name", "expected a text", ()),
    ("[[body]]\nname = 'a'", "body[0].urdf", "missing", ()),
    ("[[body]]\nname = 'a'\nurdf = 'mug.urdf'", "body[0].urdf", "there is no file 'mug.urdf'", ()),
    ("[[body]]\nname = 'a'\nurdf = 'room.toml'", "body[0].urdf", "does not end in .urdf", ()),
    (BODY + "kind = 'robo'", "body[0].kind", "neither 'robot' nor 'kinbody'", ("robot",)),
    (BODY + "kind = 'sensor'", "body[0].kind", "neither 'robot' nor 'kinbody'", ()),
    (BODY + "positon = [0, 0, 0]", "body[0].positon", "there is no such key", ("position",)),
    (BODY + "position = [0, 0, 0, 1]", "body[0].position", "expected 3 finite numbers", ()),
    (BODY + "orientation = [0, 0, 0]", "body[0].orientation", "4 finite numbers (w, x, y, z)", ()),
    (BODY + "orientation = [0, 0, 0, 0]", "body[0].orientation", "have length 0, not 1", ()),
    (BODY + "orientation = [1, 1, 0, 0]", "body[0].orientation", "have length 1.414, not 1", ()),
    (BODY + "orientation = [1.0011, 0, 0, 0]", "body[0].orientation", "not a rotation", ()),
    (BODY + "fixed = 1", "body[0].fixed", "expected true or false, found 1", ()),
    (BODY + "joints = 3", "body[0].joints", "expected a table", ()),
    (BODY + "joints = { j = 'x' }", "body[0].joints.j", "expected a finite number", ()),
    (BODY + "joints = { j = nan }", "body[0].joints.j", "expected a finite number", ()),
    (BODY + "velocity = [0, 0, 0]", "body[0].velocity", "expected 6 finite numbers", ()),
    (BODY + "velocity = [0, 0, 0, 0, 0, nan]", "body[0].velocity", "expected 6 finite", ()),
    (
        BODY + "fixed = true\nvelocity = [0, 0, 0, 0, 0, 1]",
        "body[0].velocity",
        "a fixed body does not move",
        (),
    ),
    (BODY + BODY, "body[1].name", "'a' is there already", ()),
    # sensors
    (SENSOR.replace("range_finder", "range"), "sensor[0].type", "no sensor type 'range'", None),
    (SENSOR.replace('on = "a"', 'on = "b"'), "sensor[0].on", "the scene has no body 'b'", None),
    (SENSOR.replace('name = "s"', 'name = "a"'), "sensor[0].name", "'a' is there already", ()),
    (SENSOR.replace("max_range = 1.0", ""), "sensor[0].max_range", "missing", ()),
    (SENSOR.replace("1.0", "0"), "sensor[0].max_range", "0 is not above 0", ()),
    (SENSOR + "period = -1", "sensor[0].period", "-1 is less than 0", ()),
    (SENSOR + "width = 64", "sensor[0].width", "there is no such key", ()),
    (SENSOR + "orientation = [2, 0, 0, 0]", "sensor[0].orientation", "have length 2, not 1", ()),
    (CAMERA.replace("width = 64", ""), "sensor[0].width", "missing", ()),
    (CAMERA.replace("64", "0"), "sensor[0].width", "0 is not above 0", ()),
    (LASER.replace("-45", "46"), "sensor[0].min_angle", "46 is more than max_angle", ()),
    (LASER.replace("resolution = 1", "resolution = 0"), "sensor[0].resolution", "not above 0", ()),
    (SENSOR + "powered = 1", "sensor[0].powered", "expected true or false, found 1", ()),
    (CAMERA.replace("48", "4.5"), "sensor[0].height", "4.5 is no whole number", ()),
    (CAMERA.replace("64", "640000"), "sensor[0].width", "makes more than 1,000,000 rays", ()),
    (CAMERA.replace("fov = 50", "fov = 180"), "sensor[0].fov", "180 is not below 180", ()),
    (LASER.replace("45", "181"), "sensor[0].max_angle", "more than a turn from min_angle", ()),
    (
        LASER.replace("max_angle = 45", "max_angle = 361"),
        "sensor[0].max_angle",
        "is more than 360",
        (),
    ),
    (LASER.replace("resolution = 1", ""), "sensor[0].resolution", "missing", ()),
    (LIDAR + "layers = 2.5", "sensor[0].layers", "2.5 is no whole number", ()),
    (LIDAR + "max_elevation = 90.5", "sensor[0].max_elevation", "90.5 is more than 90", ()),
    (LIDAR + "min_elevations = 1", "sensor[0].min_elevations", "no such key", None),
    (TOUCH + "max_range = 1", "sensor[0].max_range", "there is no such key", ()),
    (SENSOR + SENSOR.removeprefix(BODY), "sensor[1].name", "'s' is there already", ()),
]


@pytest.mark.parametrize(("text", "key", "words", "nearest"), MISTAKES)
def test_a_mistake_is_told_with_file_key_and_reason(scene, text, key, words, nearest):
    path = scene(text)
    error = failure(lambda: find_scene(path))
    assert error.message.startswith(f"{path}: {key}: ")
    assert words in error.message
    if nearest is not None:
        assert error.suggestions == nearest


# Those without a mistake, and those just inside, and at, what is refused just outside above.
RIGHT = [
    *(BODY, SENSOR, CAMERA, LASER, LIDAR, TOUCH),
    "timestep = 1e-9",
    "[camera]\nfov = 179.9",
    BODY + "orientation = [1.0009, 0, 0, 0]",
    SENSOR + "period = 0",
    LASER.replace("-45", "45"),
    BODY + "fixed = true\nvelocity = [0, 0, 0, 0, 0, 0]",
]


@pytest.mark.parametrize("text", RIGHT)
def test_what_is_just_right(scene, text):
    assert read_scene(scene(text)).name == "room"


def test_an_orientation_is_made_exactly_of_unit_length(scene):
    found = read_scene(scene(BODY + "orientation = [0.7071, 0.7071, 0, 0]"))
    assert sum(x * x for x in found.bodies[0].orientation) == pytest.approx(1.0, abs=1e-15)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (b"name = ", "at end of document"),
        (b"name = 'a'\nname = 'b'\n", "line 2"),
        (b"[[body]\n", "line 1"),
        (b"name = '\xff'", "utf-8"),
    ],
)
def test_what_is_no_toml_is_told_with_its_line(tmp_path, text, words):
    path = tmp_path / "bad.toml"
    path.write_bytes(text)
    error = failure(lambda: find_scene(path))
    assert error.message.startswith(f"{path}: ")
    assert words in error.message


# What is found out when the models are loaded: (text, key, words, nearest right names)
ARM_BODY = '[[body]]\nname = "arm"\nurdf = "arm.urdf"\n'
MODEL_MISTAKES = [
    ("joints = { swng = 0.1 }", "body[0].joints.swng", "arm.urdf has no such joint", ("swing",)),
    ("joints = { weld = 0.1 }", "body[0].joints.weld", "a fixed joint has no position", ()),
    ("joints = { swing = 2.001 }", "body[0].joints.swing", "2.001 is not from -1 to 2", ()),
    ("joints = { slide = 0.499 }", "body[0].joints.slide", "0.499 is not from 0.5 to 0.8", ()),
    (
        '[[sensor]]\nname = "s"\ntype = "range_finder"\non = "arm"\nlink = "uper"\nmax_range = 1',
        "sensor[0].link",
        "'arm' has no link 'uper'",
        ("upper",),
    ),
    ('[[constraint]]\ntype = "glue"\non = "arm"', "constraint[0].type", "no such constraint", None),
    ('[[constraint]]\ntype = "fixed"\non = "b"', "constraint[0].on", "the scene has no body", None),
    (
        '[[constraint]]\ntype = "fixed"\non = "arm"\nlink = "x"',
        "constraint[0].on_link",
        "'arm' has no link 'x'",
        None,
    ),
    ("[engine]\niterations = 0", "engine.iterations", "0 is less than 1", ()),
    ("[engine]\nsubsteps = 1.5", "engine.substeps", "1.5 is no whole number", ()),
]


@pytest.mark.parametrize(("text", "key", "words", "nearest"), MODEL_MISTAKES)
def test_a_mistake_about_a_model(scene, text, key, words, nearest):
    path = scene(ARM_BODY + text)
    error = failure(lambda: ssduck.load(path))
    assert error.message.startswith(f"{path}: {key}: ")
    assert words in error.message
    if nearest is not None:
        assert error.suggestions == nearest


@pytest.mark.parametrize("joints", ["swing = 2", "swing = -1.0", "slide = 0.8", "roll = 100"])
def test_joints_at_their_limits(scene, joints):
    with ssduck.load(scene(ARM_BODY + f"joints = {{ {joints} }}")) as ss:
        name, _, value = joints.partition(" = ")
        states = {state.name: state.position for state in ss.call_variable("room")["arm"].joints}
        assert states[name] == pytest.approx(float(value))


# (the model's text, words of PyBullet's own reason)
BROKEN = [
    ("this is no XML", "urdf"),
    ("<robot", "urdf"),
    ("<robot name='r'></robot>", "urdf"),
    (robot(link("a"), joint("j", "revolute", "a", "b")), "j"),
    (robot(link("a"), link("b"), joint("j", "bent", "a", "b")), "bent"),
]


@pytest.mark.parametrize(("text", "words"), BROKEN)
def test_a_model_that_cannot_be_loaded(scene, write, capfd, text, words):
    """PyBullet says on the terminal what is wrong: it is said in the error instead.

    The terminal speaks again afterwards.
    """
    write("broken.urdf", text)
    path = scene(
        '[[body]]\nname = "a"\nurdf = "cup.urdf"\n[[body]]\nname = "b"\nurdf = "broken.urdf"'
    )
    error = failure(lambda: ssduck.load(path))
    assert error.message.startswith(f"{path}: body[1].urdf: ")
    assert "broken.urdf cannot be loaded: " in error.message
    reason = error.message.partition("cannot be loaded: ")[2]
    assert len(reason) > 5
    assert words in error.message
    assert "\n" not in error.message
    assert capfd.readouterr() == ("", "")
    os.write(1, b"out\n")
    os.write(2, b"err\n")
    assert capfd.readouterr() == ("out\n", "err\n")


def test_a_scene_that_fails_leaves_no_client_and_no_descriptor_behind(scene):
    def left():
        clients = [number for number in range(100) if pybullet.isConnected(number)]
        return clients, len(list(Path("/proc/self/fd").iterdir()))

    path = scene(ARM_BODY + "joints = { swng = 0 }")
    failure(lambda: ssduck.World.load(find_scene(path)))
    before = left()
    for _ in range(5):
        failure(lambda: ssduck.World.load(find_scene(path)))
    assert left() == before


# -- finding scenes ----------------------------------------------------------------------------


def test_the_shipped_scenes_are_all_sound():
    shipped = shipped_scenes()
    assert "kitchen" in shipped
    for name, path in shipped.items():
        assert read_scene(path).name == name
        assert find_scene(name) == read_scene(path)


@pytest.mark.slow
def test_the_hall_stands_still_and_nothing_is_in_anything():
    with ssduck.load("hall") as ss:
        hall = ss.call_variable("hall")
        before = {entity.name: entity.position for entity in hall}
        collide = "SELECT id(a.this) FROM a=hall, b=hall WHERE penetration(a.this, b.this) > 0.001"
        assert (
            ss.eval(f"{collide} AND id(a.this) != 'goal' AND id(b.this) != 'goal' AS list;") == []
        )
        hall.step(240)
        for entity in hall:
            assert entity.position == pytest.approx(before[entity.name], abs=1e-3), entity.name


@pytest.mark.slow
def test_what_flies_about_begins_apart_and_stays_in_its_box():
    with ssduck.load("chaos") as ss:
        chaos = ss.call_variable("chaos")
        collide = "SELECT id(a.this) FROM a=chaos, b=chaos WHERE collides(a.this, b.this) AS list;"
        assert ss.eval(collide) == []
        flying = "SELECT id FROM chaos WHERE mass(this) > 0 AS list;"
        kinds = {name.rsplit("_", 1)[0] for name in ss.eval(flying)}
        assert kinds == {"box", "sphere", "cylinder", "capsule"}
        chaos.step(480)
        inside = "SELECT id FROM chaos WHERE mass(this) > 0 AND inBox(this, [-2,-2,-2], [2,2,2]) AS list;"
        assert ss.eval(inside) == ss.eval(flying)


@pytest.mark.parametrize(
    ("name", "nearest"), [("kitchn", ("kitchen",)), ("KITCHEN", ("kitchen",)), ("moon", ())]
)
def test_an_unknown_scene_is_told_with_the_nearest_names(name, nearest, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UnknownNameError, match=f"there is no scene '{name}'") as caught:
        find_scene(name)
    assert caught.value.suggestions == nearest
    assert "kitchen" in caught.value.message


@pytest.mark.parametrize("name", ["x" * 300, "a/" * 3000, "SELECT id FROM kitchen;", "\0"])
def test_a_text_that_no_file_can_be_called(name):
    with pytest.raises(UnknownNameError, match="there is no scene"):
        find_scene(name)


def test_a_folder_is_the_scene_in_it(scene, tmp_path):
    path = scene('name = "inside"', "scene.toml")
    assert find_scene(tmp_path).path == path
    assert find_scene(str(tmp_path)).name == "inside"


def test_a_folder_without_a_scene(tmp_path):
    assert f"{tmp_path} is a folder without a scene.toml" in str(
        failure(lambda: find_scene(tmp_path))
    )


@pytest.mark.parametrize("name", ["notes.txt", "scene", "mesh.obj"])
def test_a_file_that_is_neither(write, name):
    path = write(name, "")
    error = failure(lambda: find_scene(path))
    assert error.message.startswith(f"{path}: unknown file type")
    assert ".toml" in error.message
    assert ".urdf" in error.message


# -- models by themselves ------------------------------------------------------------------------


def test_a_urdf_by_itself(scene, tmp_path):
    scene("")
    with ssduck.load(tmp_path / "arm.urdf") as ss:
        world = ss.call_variable("arm")
        assert [(e.name, e.kind) for e in world] == [("arm", "robot")]
        assert world["arm"].position == pytest.approx([0, 0, 0])
        world.step(10)
        assert world["arm"].position[2] < -1e-3  # it is not fixed


def test_the_case_of_a_suffix_does_not_matter(write):
    assert find_scene(write("BIG.TOML", "")).name == "BIG"
    with ssduck.load(write("CUP.URDF", CUP)) as ss:
        assert ss.eval("SELECT id FROM CUP AS list;") == ["cup"]


# -- the tools of the shipped scenes -------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("name", ["kitchen", "hall", "chaos"])
def test_the_files_of_a_scene_are_what_its_tool_writes(name):
    assert name in shipped_scenes()
    done = subprocess.run(
        [sys.executable, "-m", f"tools.build_{name}", "--check"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


@pytest.mark.long
def test_an_elastic_scene_changes_no_other_simulation():
    """PyBullet has settings that all simulations of a process share."""

    def moved(*, beside):
        with ssduck.load("kitchen") as ss:
            other = ssduck.load("chaos") if beside else None
            world = ss.call_variable("kitchen").step(240)
            if other is not None:
                other.close()
            return [entity.pose + entity.velocity for entity in world]

    assert moved(beside=True) == moved(beside=False)


@pytest.mark.parametrize("simulator", ["pybullet", "mujoco"])
@pytest.mark.parametrize(
    ("model", "file", "name"),
    [
        ("tabletop", "traybox.urdf", "traybox"),
        ("dumpUrdf", "humanoid.urdf", "humanoid"),
        ("urdf_robot", "urdf/ball.urdf", "ball"),
        ("cube.urdf", "duck_vhacd.urdf", "duck_vhacd"),
        ("lbr_iiwa", "kuka_iiwa/model.urdf", "lbr_iiwa"),
        ("Cup", "red_cup_2.urdf", "Cup"),
        ("my-arm", "robot.urdf", "my_arm"),
    ],
)
def test_a_file_names_its_body_where_the_models_name_is_of_another(
    write, simulator, model, file, name
):
    body = link("l", shapes=collision('<sphere radius="1"/>'))
    path = write(file, robot(body, name=model))
    with ssduck.load(path, name="w", simulator=simulator) as ss:
        assert ss.eval("SELECT id FROM w AS list;") == [name]
