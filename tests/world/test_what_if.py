"""What-if worlds: poses that were never simulated, against moving the bodies there."""

import math

import numpy as np
import pybullet
import pybullet_data
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import ssduck
from ssduck.errors import (
    ArgumentError,
    RemovedEntityError,
    SqlError,
    StateError,
    UnknownNameError,
    UnsupportedError,
)
from ssduck.simulators.pybullet.simulator import PyBulletSimulator
from ssduck.simulators.scenes import find_scene
from tests.support.arm import ARM, HIGH, LOW, POSE, TWIST, unsettle
from tests.support.bodies import create_linked_body
from tests.support.cases import sampled
from tests.support.spy import Spy
from tests.support.stage import Stage
from tests.support.urdf import collision, joint, link, robot

EQUAL = 1e-6
TABLES = {
    "entities": [*POSE, *TWIST, *LOW, *HIGH],
    "links": [*POSE, *TWIST, *LOW, *HIGH],
    "shapes": [*POSE, *LOW, *HIGH],
    "joints": ["position", "velocity"],
}
KEYS = ("id", "name", "kind", "parent", "entity", "link", "shape", "geometry", "mass", "time")
KEYS += ("enabled", "visible")


@pytest.fixture(scope="module")
def kitchen():
    with ssduck.load("kitchen") as ss:
        yield ss.call_variable("kitchen")


def told(world):
    """All that the tables of these names say, the numbers apart; q and -q are one orientation."""
    world.request_tables(TABLES)
    numbers, rest = {}, {}
    for name, columns in TABLES.items():
        arrow = world.snapshot.tables[name].arrow
        rows = np.array([arrow[column].to_numpy() for column in columns])
        if "qw" in columns:
            most = np.abs(rows[3:7]).argmax(axis=0)
            rows[3:7] *= np.sign(np.take_along_axis(rows[3:7], most[None], axis=0))
        numbers[name] = rows
        rest[name] = arrow.select([c for c in arrow.column_names if c in KEYS]).to_pylist()
    return numbers, rest


def assert_same(one, other):
    (numbers, rest), (others, others_rest) = one, other
    assert rest == others_rest
    for name, rows in numbers.items():
        assert np.allclose(rows, others[name], rtol=0, atol=EQUAL), name
        assert not np.isnan(rows).any()


def settable(entity):
    return [joint for joint in entity.joints if joint.type in ("revolute", "prismatic")]


def limits(joint):
    return (-9.0, 9.0) if joint.lower is None else (joint.lower, joint.upper)


REAL = st.floats(-20, 20)
QUATERNION = st.lists(st.floats(-1, 1), min_size=4, max_size=4).filter(
    lambda q: np.abs(q).max() > 1e-3
)
POSES = st.tuples(QUATERNION, st.lists(REAL, min_size=3, max_size=3)).map(lambda p: p[0] + p[1])


@st.composite
def changes(draw, world, names):
    """Poses and joints of some entities."""
    moved = draw(st.lists(st.sampled_from(names), min_size=1, max_size=3, unique=True))
    poses, joints = {}, {}
    for name in moved:
        own = settable(world[name])
        chosen = draw(st.lists(st.sampled_from(own), unique_by=id)) if own else []
        if chosen:
            joints[name] = {j.name: draw(st.floats(*limits(j))) for j in chosen}
        if not chosen or draw(st.booleans()):
            poses[name] = draw(POSES)
    return poses, joints


def move(world, poses, joints):
    for name in {**poses, **joints}:
        pose = poses.get(name)
        turn, place = (pose[:4], pose[4:]) if pose else (None, None)
        world[name].move(place, turn, joints.get(name))


# -- the oracle: the bodies themselves, moved -------------------------------------------------------


@pytest.mark.slow
@given(st.data())
def test_what_if_is_moving_the_body_and_asking_again_in_the_kitchen(kitchen, data):
    bodies = [entity.name for entity in kitchen if entity.kind != "sensor"]
    poses, joints = data.draw(changes(kitchen, bodies))
    before = told(kitchen)
    maybe = kitchen.what_if(poses, joints)
    guess = told(maybe)
    assert_same(told(kitchen), before)
    originals = {name: kitchen[name].pose for name in {**poses, **joints}}
    positions = {name: [j.position for j in settable(kitchen[name])] for name in originals}
    try:
        move(kitchen, poses, joints)
        assert_same(guess, told(kitchen))
    finally:
        move(kitchen, originals, positions)
    assert_same(told(maybe), guess)


LIMIT = '<limit lower="-1.5" upper="2" effort="5" velocity="2"/>'
TYPES = ("revolute", "prismatic", "continuous", "fixed", "spherical")


def random_robot(seed, links=9):
    """A tree of links with inertial frames off their frames, and joints of all types."""
    rng = np.random.default_rng(seed)
    parts = []
    for number in range(links):
        shape = collision(
            '<box size="0.3 0.2 0.1"/>', xyz=rng.normal(size=3), rpy=rng.normal(size=3)
        )
        shapes = shape if number % 3 else ""
        com, rpy = rng.normal(size=3), rng.normal(size=3)
        parts.append(link(f"l{number}", com=com, rpy=rpy, shapes=shapes))
        if number:
            kind = TYPES[rng.integers(len(TYPES)) if number > 5 else number - 1]
            parts.append(
                joint(
                    f"j{number}",
                    kind,
                    f"l{rng.integers(max(0, number - 3), number)}",
                    f"l{number}",
                    xyz=rng.normal(size=3),
                    rpy=rng.normal(size=3),
                    axis=rng.normal(size=3),
                    limit=LIMIT if kind in ("revolute", "prismatic") else "",
                )
            )
    return robot(*parts)


def set_spherical(client, handle, rng):
    for index in range(pybullet.getNumJoints(handle, client)):
        if pybullet.getJointInfo(handle, index, client)[2] == pybullet.JOINT_SPHERICAL:
            turn = rng.normal(size=4)
            turn /= np.linalg.norm(turn)
            pybullet.resetJointStateMultiDof(
                handle, index, turn, rng.normal(size=3), physicsClientId=client
            )


@pytest.mark.slow
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    seed=st.integers(0, 1000), fixed=st.booleans(), scale=st.sampled_from([1, 2.5]), data=st.data()
)
def test_what_if_of_a_random_robot(client, write, seed, fixed, scale, data):
    """In motion: what is not set keeps its velocity."""
    pybullet.resetSimulation(physicsClientId=client)
    path = write(f"{seed}.urdf", random_robot(seed))
    for _ in range(2):
        handle = pybullet.loadURDF(
            str(path), useFixedBase=fixed, globalScaling=scale, physicsClientId=client
        )
        unsettle(client, handle, seed)
        set_spherical(client, handle, np.random.default_rng(seed))
    world = ssduck.World.attach(client)
    poses, joints = data.draw(changes(world, ["model", "model_2"]))
    guess = told(world.what_if(poses, joints))
    move(world, poses, joints)
    assert_same(guess, told(world))


LIBRARY = [
    *("kuka_iiwa/model.urdf", "franka_panda/panda.urdf", "r2d2.urdf", "humanoid/humanoid.urdf"),
    *("pr2_gripper.urdf", "laikago/laikago_toes.urdf", "kuka_iiwa/kuka_with_gripper.sdf"),
    *("mjcf/ant.xml", "mjcf/humanoid.xml", "arm"),
]


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*does not give back all shapes")
@sampled("model", LIBRARY, every=5)
def test_what_if_of_models_of_the_library(client, write, capfd, model):
    pybullet.setAdditionalSearchPath(pybullet_data.getDataPath(), client)
    path = str(write("arm.urdf", ARM)) if model == "arm" else model
    suffix = path[-4:]
    load = {"urdf": pybullet.loadURDF, ".sdf": pybullet.loadSDF, ".xml": pybullet.loadMJCF}[suffix]
    loaded = load(path, physicsClientId=client)
    for handle in loaded if isinstance(loaded, tuple) else [loaded]:
        unsettle(client, handle, 5)
    world = ssduck.World.attach(client)
    rng = np.random.default_rng(5)
    for part in (slice(None), slice(0, None, 2), slice(1, None, 3)):
        joints = {
            e.name: {j.name: rng.uniform(*limits(j)) for j in settable(e)[part]} for e in world
        }
        poses = {e.name: rng.normal(size=7).tolist() for e in world}
        guess = told(world.what_if(poses, joints))
        move(world, poses, joints)
        assert_same(guess, told(world))


@pytest.mark.parametrize("axis", [(0, 0, 1), (1, 2, 2), (0.1, 0.2, 0)])
def test_axes_of_any_length(client, axis):
    shape = pybullet.createCollisionShape(
        pybullet.GEOM_BOX, halfExtents=[0.1, 0.2, 0.3], physicsClientId=client
    )
    create_linked_body(
        client,
        1,
        shape,
        linkPositions=[[0.1, 0.2, 0.3]] * 2,
        linkOrientations=[[0.1, 0.1, 0.7, 0.7]] * 2,
        linkInertialFramePositions=[[0.1, 0, 0.2]] * 2,
        linkInertialFrameOrientations=[[0, 0.6, 0, 0.8]] * 2,
        linkJointTypes=[pybullet.JOINT_PRISMATIC, pybullet.JOINT_REVOLUTE],
        linkJointAxis=[axis] * 2,
    )
    world = ssduck.World.attach(client)
    (body,) = world
    guess = told(world.what_if(joints={body: [0.4, 0.7]}))
    body.move(joints=[0.4, 0.7])
    assert_same(guess, told(world))


# -- what it is ------------------------------------------------------------------------------------


class Untouchable(Spy):
    """A spy that lets nothing through that changes or reads anything, if it is told so."""

    calls = 0
    open = True

    def __getattr__(self, name):
        if name in (
            "place",
            "step",
            "set_joints",
            "enable",
            "show",
            "close",
            "render",
            "read_link_poses",
        ):
            self._touched()
        return super().__getattr__(name)

    def _touched(self):
        self.calls += 1
        assert self.open, "the simulator was touched"

    def _check(self, what):
        self._touched()


@pytest.fixture
def spied(client, write):
    """A world of a robot and a box, and the spy on its simulator."""
    pybullet.loadURDF(str(write("arm.urdf", ARM)), physicsClientId=client)
    Stage(client).box("box", (3, 0, 0), half=0.1, mass=1)
    spy = Untouchable(PyBulletSimulator(client, owned=True, names={0: "arm", 1: "box"}))
    return ssduck.World(spy), spy


def test_the_simulator_is_read_once_and_never_changed(spied, client):
    world, spy = spied
    world.what_if()
    spy.open = False
    maybe = world.what_if({"box": [1, 0, 0, 0, 5, 6, 7]}, {"arm": {"shoulder": 0.5}})
    again = maybe.what_if({"arm": [1, 0, 0, 0, 5, 6, 7]})
    assert told(again)[1] == told(maybe)[1]
    assert maybe["box"].position == again["box"].position == [5, 6, 7]
    assert again["arm"].joints[0].position == 0.5
    assert maybe["arm"].joints[0].position == 0.5
    assert world["box"].position == pytest.approx([3, 0, 0])
    assert pybullet.getBasePositionAndOrientation(1, client)[0] == (3, 0, 0)
    assert pybullet.getJointState(0, 0, client)[0] == 0.0
    maybe.close()
    spy.open = True


def test_it_is_of_its_tick_whatever_the_world_does_later(stage):
    for x, name in enumerate("abc"):
        stage.sphere(name, (x, 0, 0), radius=0.1, mass=1)
    pybullet.setGravity(0, 0, -10, stage.client)
    world = stage.open()
    world.step(24)
    time, number, height = world.time, world.snapshot.number, world["c"].position[2]
    maybe = world.what_if({"a": [1, 0, 0, 0, 0, 0, 5]})
    before = told(maybe)
    world.step(24)
    pybullet.removeBody(1, stage.client)
    world.tick()
    maybe.tick()
    assert_same(told(maybe), before)
    assert (maybe.time, maybe.snapshot.number) == (time, number)
    assert maybe["c"].position[2] == height
    assert [entity.name for entity in maybe] == ["a", "b", "c"]
    assert maybe["a"].velocity == [0] * 6
    assert maybe["c"].velocity[2] < -0.9
    ticks = maybe.snapshot.tables["links"].arrow["tick"].to_pylist()
    assert set(ticks) == {number}
    world.close()
    assert len(maybe) == 3


def test_sensors_move_along(write):
    write(
        "carrier.urdf",
        robot(
            link("base"),
            link("arm"),
            joint("turn", "revolute", "base", "arm", xyz=(0, 0, 1), axis=(0, 1, 0), limit=LIMIT),
        ),
    )
    scene = write(
        "room.toml",
        '[[body]]\nname = "carrier"\nurdf = "carrier.urdf"\n[[sensor]]\nname = "eye"\n'
        'type = "range_finder"\non = "carrier"\nlink = "arm"\nposition = [1, 0, 0]\nmax_range = 1\n',
    )
    world = ssduck.World.load(find_scene(scene))
    maybe = world.what_if(joints={"carrier": {"turn": math.pi / 2}})
    assert maybe["eye"].position == pytest.approx([0, 0, 0], abs=1e-9)
    assert world["eye"].position == pytest.approx([1, 0, 1], abs=1e-9)
    world["carrier"].move(joints={"turn": math.pi / 2})
    assert world["eye"].pose == pytest.approx(maybe["eye"].pose, abs=1e-9)
    world.close()


def test_handles_of_several_worlds(kitchen):
    maybe = kitchen.what_if({kitchen["can"]: [1, 0, 0, 0, 0, 0, 3]})
    assert maybe["can"] != kitchen["can"]
    assert maybe["can"].id == kitchen["can"].id
    assert kitchen["can"] not in maybe
    assert "can" in maybe
    assert isinstance(maybe["fridge_webcam"], ssduck.Sensor)
    assert repr(maybe).startswith(
        "<World 'world': 37 entities (8 sensors, 4 robots, 25 kinbodies: "
    )
    assert maybe["can"].pose == [1, 0, 0, 0, 0, 0, 3]


def test_efforts_are_unknown(kitchen):
    maybe = kitchen.what_if()
    assert {joint.effort for entity in maybe for joint in entity.joints} == {None}


def test_flags_are_carried_over(kitchen):
    kitchen["can"].enabled = False
    kitchen["can"].visible = False
    maybe = kitchen.what_if()
    kitchen["can"].enabled = True
    kitchen["can"].visible = True
    assert (maybe["can"].enabled, maybe["can"].visible) == (False, False)
    assert (maybe["sink"].enabled, maybe["sink"].visible) == (True, True)
    kitchen.tick()
    assert (kitchen["can"].enabled, kitchen["can"].visible) == (True, True)


def test_a_lost_body_stays_lost(client):
    for _ in range(2):
        pybullet.createMultiBody(1, physicsClientId=client)
    world = ssduck.World.attach(client, names={0: "lost", 1: "kept"})
    pybullet.resetBasePositionAndOrientation(0, [math.nan, 0, 0], [0, 0, 0, 1], client)
    with pytest.warns(UserWarning, match="no number"):
        world.tick()
    maybe = world.what_if({"kept": [1, 0, 0, 0, 0, 0, 3]})
    assert maybe["kept"].position == [0, 0, 3]
    assert math.isnan(maybe["lost"].position[0])
    assert maybe.what_if({"lost": [1, 0, 0, 0, 0, 0, 3]})["lost"].position == [0, 0, 3]


# -- queries ---------------------------------------------------------------------------------------


@pytest.mark.slow
@sampled("row_by_row", [False, True], every=2)
def test_programs(kitchen, row_by_row):
    low, high = kitchen["table"].aabb
    over = [(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, high[2] + 0.2]
    with ssduck.Interpreter(row_by_row=row_by_row) as ss:
        ss.add_variable("kitchen", kitchen)
        maybe = ss.add_variable("maybe", kitchen.what_if({"roomba_625x": [1, 0, 0, 0, *over]}))
        assert maybe.name == "maybe"
        program = (
            "table = SELECT this FROM {0} WHERE id(this) == 'table' AS value;"
            "SELECT id FROM {0} WHERE above(table, this) AND isRobot(this) AS list;"
        )
        assert ss.eval(program.format("kitchen")) == []
        assert ss.eval(program.format("maybe")) == ["roomba_625x"]
        assert ss.eval(
            "SELECT id(a.this) FROM a=kitchen, b=maybe WHERE id(a.this) == id(b.this) "
            "AND z(a.this) < z(b.this) AND NOT isSensor(a.this) AS list;"
        ) == ["roomba_625x"]
        kitchen["can"].visible = False
        try:
            assert ss.eval(
                "SELECT id FROM kitchen WHERE isKinbody(this) AND NOT isVisible(this) AS list;"
            ) == ["can"]
            assert (
                ss.eval(
                    "SELECT id FROM maybe WHERE isKinbody(this) AND NOT isVisible(this) AS list;"
                )
                == []
            )
        finally:
            kitchen["can"].visible = True


@pytest.mark.slow
def test_the_sensors_of_the_first_world_go_on_perceiving():
    with ssduck.load("kitchen") as ss:
        kitchen = ss.call_variable("kitchen").step(10)
        maybe = ss.add_variable("maybe", kitchen.what_if({"cup_905a": [1, 0, 0, 0, 5, 5, 5]}))
        ss.add_variable("table", kitchen["table"])
        seen = ss.eval("SELECT id FROM kitchen WHERE isSensing(this, table) AS list;")
        assert seen == ["fridge_webcam", "barrett_4918_laser_scaner"]
        for ask in (
            lambda: maybe["fridge_webcam"].depth,
            lambda: ss.eval("SELECT id FROM maybe WHERE isSensing(this, this) AS list;"),
            lambda: ss.sql("FROM maybe.sensings"),
        ):
            with pytest.raises((UnsupportedError, SqlError), match="perceive nothing in a what-if"):
                ask()
        assert len(ss.sql("FROM kitchen.sensings")) > 5
        for world in ("kitchen", "maybe"):
            ss.add_variable("table", ss.call_variable(world)["table"])
            assert ss.eval(f"SELECT id FROM {world} WHERE near(table, this, 0.1) AS list;")
        assert len(maybe["barrett_4918"].links) > 10
        assert len(maybe.what_if({})) == len(kitchen)


@pytest.mark.slow
def test_sql_across_two_worlds(kitchen):
    with ssduck.Interpreter() as ss:
        ss.add_variable("kitchen", kitchen)
        ss.add_variable("maybe", kitchen.what_if({"can": [1, 0, 0, 0, 0, 0, 3]}))
        rows = ss.sql(
            "SELECT name, m.z FROM kitchen.entities k JOIN maybe.entities m USING (id, name, tick) "
            "WHERE k.z <> m.z"
        )
        assert rows.fetchall() == [("can", 3.0)]
        ((links,),) = ss.sql("SELECT count(*) FROM maybe.links").fetchall()
        assert links == len(kitchen.snapshot.tables["links"].arrow)
        assert ss.sql("FROM entities WHERE name = 'can'").fetchall()[0][6] != 0.0
        assert ss.sql("SELECT count(*) FROM kitchen.contacts").fetchall()[0][0] > 0
        for sql in ("FROM {0}", "SELECT count(*) FROM {0}", "SELECT a FROM {0} WHERE a = 3"):
            with pytest.raises(SqlError, match="what-if world has no contacts"):
                ss.sql(sql.format("maybe.contacts"))
        ss.add_variable("maybe", kitchen)
        ss.sql("FROM maybe.contacts")
        columns = ss.sql("DESCRIBE maybe.contacts").fetchall()
        assert columns == ss.sql("DESCRIBE kitchen.contacts").fetchall()


# -- errors ----------------------------------------------------------------------------------------

POSE_AT_0 = [1, 0, 0, 0, 0, 0, 0]


@pytest.mark.parametrize(
    ("poses", "joints", "error", "said"),
    [
        ({"cann": POSE_AT_0}, None, UnknownNameError, "no entity 'cann'; did you mean 'can'"),
        ({"can": [1, 0, 0, 0]}, None, StateError, "can: pose w, x, y, z, x, y, z: expected 7 finite"),
        ({"can": None}, None, StateError, "found None"),
        ({"can": "upright"}, None, StateError, "expected 7 finite numbers"),
        ({"can": [1, 0, 0, 0, 0, 0, math.nan]}, None, StateError, "expected 7 finite numbers"),
        ({"can": [math.inf, 0, 0, 0, 0, 0, 0]}, None, StateError, "expected 7 finite numbers"),
        ({"can": [0] * 7}, None, StateError, "can: orientation: w, x, y, z are all 0"),
        ({"fridge_webcam": POSE_AT_0}, None, ArgumentError, "fridge_webcam is a sensor; move the body"),
        (None, {"fridge_webcam": []}, ArgumentError, "fridge_webcam is a sensor"),
        (None, {"roomba_625x": {"left_whel": 1}}, UnknownNameError, "no joint 'left_whel'; did you mean 'left_wheel'"),
        (None, {"roomba_625x": {"caster_mount": 1}}, ArgumentError, "'caster_mount' is fixed; only a joint"),
        (None, {"roomba_625x": {"left_wheel": math.nan}}, StateError, "joint 'left_wheel': expected 1 finite"),
        (None, {"roomba_625x": {"left_wheel": "x"}}, StateError, "joint 'left_wheel': expected 1 finite"),
        (None, {"roomba_625x": [1]}, ArgumentError, "takes 2 joint values (left_wheel, right_wheel), found 1"),
        (None, {"can": [1]}, ArgumentError, "can takes 0 joint values (none), found 1"),
    ],
)  # fmt: skip
def test_errors(kitchen, poses, joints, error, said):
    before = told(kitchen)
    with pytest.raises(error) as caught:
        kitchen.what_if(poses, joints)
    assert said in str(caught.value)
    assert isinstance(caught.value, ssduck.SelectScriptError)
    assert_same(told(kitchen), before)


def test_limits_of_joints(spied):
    world, _ = spied
    for value in (-2.6, 1.6):
        with pytest.raises(ValueError, match=r"arm: joint 'shoulder': .* is not from -2.5 to 1.5"):
            world.what_if(joints={"arm": {"shoulder": value}})
    world.what_if(joints={"arm": {"shoulder": 1.5 + 1e-6, "roll": 100.0}})


def test_it_does_not_change(kitchen):
    maybe = kitchen.what_if()
    with pytest.raises(UnsupportedError, match="not simulated: it cannot be stepped"):
        maybe.step()
    with pytest.raises(UnsupportedError, match="has no picture"):
        maybe.render()
    can = maybe["can"]
    for change in (
        lambda: can.move([0, 0, 0]),
        lambda: maybe["roomba_625x"].move(joints=[1, 1]),
        lambda: setattr(can, "enabled", False),
        lambda: setattr(can, "visible", False),
    ):
        with pytest.raises(UnsupportedError, match="does not change: ask what if"):
            change()
    assert maybe.what_if()["can"].pose == can.pose == kitchen["can"].pose


def test_entities_of_other_worlds_and_removed_ones(client, kitchen):
    pybullet.createMultiBody(1, physicsClientId=client)
    world = ssduck.World.attach(client, names={0: "thing"}, name="mine")
    with pytest.raises(ArgumentError, match="'can'> is in world 'kitchen', not in 'mine'"):
        world.what_if({kitchen["can"]: POSE_AT_0})
    thing = world["thing"]
    pybullet.removeBody(0, client)
    world.tick()
    with pytest.raises(RemovedEntityError, match="'thing' is no longer"):
        world.what_if({thing: POSE_AT_0})
    with pytest.raises(UnknownNameError, match="no entity 'thing'"):
        world.what_if({"thing": POSE_AT_0})
