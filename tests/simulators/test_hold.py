"""Bodies that hold others by a fixed constraint: `Entity.hold` and `Entity.release`."""

import numpy as np
import pybullet
import pytest

import ssduck
from ssduck.errors import (
    ArgumentError,
    RemovedEntityError,
    StateError,
    UnknownNameError,
    UnsupportedError,
)
from tests.support.urdf import collision, joint, link, robot

BOX = collision('<box size="0.1 0.1 0.1"/>')
LIMIT = '<limit lower="-1" upper="1" effort="500" velocity="2"/>'
# A slide over the floor with two jaws; what it holds is between them.
GRIPPER = robot(
    link("rail", mass=0.0),
    link("hand", shapes=BOX, com=(0.1, 0.0, 0.0), mass=2.0),
    link("left_jaw", shapes=BOX),
    link("right_jaw", shapes=BOX),
    joint("lift", "prismatic", "rail", "hand", xyz=(0, 0, 1), axis=(0, 0, 1), limit=LIMIT),
    joint("left", "fixed", "hand", "left_jaw", xyz=(0, 0.1, -0.1)),
    joint("right", "fixed", "hand", "right_jaw", xyz=(0, -0.1, -0.1)),
    name="gripper",
)
BALL = robot(link("ball", shapes=collision('<sphere radius="0.05"/>'), mass=0.3), name="ball")
SCENE = """name = "yard"
[[body]]
name = "gripper"
urdf = "gripper.urdf"
fixed = true
[[body]]
name = "ball"
urdf = "ball.urdf"
position = [0.0, 0.0, 0.88]
[[sensor]]
name = "eye"
type = "lidar"
max_range = 1.0
on = "gripper"
"""


@pytest.fixture
def yard(write):
    write("gripper.urdf", GRIPPER)
    write("ball.urdf", BALL)
    with ssduck.load(write("scene.toml", SCENE)) as ss:
        yield ss.call_variable("yard")


def between(world):
    """Where the ball is in the frame of the hand that holds it."""
    hand = next(one for one in world["gripper"].links if one.name == "hand")
    return np.array(world["ball"].position) - hand.position


@pytest.mark.slow
def test_what_is_held_goes_where_the_hand_goes(yard):
    gripper, ball = yard["gripper"], yard["ball"]
    before = np.array(ball.position)
    apart = between(yard)
    gripper.hold(ball, "hand")
    assert ball.position == pytest.approx(before)  # it moves nothing
    gripper.drive({"lift": 0.5})
    yard.step(480)
    assert ball.position == pytest.approx(before + [0.0, 0.0, 0.5], abs=0.01)
    assert between(yard) == pytest.approx(apart, abs=1e-3)
    turned = 2 * np.arccos(min(1.0, abs(ball.orientation[0])))
    assert turned < 0.01
    gripper.release(ball)
    yard.step(60)
    assert ball.position[2] < before[2] + 0.4  # it falls


@pytest.mark.parametrize(
    ("aside", "touching", "held"),
    [
        (0.0, 2, True),
        (0.0, 3, False),
        (0.0009, 2, True),  # 1.8 mm to one jaw, and 0.2 into the other
        (0.0009, 1, True),
    ],
)
def test_it_holds_what_enough_links_touch(yard, aside, touching, held):
    gripper, ball = yard["gripper"], yard["ball"]
    ball.move([0.0, aside, 0.88])
    if held:
        gripper.hold(ball, "hand", touching=touching)
        return
    with pytest.raises(StateError, match=f"not {touching}"):
        gripper.hold(ball, "hand", touching=touching)
    with pytest.raises(StateError, match="does not hold"):
        gripper.release(ball)


@pytest.mark.parametrize(("apart", "held"), [(0.0009, True), (0.0011, False)])
def test_it_touches_up_to_a_millimetre(yard, apart, held):
    gripper, ball = yard["gripper"], yard["ball"]
    ball.move([0.0, 0.2 + apart, 0.9])  # beside a jaw
    if held:
        gripper.hold(ball, "left_jaw")
        return
    with pytest.raises(StateError, match="move them there first"):
        gripper.hold(ball, "left_jaw")


def test_links_that_do_not_hang_on_it_do_not_count(yard):
    gripper, ball = yard["gripper"], yard["ball"]
    ball.move([0.0, 0.2, 0.9])
    with pytest.raises(StateError, match="0 links of 'right_jaw'"):
        gripper.hold(ball, "right_jaw")
    gripper.hold(ball)  # all hangs on the base


@pytest.mark.slow
def test_what_it_holds_is_held_in_an_excerpt(yard):
    gripper, ball = yard["gripper"], yard["ball"]
    gripper.hold(ball, "hand")
    excerpt = yard.excerpt(["gripper", "ball"])
    excerpt["gripper"].drive({"lift": 0.2})
    excerpt.step(240)
    assert excerpt["ball"].position[2] == pytest.approx(1.08, abs=0.01)
    excerpt["gripper"].release(excerpt["ball"])
    excerpt.step(60)
    assert excerpt["ball"].position[2] < 1.0
    gripper.release(ball)  # another simulation's is its own


@pytest.mark.parametrize("owned", [True, False])
def test_holding_twice_and_releasing_twice(yard, owned):
    world = yard
    client = yard.simulator.client
    if not owned:
        world = ssduck.World.attach(client, {0: "gripper", 1: "ball"})
    gripper, ball = world["gripper"], world["ball"]
    gripper.hold(ball, "hand")
    assert pybullet.getNumConstraints(client) == 1
    with pytest.raises(StateError, match="gripper holds ball already"):
        gripper.hold(ball, "left_jaw")
    assert pybullet.getNumConstraints(client) == 1
    gripper.release(ball)
    assert pybullet.getNumConstraints(client) == 0
    with pytest.raises(StateError, match="gripper does not hold ball"):
        gripper.release(ball)


def test_errors(yard):
    gripper, ball = yard["gripper"], yard["ball"]
    with pytest.raises(UnknownNameError, match="did you mean 'hand'"):
        gripper.hold(ball, "hnad")
    with pytest.raises(ArgumentError, match="gripper cannot hold itself"):
        gripper.hold(gripper)
    with pytest.raises(ArgumentError, match="eye is a sensor"):
        gripper.hold(yard["eye"])
    with pytest.raises(ArgumentError, match="no entity of the world"):
        gripper.hold("ball")
    maybe = yard.what_if()
    with pytest.raises(ArgumentError, match="no entity of the world"):
        maybe["gripper"].hold(ball)
    for act in ("hold", "release"):
        with pytest.raises(UnsupportedError, match="does not change"):
            getattr(maybe["gripper"], act)(maybe["ball"])
    gone = yard["ball"]
    yard.remove("ball")
    with pytest.raises(RemovedEntityError):
        gripper.hold(gone)
