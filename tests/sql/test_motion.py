"""Relations of motion, attitude and grasps, against NumPy, SciPy and PyBullet's contact points."""

import math

import numpy as np
import pybullet
import pytest
from scipy.spatial.transform import Rotation

import ssduck
from ssduck.errors import SqlError
from tests.support.bodies import create_linked_body, solid
from tests.support.stage import Stage

EDGE = 1e-9


@pytest.fixture(scope="module")
def lab():
    """A cube without gravity that a test places and moves, and its interpreter."""
    with Stage() as stage, ssduck.Interpreter() as ss:
        here = {"physicsClientId": stage.client}
        body = stage.box("cube", half=0.1, mass=1)
        world = ss.add_variable("lab", stage.open())

        def put(turn=(0, 0, 0, 1), linear=(0, 0, 0), angular=(0, 0, 0)):
            pybullet.resetBasePositionAndOrientation(body, [0, 0, 1], turn, **here)
            pybullet.resetBaseVelocity(body, linear, angular, **here)
            world.tick()

        yield ss, put


def both(ss, expression):
    """The value of an expression of the cube `e`, in SelectScript; in raw SQL it is the same."""
    name, _, options = expression.partition("(")
    value = ss.eval(f"{name}(lab.cube{options};" if options else f"{name}(lab.cube);")
    call = f"{name}(e{options}" if options else f"{name}(e)"
    assert ss.sql(f"SELECT {call} FROM entities e").fetchone() == (value,)
    return value


@pytest.mark.parametrize("seed", range(5))
def test_speeds_and_tilt(lab, seed):
    ss, put = lab
    rng = np.random.default_rng(seed)
    linear, angular = rng.normal(size=3), rng.normal(size=3)
    turn = Rotation.random(random_state=seed)
    put(turn.as_quat(), linear, angular)
    assert both(ss, "speed") == pytest.approx(np.linalg.norm(linear), rel=1e-12)
    assert both(ss, "angularSpeed") == pytest.approx(np.linalg.norm(angular), rel=1e-12)
    axis = turn.apply([0.0, 0.0, 1.0])
    assert both(ss, "tilt") == pytest.approx(math.acos(axis[2]), rel=1e-9)


@pytest.mark.parametrize("about", ["x", "y"])
@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize(("angle", "option"), [(0.2, ""), (0.7, ", 0.7)"), (1e-7, ", 0.0000001)")])
def test_upright_at_its_boundary(lab, angle, option, about, sign):
    ss, put = lab
    expression = f"upright({option}" if option else "upright"
    for beyond, holds in ((1e-12, False), (-1e-12, True)):
        turn = Rotation.from_euler(f"z{about}", [1.1, sign * (angle + beyond)])
        put(turn.as_quat())
        assert both(ss, expression) is holds


def test_an_object_upside_down_is_not_upright(lab):
    ss, put = lab
    put((1, 0, 0, 0))
    assert both(ss, "tilt") == pytest.approx(math.pi)
    assert both(ss, "upright") is False


@pytest.mark.parametrize(
    ("option", "linear", "angular"),
    [("", 0.01, 0.1), (", 0.5)", 0.5, 0.1), (", 0.5, 2)", 0.5, 2.0)],
)
def test_settled_at_its_boundary(lab, option, linear, angular):
    ss, put = lab
    expression = f"settled({option}" if option else "settled"
    put(linear=(0, linear, 0), angular=(0, 0, angular))
    assert both(ss, expression) is True
    put(linear=(0, linear + EDGE, 0), angular=(0, 0, angular))
    assert both(ss, expression) is False
    put(linear=(0, linear, 0), angular=(0, 0, angular + EDGE))
    assert both(ss, expression) is False


@pytest.mark.slow
def test_a_robot_is_settled_when_each_link_is(client, tmp_path):
    """Live, row by row, in raw SQL, over the ticks and in a record, against PyBullet's getter."""
    here = {"physicsClientId": client}
    box = pybullet.createCollisionShape(pybullet.GEOM_BOX, halfExtents=[0.1] * 3, **here)
    arm = create_linked_body(
        client, 0, box, linkPositions=[[0.5, 0, 0]], linkJointTypes=[pybullet.JOINT_REVOLUTE]
    )
    ss = ssduck.Interpreter()
    world = ss.add_variable("lab", ssduck.World.attach(client, names={arm: "arm"}))
    expected = [True]
    for speed in (1.0, 0.05):
        pybullet.resetJointState(arm, 0, 0.3, speed, **here)
        world.tick()
        turn = pybullet.getLinkState(arm, 0, computeLinkVelocity=1, **here)[7]
        assert np.linalg.norm(turn) == pytest.approx(speed)
        expected.append(speed <= 0.1)
        assert ss.eval("[settled(lab.arm), speed(lab.arm), settled(links(lab.arm)[1])];") == [
            *(expected[-1], 0.0, expected[-1])
        ]
        assert ss.eval("settled(lab.arm, 10, 10) AND NOT settled(lab.arm, 10, 0.01);")
        assert ss.eval("SELECT settled(this) FROM lab AS list;") == expected[-1:]
        assert ss.sql("SELECT settled(e) FROM lab.entities e").fetchone() == (expected[-1],)
    now = "SELECT settled(this) FROM lab{-1e9} AS list;"
    then = "SELECT settled(e) FROM lab.entities_history e ORDER BY tick"
    ss.export(str(tmp_path / "run"))
    with ssduck.open(tmp_path / "run") as opened:
        for asked in (ss, opened):
            assert asked.eval(now) == expected
            assert asked.sql(then).fetchall() == [(one,) for one in expected]


# -- grasps ----------------------------------------------------------------------------------------


def squeezed(angle):
    """A cylinder between two jaws of one body whose normals are an angle apart, degrees."""
    client = pybullet.connect(pybullet.DIRECT)
    here = {"physicsClientId": client}
    jaw = pybullet.createCollisionShape(pybullet.GEOM_BOX, halfExtents=[0.2, 0.01, 0.2], **here)
    half = math.radians(180 - angle) / 2
    away = 0.1 + 0.01 - 0.002  # the jaws press 2 mm into the rod
    places = [[0.0, away, 0.0], [away * math.sin(2 * half), -away * math.cos(2 * half), 0.0]]
    hand = create_linked_body(
        client,
        0,
        jaw,
        basePosition=places[0],
        linkPositions=[np.subtract(places[1], places[0]).tolist()],
        linkOrientations=[Rotation.from_euler("z", 2 * half).as_quat().tolist()],
    )
    thing = solid(client, pybullet.GEOM_CYLINDER, 1, radius=0.1, height=0.1)
    pybullet.stepSimulation(client)
    points = pybullet.getContactPoints(hand, thing, **here)
    names = {hand: "hand", thing: "thing"}
    return client, ssduck.World.attach(client, names=names), points


@pytest.mark.slow
@pytest.mark.parametrize(
    ("call", "told"),
    [
        ("upright({}, {})", "upright: angle is an angle, rad, from 0 up, not"),
        ("settled({}, {})", "settled: linear is a speed, m/s, from 0 up, not"),
        ("settled({}, {}, 1)", "settled: linear is a speed, m/s, from 0 up, not"),
        ("settled({}, 0, {})", "settled: angular is an angular speed, rad/s, from 0 up, not"),
        ("inSphere({0}, {0}, {1})", "inSphere: r is a radius, m, from 0 up, not"),
    ],
)
def test_what_is_less_than_0_is_an_error(lab, call, told):
    """Also of an object that is too fast, or lies, so that another part of it decides."""
    ss, put = lab
    put((1, 0, 0, 0), linear=(5, 0, 0), angular=(5, 0, 0))
    for value in ("-1", "-1e-9", "0 - 0.5"):
        for by_rows in (False, True):
            with ssduck.Interpreter(row_by_row=by_rows) as one:
                one.add_variable("lab", ss.worlds[0])
                for program in (
                    f"{call.format('lab.cube', value)};",
                    f"SELECT id FROM lab WHERE {call.format('this', value)} AS list;",
                    f"SELECT {call.format('this', value)} FROM lab AS list;",
                ):
                    with pytest.raises(ssduck.SelectScriptError, match=told):
                        one.eval(program)
    for value in ("-1", "-1e-9", "'nan'::DOUBLE", "e.z - 9"):
        with pytest.raises(SqlError, match=told):
            ss.sql(f"SELECT 1 FROM entities e WHERE {call.format('e', value)}")
        with pytest.raises(SqlError, match=told):
            ss.sql(f"SELECT {call.format('e', value)} FROM entities e").fetchall()
    unknown = ss.sql(f"SELECT {call.format('e', 'NULL')} FROM entities e").fetchall()
    assert unknown in ([(None,)], [(False,)])
    assert ss.eval(f"{call.format('lab.cube', '100')};") in (True, False)


@pytest.mark.slow
@pytest.mark.parametrize("angle", [180, 150, 121, 119, 90])
def test_a_grasp_is_pressed_from_opposite_sides(angle):
    client, world, points = squeezed(angle)
    normals = np.array([point[7] for point in points if point[9] > 0])
    least = (normals @ normals.T).min()
    assert least == pytest.approx(math.cos(math.radians(angle)), abs=1e-3)
    with ssduck.Interpreter() as ss:
        ss.add_variable("lab", world)
        asked = "[grasped(lab.hand, lab.thing), grasped(lab.thing, lab.hand)];"
        assert ss.eval(asked) == [least <= -0.5] * 2
        assert ss.eval("grasped(lab.hand, lab.hand);") is False
        pairs = "SELECT a.name, b.name FROM entities a, entities b WHERE grasped(a, b) ORDER BY 1"
        expected = [("hand", "thing"), ("thing", "hand")] if least <= -0.5 else []
        assert ss.sql(pairs).fetchall() == expected
        # One link of the hand presses from one side only; the rest of the hand does not count.
        links = "SELECT id FROM links(lab) WHERE grasped(this, lab.thing) AS list;"
        assert ss.eval(links) == []
        # At a recorded tick the answer is the same.
        world.tick()
        holds = ss.eval("holds(grasped(lab.hand, lab.thing));")
        assert bool(holds) == (least <= -0.5)
    pybullet.disconnect(client)


@pytest.mark.slow
def test_a_thing_that_rests_is_not_grasped(client, tmp_path):
    here = {"physicsClientId": client}
    table = solid(client, pybullet.GEOM_BOX, 0, halfExtents=[0.1] * 3)
    thing = solid(client, pybullet.GEOM_BOX, 1, [0, 0, 0.2], halfExtents=[0.1] * 3)
    pybullet.setGravity(0, 0, -9.81, **here)
    world = ssduck.World.attach(client, names={table: "table", thing: "thing"})
    with ssduck.Interpreter() as ss:
        ss.add_variable("lab", world)
        for _ in range(20):
            pybullet.stepSimulation(client)
            world.tick()
        assert ss.eval("[inContact(lab.table, lab.thing), grasped(lab.table, lab.thing)];") == [
            True,
            False,
        ]
        ss.export(tmp_path / "run")
    pybullet.disconnect(client)
    with ssduck.open(tmp_path / "run") as opened:
        assert opened.eval("[grasped(lab.table, lab.thing), settled(lab.thing)];") == [False, True]
