"""The relations of sensors, the ticks of readings, and their cost."""

import numpy as np
import pybullet
import pytest

import ssduck
from ssduck.errors import ArgumentError, SelectScriptError
from ssduck.simulators.pybullet import readings as pybullet_rays
from ssduck.world.sensor_readings import Reading
from tests.support.sensing import CAMERA, EXACT, LASER, evaluators

# -- what perceives what -------------------------------------------------------------------------


@pytest.mark.slow
def test_nothing_senses_itself_its_body_or_a_sensor(walled):
    walled.add_sensor("range_finder", "mast", "one", position=[-0.5, 0, 0], max_range=5)
    walled.add_sensor("range_finder", "mast", "two", max_range=5)
    walled.add_sensor("planar_laser", "wall", "three", position=[-1, 0, 0], **LASER)
    for ss in evaluators(walled):
        pairs = ss.eval(
            "SELECT id(a.this), id(b.this) FROM a=sim, b=sim WHERE isSensing(a.this, b.this) AS list;"
        )
        assert pairs == ["one", "wall", "two", "wall", "three", "mast"]
        # The first argument is no sensor.
        assert (
            ss.eval(
                "SELECT id FROM sim WHERE isSensing(this, this) OR sensingAmount(this, this) > 0 AS list;"
            )
            == []
        )
        assert ss.eval("SELECT sensingEnvIDs FROM sim WHERE NOT isSensor(this) AS list;") == [
            [],
            [],
        ]
        assert (
            ss.eval(
                "SELECT id(b.this) FROM a=sim, b=sim WHERE id(a.this) == 'wall' AND isSensing(a.this, b.this) AS list;"
            )
            == []
        )


@pytest.mark.slow
def test_aliases_in_sql_may_be_words_of_the_table(walled):
    walled.add_sensor("range_finder", "mast", "eye", max_range=5)
    for ss in evaluators(walled):
        for a, b in (
            ("sensor", "entity"),
            ("hits", "rays"),
            ("ids", "seen"),
            ("s", "e"),
            ("e", "s"),
        ):
            rows = ss.sql(
                f"SELECT {a}.name, {b}.name, sensingAmount({a}, {b}), sensingEnvIDs({a}) "
                f"FROM entities {a}, entities {b} WHERE isSensing({a}, {b})"
            )
            assert rows.fetchall() == [("eye", "wall", 1.0, [walled["wall"].id])]
        for a, b in (("sensor", "hits"), ("rays", "seen"), ("s", "e")):
            program = f"SELECT id({a}.this), id({b}.this) FROM {a}=sim, {b}=sim WHERE isSensing({a}.this, {b}.this) AS list;"
            assert ss.eval(program) == ["eye", "wall"]


# Programs with `eye`, which sees wall and post, as a variable: (program, result). Other forms of
# queries are in geometry/shapes, and in the random programs.
PROGRAMS = [
    ("SELECT id FROM sim WHERE isSensing(eye, this) AS list;", ["wall", "post"]),
    ("SELECT id FROM sim WHERE NOT isSensing(eye, this) AS list;", ["eye", "mast"]),
    ("SELECT id FROM sim WHERE sensingAmount(eye, this) > 0.5 AS list;", ["wall"]),
    (
        "SELECT id FROM sim WHERE environmentID(this) IN sensingEnvIDs(eye) AS list;",
        ["wall", "post"],
    ),
    (
        "SELECT id FROM sim ORDER BY sensingAmount(eye, this) DESC, id LIMIT 2 AS list;",
        ["wall", "post"],
    ),
    (
        "SELECT id, count(sensingEnvIDs(this)) FROM sim WHERE count(sensingEnvIDs(this)) > 0;",
        [{"id": "eye", "count": 2}],
    ),
    (
        "[isSensing(eye, wall), isSensing(eye, eye), isSensing(wall, eye), sensingAmount(wall, eye)];",
        [True, False, False, 0.0],
    ),
    ("[count(sensingEnvIDs(eye)), sensingEnvIDs(wall)];", [2, []]),
]


@pytest.mark.slow
@pytest.mark.parametrize(("program", "expected"), PROGRAMS)
@pytest.mark.parametrize("owned", [True, False])
def test_programs_about_sensors(mast, program, expected, owned):
    mast.box("wall", [0.5, 9, 9], [3, 0, 0])
    mast.box("post", [0.1, 0.1, 0.1], [1, 0, 0])
    world = mast.open(owned=owned)
    eye = world.add_sensor("depth_camera", "mast", "eye", **CAMERA)
    for ss in evaluators(world):
        ss.add_variable("eye", eye)
        ss.add_variable("wall", world["wall"])
        assert ss.eval(program) == expected


def test_a_number_is_no_sensor(mast):
    for ss in evaluators(mast.open()):
        with pytest.raises(ArgumentError, match="s must be a sensor, not a number"):
            ss.eval("SELECT id FROM sim WHERE isSensing(3, this) AS list;")


def test_without_a_world_sql_says_so():
    with (
        ssduck.Interpreter() as ss,
        pytest.raises(SelectScriptError, match="isSensing: in SQL it needs one world"),
    ):
        ss.sql("SELECT isSensing({'id': 1}, {'id': 2})")


# -- a reading is of a tick ----------------------------------------------------------------------


@pytest.mark.slow
def test_a_plan_sees_what_is_perceived_now(mast):
    """The table has more or fewer rows from tick to tick; plans are kept all the same."""
    mast.box("wall", [0.5, 9, 9], [2, 0, 0])
    mast.box("post", [0.1, 0.1, 0.1], [1, 0, 0])
    world = mast.open()
    eye = world.add_sensor("depth_camera", "mast", "eye", **CAMERA)
    for ss in evaluators(world):
        ss.sql(
            "CREATE OR REPLACE TEMP VIEW seen AS SELECT e.name FROM entities s, entities e WHERE isSensing(s, e) ORDER BY 1"
        )
        program = ss.compile(
            "SELECT id(b.this) FROM a=sim, b=sim WHERE isSensing(a.this, b.this) ORDER BY id(b.this) AS list;"
        )
        for place, expected in (
            ([1, 0, 0], ["post", "wall"]),
            ([-1, 0, 0], ["wall"]),
            ([1, 0.1, 0], ["post", "wall"]),
            ([4, 0, 0], ["wall"]),
        ):
            world["post"].move(place)
            assert ss.eval(program) == expected
            assert ss.sql("FROM seen").fetchall() == [(name,) for name in expected]
            assert sorted(mast.seen(eye)) == expected


def test_a_reading_stays_what_it_was(mast):
    mast.sphere("ball", 0.1, [1, 0, 0], mass=1)
    pybullet.setGravity(0, 0, -10, mast.client)
    world = mast.open()
    eye = world.add_sensor("planar_laser", "mast", **LASER)
    first = eye.reading
    ranges = first.ranges.copy()
    world.step(240)
    second = eye.reading
    assert isinstance(first, Reading)
    assert (first.time, second.time) == (0.0, pytest.approx(1.0))
    assert first.tick < second.tick == world.snapshot.number
    assert (first.ranges == ranges).all()
    assert first.hits
    assert second.hits == {}
    with pytest.raises(ValueError, match="read-only"):
        first.ranges[0] = 0
    with pytest.raises(AttributeError):
        first.time = 3


@pytest.mark.slow
def test_a_period_passes_before_a_sensor_is_read_again(mast):
    mast.sphere("ball", 0.1, [1, 0, 0])
    world = mast.open()
    world.add_sensor("planar_laser", "mast", "slow", **LASER, period=0.1)
    world.add_sensor("range_finder", "mast", "quick", max_range=5)
    for ss in evaluators(world):
        assert ss.eval(
            "SELECT id(a.this) FROM a=sim, b=sim WHERE isSensing(a.this, b.this) AS list;"
        ) == ["slow", "quick"]
    mast.casts.clear()
    for _ in range(49):
        world.step()
    # 24 steps of 1/240 s are a tenth of a second.
    assert mast.casts == [361 if n in (24, 48) else 1 for n in range(1, 50)]
    found = dict(
        zip(
            *(world.snapshot.tables["sensings"][c].tolist() for c in ("sensor", "measured")),
            strict=True,
        )
    )
    assert found == {
        world["slow"].id: pytest.approx(0.2),
        world["quick"].id: pytest.approx(49 / 240),
    }
    assert world["slow"].reading.time == pytest.approx(0.2)
    assert world["slow"].reading.tick == world.snapshot.number - 1
    # What is moved by hand is seen at once: no time passed.
    world["ball"].move([-5, 0, 0])
    assert mast.casts[-1] == 361
    assert world["quick"].reading.hits == {}
    # And so is what came or went.
    world.add_sensor("range_finder", "ball", "new", max_range=5)
    assert mast.casts[-1] == 362


def test_in_your_own_client_time_may_pass_unknown(mast):
    """Every tick of the same time is read."""
    ball = mast.sphere("ball", 0.1, [1, 0, 0])
    world = mast.open(owned=False)
    eye = world.add_sensor("range_finder", "mast", max_range=5, period=10)
    assert mast.seen(eye) == ["ball"]
    pybullet.resetBasePositionAndOrientation(ball, [0, 3, 0], [0, 0, 0, 1], mast.client)
    assert mast.seen(eye) == ["ball"]
    assert mast.seen(world.tick(steps=0) and eye) == []
    pybullet.resetBasePositionAndOrientation(ball, [1, 0, 0], [0, 0, 0, 1], mast.client)
    world.step()
    assert mast.seen(eye) == []  # a clock that runs counts
    mast.casts.clear()
    world.step(10)
    assert mast.casts == []


# -- what it costs -------------------------------------------------------------------------------


@pytest.mark.slow
def test_sensors_cost_nothing_until_they_are_asked_for(mast, walled):
    walled.add_sensor("depth_camera", "mast", **CAMERA)
    walled.add_sensor("planar_laser", "mast", **LASER)
    for _ in range(3):
        walled.step()
    for ss in evaluators(walled):
        ss.eval("SELECT id, z FROM sim WHERE isSensor(this);")
        ss.sql("SELECT count(*) FROM entities e WHERE isSensor(e)")
    assert mast.casts == []


@pytest.mark.slow
def test_one_sensor_is_read_by_itself(mast, walled):
    """An expensive one is not read for the sake of a cheap one; a query reads all."""
    camera = walled.add_sensor("depth_camera", "mast", **CAMERA)
    finder = walled.add_sensor("range_finder", "mast", max_range=5, period=0.1)
    assert finder.ranges == pytest.approx([1.5], abs=EXACT)
    assert mast.casts == [1]
    walled.step(24)
    assert mast.casts == [1, 1]
    assert camera.rays == 64 * 48  # asked for now, in the same tick
    assert mast.casts == [1, 1, 64 * 48]
    assert walled.snapshot.tables["sensings"].count == 0
    for ss in evaluators(walled):
        assert ss.sql("SELECT count(*) FROM sensings").fetchone() == (2,)
        assert ss.eval("SELECT id FROM sim WHERE count(sensingEnvIDs(this)) > 0 AS list;") == [
            camera.name,
            finder.name,
        ]
    finder.power(False)
    assert finder.reading is None
    finder.power(True)
    assert finder.reading.hits


@pytest.mark.slow
def test_more_rays_than_pybullet_takes_in_one_call(walled):
    camera = walled.add_sensor("depth_camera", "mast", width=200, height=150, fov=40, max_range=5)
    assert camera.rays == 30_000 > pybullet_rays.MAX_RAYS
    assert camera.depth == pytest.approx(np.full((150, 200), 1.5), abs=EXACT)


def test_colours_are_drawn_when_they_are_asked_for(walled):
    camera = walled.add_sensor("depth_camera", "mast", **CAMERA, period=1.0)
    pictures = []
    real = walled.simulator.photograph
    walled.simulator.photograph = lambda view: pictures.append(view) or real(view)
    assert camera.depth.shape == (48, 64)
    walled.step()
    assert pictures == []
    assert camera.reading.image is None
    image = camera.image
    assert image.shape == (48, 64, 3)
    assert camera.image is image
    assert camera.reading.time == walled.time  # its depth is of the same moment
    assert len(pictures) == 1
    walled.step(240)
    assert len(pictures) == 2
    # Nobody asks any more.
    for _ in range(260):
        walled.step(0)
        walled.request_tables(["sensings"])
    walled.step(240)
    assert len(pictures) == 2
