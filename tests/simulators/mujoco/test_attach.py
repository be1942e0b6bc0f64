"""MuJoCo simulations of the user's as worlds, compared with MuJoCo's own functions."""

import re
import subprocess
import sys
import types
from itertools import pairwise

import numpy as np
import pytest

import ssduck
from ssduck.errors import (
    ArgumentError,
    ProgramWarning,
    SimulatorError,
    StateError,
    UnknownNameError,
    UnsupportedError,
)
from ssduck.geometry.arrays import are_moderate
from ssduck.geometry.poses import rotation_matrices
from tests.support.mjcf import LAB, random_state

mujoco = pytest.importorskip("mujoco")
BODY = mujoco.mjtObj.mjOBJ_XBODY


@pytest.fixture(scope="module")
def model():
    return mujoco.MjModel.from_xml_string(LAB)


@pytest.fixture
def data(model):
    return mujoco.MjData(model)


def rows(world, table, *columns):
    world.request_tables([table])
    arrow = world.snapshot.tables[table].arrow
    return list(zip(*(arrow[column].to_pylist() for column in columns), strict=True))


def test_entities_are_the_trees_below_the_world(model, data):
    world = ssduck.World.attach(model, data, {"ball": "egg", 2: "cube"}, {"hand": "robot"})
    found = [(entity.name, entity.kind, entity.mass) for entity in world]
    fore_and_arm = sum(model.body_mass[model.body("arm").id : model.body("hand").id])
    assert found == [
        ("world", "kinbody", 0.0),
        ("table", "kinbody", 0.0),  # fixed to the world
        ("cube", "kinbody", 2.0),
        ("egg", "kinbody", 0.5),
        ("wedge", "kinbody", 1.0),
        ("arm", "robot", pytest.approx(fore_and_arm)),
        ("hand", "robot", pytest.approx(4000 / 3 * np.pi * 0.1**3)),
    ]
    assert [link.name for link in world["arm"].links] == ["arm", "fore", "body_7"]
    kinds = rows(world, "joints", "name", "type", "link", "joint", "lower")
    assert kinds == [
        ("joint_0", "free", 0, 0, None),
        ("joint_1", "free", 0, 0, None),
        ("joint_2", "free", 0, 0, None),
        ("turn", "revolute", 0, 0, None),
        ("push", "prismatic", 1, 1, -0.5),
        ("bend", "revolute", 1, 2, pytest.approx(-np.pi / 2)),
        ("wrist", "spherical", 2, 3, None),
    ]
    # What is only drawn has no shape.
    assert [e for (e,) in rows(world, "shapes", "entity")].count(world["world"].id) == 1


@pytest.mark.parametrize("seed", range(3))
def test_links_are_where_mujoco_has_them_and_as_fast(model, data, seed):
    random_state(model, data, seed)
    world = ssduck.World.attach(model, data)
    world.request_tables(["links", "joints"])
    numbers = [0, *range(1, model.nbody)]
    links = world.snapshot.tables["links"]
    assert np.array_equal(links.doubles("x", "z").T, data.xpos[numbers])
    matrices = rotation_matrices(links.doubles("qw", "qz").T)
    assert matrices == pytest.approx(data.xmat[numbers].reshape(-1, 3, 3), abs=1e-12)
    for number, found in zip(numbers, links.doubles("vx", "wz").T, strict=True):
        expected = np.zeros(6)
        mujoco.mj_objectVelocity(model, data, BODY, number, expected, 0)
        assert found == pytest.approx([*expected[3:], *expected[:3]], abs=1e-12)
    for name, position, velocity in rows(world, "joints", "name", "position", "velocity"):
        if name in {"turn", "push", "bend"}:
            joint = model.joint(name)
            assert (position, velocity) == (data.qpos[joint.qposadr[0]], data.qvel[joint.dofadr[0]])
        else:
            assert position is None


def test_the_simulation_of_the_user_is_not_touched(model):
    """Not by a bit: ticks read, whether they compute the poses of their own time or not."""
    bare, plain, forward = (mujoco.MjData(model) for _ in range(3))
    worlds = [ssduck.World.attach(model, plain), ssduck.World.attach(model, forward, forward=True)]
    for _ in range(20):
        for data in (bare, plain, forward):
            mujoco.mj_step(model, data)
        for world in worlds:
            world.tick().request_tables(["links", "joints", "shapes", "contacts"])
    size = mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_INTEGRATION)
    states = np.zeros((3, size))
    for state, data in zip(states, (bare, plain, forward), strict=True):
        mujoco.mj_getState(model, data, state, mujoco.mjtState.mjSTATE_INTEGRATION)
    assert np.array_equal(states[0], states[1])
    assert np.array_equal(states[0], states[2])
    # Without a forward pass the poses are those at the beginning of the last step.
    box = model.body("box").id
    assert np.array_equal(worlds[0]["box"].position, bare.xpos[box])
    assert worlds[1]["box"].position[2] == pytest.approx(bare.qpos[2], abs=1e-12)
    assert worlds[0]["box"].position[2] != worlds[1]["box"].position[2]


@pytest.mark.slow
def test_a_reset_begins_an_episode(model, data, tmp_path):
    heard = []
    with ssduck.Interpreter() as ss:
        lab = ss.add_variable("lab", ssduck.World.attach(model, data))
        ball = lab["ball"]
        ss.record_to(tmp_path / "run")
        ss.add_trigger(
            "late", "SELECT time FROM lab WHERE id == 'ball' AS value;", 0.004, heard.append
        )
        for _ in range(3):
            mujoco.mj_step(model, data)
            lab.tick()
        assert ss.past("lab").times == pytest.approx([0.0, 0.002, 0.004, 0.006])
        run, other = lab.snapshot.run, ssduck.World.attach(model, data)
        mujoco.mj_resetData(model, data)
        with pytest.raises(StateError, match=r"was reset since the last tick: call tick\(\)"):
            other.request_tables(["joints"])
        lab.tick()
        assert (lab.time, lab.snapshot.run == run) == (0.0, False)
        mujoco.mj_step(model, data)
        mujoco.mj_step(model, data)
        lab.tick()
        assert ss.past("lab").times == pytest.approx([0.0, 0.004])
        assert heard == pytest.approx([0.0, 0.004, 0.0, 0.004])
        assert ball in lab  # its model is the same
    episodes = [episode.ticks for episode in ssduck.episodes(tmp_path / "run")]
    assert episodes == [4, 2]


@pytest.mark.slow
def test_resets_of_worlds_that_no_interpreter_has(model, data):
    """One was closed, in another the name stands for something else now."""
    closed, other = ssduck.Interpreter(), ssduck.Interpreter()
    world = closed.add_variable("lab", ssduck.World.attach(model, data))
    other.add_variable("lab", world)
    closed.close()
    other.add_variable("lab", 5)
    mujoco.mj_step(model, data, 5)
    world.tick()
    mujoco.mj_resetData(model, data)
    assert world.tick().time == 0.0
    assert other.eval("lab;") == 5
    other.close()


def test_a_model_that_is_built_anew(model):
    """Entities stay if nothing about them changed; one that changed is another one."""
    text = {"now": LAB}
    made = []

    def reset():
        built = mujoco.MjModel.from_xml_string(text["now"])
        made.append((built, mujoco.MjData(built)))

    reset()
    world = ssduck.World.attach(lambda: made[-1], names={"wedge": "cheese"})
    before = {entity.name: entity.id for entity in world}
    reset()
    world.tick()
    assert {entity.name: entity.id for entity in world} == before
    text["now"] = LAB.replace('size=".05" mass=".5"', 'size=".07" mass=".5"')
    reset()
    world.tick()
    after = {entity.name: entity.id for entity in world}
    assert {name for name in before if before[name] != after[name]} == {"ball"}
    text["now"] = text["now"].replace('<body name="table"', '<body name="new"/><body name="table"')
    reset()
    world.tick()  # all have other numbers
    assert [entity.name for entity in world][1:3] == ["new", "table"]
    assert "cheese" in world
    assert world["ball"].aabb[1][2] == pytest.approx(0.451 + 0.07)
    # The same where the user writes into the model.
    made[-1][0].geom_size[made[-1][0].geom("floor").id + 2] = 0.6  # of the table
    world.tick()
    assert world["table"].aabb[1][2] == pytest.approx(0.2 + 0.6)


def test_masses_and_margins_are_those_of_now(model):
    model = mujoco.MjModel.from_xml_string(LAB)
    world = ssduck.World.attach(model, mujoco.MjData(model))
    model.body_mass[model.body("box").id] = 5.0
    model.geom_margin[:] = 0.25
    world.tick()
    world.request_tables(["entities", "masses", "shapes", "margins"])
    assert world["box"].mass == 5.0
    assert set(rows(world, "shapes", "margin")) == {(0.25,)}


class _Wrapped:
    def __init__(self, **parts):
        self.__dict__.update(parts)


def _named(cls):
    """A binding's class: not MuJoCo's own, with a pointer to that."""
    return type(cls, (_Wrapped,), {})


PLACES = {
    "gymnasium": lambda m, d: _Wrapped(unwrapped=_Wrapped(model=m, data=d)),
    "dm_control": lambda m, d: _Wrapped(
        physics=_Wrapped(model=_named("MjModel")(ptr=m), data=_named("MjData")(ptr=d))
    ),
    "robosuite": lambda m, d: _Wrapped(
        sim=_Wrapped(model=_named("MjModel")(_model=m), data=_named("MjData")(_data=d))
    ),
    "wrapped twice": lambda m, d: _Wrapped(
        env=_Wrapped(env=_Wrapped(sim=_Wrapped(model=m, data=d)))
    ),
    "pair": lambda m, d: (m, d),
    "function": lambda m, d: lambda: (m, d),
    "function of an environment": lambda m, d: lambda: _Wrapped(model=m, data=d),
}


@pytest.mark.parametrize("place", PLACES)
def test_environments_say_where_their_simulation_is(model, data, place):
    world = ssduck.World.attach(PLACES[place](model, data))
    assert world.simulator.data is data
    assert world["ball"].position[2] == pytest.approx(0.451)


def test_an_environment_may_make_its_simulation_in_another_place(model, data):
    environment, other = _Wrapped(sim=_Wrapped(model=model, data=data)), mujoco.MjData(model)
    other.qpos[:] = data.qpos
    world = ssduck.World.attach(environment)
    environment.sim = _Wrapped(model=model, data=other)  # in the same place
    assert world.tick().simulator.data is other
    del environment.sim
    environment.physics = _Wrapped(model=_named("MjModel")(ptr=model), data=data)
    assert world.tick().simulator.data is data
    del environment.physics
    with pytest.raises(SimulatorError, match="has no MuJoCo model with its data"):
        world.tick()


def _of_module(module):
    """Returns an object whose class says that it is of a module."""
    return type("Model", (), {"__module__": module})()


WRONG = {
    "no simulation": (lambda m, d: ((object(),), {}), SimulatorError, "no connected PyBullet client, and it has no MuJoCo"),
    "a model alone": (lambda m, d: ((m,), {}), SimulatorError, "a model without its data"),
    "data alone": (lambda m, d: ((d,), {}), SimulatorError, "data without its model"),
    "a model on a device": (lambda m, d: ((_of_module("mujoco.mjx._src.types"), d), {}), SimulatorError, "mjx.get_data"),
    "an object of Warp": (lambda m, d: ((_of_module("mujoco_warp._src.types"),), {}), SimulatorError, "copy it to an MjData"),
    "data of another model": (
        lambda m, _: ((m, mujoco.MjData(mujoco.MjModel.from_xml_string("<mujoco/>"))), {}),
        SimulatorError, "of another model: it has 1 bodies, the model 9",
    ),
    "a module": (lambda *_: ((types,), {}), SimulatorError, "unwrapped, physics or sim"),
    "no data": (lambda m, d: ((m, "data"), {}), SimulatorError, "it has no MuJoCo model and data"),
    "function of nothing": (lambda m, d: ((lambda: None,), {}), SimulatorError, "no MuJoCo model"),
    "name": (lambda m, d: ((m, d, {"bal": "x"}), {}), UnknownNameError, r"no body 'bal'.*ball"),
    "number": (lambda m, d: ((m, d, {99: "x"}), {}), ArgumentError, "its bodies are 0 to"),
    "link": (lambda m, d: ((m, d, {"fore": "x"}), {}), ArgumentError, "link of the entity 'arm'"),
    "kind": (lambda m, d: ((m, d), {"kinds": {"arm": "sensor"}}), ArgumentError, "'sensor' is no"),
    "shapes": (lambda m, d: ((m, d), {"shapes": {0: None}}), ArgumentError, "MuJoCo gives all"),
    "twice": (lambda m, d: ((m, d, {}), {"names": {1: "x"}}), ArgumentError, "given twice"),
    "too many": (lambda m, d: ((m, d, {}, {}, 5), {}), ArgumentError, "too many values: {}, {}, 5"),
    "simulator": (lambda m, d: ((m, d), {"simulator": "mujco"}), UnknownNameError, "mujoco"),
    "forward": (lambda m, d: ((m, d), {"forward": 2}), ArgumentError, "forward"),
}  # fmt: skip


@pytest.mark.parametrize("case", WRONG)
def test_wrong_arguments_are_told_at_once(model, data, case):
    arguments, error, text = WRONG[case]
    values, named = arguments(model, data)
    with pytest.raises(error) as caught:
        ssduck.World.attach(*values, **named)
    assert re.search(text, str(caught.value))


@pytest.mark.slow
def test_ticks_take_no_time_from_the_user(model, data):
    world = ssduck.World.attach(model, data)
    with pytest.raises(ArgumentError, match="keeps the time itself"):
        world.tick(steps=1)
    mujoco.mj_step(model, data, 7)
    with ssduck.Interpreter() as ss:
        ss.add_variable("lab", world)
        with pytest.warns(ProgramWarning, match=r"has moved on.*call tick\(\) after each step$"):
            ss.eval("SELECT id FROM lab;")
    assert world.tick().time == pytest.approx(0.014)
    assert world.step(3).time == pytest.approx(0.02)


@pytest.mark.slow
def test_sensors_perceive_what_collides(model, data):
    """A range finder on the hand looks through it and what is only drawn, down to the table."""
    with ssduck.Interpreter() as ss:
        lab = ss.add_variable("lab", ssduck.World.attach(model, data))
        lab["hand"].move([0.3, -0.2, 1.0], [0.5**0.5, 0, 0.5**0.5, 0])
        sensor = lab.add_sensor("range_finder", "hand", "eye", max_range=2.0)
        assert sensor.reading.ranges.tolist() == [pytest.approx(0.6, abs=1e-9)]
        assert ss.eval("SELECT id FROM lab WHERE isSensing(lab.eye, this) AS list;") == ["table"]
        lab["hand"].move([2.0, -2.0, 1.0])  # nothing but the paint and the floor below
        assert sensor.reading.ranges.tolist() == [pytest.approx(1.0, abs=1e-9)]
        assert ss.eval("SELECT id FROM lab WHERE isSensing(lab.eye, this) AS list;") == ["world"]


def test_a_closed_world_says_so(model, data):
    world = ssduck.World.attach(model, data)
    world.close()
    with pytest.raises(SimulatorError, match="the world is closed"):
        world.tick()
    mujoco.mj_step(model, data)  # the simulation goes on


@pytest.mark.slow
def test_ssduck_works_without_mujoco():
    """It is imported when a world needs it, and its absence is told then."""
    code = (
        "import sys; sys.modules['mujoco'] = None\n"
        "import ssduck, types\n"
        "ss = ssduck.Interpreter()\n"
        "from ssduck.simulators.backends import backend\n"
        "try: backend('mujoco')\n"
        "except ssduck.errors.UnsupportedError as error: print(error)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "pip install 'ssduck[mujoco]'" in done.stdout


@pytest.mark.slow
def test_a_file_is_loaded_and_run(tmp_path):
    path = tmp_path / "lab.xml"
    path.write_text(LAB)
    with ssduck.load(path) as ss:
        lab = ss.call_variable("lab")
        assert lab.simulator.backend == "mujoco"
        lab.run(0.1)
        bare = mujoco.MjModel.from_xml_string(LAB)
        data = mujoco.MjData(bare)
        mujoco.mj_forward(bare, data)
        mujoco.mj_step(bare, data, 50)
        assert np.array_equal(lab["ball"].position, data.xpos[bare.body("ball").id])
        heights = ss.eval("SELECT z FROM lab{} WHERE id == 'ball' AS list;")
        assert all(a >= b for a, b in pairwise(heights[:5]))
        assert len(heights) == 51
    path.write_text("<mujoco><worldbody><geom/></worldbody></mujoco>")
    with pytest.raises(ssduck.errors.SceneError, match=r"lab\.xml cannot be loaded: .*size"):
        ssduck.load(path)
    with pytest.raises(UnsupportedError, match="MuJoCo loads scenes of URDF files"):
        ssduck.load("chaos", simulator="mujoco")


@pytest.mark.slow
def test_unknown_numbers_of_joints_are_buffered_with_the_other_rows(model, data, tmp_path):
    """A free joint has no position, and that of every tick is NULL wherever its row is."""
    tables = ("links", "joints", "contacts")
    with ssduck.Interpreter() as ss:
        world = ss.add_variable("sim", ssduck.World.attach(model, data))
        ss.record("sim", ssduck.Recording(tables=tables))
        with ss.record_to(tmp_path / "run", recording=ssduck.Recording(tables=tables)):
            for _ in range(40):
                mujoco.mj_step(model, data)
                world.tick()
            query = (
                "SELECT tick, entity, joint, position, upper FROM sim.joints_history ORDER BY ALL"
            )
            live = ss.sql(query).fetchall()
            assert any(row[3] is None for row in live)
            assert not any(value != value for row in live for value in row)  # noqa: PLR0124
    parts = list((tmp_path / "run" / "joints").rglob("*.parquet"))
    assert len(parts) <= 2
    with ssduck.open(tmp_path / "run") as past:
        assert past.sql(query).fetchall() == live


@pytest.mark.parametrize("number", [np.nan, np.inf, -np.inf, 1e60])
@pytest.mark.parametrize("count", [3, 100_000])
def test_numbers_whose_sums_of_products_may_overflow_are_found(number, count):
    numbers = np.linspace(-9, 9, count)
    assert are_moderate(numbers)
    for place in (0, count // 2, -1):
        changed = numbers.copy()
        changed[place] = number
        assert not are_moderate(changed)
