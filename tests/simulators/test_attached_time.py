"""The time of a client that its owner steps: it goes on with each tick, by the client's time step."""

import itertools
import math

import numpy as np
import pybullet
import pytest

import ssduck
from ssduck.errors import (
    ArgumentError,
    EvaluationError,
    NumberError,
    ProgramWarning,
    SelectScriptError,
    SimulatorError,
)
from tests.support.bodies import solid
from tests.support.cases import sampled
from tests.support.warned import heard

STEP = 1 / 240
# The ball bounces up and down through this height, m.
LOW = 0.3


@pytest.fixture
def bouncing(client):
    """A ball that bounces on a floor, in a client that the test steps."""
    pybullet.setGravity(0, 0, -9.81, client)
    bodies = {
        solid(client, pybullet.GEOM_BOX, halfExtents=[1, 1, 0.1]): "floor",
        solid(client, pybullet.GEOM_SPHERE, 1, [0, 0, 1], radius=0.1): "ball",
    }
    for body in bodies:
        pybullet.changeDynamics(body, -1, restitution=0.9, physicsClientId=client)
    world = ssduck.World.attach(client, names=bodies)
    with ssduck.Interpreter() as ss:
        ss.add_variable("sim", world)
        ss.eval("""
            floor = SELECT obj FROM sim WHERE id(this) == 'floor' AS value;
            ball  = SELECT obj FROM sim WHERE id(this) == 'ball' AS value;
        """)
        yield ss, world


def height(client):
    return pybullet.getBasePositionAndOrientation(1, client)[0][2]


def stepped(client, count=1):
    for _ in range(count):
        pybullet.stepSimulation(client)


@pytest.mark.slow
def test_each_tick_is_a_step_later(client, bouncing):
    """Of intervals, changes and triggers a plain loop over PyBullet tells the times."""
    ss, world = bouncing
    fired = []
    ss.add_trigger("z", "z(ball);", 0.1, lambda z: fired.append((world.time, z)))
    times, heights = [0.0], [height(client)]
    for step in range(1, 481):
        stepped(client)
        world.tick()
        times.append(step / 240)
        heights.append(height(client))
    assert world.time == 2.0
    assert ss.eval("getTime();") == 2.0

    low = np.array(heights) < LOW
    edges = np.flatnonzero(low[1:] != low[:-1]) + 1
    bounds = [*edges, 480] if low[-1] else [*edges]
    intervals = [[times[a], times[b]] for a, b in zip(bounds[::2], bounds[1::2], strict=True)]
    assert len(intervals) >= 2
    assert ss.eval(f"holds(z(ball) < {LOW});") == intervals
    assert ss.eval(f"changes(z(ball) < {LOW});") == [
        [0.0, False],
        *([times[edge], bool(low[edge])] for edge in edges),
    ]
    since = ss.eval(f"since(z(ball) >= {LOW});")
    assert since == (None if low[-1] else times[edges[-1]])
    assert ss.eval("heldFor(z(floor) < 0.3);") == 2.0
    assert ss.eval("least(z(ball));") == [times[int(np.argmin(heights))], min(heights)]

    due = [0, *(next(n for n in range(481) if n / 240 >= k / 10 - 1e-9) for k in range(1, 21))]
    looked = [(times[n], heights[n]) for n in due]
    assert fired == [
        looked[0],
        *(new for old, new in itertools.pairwise(looked) if new[1] != old[1]),
    ]
    assert ss.triggers()[0].evaluations == len(due)
    told = ss.sql("SELECT DISTINCT tick, time FROM entities_history ORDER BY tick").fetchall()
    assert [time for _, time in told] == times


@pytest.mark.slow
def test_where_something_rests_is_told_in_time(client, bouncing):
    """`on` of a cube that was put down holds from its step on, not `[[0, 0]]`."""
    ss, world = bouncing
    for step in range(240):
        if step == 120:
            pybullet.resetBasePositionAndOrientation(1, [0, 0, 0.2], [0, 0, 0, 1], client)
            pybullet.resetBaseVelocity(1, [0, 0, 0], [0, 0, 0], client)
            pybullet.changeDynamics(1, -1, restitution=0, physicsClientId=client)
        stepped(client)
        world.tick()
    (*_, (start, end)) = ss.eval("holds(on(floor, ball));")
    assert (start, end) == (121 / 240, 1.0)


def test_the_clients_time_step_counts_as_it_is_set(client, bouncing):
    _, world = bouncing
    stepped(client, 4)
    assert world.tick(steps=4).time == 4 / 240
    pybullet.setTimeStep(0.01, client)
    stepped(client)
    assert world.tick().time == pytest.approx(4 / 240 + 0.01)
    assert world.tick(steps=10).time == pytest.approx(4 / 240 + 0.11)
    pybullet.setPhysicsEngineParameter(fixedTimeStep=0.5, physicsClientId=client)
    assert world.tick(steps=np.int64(2)).time == pytest.approx(4 / 240 + 1.11)
    assert world.step(2).time == pytest.approx(4 / 240 + 2.11)


def test_the_time_may_be_told(client, bouncing):
    ss, world = bouncing
    assert world.tick(time=0.25).time == 0.25
    assert world.tick(time=np.float32(0.5)).time == 0.5
    assert world.tick().time == 0.5 + STEP
    assert world.tick(time=3).time == 3.0
    assert ss.sql("SELECT DISTINCT time FROM ticks_history ORDER BY time").fetchall() == [
        (0.0,),
        (0.25,),
        (0.5,),
        (0.5 + STEP,),
        (3.0,),
    ]


@pytest.mark.parametrize("again", [{"steps": 0}, {"time": 0.5}, {"time": 0.5 - STEP / 2e6}])
def test_another_tick_of_the_same_time(client, bouncing, again):
    """As a body that is moved by hand takes one: the later tick is in force at that time."""
    ss, world = bouncing
    world.tick(time=0.5)
    pybullet.resetBasePositionAndOrientation(1, [0, 0, 0.3], [0, 0, 0, 1], client)
    world.tick(**again)
    assert world.time == 0.5
    assert ss.eval("SELECT z FROM sim{0.5} WHERE id(this) == 'ball' AS value;") == 0.3
    assert ss.eval("holds(z(ball) < 0.5);") == [[0.5, 0.5]]
    world.tick(time=1)
    assert ss.eval("holds(z(ball) < 0.5);") == [[0.5, 1.0]]


@sampled(
    ("arguments", "error", "message"),
    [
        ({"time": 0.75}, NumberError, r"0.75 s is before the last tick, 1 s.*begin_episode\(\)"),
        ({"time": 1.0 - STEP / 2}, NumberError, "is before the last tick"),
        ({"time": -1}, NumberError, "is before the last tick"),
        ({"time": math.nan}, NumberError, "nan is no finite number of seconds"),
        ({"time": math.inf}, NumberError, "inf is no finite number of seconds"),
        ({"time": 10**400}, NumberError, "is no finite number of seconds"),
        ({"time": 1e300}, NumberError, "so large that adding a step does not change it"),
        ({"time": "2"}, NumberError, "'2' is no finite number of seconds"),
        ({"time": True}, NumberError, "True is no finite number of seconds"),
        ({"steps": -1}, NumberError, "cannot run -1 steps"),
        ({"steps": 0.5}, NumberError, r"0.5 is no whole number of steps; .*tick\(time="),
        ({"steps": 1.0}, NumberError, "1.0 is no whole number of steps"),
        ({"steps": True}, NumberError, "True is no whole number of steps"),
        ({"steps": "1"}, NumberError, "'1' is no whole number of steps"),
        ({"steps": 10**13}, NumberError, "more than 1,000,000,000,000"),
        ({"steps": 1, "time": 2.0}, ArgumentError, "exclude each other"),
    ],
    every=4,
)
def test_times_that_a_tick_cannot_have(bouncing, arguments, error, message):
    _, world = bouncing
    world.tick(time=1)
    number = world.snapshot.number
    with pytest.raises(error, match=f"^tick: .*{message}") as raised:
        world.tick(**arguments)
    assert isinstance(raised.value, SelectScriptError)
    assert (world.time, world.snapshot.number) == (1.0, number)


def test_reading_a_table_takes_no_time(client, bouncing):
    """Though its first reading takes a tick of its own."""
    ss, world = bouncing
    stepped(client, 3)
    world.tick(steps=3)
    for question in ("SELECT count(*) FROM contacts", "SELECT count(*) FROM joints"):
        ss.sql(question)
        assert world.time == 3 / 240
    assert world["ball"].links[0].name
    world["ball"].move([0, 0, 0.5])
    assert world.time == 3 / 240


def test_steps_of_the_world_and_of_its_owner(client, bouncing):
    """Those of the world count as they are run, the owner's with his tick."""
    _, world = bouncing
    world.step(3)
    stepped(client, 2)
    world.tick(steps=2)
    world.run(0.5)
    assert world.time == 125 / 240
    world.step(0)
    world.run(0.0)
    assert world.time == 125 / 240
    stepped(client)
    assert world.tick().time == 126 / 240


def test_a_sensors_period_is_of_that_time(client, bouncing):
    _, world = bouncing
    sensor = world.add_sensor(
        "range_finder", "ball", orientation=[2**-0.5, 0, 2**-0.5, 0], max_range=5.0, period=0.1
    )
    measured = []
    for _ in range(120):
        stepped(client)
        world.tick()
        measured.append(sensor.reading.time)
    assert sorted(set(measured)) == pytest.approx([STEP, *(0.1 * k + STEP for k in range(1, 5))])


@pytest.mark.slow
def test_a_record_has_the_times(client, bouncing, tmp_path):
    ss, world = bouncing
    with ss.record_to(tmp_path / "run"):
        for _ in range(240):
            stepped(client)
            world.tick()
    asked = "holds(z(ball) < 0.5);"
    with ssduck.open(tmp_path / "run") as record:
        record.eval("ball = SELECT obj FROM sim WHERE id(this) == 'ball' AS value;")
        assert record.eval(asked) == ss.eval(asked)
        assert record.call_variable("sim").time == 1.0


@pytest.mark.parametrize("value", [4, 0.5, "4"])
def test_an_argument_without_a_name_is_an_error_that_names_both(client, bouncing, value):
    _, world = bouncing
    with pytest.raises(ArgumentError) as raised:
        world.tick(value)
    assert f"tick(steps={value!r})" in raised.value.message
    assert f"tick(time={value!r})" in raised.value.message
    assert world.time == 0


def late_start(act):
    return heard(act, "were not recorded")[1]


@pytest.mark.slow
def test_ticks_before_a_world_is_bound_are_told_of_once(client, bouncing):
    _, world = bouncing
    late = ssduck.World.attach(client, names={0: "floor", 1: "ball"})
    for _ in range(24):
        stepped(client)
        late.tick()
        world.tick()
    for bound, expected in ((late, 1), (world, 0)):  # the other one was bound at once
        with ssduck.Interpreter() as ss:
            ss.add_variable("late", bound)
            assert late_start(lambda ss=ss: ss.eval("SELECT z FROM late;")) == []
            messages = late_start(lambda ss=ss: ss.eval("holds(z(late.ball) > 2);"))
            assert len(messages) == expected
            assert all(message.startswith("late: its ticks before 0.1 s") for message in messages)
            for program in ("since(z(late.ball) > 0);", "changes(z(late.ball) > 0);"):
                assert late_start(lambda ss=ss, program=program: ss.eval(program)) == []


@pytest.mark.usefixtures("bouncing")
def test_ticks_at_the_start_are_none_before_it(client):
    """Of a world that has not been stepped, all times are recorded."""
    late = ssduck.World.attach(client, names={0: "floor", 1: "ball"})
    late["ball"].move([0, 0, 2])
    with ssduck.Interpreter() as ss:
        ss.add_variable("late", late)
        assert late_start(lambda: ss.eval("holds(z(late.ball) > 2);")) == []


def test_after_a_reset_the_client_is_attached_anew(client, bouncing, tmp_path):
    """A reset alone removes bodies and leaves the time; a new world begins at 0."""
    ss, world = bouncing
    stepped(client, 240)
    world.tick(steps=240)
    pybullet.resetSimulation(physicsClientId=client)
    assert len(world.tick()) == 0
    assert world.time == 241 / 240
    with pytest.raises(NumberError, match=r"after a reset, call begin_episode\(\)"):
        world.tick(time=0.0)
    again = ss.add_variable("sim", ssduck.World.attach(client))
    assert again.time == 0.0
    assert ss.eval("getTime();") == 0.0
    stepped(client)
    assert again.tick().time == STEP


def built(client, *radii):
    """Resets a client, and builds balls."""
    pybullet.resetSimulation(physicsClientId=client)
    for x, radius in enumerate(radii):
        solid(client, pybullet.GEOM_SPHERE, 1, [x, 0, 1], radius=radius)


def test_bodies_that_are_built_again_keep_their_names_in_the_next_episode(client):
    built(client, 0.1, 0.2, 0.1)
    world = ssduck.World.attach(client, names={0: "body_1", 2: "goal"}, kinds={2: "robot"})
    first = [(entity.name, entity.kind) for entity in world]
    assert first == [("body_1", "kinbody"), ("body_1_2", "kinbody"), ("goal", "robot")]
    for _ in range(2):
        built(client, 0.1, 0.2, 0.1)
        world.begin_episode()
        assert [(entity.name, entity.kind) for entity in world] == first
        world.begin_episode()  # nothing was built
        assert [(entity.name, entity.kind) for entity in world] == first
    # In an episode a later body with the same number has the name of its model.
    built(client, 0.1, 0.2, 0.1)
    with pytest.warns(ProgramWarning, match="^body_1, goal: .*built again.*begin_episode"):
        later = [(entity.name, entity.kind) for entity in world.tick()]
    assert later == [(f"body_{number}", "kinbody") for number in range(3)]
    built(client, 0.1, 0.2, 0.1)
    assert heard(world.tick)[1] == []  # it is told once
    built(client, 0.1, 0.2, 0.3)
    with pytest.warns(ProgramWarning, match="^goal: begin_episode found other bodies.*names="):
        world.begin_episode()
    assert [entity.name for entity in world] == ["body_1", "body_1_2", "body_2"]
    built(client, 0.1, 0.2, 0.1)
    world.begin_episode()
    assert [(entity.name, entity.kind) for entity in world] == first


def test_a_body_in_place_of_the_only_one_is_no_reset(client):
    built(client, 0.1)
    world = ssduck.World.attach(client, names={0: "ball"})
    pybullet.removeBody(0, client)
    solid(client, pybullet.GEOM_SPHERE, 1, [0, 0, 1], radius=0.1)
    assert heard(world.tick)[1] == []
    assert [entity.name for entity in world] == ["body_0"]


@pytest.mark.slow
def test_a_table_that_was_not_read_does_not_count_the_tick_twice(client, bouncing):
    """Sums over the past are the same after any query."""
    ss, world = bouncing
    forces = []
    for _ in range(110):
        stepped(client)
        world.tick()
        points = pybullet.getContactPoints(physicsClientId=client)
        forces += [point[9] for point in points if point[9] > 0]
    number = world.tick_number
    for table in ("joints", "links", "shapes"):
        world.request_tables([table])
    assert world.tick_number == number
    (row,) = ss.sql("SELECT count(*), sum(force) FROM contacts_history").fetchall()
    assert row == (len(forces), pytest.approx(sum(forces)))
    assert forces
    ss.record("sim", ssduck.Recording(tables=("entities", "sensings")))
    assert (world.tick_number, ss.past("sim").times) == (number, [world.time])
    # What was moved since is another tick.
    late = ssduck.World.attach(client)
    number = late.tick_number
    pybullet.resetBaseVelocity(1, [1, 0, 0], physicsClientId=client)
    late.request_tables(["joints"])
    assert late.tick_number == number + 1


def test_a_tick_that_fails_takes_no_time(client, bouncing, monkeypatch):
    """The same tick again is not counted twice."""
    _, world = bouncing

    def fail(*_, **__):
        raise SimulatorError("no answer")

    with monkeypatch.context() as patch:
        patch.setattr(world.simulator, "read_link_poses", fail)
        with pytest.raises(SimulatorError, match="no answer"):
            world.tick()
    assert world.simulator.time == world.time == 0.0
    assert world.tick().time == STEP


def test_a_tick_is_refused_while_a_query_runs(bouncing):
    _, world = bouncing
    with world.pinned(), pytest.raises(SelectScriptError, match="a query on 'sim' is running"):
        world.tick()
    assert world.simulator.time == 0.0


def test_a_step_of_no_length(client, bouncing):
    _, world = bouncing
    pybullet.setTimeStep(0.0, client)
    assert world.tick().time == 0.0
    assert world.tick(time=1).time == 1.0


@pytest.mark.slow
def test_other_worlds_take_no_time_by_a_tick(tmp_path):
    """Of a world that ssduck steps, of one that is not simulated, and of a record."""
    with ssduck.load("chaos", recording=None) as ss:
        world = ss.call_variable("chaos")
        with ss.record_to(tmp_path / "run"):
            world.step(2)
        worlds = [world, world.what_if()]
        with ssduck.open(tmp_path / "run") as record:
            for each in (*worlds, record.call_variable("chaos")):
                before = each.time
                assert each.tick().time == before
                for arguments in ({"steps": 1}, {"steps": 0}, {"time": 5.0}):
                    with pytest.raises(ArgumentError, match="only step and run take its time"):
                        each.tick(**arguments)
                assert each.time == before


@pytest.mark.slow
def test_the_last_of_ticks_at_the_same_time_counts(client, bouncing):
    """The ball is put elsewhere between two steps; before, at and after that time."""
    ss, world = bouncing
    for _ in range(10):
        stepped(client)
        world.tick()
    time = world.time
    for z in (3.0, 4.0, 5.0):
        pybullet.resetBasePositionAndOrientation(1, [0, 0, z], [0, 0, 0, 1], client)
        pybullet.resetBaseVelocity(1, [0, 0, 0], [0, 0, 0], client)
        world.tick(steps=0)
    highest = height(client)
    world.tick(time=time)  # again the same time
    stepped(client)
    world.tick()
    assert highest == 5.0
    assert len(ss.past("sim").times) == 11 + 3 + 1 + 1
    assert ss.eval("changes(round(z(ball), 0) == 3.0);") == [[0.0, False]]
    assert ss.eval("changes(round(z(ball), 0) == 5.0);") == [[0.0, False], [time, True]]
    assert ss.eval("holds(round(z(ball), 0) == 4.0);") == []
    assert ss.eval("since(z(ball) > 4.5);") == time
    assert ss.eval("heldFor(z(ball) > 4.5);") == world.time - time
    assert ss.eval(f"SELECT z FROM sim{{{time!r}}} WHERE id == 'ball' AS value;") == 5.0
    before = ss.eval(f"SELECT z FROM sim{{{time - STEP / 2!r}}} WHERE id == 'ball' AS value;")
    assert before < 1.0
    rows = ss.sql(
        "SELECT z FROM entities_history WHERE name = 'ball' AND time = ? ORDER BY tick", [time]
    ).fetchall()
    assert [round(z) for (z,) in rows] == [1, 3, 4, 5, 5]


@pytest.mark.slow
def test_pieces_of_ticks_at_the_same_time_stay_together(client, bouncing):
    """`since` reads the last ticks first, some hundred at a time."""
    ss, world = bouncing
    stepped(client)
    world.tick()
    for count in (238, 1, 1, 1, 1):  # the first piece has 240 ticks
        for _ in range(count):
            world.tick(steps=0)
        assert ss.eval("since(z(ball) > 0.5);") == 0.0
        assert ss.eval("since(z(ball) < 0.99999);") == STEP
    assert ss.eval("changes(z(ball) < 0.99999);") == [[0.0, False], [STEP, True]]


def test_shapes_belong_to_the_tick_that_is_there(client, bouncing):
    """A query of shapes takes no tick: neither a second one of its time, nor of a client that moved."""
    ss, world = bouncing
    stepped(client)
    world.tick()
    number, z = world.snapshot.number, height(client)
    stepped(client, 60)
    ((low, high),) = ss.sql(
        "SELECT s.zmin, s.zmax FROM shapes s JOIN entities e ON s.entity = e.id "
        "WHERE e.name = 'ball'"
    ).fetchall()
    assert (low, high) == (pytest.approx(z - 0.1, abs=1e-12), pytest.approx(z + 0.1, abs=1e-12))
    assert world.snapshot.number == number
    assert ss.sql("SELECT count(*) FROM ticks_history").fetchall() == [(2,)]


def test_a_time_before_the_world_was_bound_says_so(client):
    world = ssduck.World.attach(client)
    world.tick()
    world.tick()
    with ssduck.Interpreter() as ss:
        ss["sim"] = world
        world.tick()
        kept = r"recorded from 0.00833333 s to 0.0125 s; there is no tick at 0 s; ticks are kept "
        with pytest.raises(EvaluationError, match=f"{kept}from when the world is bound"):
            ss.eval("sim{0.0};")
        with pytest.raises(EvaluationError, match=r"there is no tick at 1 s\n"):
            ss.eval("sim{1.0};")
