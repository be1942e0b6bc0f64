"""What was recorded is to the last bit as it was: live, opened, in one go or in parts."""

from __future__ import annotations

import math
import random

import numpy as np
import pybullet
import pytest

import ssduck
from ssduck import Recording
from ssduck.geometry.poses import compose, cross, multiply, rotate, rotation_matrices
from ssduck.schema import RECORDABLE
from tests.support.cases import sampled
from tests.support.recorded import end_part

ALL = Recording(tables=RECORDABLE)
POSES = Recording()
PRESENT = (*RECORDABLE, "geometries")
PLACES = ("live", "parts", "copy", "file")


def turned(chance):
    turn = [chance.gauss(0, 1) for _ in range(4)]
    length = math.sqrt(sum(part * part for part in turn))
    return [part / length for part in turn]


def crooked(client):
    """Bodies of every build, of which nothing is along an axis: some fall, one stands."""
    chance = random.Random(1)  # noqa: S311  # no secret
    own = {"physicsClientId": client}
    pybullet.setGravity(0, 0, -9.81, **own)
    box = pybullet.createCollisionShape(
        pybullet.GEOM_BOX,
        halfExtents=[0.05, 0.1, 0.3],
        collisionFramePosition=[0.1, 0.2, 0.3],
        collisionFrameOrientation=turned(chance),
        **own,
    )
    can = pybullet.createCollisionShape(pybullet.GEOM_CYLINDER, radius=0.1, height=0.3, **own)
    for place in range(5):
        pybullet.createMultiBody(
            1,
            (box, can)[place % 2],
            basePosition=[0.2 * place, 0, 1],
            baseOrientation=turned(chance),
            baseInertialFramePosition=[0.1, 0.2, 0.1],
            baseInertialFrameOrientation=turned(chance),
            **own,
        )
    for place in range(3):
        pybullet.createMultiBody(
            1,
            box,
            basePosition=[place, 3, 1],
            baseOrientation=turned(chance),
            linkMasses=[1, 1],
            linkCollisionShapeIndices=[box, can],
            linkVisualShapeIndices=[-1, -1],
            linkPositions=[[0, 0, 0.3], [0, 0.1, 0.3]],
            linkOrientations=[turned(chance), turned(chance)],
            linkInertialFramePositions=[[0, 0, 0.3], [0.1, 0.2, 0.3]],
            linkInertialFrameOrientations=[turned(chance), turned(chance)],
            linkParentIndices=[0, 1],
            linkJointTypes=[pybullet.JOINT_REVOLUTE, pybullet.JOINT_REVOLUTE],
            linkJointAxis=[[1, 0, 0], [0, 1, 0]],
            **own,
        )
    pybullet.createMultiBody(
        0, box, basePosition=[0, 0, 0.2], baseOrientation=turned(chance), **own
    )
    world = ssduck.World.attach(client)
    world.add_sensor("range_finder", "body_5", "eye", orientation=turned(chance), max_range=5.0)
    return world


def told(ss, tables):
    """The present tick: each row as text, which tells the last bit, and a 0.0 from a -0.0."""
    rows = {table: ss.sql(f"SELECT * FROM {table} ORDER BY ALL").fetchall() for table in tables}
    return {table: list(map(repr, found)) for table, found in rows.items()}


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """What a live world told at some ticks, and where it was recorded: all of it, or poses."""
    place = tmp_path_factory.mktemp("bits")
    client = pybullet.connect(pybullet.DIRECT)
    world = crooked(client)
    with (
        ssduck.Interpreter(place / "file", recording=ALL) as ss,
        ssduck.Interpreter(recording=ALL) as other,
        ssduck.Interpreter(recording=POSES) as poses,
    ):
        for each in (ss, other, poses):
            each.add_variable("lab", world)
        told(ss, PRESENT)  # from now on each tick has them
        live = {}
        with other.record_to(place / "parts") as parts, ss.record_to(place / "live"):
            for tick in range(30):
                world.step(8)
                if tick % 7 == 0:
                    end_part(parts)
                if tick % 11 == 0:
                    ss.flush()
                live[world.time] = told(ss, PRESENT)
        other.export(place / "copy")
        poses.export(place / "poses")
    pybullet.disconnect(client)
    return place, live


@pytest.mark.slow
@sampled("name", PLACES, every=4)
def test_the_present_of_an_opened_record_is_as_it_was(recorded, name):
    place, live = recorded
    with ssduck.open(place / name) as ss:
        world = ss.call_variable("lab")
        for time in list(live)[::6] + list(live)[-1:]:
            world.seek(time)
            assert told(ss, PRESENT) == live[time]


@pytest.mark.slow
def test_so_is_what_follows_from_poses_alone(recorded):
    place, live = recorded
    with ssduck.open(place / "poses") as ss:
        world = ss.call_variable("lab")
        for time in list(live)[::6]:
            world.seek(time)
            assert told(ss, ("entities", "shapes")) == {
                table: live[time][table] for table in ("entities", "shapes")
            }


SUMMED = {
    "entities": "z",
    "links": "wz",
    "joints": "velocity",
    "shapes": "zmax",
    "contacts": "fx",
    "sensings": "measured",
}
PROGRAMS = [
    "SELECT contactForce(body_8, this) FROM lab{} AS list;",
    "sum((SELECT x(this) FROM lab{} AS list));",
    "SELECT force(this), torque(this) FROM lab WHERE isKinbody(this) AS list;",
    "[holds(near(body_0, body_8, 0.2)), least(clearance(body_0, body_8)), least(z(body_0))];",
]


@pytest.mark.long
def test_parts_make_no_difference(recorded):
    place, _ = recorded
    found = {}
    for name in PLACES:
        with ssduck.open(place / name) as ss:
            for each in ss.call_variable("lab"):
                ss.add_variable(each.name, each)
            tables = [ss.sql(f"FROM {table}_history ORDER BY ALL").df() for table in RECORDABLE]
            sums = [
                ss.sql(f"SELECT sum({column}), avg({column}) FROM {table}_history").fetchall()
                for table, column in SUMMED.items()
                if name != "file" or table != "links"  # whose rows are in another order there
            ]
            found[name] = (
                [repr(table.to_numpy().tolist()) for table in tables],
                [table.dtypes.to_dict() for table in tables],
                [ss.eval(program) for program in PROGRAMS],
                *([repr(sums)] if name != "file" else []),
            )
    assert found["parts"] == found["live"] == found["copy"]
    assert found["file"] == found["live"][:3]


@pytest.mark.parametrize("count", [1, 2, 3, 5, 8, 15, 16, 17, 33])
@pytest.mark.parametrize("start", [0, 1, 5])
def test_a_pose_does_not_depend_on_those_beside_it(count, start):
    chance = np.random.default_rng(0)
    turns, others = chance.normal(size=(2, 64, 4))
    turns /= np.linalg.norm(turns, axis=1)[:, None]
    points, vectors = chance.normal(size=(2, 64, 3))
    some = slice(start, start + count)
    for work, parts in (
        (rotation_matrices, (turns,)),
        (multiply, (turns, others)),
        (cross, (points, vectors)),
        (lambda q, v: rotate(rotation_matrices(q), v), (turns, vectors)),
        (lambda *four: np.hstack(compose(*four)), (points, turns, vectors, others)),
    ):
        few = work(*(part[some].copy() for part in parts))
        assert np.array_equal(few, work(*parts)[some])
