"""Worlds and handles of entities."""

import copy
from unittest.mock import patch

import numpy as np
import pybullet
import pytest
from scipy.spatial.transform import Rotation

import ssduck
from ssduck.errors import (
    ArgumentError,
    RemovedEntityError,
    SelectScriptError,
    SimulatorError,
    UnknownNameError,
)
from ssduck.formatting import RESERVED_WORDS
from ssduck.language.tokens import CLAUSES
from ssduck.simulators.scenes import Camera, find_scene
from ssduck.world import entity_registry
from tests.support.urdf import collision, joint, link, robot


def test_what_a_handle_tells(kitchen):
    cup = kitchen["cup_905a"]
    assert (cup.name, cup.kind, cup.world) == ("cup_905a", "kinbody", kitchen)
    assert cup.position == pytest.approx([1.0, 0.433, 0.922])
    assert np.abs(cup.orientation) == pytest.approx([1, 0, 0, 0])
    assert cup.pose == cup.orientation + cup.position
    assert cup.velocity == pytest.approx([0] * 6)
    assert cup.aabb[0] == pytest.approx([0.952582812, 0.391988982, 0.920137834])
    assert 0.1 < cup.mass < 1
    assert [link.name for link in cup.links] == ["cup"]
    assert cup.links[0].aabb == cup.aabb
    assert cup.joints == []
    assert repr(cup) == "<kinbody 'cup_905a'>"


@pytest.mark.slow
def test_handles_are_equal_if_they_are_of_the_same_entity(kitchen):
    one, same, other = kitchen["can"], kitchen["can"], kitchen["sink"]
    assert one is not same
    assert one == same
    assert hash(one) == hash(same)
    assert one != other
    assert len({one, same, other}) == 2
    assert one != "can"
    assert copy.deepcopy([one])[0] == one
    with ssduck.load("kitchen") as second:
        assert second.call_variable("kitchen")["can"] != one


def test_iteration_and_names(kitchen):
    entities = list(kitchen)
    assert len(kitchen) == len(entities) == 37
    kinds = [entity.kind for entity in entities]
    assert kinds == ["sensor"] * 8 + ["robot"] * 4 + ["kinbody"] * 25
    assert [e.id for e in entities] == sorted({e.id for e in entities})
    assert "can" in kitchen
    assert "cann" not in kitchen
    with pytest.raises(UnknownNameError, match="no entity 'cann'") as caught:
        kitchen["cann"]
    assert "can" in caught.value.suggestions
    first = ", ".join(entity.name for entity in list(kitchen)[:6])
    contents = f"8 sensors, 4 robots, 25 kinbodies: {first} and 31 more"
    assert repr(kitchen) == f"<World 'kitchen': 37 entities ({contents}), t=0 s>"


# A body with its centre of mass off its frame, a fixed one, a robot.
@pytest.mark.parametrize("name", ["cup_905a", "table", "roomba_625x"])
def test_move(kitchen, name):
    entity = kitchen[name]
    low, high = np.array(entity.aabb)
    turn = np.array([np.cos(0.4), 0, 0, np.sin(0.4)])
    before = np.array(entity.position)
    entity.move(position=before + [0.5, -0.25, 1.5])
    assert entity.position == pytest.approx(before + [0.5, -0.25, 1.5], abs=1e-9)
    assert np.array(entity.aabb) == pytest.approx(
        np.array([low, high]) + [0.5, -0.25, 1.5], abs=1e-9
    )
    entity.move(orientation=3 * turn)
    assert abs(np.dot(entity.orientation, turn)) == pytest.approx(1)
    assert entity.position == pytest.approx(before + [0.5, -0.25, 1.5], abs=1e-9)
    entity.move(before, [1, 0, 0, 0])
    assert np.array(entity.aabb) == pytest.approx(np.array([low, high]), abs=1e-9)
    kitchen.tick()
    assert entity.position == pytest.approx(before, abs=1e-9)


@pytest.mark.slow
def test_what_was_moved_is_at_rest(kitchen):
    kitchen["can"].move(position=[0, 0, 50])
    kitchen.step(60)
    assert kitchen["can"].velocity[2] < -1
    kitchen["can"].move(position=[0, 0, 50])
    assert kitchen["can"].velocity == pytest.approx([0] * 6)


@pytest.mark.parametrize(
    "arguments",
    [
        {"position": [0, 0]},
        {"position": [0, 0, float("nan")]},
        {"position": [0, 0, float("inf")]},
        {"orientation": [1, 0, 0]},
        {"orientation": [0, 0, 0, 0]},
    ],
)
def test_bad_moves_change_nothing(kitchen, arguments):
    before = kitchen["can"].pose
    with pytest.raises(ValueError, match=next(iter(arguments))):
        kitchen["can"].move(**arguments)
    assert kitchen["can"].pose == before


def test_sensors_move_with_what_they_sit_on(kitchen):
    robot, laser = kitchen["barrett_4918"], kitchen["barrett_4918_laser_scaner"]
    assert isinstance(laser, ssduck.Sensor)
    assert laser.spec.type == "planar_laser"
    assert laser.mass == 0
    robot.move([5, 6, 1], [np.cos(np.pi / 4), 0, 0, np.sin(np.pi / 4)])
    # Its offset is 0.35 m ahead and 0.65 m below; ahead is now along y.
    assert laser.position == pytest.approx([5, 6.35, 0.35], abs=1e-6)
    assert laser.aabb == (laser.position, laser.position)
    with pytest.raises(SelectScriptError, match="is a sensor; move the body that it is mounted on"):
        laser.move([0, 0, 0])


def test_openraves_spellings(kitchen):
    assert kitchen.GetRobot("barrett_4918") == kitchen["barrett_4918"]
    assert kitchen.GetRobot("can") is None
    assert kitchen.GetKinBody("can") == kitchen["can"]
    assert kitchen.GetSensor("fridge_webcam") == kitchen["fridge_webcam"]
    assert [e.GetName() for e in kitchen.GetRobots()] == [
        *("fridge", "cooker", "barrett_4918", "roomba_625x")
    ]
    assert len(kitchen.GetSensors()) == 8
    assert len(kitchen.GetBodies()) == 29
    box = kitchen["table"].ComputeAABB()
    assert box.pos() - box.extents() == pytest.approx(kitchen["table"].aabb[0])
    transform = kitchen["chair_2e39"].GetTransform()
    assert transform[:3, 3] == pytest.approx([0.95, -1.15, 0.0])
    assert transform[:3, :3] @ transform[:3, :3].T == pytest.approx(np.eye(3), abs=1e-9)
    assert kitchen["table"].GetEnv() is kitchen


@pytest.mark.slow
def test_an_interpreter_closes_only_the_world_that_it_loaded(client):
    pybullet.createMultiBody(physicsClientId=client)
    world = ssduck.World.attach(client)
    with ssduck.load("kitchen") as ss:
        kitchen = ss.call_variable("kitchen")
        ss.add_variable("mine", world)
    world.tick()
    with pytest.raises(SelectScriptError, match="closed"):
        kitchen.tick()


# -- collisions, drawing ---------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("row_by_row", [False, True])
def test_flags_are_seen_by_the_next_query(kitchen, row_by_row):
    with ssduck.Interpreter(row_by_row=row_by_row) as ss:
        ss.add_variable("kitchen", kitchen)
        disabled = (
            "SELECT id FROM kitchen WHERE NOT isEnabled(this) AND NOT isSensor(this) AS list;"
        )
        hidden = "SELECT id FROM kitchen WHERE NOT isVisible(this) AND NOT isSensor(this) AS list;"
        prepared = ss.compile(disabled)
        assert ss.eval(prepared) == ss.eval(hidden) == []
        kitchen["can"].enabled = False
        kitchen["roomba_625x"].visible = False
        assert (ss.eval(prepared), ss.eval(hidden)) == (["can"], ["roomba_625x"])
        sql = "SELECT name FROM entities WHERE kind <> 'sensor' AND NOT (enabled AND visible)"
        assert ss.sql(sql + " ORDER BY id").fetchall() == [("roomba_625x",), ("can",)]
        kitchen.step(3)
        assert not kitchen["can"].enabled
        assert kitchen["can"].visible
        assert not kitchen["roomba_625x"].visible
        kitchen["can"].enabled = True
        kitchen["roomba_625x"].visible = True
        assert ss.eval(prepared) == ss.eval(hidden) == []


def test_what_is_not_enabled_falls_through_the_table_and_back(client):
    """Bodies of all sorts, against what they did before: a fixed one, a robot, rigid ones."""
    pybullet.setGravity(0, 0, -10, client)
    box = pybullet.createCollisionShape(
        pybullet.GEOM_BOX, halfExtents=[0.5] * 3, physicsClientId=client
    )
    for index, position in enumerate(
        [(0, 0, 0), (0.3, 0, 0), (0, 0, 0.95), (6, 0, 0), (6, 0, 0.95), (0, 0.2, 1.9)]
    ):
        pybullet.createMultiBody(
            0 if index < 2 else 1,
            box,
            basePosition=position,
            useMaximalCoordinates=index in (3, 4),
            physicsClientId=client,
        )
    world = ssduck.World.attach(client)
    pybullet.performCollisionDetection(client)

    def touching():
        world.request_tables(["contacts"])
        world.tick()
        table = world.snapshot.tables["contacts"].arrow
        return set(zip(table["a"].to_pylist(), table["b"].to_pylist(), strict=True))

    before = touching()
    assert before == {(1, 3), (2, 3), (3, 6), (4, 5)}  # fixed ones do not meet each other
    for entity in world:
        entity.enabled = False
        assert not any(entity.id in pair for pair in touching())
        # The ray ends above all bodies but the last.
        (hit,) = pybullet.rayTest([0, 0.2, 9], [0, 0.2, 1.5], physicsClientId=client)
        assert hit[0] == (-1 if entity.id == 6 else 5)
        entity.enabled = True
        entity.enabled = True
        assert touching() == before


def test_a_robot_that_is_not_enabled_meets_nothing(write):
    write("carrier.urdf", CARRIER)
    write("table.urdf", robot(link("top", shapes=collision('<box size="9 9 1"/>'))))
    scene = '[[body]]\nname = "{}"\nurdf = "{}.urdf"\nfixed = {}\n'
    text = scene.format("carrier", "carrier", "false") + scene.format("table", "table", "true")
    world = ssduck.World.load(find_scene(write("room.toml", text)))
    world.request_tables(["contacts"])
    assert world.snapshot.tables["contacts"].count
    world["carrier"].enabled = False
    assert not world.snapshot.tables["contacts"].count
    world.step(24)
    assert not world.snapshot.tables["contacts"].count
    assert world["carrier"].velocity[2] < -0.9
    world.close()


@pytest.mark.slow
def test_what_is_hidden_is_not_drawn_and_gets_its_colours_back(kitchen):
    camera = Camera(eye=(2.5, 2.0, 2.5), target=(1.0, 0.4, 0.9))
    before = kitchen.render(160, 120, camera)
    for name in ("table", "cup_905a"):
        kitchen[name].visible = False
        kitchen[name].visible = False
        without = kitchen.render(160, 120, camera)
        assert (without != before).any()
        kitchen[name].visible = True
        assert (kitchen.render(160, 120, camera) == before).all()


def test_a_removed_bodys_state_does_not_pass_on(client):
    """PyBullet gives its number to the next body."""
    first = pybullet.createMultiBody(1, physicsClientId=client)
    world = ssduck.World.attach(client)
    (old,) = world
    old.enabled, old.visible = False, False
    pybullet.removeBody(first, client)
    assert pybullet.createMultiBody(1, physicsClientId=client) == first
    for change in (
        lambda: setattr(old, "enabled", True),
        lambda: setattr(old, "visible", True),
        lambda: old.move([1, 1, 1]),
        lambda: old.move([1, 1, 1], [1, 0, 0, 0]),
    ):
        with pytest.raises(RemovedEntityError, match="no longer"):
            change()
    (new,) = world.tick()
    assert (new.enabled, new.visible, new.position) == (True, True, [0, 0, 0])
    assert not world.simulator.disabled
    assert not world.simulator.hidden
    assert not world.simulator._colours


def test_sensors_and_closed_worlds_have_no_such_state(kitchen):
    eye = kitchen["fridge_webcam"]
    assert (eye.enabled, eye.visible) == (False, False)
    for name in ("enabled", "visible"):
        with pytest.raises(
            ArgumentError, match=r"is a sensor; (enable|show) the body that it is mounted on"
        ):
            setattr(eye, name, True)
    with pytest.raises(ArgumentError, match="is a sensor"):
        eye.move(joints=[])
    can = kitchen["can"]
    kitchen.close()
    for change in (
        lambda: setattr(can, "enabled", False),
        lambda: setattr(can, "visible", False),
        lambda: can.move(joints=[]),
        lambda: kitchen["roomba_625x"].move(joints=[0, 0]),
    ):
        with pytest.raises(SimulatorError, match="closed"):
            change()
    assert (can.enabled, can.visible) == (True, True)


@pytest.mark.slow
def test_nothing_is_set_while_a_query_runs(kitchen):
    with ssduck.Interpreter() as ss:
        ss.add_variable("kitchen", kitchen)

        def disable(thing):
            thing.enabled = False
            return True

        ss.add_function("disable", disable)
        with pytest.raises(SelectScriptError, match="a query on 'kitchen' is running"):
            ss.eval("SELECT id FROM kitchen WHERE disable(this);")
    assert kitchen["can"].enabled


# -- links, joints, sensors ------------------------------------------------------------------------

LIMIT = '<limit lower="-3" upper="3" effort="5" velocity="2"/>'
CARRIER = robot(
    link("base", com=(0.1, 0.2, 0.3), rpy=(0.4, 0, 0), shapes=collision('<box size="1 1 1"/>')),
    link("arm", com=(0, 0, 0.5), shapes=collision('<sphere radius="0.25"/>', xyz=(0, 0, 1))),
    joint("turn", "revolute", "base", "arm", xyz=(0, 0, 1), axis=(0, 1, 0), limit=LIMIT),
    name="carrier",
)
SCENE = """
gravity = [0, 0, 0]
timestep = 1e-6
[[body]]
name = "carrier"
urdf = "carrier.urdf"
position = [1, 2, 3]
orientation = [0.5, 0.5, 0.5, 0.5]
joints = { turn = 0.5 }
[[sensor]]
name = "on_the_arm"
type = "range_finder"
on = "carrier"
link = "arm"
position = [0.1, 0.2, 0.9]
orientation = [0.8, 0, 0.6, 0]
max_range = 1
"""


@pytest.fixture
def carrier(write):
    """A scene of a robot with a sensor on its arm."""
    write("carrier.urdf", CARRIER)
    world = ssduck.World.load(find_scene(write("room.toml", SCENE)))
    yield world
    world.close()


def test_a_sensor_is_a_point_that_moves_with_its_link(carrier):
    """Its pose by composition, its velocity by the change of its position."""
    client = carrier.simulator.client
    (handle,) = carrier.simulator._descriptions
    pybullet.resetBaseVelocity(handle, [1, 2, 3], [3, -2, 1], client)
    pybullet.setJointMotorControl2(
        handle, 0, pybullet.VELOCITY_CONTROL, force=0, physicsClientId=client
    )
    pybullet.resetJointState(handle, 0, 0.5, 4.0, client)
    carrier.tick()
    eye = carrier["on_the_arm"]
    before = np.array(eye.position)
    carrier.step()
    arm = Rotation.from_quat(pybullet.getLinkState(handle, 0, 0, 1, client)[5])
    place = pybullet.getLinkState(handle, 0, 0, 1, client)[4]
    assert eye.position == pytest.approx(arm.apply([0.1, 0.2, 0.9]) + place, abs=1e-6)
    turn = arm * Rotation.from_quat([0, 0.6, 0, 0.8])
    assert (turn.inv() * Rotation.from_quat(np.roll(eye.orientation, -1))).magnitude() < 1e-6
    assert (np.array(eye.position) - before) / 1e-6 == pytest.approx(eye.velocity[:3], abs=1e-3)
    assert np.linalg.norm(eye.velocity[:3]) > 3
    assert eye.velocity[3:] == pytest.approx(
        pybullet.getLinkState(handle, 0, 1, 1, client)[7], abs=1e-6
    )
    assert eye.aabb == (eye.position, eye.position)


def test_links_and_joints_of_a_robot(carrier):
    robot = carrier["carrier"]
    base, arm = robot.links
    assert [base.name, arm.name] == ["base", "arm"]
    assert base.position == robot.position == pytest.approx([1, 2, 3])
    # The base's z is the world's x; the joint, 1 m along it, turns about the base's y, which is
    # the world's z.
    assert arm.position == pytest.approx([2, 2, 3], abs=1e-6)
    centre = np.array([2 + np.cos(0.5), 2 + np.sin(0.5), 3])
    assert np.array(arm.aabb) == pytest.approx(np.array([centre - 0.25, centre + 0.25]), abs=1e-6)
    low, high = np.array(robot.aabb)
    assert low == pytest.approx(np.minimum(base.aabb[0], arm.aabb[0]))
    assert high == pytest.approx(np.maximum(base.aabb[1], arm.aabb[1]))
    assert (base.mass, arm.mass, robot.mass) == (1.0, 1.0, 2.0)
    (turn,) = robot.joints
    assert (turn.name, turn.type, turn.lower, turn.upper) == ("turn", "revolute", -3.0, 3.0)
    assert (turn.position, turn.velocity) == pytest.approx((0.5, 0.0))
    assert carrier["on_the_arm"].links == carrier["on_the_arm"].joints == []


def test_a_moved_robot_keeps_its_joints(carrier):
    robot = carrier["carrier"]
    robot.move([0, 0, 0], [1, 0, 0, 0])
    assert robot.joints[0].position == pytest.approx(0.5)
    assert robot.links[1].position == pytest.approx([0, 0, 1], abs=1e-6)
    assert carrier["on_the_arm"].position == pytest.approx(
        Rotation.from_rotvec([0, 0.5, 0]).apply([0.1, 0.2, 0.9]) + [0, 0, 1], abs=1e-6
    )


def test_joints_are_set_and_seen_by_the_next_query(carrier):
    robot = carrier["carrier"]
    pose = robot.pose
    with ssduck.Interpreter() as ss:
        ss.add_variable("room", carrier)
        for values in ({"turn": -0.25}, [0.75]):
            (value,) = values.values() if isinstance(values, dict) else values
            robot.move(joints=values)
            assert ss.sql("SELECT position, velocity FROM joints").fetchall() == [(value, 0.0)]
            assert robot.pose == pose
            # The joint's axis is the world's z here.
            centre = np.array([2 + np.cos(value), 2 + np.sin(value), 3])
            assert np.array(robot.links[1].aabb) == pytest.approx(
                np.array([centre - 0.25, centre + 0.25]), abs=1e-6
            )
    robot.move([0, 0, 0], [1, 0, 0, 0], {"turn": 0.5})
    assert robot.position == [0, 0, 0]
    assert robot.joints[0].position == 0.5


def test_motors_that_hold_joints_hold_them_where_they_are_set(write):
    """In a world that ssduck loaded; without gravity, so that they have nothing to lift."""
    write("carrier.urdf", CARRIER)
    scene = SCENE.replace("1e-6", "0.004").partition("[[sensor]]")[0]
    world = ssduck.World.load(find_scene(write("room.toml", scene)))
    world["carrier"].move(joints={"turn": -1.5})
    world.step(100)
    assert world["carrier"].joints[0].position == pytest.approx(-1.5, abs=0.01)
    world.close()


def test_motors_of_a_client_are_its_owners(client, write):
    path = write("carrier.urdf", CARRIER)
    handle = pybullet.loadURDF(str(path), useFixedBase=True, physicsClientId=client)
    pybullet.setJointMotorControl2(
        handle, 0, pybullet.POSITION_CONTROL, targetPosition=0.5, force=50, physicsClientId=client
    )
    world = ssduck.World.attach(client)
    world["carrier"].move(joints={"turn": -1.5})
    assert world["carrier"].joints[0].position == -1.5
    world.step(2000)
    assert world["carrier"].joints[0].position == pytest.approx(0.5, abs=0.05)


@pytest.mark.parametrize(
    ("joints", "error", "said"),
    [
        ({"tur": 0}, UnknownNameError, "carrier has no joint 'tur'; did you mean 'turn'?"),
        ({"turn": 3.5}, ValueError, "joint 'turn': 3.5 is not from -3 to 3, the joint's limits"),
        ({"turn": float("nan")}, ValueError, "joint 'turn': expected 1 finite numbers"),
        ([], ArgumentError, "takes 1 joint values (turn), found 0"),
        ([1, 2], ArgumentError, "takes 1 joint values (turn), found 2"),
    ],
)
def test_bad_joints_change_nothing(carrier, joints, error, said):
    robot = carrier["carrier"]
    before = robot.pose, robot.joints[0].position
    with pytest.raises(error) as caught:
        robot.move([9, 9, 9], joints=joints)
    assert said in str(caught.value)
    assert (robot.pose, robot.joints[0].position) == before


def test_openraves_setters(carrier):
    robot = carrier["carrier"]
    robot.SetDOFValues([0.25])
    assert robot.GetDOFValues().tolist() == [0.25]
    robot.SetDOFValues([-0.25], [0])
    assert robot.GetDOFValues().tolist() == [-0.25]
    for indices, said in (([1], "has no joint 1; it has 1"), ([], "0 indices, 1 values")):
        with pytest.raises(ArgumentError, match=said):
            robot.SetDOFValues([0.5], indices)
    turn = np.eye(4)
    turn[:3, :3] = Rotation.from_rotvec([0.1, 0.2, 0.3]).as_matrix()
    turn[:3, 3] = [1, 2, 3]
    robot.SetTransform(turn)
    assert robot.GetTransform() == pytest.approx(turn, abs=1e-9)
    robot.SetTransform([1, 0, 0, 0, 4, 5, 6])
    assert robot.pose == pytest.approx([1, 0, 0, 0, 4, 5, 6])
    for wrong in (np.zeros((4, 4)), [1, 2, 3], -np.eye(4)):
        with pytest.raises(ValueError, match="carrier: "):
            robot.SetTransform(wrong)
    robot.Enable(False)
    robot.SetVisible(False)
    assert not robot.IsEnabled()
    assert not robot.IsVisible()
    robot.Enable(True)
    robot.SetVisible(True)
    assert robot.IsEnabled()
    assert robot.IsVisible()


def test_contacts_are_of_where_things_are(kitchen):
    """As loaded and after a move, without a step."""
    kitchen.request_tables(["contacts"])
    can = kitchen["can"]

    def touching():
        table = kitchen.snapshot.tables["contacts"].arrow
        ids = zip(table["a"].to_pylist(), table["b"].to_pylist(), strict=True)
        return {a + b - can.id for a, b in ids if can.id in (a, b)}

    can.move(position=[0, 0, 50])
    assert touching() == set()
    x, y, _ = kitchen["table"].position
    can.move(position=[x, y, kitchen["table"].aabb[1][2] - 0.01])
    assert kitchen["table"].id in touching()


@pytest.mark.slow
def test_the_name_of_a_part_is_told_as_a_program_writes_it(tmp_path):
    """Names may be words of the language: each advice is a program."""
    words = (*CLAUSES, *RESERVED_WORDS, "THIS", "TRUE", "NULL", "CASE", "IF", "arm", "it's", "a b")
    names = sorted({word.lower() for word in words})
    (tmp_path / "m.urdf").write_text(
        robot(link("base"), link("tip"), joint("j", "fixed", "base", "tip"))
    )
    bodies = "".join(f'[[body]]\nname="{name}"\nurdf="m.urdf"\n' for name in names)
    (tmp_path / "scene.toml").write_text(f'name="lab"\n{bodies}')
    with (
        ssduck.load(tmp_path / "scene.toml") as ss,
        patch.object(entity_registry, "_MAX_OWNERS", 99),
    ):
        with pytest.raises(UnknownNameError) as raised:
            ss["lab"]["tip"]
        advice = raised.value.message.partition("write ")[2].split(" or ")
        assert "lab.arm.tip" in advice
        assert sorted(ss.eval(f"{each};").entity.name for each in advice) == names
