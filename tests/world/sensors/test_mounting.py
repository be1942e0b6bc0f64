"""Sensors on links, contact sensors, and sensors that come and go."""

import math

import numpy as np
import pybullet
import pytest

import ssduck
from ssduck.errors import ArgumentError, RemovedEntityError, SelectScriptError, UnknownNameError
from ssduck.simulators.scenes import SensorSpec, find_scene, read_sensor
from ssduck.simulators.sensor_types import MAX_RAYS, SENSOR_TYPES
from tests.support.sensing import EXACT, LASER, Stage, evaluators
from tests.support.urdf import collision, joint, link, robot

# -- on a link -----------------------------------------------------------------------------------


LIMIT = '<limit lower="-3" upper="3" effort="500" velocity="20"/>'

ARM = robot(
    link("base", mass=5, com=(0, 0, 0.1), shapes=collision('<box size="0.4 0.4 0.4"/>')),
    link("arm", com=(0.2, 0.1, 0), rpy=(0.3, 0, 0), shapes=collision('<sphere radius="0.05"/>')),
    joint("turn", "revolute", "base", "arm", xyz=(0, 0, 1), axis=(0, 0, 1), limit=LIMIT),
    name="arm",
)

BALL = robot(link("ball", shapes=collision('<sphere radius="0.25"/>')), name="ball")

SCENE = """
gravity = [0, 0, 0]
[[body]]
name = "arm"
urdf = "arm.urdf"
position = [1, 2, 0]
fixed = true
[[body]]
name = "ahead"
urdf = "ball.urdf"
position = [4, 2, 1]
[[body]]
name = "aside"
urdf = "ball.urdf"
position = [1, 4, 1]
[[sensor]]
name = "eye"
type = "range_finder"
on = "arm"
link = "arm"
position = [0.1, 0, 0]
max_range = 10
"""


@pytest.fixture
def arm(write):
    write("arm.urdf", ARM)
    write("ball.urdf", BALL)
    world = ssduck.World.load(find_scene(write("room.toml", SCENE)))
    yield world
    world.close()


@pytest.mark.slow
def test_a_sensor_on_a_link_looks_where_the_link_points(arm):
    client = arm.simulator.client
    (handle,) = (
        b.handle for b in (d.body for d in arm.simulator._descriptions.values()) if b.name == "arm"
    )
    eye = arm["eye"]
    assert eye.ranges == pytest.approx([3 - 0.1 - 0.25], abs=EXACT)
    assert [arm.entity(id).name for id in eye.reading.hits] == ["ahead"]
    pybullet.setJointMotorControl2(
        handle,
        0,
        pybullet.POSITION_CONTROL,
        targetPosition=math.pi / 2,
        force=500,
        physicsClientId=client,
    )
    arm.step(480)
    assert arm["arm"].joints[0].position == pytest.approx(math.pi / 2, abs=1e-2)
    assert [arm.entity(id).name for id in eye.reading.hits] == ["aside"]
    assert eye.ranges == pytest.approx([2 - 0.1 - 0.25], abs=5e-3)
    for ss in evaluators(arm):
        assert ss.eval(
            "SELECT id(b.this) FROM a=sim, b=sim WHERE isSensing(a.this, b.this) AS list;"
        ) == ["aside"]


def test_a_sensor_is_added_to_a_link(arm):
    eye = arm.add_sensor(
        "range_finder", "arm", "new", link="arm", position=[0.2, 0, 0], max_range=9
    )
    assert eye.position == pytest.approx([1.2, 2, 1], abs=1e-6)
    assert [e.name for e in arm] == ["eye", "new", "arm", "ahead", "aside"]
    assert eye.ranges == pytest.approx([3 - 0.2 - 0.25], abs=EXACT)
    with pytest.raises(
        ArgumentError, match="add_sensor: link: 'arm' has no link 'amr'; did you mean 'arm'"
    ):
        arm.add_sensor("range_finder", "arm", link="amr", max_range=9)


# -- contact -------------------------------------------------------------------------------------


def standing(stage):
    """A crate on a floor, and a lamp that hangs above it."""
    pybullet.setGravity(0, 0, -10, stage.client)
    stage.box("floor", [5, 5, 0.5], [0, 0, -0.5])
    stage.box("crate", [0.5, 0.5, 0.5], [0, 0, 0.5], mass=2.0)
    stage.box("lamp", [0.5, 0.5, 0.5], [0, 0, 1.6])
    return stage.open()


@pytest.mark.slow
def test_a_contact_sensor_feels_what_presses(stage):
    world = standing(stage)
    touch = world.add_sensor("contact_sensor", "crate", "touch")
    world.step(240)
    assert stage.seen(touch) == ["floor"]
    assert touch.forces.sum() == pytest.approx(20, rel=0.02)
    assert touch.rays == len(touch.forces) == len(touch.points)
    assert touch.points[:, 2] == pytest.approx(np.zeros(touch.rays), abs=5e-3)
    for ss in evaluators(world):
        program = "SELECT id(b.this), sensingAmount(a.this, b.this) FROM a=sim, b=sim WHERE isSensing(a.this, b.this) AS list;"
        assert ss.eval(program) == ["floor", 1.0]
    touch.power(False)
    for ss in evaluators(world):
        assert ss.eval(program) == []
    touch.power(True)
    world["crate"].move([0, 0, 3])
    world.step()
    assert stage.seen(touch) == []
    assert touch.points.shape == (0, 3)
    assert stage.casts == []  # it casts no rays


def test_what_touches_without_force_does_not_press(stage):
    """Before the first step the solver knows of no forces."""
    stage.box("floor", [5, 5, 0.5], [0, 0, -0.5])
    stage.box("crate", [0.5, 0.5, 0.5], [0, 0, 0.499], mass=2.0)
    world = stage.open()
    pybullet.performCollisionDetection(stage.client)
    touch = world.add_sensor("contact_sensor", "crate")
    world.request_tables(["contacts"])
    assert world.snapshot.tables["contacts"].count > 0
    assert touch.rays == 0


def test_a_contact_sensor_on_a_link_feels_that_link(write):
    """The arm rests on a ball; its base on nothing."""
    write("arm.urdf", ARM)
    write("ball.urdf", BALL)
    scene = (
        SCENE.replace("[0, 0, 0]", "[0, 0, -10]")
        .replace("position = [4, 2, 1]", "position = [1, 2, 1.3]")
        .replace("[1, 4, 1]", "[1, 4, 50]")
    )
    scene += '[[sensor]]\nname = "of_arm"\ntype = "contact_sensor"\non = "arm"\nlink = "arm"\n'
    scene += '[[sensor]]\nname = "of_base"\ntype = "contact_sensor"\non = "arm"\nlink = "base"\n'
    scene += '[[sensor]]\nname = "of_all"\ntype = "contact_sensor"\non = "arm"\n'
    world = ssduck.World.load(find_scene(write("room.toml", scene)))
    try:
        world["of_all"].power(True)
        for _ in range(24):
            world.step()
            found = {name: world[name].reading.rays for name in ("of_arm", "of_base", "of_all")}
            if found["of_all"]:
                break
        assert found["of_all"] == found["of_arm"] > 0
        assert found["of_base"] == 0
        assert [world.entity(id).name for id in world["of_arm"].reading.hits] == ["ahead"]
    finally:
        world.close()


# -- coming and going ----------------------------------------------------------------------------


@pytest.mark.slow
def test_sensors_come_and_go(mast, walled):
    eye = walled.add_sensor("range_finder", "mast", max_range=5)
    again = walled.add_sensor("range_finder", "mast", max_range=5)
    assert [eye.name, again.name] == ["mast_range_finder", "mast_range_finder_2"]
    assert [eye.kind, eye.spec.on, eye.mass] == ["sensor", "mast", 0.0]
    for ss in evaluators(walled):
        assert ss.eval("SELECT id FROM sim WHERE isSensor(this) AS list;") == [eye.name, again.name]
    assert mast.seen(eye) == ["wall"]
    walled.remove_sensor(eye)
    assert [e.name for e in walled] == [again.name, "mast", "wall"]
    for act in (
        lambda: eye.reading,
        lambda: eye.power(False),
        lambda: eye.powered,
        lambda: walled.remove_sensor(eye),
        lambda: eye.ranges,
    ):
        with pytest.raises(RemovedEntityError, match="'mast_range_finder' is no longer in world"):
            act()
    walled.remove_sensor(again.name)
    for ss in evaluators(walled):
        assert ss.eval("SELECT id FROM sim WHERE isSensor(this) AS list;") == []
        assert ss.sql("FROM sensings").fetchall() == []


@pytest.mark.slow
def test_what_is_removed_is_perceived_no_more(mast):
    mast.box("wall", [0.5, 9, 9], [2, 0, 0])
    behind = mast.box("behind", [0.5, 9, 9], [4, 0, 0])
    world = mast.open(owned=False)
    eye = world.add_sensor("range_finder", "mast", max_range=5, period=100)
    other = world.add_sensor("range_finder", "behind", "other", max_range=5)
    assert mast.seen(eye) == ["wall"]
    pybullet.removeBody(1, mast.client)
    world.tick()
    assert mast.seen(eye) == ["behind"]
    pybullet.removeBody(behind, mast.client)
    for ss in evaluators(world):
        world.tick()
        assert (
            ss.eval("SELECT id(b.this) FROM a=sim, b=sim WHERE isSensing(a.this, b.this) AS list;")
            == []
        )
    with pytest.raises(RemovedEntityError):
        other.reading  # noqa: B018


def test_a_body_that_the_world_does_not_know_yet_is_in_the_way(mast):
    """It ends rays, and is nothing that could be named before the next tick."""
    mast.box("wall", [0.5, 9, 9], [2, 0, 0])
    world = mast.open()  # ssduck's own: bodies that others add are not looked for
    mast.box("late", [0.1, 1, 1], [1, 0, 0])
    eye = world.add_sensor("range_finder", "mast", max_range=5)
    assert eye.ranges == pytest.approx([0.9], abs=EXACT)
    assert eye.reading.entities.tolist() == [0]
    assert eye.reading.hits == {}


def test_a_sensor_that_is_nowhere_perceives_nothing(mast):
    body = mast.sphere("lost", 0.1, [0, 0, 5], mass=1)
    mast.box("wall", [0.5, 9, 9], [2, 0, 0])
    world = mast.open()
    lost = world.add_sensor("range_finder", "lost", max_range=5)
    found = world.add_sensor("range_finder", "mast", max_range=5)
    pybullet.resetBasePositionAndOrientation(body, [math.nan, 0, 0], [0, 0, 0, 1], mast.client)
    with pytest.warns(UserWarning, match="no number"):
        world.tick()
    assert lost.reading is None
    assert mast.seen(found) == ["wall"]


# (type, settings besides a range of 1 m, words); more of them are in simulators/test_scenes
OF_SETTINGS = [
    ("range_finder", {"max_range": math.inf}, "max_range: expected a finite number"),
    ("range_finder", {"widht": 3}, "widht: there is no such key"),
    ("range_finder", {"position": [0, 0]}, "position: expected 3 finite numbers"),
    ("range_finder", {"position": [0, 0, math.nan]}, "position: expected 3"),
    ("range_finder", {"name": "eye"}, "name: 'eye' is there already"),
    ("range_finder", {"name": ""}, "name: expected a text, found ''"),
    ("planar_laser", LASER | {"resolution": 1e-9}, "resolution: that makes more than 1,000,000"),
    ("planar_laser", LASER | {"resolution": 1e-300}, "resolution: that makes more than"),
    ("planar_laser", LASER | {"min_angle": -360.1}, "min_angle: -360.1 is less than -360"),
    ("lidar", {"min_elevation": 16}, "min_elevation: 16 is more than max_elevation, which is 15"),
    ("lidar", {"layers": 0}, "layers: 0 is not above 0"),
]
# (add_sensor's arguments, kind of error, words)
MISTAKES = [
    *(
        ({"type": kind, "max_range": 1} | more, ArgumentError, words)
        for kind, more, words in OF_SETTINGS
    ),
    ({"type": "lasr"}, ArgumentError, "add_sensor: type: there is no sensor type 'lasr'"),
    ({"type": "planar_lasr"}, ArgumentError, "did you mean 'planar_laser'?"),
    ({}, ArgumentError, "add_sensor: max_range: missing"),
    ({"max_rang": 1}, ArgumentError, "max_range: missing, but there is 'max_rang'"),
    ({"on": "eye", "max_range": 1}, ArgumentError, "on: 'eye' is a sensor, not a body"),
    (
        {"on": "mats", "max_range": 1},
        UnknownNameError,
        "add_sensor: on: world 'world' has no entity 'mats'; did you mean 'mast'?",
    ),
]


@pytest.mark.parametrize(("arguments", "kind", "words"), MISTAKES)
def test_mistakes_are_told(mast, arguments, kind, words):
    world = mast.open()
    world.add_sensor("range_finder", "mast", "eye", max_range=1)
    before = [e.name for e in world]
    with pytest.raises(kind) as caught:
        world.add_sensor(**{"type": "range_finder", "on": "mast", **arguments})
    assert words in str(caught.value)
    assert [e.name for e in world] == before


@pytest.mark.slow
def test_mistakes_of_other_worlds_and_of_others_than_sensors(mast):
    world = mast.open()
    other = Stage()
    other.sphere("mast", 0.1, [0, 0, 0])
    stranger = other.open()["mast"]
    with pytest.raises(ArgumentError, match="'mast' is of another world"):
        world.add_sensor("range_finder", stranger, max_range=1)
    with pytest.raises(ArgumentError, match="'mast' is a kinbody, no sensor"):
        world.remove_sensor("mast")
    with pytest.raises(UnknownNameError, match="no entity 'mats'; did you mean 'mast'"):
        world.remove_sensor("mats")
    pybullet.disconnect(other.client)


@pytest.mark.slow
def test_sensors_stay_what_they_are_while_a_query_runs(walled):
    eye = walled.add_sensor("range_finder", "mast", "eye", max_range=5)
    acts = {
        "off": lambda thing: eye.power(False),
        "mount": lambda thing: walled.add_sensor("range_finder", "mast", max_range=5),
        "remove": lambda thing: walled.remove_sensor(eye),
    }
    for ss in evaluators(walled):
        for name, act in acts.items():
            ss.add_function(name, act)
            with pytest.raises(SelectScriptError, match="a query on 'sim' is running"):
                ss.eval(f"SELECT id FROM sim WHERE {name}(this) AS list;")
        ss.add_function("far", lambda sensor: float(sensor.ranges[0]))
        assert ss.eval("SELECT far(this) FROM sim WHERE isSensor(this) AS value;") == pytest.approx(
            1.5, abs=EXACT
        )
        assert eye.powered


def test_the_greatest_number_of_rays():
    kind = SENSOR_TYPES["depth_camera"]
    assert kind.fault({"width": 1000.0, "height": 1000.0, "fov": 50.0}) is None
    assert MAX_RAYS == 1000 * 1000
    assert kind.fault({"width": 1001.0, "height": 1000.0, "fov": 50.0})[0] == "width"


def test_what_a_scene_need_not_say_of_a_sensor():
    spec = read_sensor({"name": "s", "type": "lidar", "on": "a", "max_range": 3}, ["a"])
    assert spec == SensorSpec(
        "s", "a", None, "lidar", (0, 0, 0), (1, 0, 0, 0), 0.0, 3.0,
        {"min_angle": -180.0, "max_angle": 180.0, "resolution": 1.0, "min_elevation": -15.0, "max_elevation": 15.0, "layers": 16.0},
        powered=True,
    )  # fmt: skip
    touch = read_sensor({"name": "s", "type": "contact_sensor", "on": "a", "powered": False}, ["a"])
    assert (touch.max_range, touch.settings, touch.powered) == (0.0, {}, False)
