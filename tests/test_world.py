"""Worlds and handles of entities."""

from __future__ import annotations

import copy

import numpy as np
import pybullet
import pytest

import ssduck
from ssduck.errors import SelectScriptError, UnknownNameError
from ssduck.scenes import Camera


@pytest.fixture
def kitchen():
    with ssduck.load("kitchen") as ss:
        yield ss.call_variable("kitchen")


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
    assert repr(kitchen) == "<World 'kitchen': 37 entities, t=0 s>"


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
    with pytest.raises(SelectScriptError, match="is a sensor; move what it sits on"):
        laser.move([0, 0, 0])


def test_steps_and_time(kitchen):
    assert kitchen.time == 0.0
    assert kitchen.step() is kitchen
    assert kitchen.time == pytest.approx(1 / 240)
    kitchen.step(239)
    assert kitchen.time == pytest.approx(1.0, abs=1e-9)


def test_pictures(kitchen):
    picture = kitchen.render(160, 120)
    assert picture.shape == (120, 160, 3)
    assert picture.dtype == np.uint8
    colours = len(np.unique(picture.reshape(-1, 3), axis=0))
    assert colours > 100
    above = kitchen.render(160, 120, Camera(eye=(0.0, 0.1, 9.0), target=(0.0, 0.0, 0.0)))
    assert (above != picture).any()


def test_openraves_spellings(kitchen):
    assert kitchen.GetRobot("barrett_4918") == kitchen["barrett_4918"]
    assert kitchen.GetRobot("can") is None
    assert kitchen.GetKinBody("can") == kitchen["can"]
    assert kitchen.GetSensor("fridge_webcam") == kitchen["fridge_webcam"]
    assert [e.GetName() for e in kitchen.GetRobots()] == [
        *("fridge", "cooker", "barrett_4918", "roomba_625x"),
    ]
    assert len(kitchen.GetSensors()) == 8
    assert len(kitchen.GetBodies()) == 29
    box = kitchen["table"].ComputeAABB()
    assert box.pos() - box.extents() == pytest.approx(kitchen["table"].aabb[0])
    transform = kitchen["chair_2e39"].GetTransform()
    assert transform[:3, 3] == pytest.approx([0.95, -1.15, 0.0])
    assert transform[:3, :3] @ transform[:3, :3].T == pytest.approx(np.eye(3), abs=1e-9)
    assert kitchen["table"].GetEnv() is kitchen


def test_closing_twice(kitchen):
    kitchen.close()
    kitchen.close()
    with pytest.raises(SelectScriptError, match="closed"):
        kitchen.tick()


def test_an_interpreter_closes_only_the_world_that_it_loaded(client):
    pybullet.createMultiBody(physicsClientId=client)
    world = ssduck.World.attach(client)
    with ssduck.load("kitchen") as ss:
        kitchen = ss.call_variable("kitchen")
        ss.add_variable("mine", world)
    world.tick()
    with pytest.raises(SelectScriptError, match="closed"):
        kitchen.tick()
