"""The published tutorial of SelectScript, cell by cell: sections 4 to 9.

`CELLS` holds the programs as they are printed there, in order, with the results that are printed
below them. Handles are compared by name; numbers to the precision that the scene is built to.
"""

from __future__ import annotations

import warnings
from typing import Any

import pytest

import ssduck
from ssduck.simulators.scenes import find_scene
from tests.support.environments import by_name

# (cell, program, result)
CELLS = [
    ("8", "1+2*3-4/5.;", 6.2),
    (
        "9",
        """ 2 * 2;    // multible commands can defined within a script, comments are in C style ...
           a = False; """,
        False,
    ),
    (
        "10",
        """ b = (2+2)*3.45; 
           a = False or True;
           [b, a, "a string", 'or another string']; """,
        [13.8, True, "a string", "or another string"],
    ),
    (
        "14",
        "help('isKinbody');",
        "isKinbody\nChecks if object is of type Kinbody.\nUsage: isKinbody(object) -> bool",
    ),
    ("15", "help('obj');", "obj\nReturns the object itself.\nUsage: obj(object) -> object"),
    (
        "17",
        "SELECT id, position, type FROM kitchen WHERE isRobot(this);",
        [
            {"id": "fridge", "position": [-0.87, -2.0, 1.55], "type": "robot"},
            {"id": "cooker", "position": [1.98, 1.72, 0.75], "type": "robot"},
            {"id": "barrett_4918", "position": [0.42, 1.3, 0.892], "type": "robot"},
            {"id": "roomba_625x", "position": [1.8, 0.0, 0.17], "type": "robot"},
        ],
    ),
    (
        "18",
        """// stores the table objects within a variable
          table = SELECT obj FROM kitchen WHERE id(this) == 'table' AS value;

          // select all volumes (AS list) of objects that are above the object 
          // table an with an volume smaller than 0.001
          SELECT volume 
          FROM kitchen 
          WHERE above(table, this) and volume(this) < 0.001 
          AS list; 
       """,
        [0.00011874852207310614] * 3 + [0.00015723991637302734] * 4,
    ),
    (
        "20",
        "SELECT obj, volume FROM kitchen WHERE below(table, this) AS dict;",
        [
            {"obj": "chair_6b56", "volume": 0.030726317000293702},
            {"obj": "chair_083c", "volume": 0.025596275454522633},
        ],
    ),
    (
        "21",
        "microwave = SELECT obj FROM kitchen WHERE id(this) == 'microwave' AS value; \
SELECT obj, position FROM kitchen WHERE within(microwave, this) AS list;",
        ["plate_b4e7", [-1.13, 2.01, 1.14]],
    ),
    (
        "30",
        "help('onX');",
        "onX\nChecks if the position of an object (o2) is above object (o1).\n"
        "                     Usage: onX(o1, o2) -> bool ",
    ),
    (
        "31",
        "sink    = SELECT obj FROM kitchen WHERE id(this) == 'sink' AS value;"
        "table   = SELECT obj FROM kitchen WHERE id(this) == 'table' as value;"
        "cleanUp = SELECT obj FROM kitchen WHERE onX(table, this) AND "
        "distance(robot, this) < 1.3 AS list;",
        ["cup_905a", "cup_58a2", "cup_b6af", "cup_d441"],
    ),
]

# What the three cells of section 7 print, and what section 9 prints once the barrett has driven in
# front of the fridge.
AS_LOADED = [{"sensor": "barrett_4918_laser_scaner", "robot": "roomba_625x"}]
AT_THE_FRIDGE = [{"sensor": "fridge_webcam", "robot": "barrett_4918"}, *AS_LOADED]
# Section 7, as printed: (cell, program).
SENSING_CELLS = [
    (
        "25",
        "SELECT to(id(e1.this), 'sensor'), to(id(e2.this), 'robot')                   \
        FROM e1=kitchen, e2=kitchen                                                  \
        WHERE isSensor(e1.this) AND isRobot(e2.this) AND isSensing(e1.this, e2.this) \
        AS dict;",
    ),
    (
        "26",
        "sensor = SELECT obj FROM kitchen WHERE isSensor(this) AS list;     \
        robot  = SELECT obj FROM kitchen WHERE isRobot(this)  AS list;     \
                                                                           \
        SELECT to(id(sensor.this), 'sensor'), to(id(robot.this), 'robot')  \
        FROM sensor, robot                                                 \
        WHERE isSensing(sensor.this, robot.this)                           \
        AS dict;",
    ),
    (
        "27",
        "SELECT to(id(e1.this), 'sensor'), to(id(e2.this), 'robot')                   \
        FROM e1=(SELECT obj FROM kitchen WHERE isSensor(this) AS list),              \
             e2=(SELECT obj FROM kitchen WHERE isRobot(this) AS list)                \
        WHERE isSensor(e1.this) AND isRobot(e2.this) AND isSensing(e1.this, e2.this) \
        AS dict;",
    ),
]

# What section 5 prints of help().
TUTORIAL_FUNCTIONS = """
    sensingEnvIDs sensingAmount isSensing help getTime within environmentID id isEnabled below to above
    var sensor isRobot isSensor pose volume position distance isKinbody obj kinbody type clear robot
    isVisible y x z
"""


def on(o1, o2):
    """Cell 28, as printed."""
    if o1 == o2:
        return False

    ab = o1.ComputeAABB()
    pos = o2.GetTransform()[:3, 3]

    if ab.pos()[0] - ab.extents()[0] <= pos[0] <= ab.pos()[0] + ab.extents()[0]:
        if ab.pos()[1] - ab.extents()[1] <= pos[1] <= ab.pos()[1] + ab.extents()[1]:
            if pos[2] >= ab.pos()[2] + ab.extents()[2]:
                return True

    return False


@pytest.fixture(scope="module")
def mujoco_kitchen(tmp_path_factory):
    """The kitchen, saved for MuJoCo."""
    pytest.importorskip("mujoco")
    folder = tmp_path_factory.mktemp("saved") / "kitchen"
    with ssduck.load("kitchen") as ss, warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # its motors
        ss["kitchen"].save(folder, "mujoco")
    return folder


def loaded(request, simulator):
    """The path or the name of the kitchen in a simulator."""
    pytest.importorskip(simulator)
    return request.getfixturevalue("mujoco_kitchen") if simulator == "mujoco" else "kitchen"


@pytest.fixture(scope="module", params=["pybullet", "mujoco"])
def tutorial(request):
    """An interpreter in which the tutorial's cells run one after another, with its Python."""
    with ssduck.load(loaded(request, request.param)) as ss:
        assert ss["kitchen"].simulator.backend == request.param
        env = ss.callVariable("kitchen")
        ss.addFunction(
            "onX",
            on,
            """Checks if the position of an object (o2) is above object (o1).
                     Usage: onX(o1, o2) -> bool """,
        )
        ss.addVariable("robot", env.GetRobot("barrett_4918"))
        yield ss


def assert_alike(found: Any, expected: Any) -> None:
    """Equal, numbers to 1e-4 relative or 1e-9 absolute."""
    if isinstance(expected, float):
        assert found == pytest.approx(expected, rel=1e-4, abs=1e-9)
    elif isinstance(expected, list):
        assert len(found) == len(expected)
        for one, other in zip(found, expected, strict=True):
            assert_alike(one, other)
    elif isinstance(expected, dict):
        assert list(found) == list(expected)
        for key, other in expected.items():
            assert_alike(found[key], other)
    else:
        assert type(found) is type(expected)
        assert found == expected


def test_cells_in_order(tutorial):
    for cell, program, expected in CELLS:
        found = by_name(tutorial.eval(tutorial.compile(program)))
        try:
            assert_alike(found, expected)
        except AssertionError as error:
            raise AssertionError(f"cell {cell}: {found!r} is not {expected!r}") from error


def test_variables_are_reached_from_python(tutorial):
    """Cells 11 and 12, and the loop of cell 32 over the objects to be cleaned up."""
    tutorial.eval("b = (2+2)*3.45;")
    assert tutorial.callVariable("b") == pytest.approx(13.8)
    tutorial.addVariable("c", 1.234)
    assert tutorial.callVariable("c") == 1.234
    assert tutorial.eval("c + 1;") == pytest.approx(2.234)
    tutorial.eval(CELLS[-1][1])
    names = [thing.GetName() for thing in tutorial.callVariable("cleanUp")]
    assert names == ["cup_905a", "cup_58a2", "cup_b6af", "cup_d441"]
    assert tutorial.callVariable("sink").position == pytest.approx([0.35, 2.15, -0.1])


def test_help_lists_the_tutorials_functions(tutorial):
    """Cell 13."""
    assert set(TUTORIAL_FUNCTIONS.split()) <= set(tutorial.eval("help();"))
    assert "onX" in tutorial.eval("help();")


# -- section 7 ---------------------------------------------------------------------------------


@pytest.fixture(
    params=[(False, "pybullet"), (True, "pybullet"), (False, "mujoco")],
    ids=["as SQL", "row by row", "in MuJoCo"],
)
def sensing(request):
    """An interpreter with the kitchen, its sensors switched on as in cell 23."""
    row_by_row, simulator = request.param
    with ssduck.Interpreter(row_by_row=row_by_row) as ss:
        scene = find_scene(loaded(request, simulator))
        env = ss.addVariable("kitchen", ssduck.World.load(scene))
        Sensor = ssduck.Sensor  # noqa: N806  # the tutorial imports it by that name
        for sensor in env.GetSensors():
            sensor.Configure(Sensor.ConfigureCommand.PowerOff)
        assert ss.eval(SENSING_CELLS[0][1]) == []
        for sensor in env.GetSensors():
            sensor.Configure(Sensor.ConfigureCommand.PowerOn)
            sensor.Configure(Sensor.ConfigureCommand.RenderDataOn)
        yield ss
        env.close()


def in_each_formulation(ss):
    return [ss.eval(ss.compile(program)) for _, program in SENSING_CELLS]


@pytest.mark.slow
def test_which_sensors_perceive_a_robot(sensing):
    """Cells 23 to 27: one result in three formulations, then in raw SQL."""
    assert in_each_formulation(sensing) == [AS_LOADED] * 3
    rows = sensing.sql(
        "SELECT s.name, r.name FROM entities s, entities r "
        "WHERE isSensor(s) AND isRobot(r) AND isSensing(s, r)"
    ).fetchall()
    assert rows == [("barrett_4918_laser_scaner", "roomba_625x")]


@pytest.mark.slow
def test_which_sensors_perceive_a_robot_at_the_fridge(sensing):
    """Cell 38: the barrett in front of the fridge, turned to the roomba."""
    env = sensing.callVariable("kitchen")
    env["barrett_4918"].move([0.25, -1.9, 0.892], [0.92388, 0.0, 0.0, 0.38268])
    assert in_each_formulation(sensing) == [AT_THE_FRIDGE] * 3


# -- section 9 ---------------------------------------------------------------------------------

# Cell 34, as printed.
CALLBACK = """
cbResult = []
def callback(result):
    global cbResult
    cbResult = result
"""
# Cell 35, as printed.
SENSING_SENSORS = "env  = kitchen;                                                              \
        SELECT to(id(e1.this), 'sensor'), to(id(e2.this), 'robot')                   \
        FROM e1 = env, e2 = env                                                      \
        WHERE isSensor(e1.this) AND isRobot(e2.this) AND isSensing(e1.this, e2.this) \
        AS dict;                                                                     "


@pytest.mark.slow
def test_callbacks(sensing):
    """Cells 34 to 38; the simulation goes on in between, and somebody drives the barrett."""
    ssPar = ssInt = sensing  # noqa: N806  # what parses and what runs are one here
    kitchen = ssInt.callVariable("kitchen")
    cells = {}
    exec(CALLBACK, cells)  # noqa: S102
    prog = ssPar.compile(SENSING_SENSORS)
    ssInt.addTrigger("sensing_sensors", prog, 1, cells["callback"])
    assert cells["cbResult"] == AS_LOADED
    kitchen.step(480)
    assert cells["cbResult"] == AS_LOADED
    assert ssInt.triggers()[0].firings == 1
    kitchen["barrett_4918"].move([0.25, -1.9, 0.892], [0.92388, 0.0, 0.0, 0.38268])
    kitchen.step(239)
    assert cells["cbResult"] == AS_LOADED
    kitchen.step(1)
    assert cells["cbResult"] == AT_THE_FRIDGE
    ssInt.delTrigger("sensing_sensors")
