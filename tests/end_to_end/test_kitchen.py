"""The shipped kitchen is the tutorial's: names, poses, boxes, and it stands still."""

import itertools
import math
import tomllib
from pathlib import Path

import fcl
import numpy as np
import pytest

import ssduck

FACTS = tomllib.loads(
    (Path(__file__).parents[1] / "data" / "kitchen.toml").read_text(encoding="utf-8")
)
ON_THE_TABLE = [
    *("plate_835a", "plate_496f", "plate_fa76"),
    *("cup_905a", "cup_58a2", "cup_b6af", "cup_d441"),
]
ABOVE = sorted(
    [("table", name) for name in ON_THE_TABLE]
    + [("microwave", "pin_a091"), ("microwave", "pin_c671")]
)


@pytest.fixture(scope="module")
def loaded():
    """The kitchen as it is loaded."""
    with ssduck.load("kitchen") as ss:
        yield ss


@pytest.fixture(scope="module")
def settled():
    """The kitchen after two seconds, with where everything was before."""
    with ssduck.load("kitchen") as ss:
        kitchen = ss.call_variable("kitchen")
        before = {entity.name: entity.position for entity in kitchen}
        kitchen.step(480)
        yield ss, before


def test_names_kinds_and_load_order(loaded):
    kitchen = loaded.call_variable("kitchen")
    sensors = [sensor["name"] for sensor in FACTS["sensor"]]
    robots = [robot["name"] for robot in FACTS["robot"]]
    kinbodies = [body["name"] for body in FACTS["kinbody"]]
    assert [e.name for e in kitchen] == sensors + robots + kinbodies
    kinds = ["sensor"] * len(sensors) + ["robot"] * len(robots) + ["kinbody"] * len(kinbodies)
    assert [e.kind for e in kitchen] == kinds


@pytest.mark.parametrize("robot", FACTS["robot"], ids=lambda robot: robot["name"])
def test_robots_and_their_sensors(loaded, robot):
    kitchen = loaded.call_variable("kitchen")
    assert kitchen[robot["name"]].position == pytest.approx(robot["position"], abs=1e-9)
    parents = loaded.sql("SELECT name, parent FROM entities WHERE kind = 'sensor'").fetchall()
    sensors = [sensor["name"] for sensor in FACTS["sensor"] if sensor["on"] == robot["name"]]
    assert [name for name, parent in parents if parent == robot["name"]] == sensors


@pytest.mark.parametrize("sensor", FACTS["sensor"], ids=lambda sensor: sensor["name"])
def test_sensors_are_what_they_are_measured_to_be(loaded, sensor):
    spec = loaded.call_variable("kitchen")[sensor["name"]].spec
    found = {"type": spec.type, "period": spec.period, "max_range": spec.max_range}
    expected = {key: sensor[key] for key in sensor if key not in ("name", "on", "offset", "yaw")}
    found |= {key: spec.settings[key] for key in expected if key not in found}
    assert found == expected
    if "yaw" in sensor:
        w, x, y, z = spec.orientation
        turned = math.degrees(2 * math.atan2(z, w)) % 360
        assert (x, y, turned) == pytest.approx((0, 0, sensor["yaw"]))


@pytest.mark.parametrize("sensor", FACTS["sensor"], ids=lambda sensor: sensor["name"])
def test_sensors_are_where_they_are_mounted(loaded, sensor):
    """The robots are not turned, so that a sensor's offset is that in the world."""
    kitchen = loaded.call_variable("kitchen")
    place = np.add(kitchen[sensor["on"]].position, sensor["offset"])
    assert kitchen[sensor["name"]].position == pytest.approx(place, abs=1e-9)


@pytest.mark.parametrize("body", FACTS["kinbody"], ids=lambda body: body["name"])
def test_poses_boxes_and_volumes(loaded, body):
    entity = loaded.call_variable("kitchen")[body["name"]]
    assert entity.position == pytest.approx(body["position"], abs=1e-9)
    turn = np.array(body["orientation"]) / np.linalg.norm(body["orientation"])
    assert abs(float(np.dot(entity.orientation, turn))) == pytest.approx(1.0, abs=1e-9)
    low, high = entity.aabb
    assert low == pytest.approx(body["low"], abs=1e-5)
    assert high == pytest.approx(body["high"], abs=1e-5)
    halves = (np.array(high) - np.array(low)) / 2
    assert float(halves.prod()) == pytest.approx(body["volume"], rel=1e-4)


def collision_objects(ss):
    """FCL's objects of all shapes, from the tables alone: entity's name and object."""
    rows = ss.sql(
        "SELECT e.name, g.type, g.size_x, g.size_y, g.size_z, g.vertices, "
        "s.x, s.y, s.z, s.qw, s.qx, s.qy, s.qz FROM shapes s JOIN entities e ON e.id = s.entity "
        "JOIN geometries g ON g.id = s.geometry"
    )
    for name, kind, a, b, c, vertices, *pose in rows:
        if kind == "box":
            geometry = fcl.Box(a, b, c)
        elif kind == "sphere":
            geometry = fcl.Sphere(a)
        elif kind == "cylinder":
            geometry = fcl.Cylinder(a, b)
        else:
            assert kind == "hull", kind
            # FCL takes the hull of the vertices, whatever the faces are.
            faces = np.array([3, 0, 1, 2], dtype=np.int64)
            geometry = fcl.Convex(np.array(vertices), 1, faces)
        yield (
            name,
            fcl.CollisionObject(geometry, fcl.Transform(np.array(pose[3:]), np.array(pose[:3]))),
        )


def depth(first, second):
    """How deep two FCL objects are in each other, 0 if they are apart."""
    request = fcl.CollisionRequest(num_max_contacts=10, enable_contact=True)
    result = fcl.CollisionResult()
    fcl.collide(first, second, request, result)
    return max((contact.penetration_depth for contact in result.contacts), default=0.0)


@pytest.mark.slow
def test_nothing_starts_in_penetration(loaded):
    """No two shapes of different bodies are deeper than 1e-6 in each other."""
    objects = list(collision_objects(loaded))
    boxes = {e.name: np.array(e.aabb) for e in loaded.call_variable("kitchen")}
    asked = 0
    for (one, first), (other, second) in itertools.combinations(objects, 2):
        a, b = boxes[one], boxes[other]
        if one == other or (a[0] > b[1]).any() or (b[0] > a[1]).any():
            continue
        asked += 1
        assert depth(first, second) < 1e-6, (one, other)
    assert asked > 500


def test_the_check_of_penetration_can_fail(loaded):
    """A cup that is lowered by 5 mm is in the table."""
    objects = list(collision_objects(loaded))
    table = [thing for name, thing in objects if name == "table"]
    cup = [thing for name, thing in objects if name == "cup_905a"]
    for thing in cup:
        thing.setTranslation(thing.getTranslation() - np.array([0, 0, 0.005]))
    assert max(depth(a, b) for a in table for b in cup) > 1e-3


@pytest.mark.slow
def test_everything_stands_still(settled):
    """Plates and cups within 1 cm of where they were after two seconds, nothing moved by 2 cm."""
    ss, before = settled
    for entity in ss.call_variable("kitchen"):
        moved = float(np.linalg.norm(np.subtract(entity.position, before[entity.name])))
        assert moved < (0.01 if entity.name.startswith(("plate", "cup")) else 0.02), entity.name


@pytest.mark.slow
def test_the_plate_is_still_in_the_microwave(settled):
    ss, _ = settled
    kitchen = ss.call_variable("kitchen")
    low, high = kitchen["microwave"].aabb
    assert all(
        lower < value < upper
        for lower, value, upper in zip(low, kitchen["plate_b4e7"].position, high, strict=True)
    )


def over(a, b):
    (low, high), (x, y, _) = a.aabb, b.position
    return low[0] <= x <= high[0] and low[1] <= y <= high[1]


def test_the_tutorials_relations_hold_as_loaded_and_settled(loaded, settled):
    """By a loop over what the entities tell, sensors aside."""
    for ss in (loaded, settled[0]):
        bodies = [e for e in ss.call_variable("kitchen") if e.kind != "sensor"]
        table = ss.call_variable("kitchen")["table"]
        centre = (table.aabb[0][2] + table.aabb[1][2]) / 2
        pairs = [(a, b) for a, b in itertools.permutations(bodies, 2) if over(a, b)]
        above = [(a.name, b.name) for a, b in pairs if b.position[2] >= a.aabb[1][2]]
        assert sorted(above) == ABOVE
        below = [b.name for b in bodies if b != table and over(table, b) and b.position[2] < centre]
        assert below == ["chair_6b56", "chair_083c"]
        asked = (
            "SELECT a.name, b.name FROM entities a, entities b "
            "WHERE above(a, b) AND a.kind <> 'sensor' AND b.kind <> 'sensor'"
        )
        assert sorted(ss.sql(asked).fetchall()) == ABOVE


def test_the_robots_can_move(loaded):
    kitchen = loaded.call_variable("kitchen")
    arm = {joint.name: joint for joint in kitchen["barrett_4918"].joints}
    assert [name for name in arm if name[0] == "j" and name[1:].isdigit()] == [
        f"j{number}" for number in range(1, 8)
    ]
    assert all(arm[f"j{number}"].lower is not None for number in range(1, 8))
    assert {"f1", "f2", "f3", "spread", "left_wheel", "right_wheel"} <= set(arm)
    wheels = {joint.name for joint in kitchen["roomba_625x"].joints if joint.type == "revolute"}
    assert {"left_wheel", "right_wheel"} <= wheels


def test_what_is_furniture_is_fixed_and_what_is_not_has_a_mass(loaded):
    masses = dict(loaded.sql("SELECT name, mass FROM entities").fetchall())
    fixed = {name for name, mass in masses.items() if mass == 0.0}
    chairs = {body["name"] for body in FACTS["kinbody"] if body["name"].startswith("chair")}
    sensors = {sensor["name"] for sensor in FACTS["sensor"]}
    assert fixed == {"kitchen", "table", "sink", "fridge", "cooker"} | chairs | sensors
    assert 0.1 < masses["cup_905a"] < 1.0
    assert 5.0 < masses["microwave"] < 30.0
