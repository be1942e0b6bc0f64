"""Motors of joints: `Entity.drive`."""

import numpy as np
import pytest

import ssduck
from ssduck.errors import (
    ArgumentError,
    RemovedEntityError,
    SelectScriptError,
    StateError,
    UnknownNameError,
    UnsupportedError,
)
from tests.support.cases import sampled
from tests.support.urdf import collision, joint, link, robot

BOX = collision('<box size="0.1 0.1 0.1"/>')
LIMIT = '<limit lower="-1" upper="1" effort="30" velocity="0.5"/>'
# A boom that turns about a level axis, its weight beside it; a slide; a wheel; a ball joint.
CRANE = robot(
    link("base", shapes=BOX),
    link("boom", com=(0.5, 0, 0), mass=2.0),
    link("slide", mass=0.5),
    link("wheel", mass=0.5),
    link("ball", mass=0.1),
    joint("lift", "revolute", "base", "boom", axis=(0, -1, 0), limit=LIMIT),
    joint("push", "prismatic", "base", "slide", axis=(0, 1, 0), limit=LIMIT),
    joint("spin", "continuous", "base", "wheel", limit='<limit effort="5" velocity="20"/>'),
    joint("swivel", "spherical", "base", "ball"),
    name="crane",
)


@pytest.fixture
def crane(write):
    path = write("crane.urdf", CRANE)
    scene = write(
        "scene.toml", 'name="yard"\n[[body]]\nname="crane"\nurdf="crane.urdf"\nfixed=true\n'
    )
    assert path.parent == scene.parent
    with ssduck.load(scene) as ss:
        yield ss.call_variable("yard")["crane"]


def at(entity, name):
    return next(j for j in entity.joints if j.name == name)


@pytest.mark.slow
def test_motors_take_joints_to_positions_and_hold_them(crane):
    world = crane.world
    before = world.snapshot.number
    crane.drive({"lift": 0.6, "push": -0.4})
    assert world.snapshot.number == before  # nothing moves until the world is stepped
    assert at(crane, "lift").position == pytest.approx(0.0, abs=1e-3)
    world.step(600)
    assert at(crane, "lift").position == pytest.approx(0.6, abs=0.01)
    assert at(crane, "push").position == pytest.approx(-0.4, abs=0.01)
    crane.drive([-0.2, 0.1, 0.0])  # one for each joint whose position is a number
    world.step(600)
    assert at(crane, "lift").position == pytest.approx(-0.2, abs=0.01)
    assert at(crane, "push").position == pytest.approx(0.1, abs=0.01)


@pytest.mark.slow
def test_no_faster_than_the_model_allows(crane):
    crane.drive({"lift": 0.9})
    fastest = 0.0
    for _ in range(60):
        crane.world.step(4)
        fastest = max(fastest, abs(at(crane, "lift").velocity))
    assert 0.45 < fastest < 0.55


def test_motors_turn_joints_at_velocities(crane):
    crane.drive(velocities={"spin": -7.0})
    crane.world.step(240)
    assert at(crane, "spin").velocity == pytest.approx(-7.0, abs=0.05)
    assert at(crane, "spin").position == pytest.approx(-7.0, abs=0.2)


@pytest.mark.slow
def test_what_is_not_named_goes_on(crane):
    crane.drive({"push": 0.3}, velocities={"spin": 2.0})
    crane.world.step(480)
    crane.drive(velocities={"spin": 4.0})
    crane.world.step(480)
    assert at(crane, "push").position == pytest.approx(0.3, abs=0.01)
    assert at(crane, "spin").velocity == pytest.approx(4.0, abs=0.05)


@pytest.mark.parametrize(("effort", "holds"), [(2.0, False), (9.0, False), (11.0, True)])
def test_efforts_are_bounds(crane, effort, holds):
    """The boom's weight asks for 2 kg * 9.81 m/s² * 0.5 m = 9.81 N m."""
    crane.drive({"lift": 0.0}, efforts={"lift": effort})
    crane.world.step(240)
    assert (at(crane, "lift").position > -0.05) == holds


@sampled(
    ("arguments", "error", "says"),
    [
        ({"positions": {"lift": 1.1}}, StateError, "1.1 is not from -1 to 1"),
        ({"positions": {"lift": float("nan")}}, StateError, "finite"),
        ({"positions": {"lit": 0.1}}, UnknownNameError, "no joint 'lit'; did you mean 'lift'"),
        ({"positions": {"swivel": 0.1}}, ArgumentError, "'swivel' is spherical"),
        ({"positions": [0.1]}, ArgumentError, "takes 3 joint values"),
        ({"velocities": {"spin": 20.1}}, StateError, "velocity 20.1 is more than"),
        ({"velocities": {"spin": -20.1}}, StateError, "velocity -20.1 is more than"),
        ({"velocities": {"spn": 1.0}}, UnknownNameError, "did you mean 'spin'"),
        ({"positions": {"lift": 0.1}, "efforts": {"lift": 31.0}}, StateError, "effort 31 is more"),
        ({"positions": {"lift": 0.1}, "efforts": {"lift": -1.0}}, StateError, "effort -1 is below"),
        (
            {"positions": {"lift": 0.1}, "efforts": {"push": 1.0}},
            ArgumentError,
            "'push' has an eff",
        ),
        ({"positions": {"push": 0.1}, "velocities": {"push": 0.1}}, ArgumentError, "'push'"),
    ],
    every=3,
)
def test_what_cannot_be_done_is_refused_and_changes_nothing(crane, arguments, error, says):
    with pytest.raises(error, match=says):
        crane.drive(**arguments)
    crane.world.step(60)
    assert [j.position for j in crane.joints] == pytest.approx([0, 0, 0, 0], abs=1e-3)


def test_bounds_of_a_model_are_allowed(crane):
    crane.drive({"lift": 1.0}, velocities={"spin": 20.0}, efforts={"lift": 30.0, "spin": 0.0})
    crane.world.step(60)
    assert at(crane, "spin").position == pytest.approx(0.0, abs=1e-6)


def test_who_has_no_motors(crane):
    maybe = crane.world.what_if()
    with pytest.raises(UnsupportedError, match="does not change"):
        maybe["crane"].drive({"lift": 0.1})
    sensor = crane.world.add_sensor("range_finder", "crane", max_range=1.0)
    with pytest.raises(
        SelectScriptError, match="is a sensor; drive the body that it is mounted on"
    ):
        sensor.drive({"lift": 0.1})
    crane.world.remove("crane")
    with pytest.raises(RemovedEntityError):
        crane.drive({})


@pytest.mark.slow
def test_a_robot_drives_on_its_wheels():
    with ssduck.load("kitchen") as ss:
        kitchen = ss.call_variable("kitchen")
        barrett = kitchen["barrett_4918"]
        start = np.array(barrett.position)
        barrett.drive(velocities={"left_wheel": 2.0, "right_wheel": 2.0})
        kitchen.step(240)
        # Wheels of 0.24 m that turn at 2 rad/s; it takes a moment to get there.
        assert barrett.position[0] - start[0] == pytest.approx(0.44, abs=0.06)
        assert barrett.position[1:] == pytest.approx(start[1:].tolist(), abs=0.01)
