"""Recorded worlds for the tests of records."""

import os
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

import pytest

import ssduck
from ssduck import Recording
from ssduck.schema import RECORDABLE
from tests.support.bodies import create_linked_body, solid

pybullet = pytest.importorskip("pybullet")

ROOT = Path(__file__).resolve().parents[2]

ALL = Recording(tables=RECORDABLE)

POSIX = pytest.mark.skipif(os.name != "posix", reason="limits and signals of POSIX")

# What a world shows in SQL: the present, and what is kept of it.
PRESENT = (*RECORDABLE, "ticks", "geometries")

PAST = tuple(f"{table}_history" for table in (*RECORDABLE, "ticks"))

MODELS = tuple(
    f"{table}_model" for table in ("entities", "links", "joints", "shapes", "geometries")
)


def rows(ss, table, where=""):
    return ss.sql(f'SELECT * FROM "{table}" {where} ORDER BY ALL').fetchall()


@contextmanager
def nobody():
    """Another user than root, who may read everything."""
    if os.geteuid() != 0:
        yield
        return
    os.seteuid(65534)
    try:
        yield
    finally:
        os.seteuid(0)


def sphere(client, place, radius=0.1):
    """A ball that falls; its number."""
    return solid(client, pybullet.GEOM_SPHERE, 1, place, radius=radius)


def lively(client, names=()):
    """A world of a board, balls that fall on it and an arm of two links; it changes on its way."""
    pybullet.setGravity(0, 0, -9.81, client)
    box = {"physicsClientId": client}
    arm = pybullet.createCollisionShape(pybullet.GEOM_BOX, halfExtents=[0.05, 0.05, 0.3], **box)
    bodies = {
        "board": solid(client, pybullet.GEOM_BOX, 0, [0, 0, -0.05], halfExtents=[2, 2, 0.05]),
        "ball": sphere(client, [0.5, 0, 0.3]),
        "other": sphere(client, [-0.5, 0, 0.2]),
        "arm": create_linked_body(
            client,
            0,
            arm,
            basePosition=[0, 1, 0.3],
            linkPositions=[[0, 0, 0.3]],
            linkInertialFramePositions=[[0, 0, 0.3]],
            linkJointTypes=[pybullet.JOINT_REVOLUTE],
            linkJointAxis=[[1, 0, 0]],
        ),
    }
    named = {bodies[old]: new for old, new in zip(bodies, names, strict=False)}
    return {number: named.get(number, name) for name, number in bodies.items()}


def end_part(recording):
    """Stores the ticks so far as a part, which else takes as many ticks as a part has."""
    last = recording.flush()
    recording._folder.complete()
    return last


def live_lab(ss, client, recording=ALL, ticks=40):
    """A world `lab` of which bodies came and went, one has been switched off, with a sensor."""
    numbers = lively(client)
    world = ss.add_variable("lab", ssduck.World.attach(client, names=numbers))
    world.add_sensor(
        "range_finder",
        "arm",
        "eye",
        position=[0, -0.2, 0],
        orientation=[0.5**0.5, 0, 0.5**0.5, 0],
        max_range=5.0,
    )
    ss.record("lab", recording)
    for tick in range(ticks):
        if tick == 10:
            pybullet.removeBody(next(n for n, name in numbers.items() if name == "ball"), client)
        if tick == 15:
            sphere(client, [0.2, 0.2, 0.05], radius=0.15)
        if tick == 20:
            ss.flush()
            world["other"].enabled = False
        if tick == 30:
            world["other"].enabled = True
        world.step(2)
    return world


PROGRAMS = {
    "kitchen": [
        "SELECT id, position, orientation, mass, aabb FROM kitchen AS list;",
        "SELECT id(this) FROM kitchen WHERE isRobot(this) ORDER BY z(this) AS list;",
        "table = SELECT obj FROM kitchen WHERE id(this) == 'table' AS value;"
        " SELECT id FROM kitchen WHERE above(table, this) AS list;",
        "table = SELECT obj FROM kitchen WHERE id(this) == 'table' AS value;"
        " SELECT id, clearance(table, this) FROM kitchen WHERE on(table, this) AS list;",
        "SELECT id(a.this), id(b.this) FROM a=kitchen, b=kitchen"
        " WHERE collides(a.this, b.this) AS list;",
        "SELECT id(a.this), id(b.this) FROM a=kitchen, b=kitchen"
        " WHERE near(a.this, b.this, 0.002) AS list;",
        "SELECT id(a.this), id(b.this) FROM a=kitchen, b=kitchen"
        " WHERE inContact(a.this, b.this) AND id(a.this) < id(b.this) AS list;",
        "SELECT id(a.this), id(b.this) FROM a=kitchen, b=kitchen"
        " WHERE isSensor(a.this) AND isSensing(a.this, b.this) AS list;",
        "SELECT id(this), tick(this), time, z FROM kitchen{0.2} AS list;",
        "SELECT id(this), tick(this) FROM kitchen{-0.1}"
        " WHERE isRobot(this) AND x(this) > 0 AS list;",
        "SELECT id(a.this), id(b.this), tick(a.this) FROM a=kitchen{-0.05}, b=kitchen{-0.05}"
        " WHERE touching(a.this, b.this) AND id(a.this) < id(b.this) AS list;",
        "count(SELECT this FROM kitchen{} AS list);",
        "getTime();",
    ],
    "lab": [
        "SELECT id, type, tick, position, velocity, isEnabled(this) FROM lab{} AS list;",
        "SELECT id, isSphere(this), isBox(this), volume(this) FROM lab{} AS list;",
        "SELECT id(a.this), id(b.this), tick(a.this), penetration(a.this, b.this)"
        " FROM a=lab{}, b=lab{} WHERE collides(a.this, b.this) AS list;",
        "SELECT id(a.this), id(b.this), clearance(a.this, b.this) FROM a=lab{0.1}, b=lab{0.1}"
        " WHERE id(a.this) < id(b.this) AS list;",
        "SELECT id(a.this), id(b.this), contactForce(a.this, b.this) FROM a=lab, b=lab"
        " WHERE inContact(a.this, b.this) AS list;",
        "SELECT id(a.this), id(b.this) FROM a=lab, b=lab"
        " WHERE isSensor(a.this) AND isSensing(a.this, b.this) AS list;",
        "SELECT id, x, y, z FROM lab WHERE isSensor(this) AS list;",
    ],
}


def answer(ss, program):
    """What a program gives, or why it does not."""
    try:
        return repr(ss.eval(program))
    except ssduck.SelectScriptError as error:
        return repr(error)


def python(code, *arguments):
    """What Python prints in a process of its own, which succeeds."""
    done = subprocess.run(
        [sys.executable, "-c", code, *map(str, arguments)],
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout
