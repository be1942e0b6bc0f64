"""Relations that read as something else: a share as a condition, and `volume`; warnings have a limit."""

import warnings
from concurrent.futures import ThreadPoolExecutor

import pybullet
import pytest

import ssduck
from ssduck.errors import ArgumentError, ProgramWarning
from ssduck.interpreter.episode_batches import collected_doubts
from ssduck.interpreter.execution import MAX_WARNINGS
from tests.support.stage import PLANE, Stage
from tests.support.warned import told


@pytest.fixture(scope="module")
def world():
    """A ball in a box."""
    with Stage() as stage:
        stage.box("bin")
        stage.sphere("ball", (0.5, 0, 0), radius=0.1, mass=1)
        yield stage.open()


@pytest.fixture
def ss(world):
    with ssduck.Interpreter() as ss:
        ss.add_variable("sim", world)
        yield ss


@pytest.mark.parametrize(
    ("program", "name"),
    [
        ("SELECT id FROM sim WHERE inside(sim.bin, this);", "inside"),
        ("SELECT id FROM sim WHERE z(this) > 0 AND NOT inside(this, sim.bin);", "inside"),
        ("IF(inside(sim.bin, sim.ball); 1; 0);", "inside"),
        ("inside(sim.bin, sim.ball) OR False;", "inside"),
        ("heldFor(inside(sim.bin, sim.ball));", "inside"),
        ("historically(distance(sim.bin, sim.ball), 0, 1);", "distance"),
        ("SELECT id FROM sim WHERE distance(this, sim.ball);", "distance"),
        ("once(z(sim.ball));", "z"),
        ("NOT tilt(sim.ball);", "tilt"),
        ("SELECT id FROM sim WHERE NOT clearance(this, sim.ball);", "clearance"),
    ],
)
def test_a_number_as_a_condition_is_told_of(ss, program, name):
    (message,) = told(ss.eval, program)
    assert message.startswith(f"{name} as a condition holds of any number but 0")
    assert ("write contains(a, b)" in message) is (name == "inside")
    ss.strict = True
    with pytest.raises(ArgumentError, match=f"{name} as a condition"):
        ss.eval(program)


@pytest.mark.parametrize(
    "program",
    [
        "SELECT id FROM sim WHERE inside(sim.bin, this) > 0.4;",
        "SELECT inside(sim.bin, this) FROM sim;",
        "inside(sim.bin, sim.ball);",
        "contains(sim.bin, sim.ball) AND contactForce(sim.bin, sim.ball);",
    ],
)
def test_a_number_that_is_compared_is_not(ss, program):
    ss.strict = True
    assert told(ss.eval, program) == []


@pytest.mark.parametrize(
    "program", ["heldSince(z(sim.ball) > 1, 5);", "heldSince(z(sim.ball) > 1, 0, 5);"]
)
def test_a_time_in_place_of_a_condition_is_told_of(ss, program):
    (message,) = told(ss.eval, program)
    assert message.startswith("heldSince takes a condition here, and a number always holds")
    assert told(ss.eval, "heldSince(z(sim.ball) > 1, True, 0, 5);") == []


# (program, what always holds)
ALWAYS = [
    ("SELECT id FROM sim WHERE position;", "position is a list"),
    ("SELECT id FROM sim WHERE velocity(this) AND z(this) > 0;", "velocity is a list"),
    ("SELECT id FROM sim WHERE sim.ball AND z(this) > 0;", "sim.ball is an entity"),
    ("SELECT id FROM sim WHERE NOT sim['ball'];", "sim.ball is an entity"),
    ("SELECT id FROM sim WHERE name OR z > 1;", "name is a text"),
    ("ball AND True;", "ball is an entity"),
    ("IF(pose(sim.ball); 1; 2);", "pose is a list"),
]


@pytest.mark.parametrize(("program", "what"), ALWAYS)
def test_what_always_holds_is_told_of(ss, program, what):
    ss.add_variable("ball", ss["sim"]["ball"])
    (message,) = told(ss.eval, program)
    assert message.startswith(f"{what}, which always holds as a condition: compare it")


@pytest.mark.parametrize(
    "program",
    [
        "SELECT id FROM sim WHERE robot(this);",  # nothing for what is none
        "SELECT id FROM sim WHERE sensingEnvIDs(this);",  # empty where nothing is seen
        "SELECT id FROM sim WHERE has.bin AND z(this) > 0;",
    ],
)
def test_what_may_not_hold_is_not(ss, program):
    ss.add_variable("has", {"bin": False})
    ss.strict = True
    assert told(ss.eval, program) == []


@pytest.fixture
def marked():
    """A cup inside of a goal that is drawn only."""
    with Stage() as stage:
        drawn = pybullet.createVisualShape(
            pybullet.GEOM_BOX, halfExtents=[0.5] * 3, physicsClientId=stage.client
        )
        goal = pybullet.createMultiBody(0, -1, drawn, physicsClientId=stage.client)
        stage.names[goal] = "goal"
        stage.sphere("cup", radius=0.1, mass=1)
        with ssduck.Interpreter() as ss:
            ss.add_variable("sim", stage.open())
            yield ss


@pytest.mark.parametrize(
    "program",
    [
        "near(sim.goal, sim.cup, 0.1);",
        "SELECT id FROM sim WHERE within(sim['goal'], this);",
        "contains(sim.goal, sim.cup) OR True;",
        "least(clearance(sim.cup, sim.goal));",
    ],
)
def test_what_is_drawn_only_has_no_shapes_to_ask_for(marked, program):
    (message,) = told(marked.eval, program)
    assert "asks for the shapes of sim.goal, which has none that collides" in message
    marked.strict = True
    with pytest.raises(ArgumentError, match=r"distance\(sim.goal, …\) is that of positions"):
        marked.eval(program)


def test_its_position_is_known(marked):
    marked.strict = True
    assert marked.eval("distance(sim.goal, sim.cup) < 0.01;")
    assert marked.eval("inBox(sim.cup, [-0.5, -0.5, -0.5], [0.5, 0.5, 0.5], sim.goal);")


@pytest.mark.parametrize("program", ["volume(sim.ball);", "SELECT id, volume FROM sim;"])
def test_volume_is_told_of_once_and_stays_as_published(ss, program):
    ss.strict = True
    (message,) = told(ss.eval, program)
    assert "solidVolume" in message
    assert "aabbVolume" in message
    assert ss.eval("volume(sim.bin);") == pytest.approx(1 / 8)
    assert told(ss.eval, program) == told(ss.sql, "SELECT volume(e) FROM entities e") == []


def test_raw_sql_tells_of_volume_too(ss):
    assert len(told(ss.sql, "SELECT volume(e) FROM entities e")) == 1


@pytest.fixture(scope="module")
def slope():
    """A ball 2 m over the origin of three planes: tilted, level and upright."""
    with Stage() as stage:
        for name, normal in {"slope": [0, 0.6, 0.8], "floor": [0, 0, 1], "wall": [1, 0, 0]}.items():
            stage.add(name, PLANE, planeNormal=normal)
        stage.sphere("ball", (0, 0, 2), radius=0.2, mass=1)
        yield stage.open(), stage.client


@pytest.mark.slow
@pytest.mark.parametrize(
    ("program", "planes"),
    [
        ("above(sim.slope, sim.ball);", ["sim.slope"]),
        ("SELECT id FROM sim WHERE above(sim.slope, this);", ["sim.slope"]),
        ("below(sim.slope, sim.ball);", ["sim.slope"]),
        ("within(sim.slope, sim.ball);", ["sim.slope"]),
        ("overlaps(sim.ball, sim.slope);", ["sim.slope"]),
        ("above(sim.floor, sim.ball);", []),
        ("above(sim.wall, sim.ball);", []),
        ("above(sim.ball, sim.slope);", []),
        ("overlaps(sim.floor, sim.ball);", []),
        ("penetration(sim.slope, sim.ball);", []),
    ],
)
def test_a_tilted_plane_in_a_relation_of_boxes_is_told_of(slope, program, planes):
    world, client = slope
    with ssduck.Interpreter() as ss:
        ss.add_variable("sim", world)
        messages = told(ss.eval, program)
        told_of = [message.partition("the axis-aligned box of ")[2] for message in messages]
        assert [message.partition(", a tilted plane")[0] for message in told_of] == planes
        assert told(ss.eval, program) == []
        # What it is told to ask is what PyBullet has.
        (gap,) = {
            point[8] for point in pybullet.getClosestPoints(0, 3, 5.0, physicsClientId=client)
        }
        assert ss.eval("clearance(sim.slope, sim.ball);") == pytest.approx(gap)
        assert ss.eval("penetration(sim.slope, sim.ball);") == 0.0


@pytest.fixture(scope="module")
def planes():
    """Balls over and under a floor, a ceiling, an upright and a tilted plane."""
    with Stage() as stage:
        for name, normal, z in (
            ("floor", [0, 0, 1], 0.5),
            ("ceiling", [0, 0, -1], 3),
            ("wall", [1, 0, 0], 0),
            ("slope", [0, 0.6, 0.8], 0),
        ):
            stage.add(name, PLANE, (0, 0, z), planeNormal=normal)
        for n, z in enumerate((-5, 0.2, 2, 4)):
            stage.sphere(f"ball_{n}", (-1, 0, z), radius=0.1, mass=1)
        yield stage.open()


@pytest.mark.filterwarnings("ignore:.*a tilted plane:ssduck.errors.ProgramWarning")
@pytest.mark.parametrize("row_by_row", [False, True])
def test_what_is_below_the_surface_of_a_level_plane_is_below_it(planes, row_by_row):
    with ssduck.Interpreter(row_by_row=row_by_row) as ss:
        ss.add_variable("sim", planes)
        heights = {f"ball_{n}": z for n, z in enumerate((-5, 0.2, 2, 4))}
        below = {
            **{("floor", ball): z < 0.5 for ball, z in heights.items()},
            **{("ceiling", ball): z < 3 for ball, z in heights.items()},
            **{(plane, ball): False for plane in ("wall", "slope") for ball in heights},
        }
        for (plane, ball), expected in below.items():
            assert ss.eval(f"below(sim.{plane}, sim.{ball});") is expected
        pairs = "SELECT a.name, b.name FROM entities a, entities b WHERE below(a, b)"
        every = "SELECT a.id AS a, b.id AS b FROM a=sim, b=sim WHERE below(a.this, b.this);"
        expected_pairs = sorted(pair for pair, is_below in below.items() if is_below)
        for found in (ss.sql(pairs).fetchall(), [tuple(row.values()) for row in ss.eval(every)]):
            known = sorted(pair for pair in found if pair in below)
            assert known == expected_pairs
        level = "SELECT id FROM sim WHERE {}(sim.floor, this) AND mass > 0 AS list;"
        assert ss.eval(level.format("below")) == ["ball_0", "ball_1"]
        assert ss.eval(level.format("within")) == ["ball_0", "ball_1"]
        assert ss.eval(level.format("above")) == ["ball_2", "ball_3"]


@pytest.mark.parametrize("name", ["on", "onTop", "supports", "restsOn", "contains", "enclosed"])
def test_an_immovable_thing_in_a_movable_one_is_told_of(ss, name):
    (message,) = told(ss.eval, f"{name}(sim.ball, sim.bin);")
    assert message.startswith(f"{name}(sim.ball, sim.bin) asks whether sim.bin, which is immovable")
    assert f"write {name}(sim.bin, sim.ball)" in message
    assert not told(ss.eval, f"{name}(sim.bin, sim.ball);")
    ss.strict = True
    with pytest.raises(ArgumentError, match="immovable"):
        ss.eval(f"heldFor({name}(sim.ball, sim.bin)) > 0.2;")


@pytest.fixture(scope="module")
def shelf_world():
    """A shelf on the floor, a cup and a lamp in the air over it; all but the cup immovable."""
    with Stage() as stage:
        for name, half, mass, z in (
            ("floor", [1, 1, 0.1], 0, -0.1),
            ("shelf", [0.2, 0.2, 0.25], 0, 0.25),
            ("cup", 0.05, 1, 0.55),
            ("lamp", 0.1, 0, 2),
        ):
            stage.box(name, (0, 0, z), half, mass=mass)
        yield stage.open()


@pytest.fixture(params=[False, True])
def shelf(request, shelf_world):
    with ssduck.Interpreter(row_by_row=request.param) as ss:
        ss.add_variable("sim", shelf_world)
        yield ss


# (program or SQL, the start of the message; "" where the question is meant as it stands)
ROLES = [
    ("SELECT id FROM sim WHERE on(this, sim.lamp);", "on(this, sim.lamp) asks whether sim.lamp"),
    ("count(SELECT id FROM sim WHERE z > 0 AND supports(this, sim.lamp)) == 1;", "supports(this,"),
    ("EXISTS (SELECT this FROM sim{} WHERE restsOn(this, sim['lamp']));", "restsOn(this, sim.l"),
    ("SELECT id, on(this, lamp) AS it FROM sim;", "on(this, sim.lamp)"),
    ("SELECT a.id FROM a=sim, b=sim WHERE on(a.this, b.this) AND b.id = 'lamp';", "on(a.this, b.t"),
    (
        "SELECT a.id FROM a=sim WHERE (SELECT on(a.this, sim.lamp) FROM sim LIMIT 1 AS value);",
        "on(",
    ),
    ("SELECT id FROM things WHERE contains(this, sim.lamp);", "contains(this, sim.lamp)"),
    ("SELECT id FROM sim WHERE inside(this, sim.lamp) > 0.5;", "inside(this, sim.lamp)"),
    ("SELECT id FROM sim WHERE below(this, sim.floor);", ""),  # nothing is below it, either
    ("SELECT id FROM sim WHERE on(this, sim.shelf);", ""),  # on the floor
    ("SELECT id FROM sim WHERE kind(this) = 'robot' AND on(this, sim.shelf);", ""),
    ("SELECT id FROM sim WHERE on(sim.lamp, this);", ""),
    ("SELECT id FROM sim WHERE on(this, sim.cup) AND z > 9;", ""),
    ("SELECT id FROM sim WHERE above(this, sim.lamp);", ""),  # over all others
    ("SELECT id FROM sim WHERE above(this, sim.floor);", "above(this, sim.floor)"),
    ("SELECT id FROM sim{} WHERE above(this, sim.floor);", ""),  # something may have been
    ("SELECT a.id FROM a=sim, b=sim WHERE on(a.this, b.this);", ""),
    (
        "SELECT a.name FROM entities a, entities b WHERE onTop(a, b) AND b.name = 'lamp'",
        "onTop(a, b) asks whether b, which is sim.lamp, immovable, is on a: write onTop(b, a)",
    ),
    ("SELECT a.name FROM entities a, entities b WHERE RestsOn(a, b) AND b.name = ?", "RestsOn(a,"),
    ("SELECT a.name FROM entities a, entities b WHERE onTop(a, b) AND b.name = 'shelf'", ""),
    ("SELECT a.name FROM entities a, entities b WHERE onTop(a, b) AND b.name <> 'lamp'", ""),
    ("SELECT a.name FROM entities a, entities b WHERE onTop(b, a) AND b.name = 'lamp'", ""),
    ("SELECT a.name FROM entities a, entities b WHERE onTop(a, b) OR b.name = 'lamp'", ""),
]


@pytest.mark.slow
@pytest.mark.parametrize(("text", "message"), ROLES)
def test_swapped_roles_of_the_rows_of_a_query_are_told_of(shelf, text, message):
    world = shelf["sim"]
    shelf.add_variable("lamp", world["lamp"])
    shelf.add_variable("things", list(world))
    if text.endswith(";"):
        arguments = (shelf.eval, text)
    else:
        arguments = (shelf.sql, text, ["lamp"]) if "?" in text else (shelf.sql, text)
    told_now = told(*arguments)
    assert [one[: len(message)] for one in told_now] == [message] * bool(message)
    assert all("immovable" in one for one in told_now)
    shelf.strict = True
    if "immovable" in "".join(told_now) and "above" not in message:
        with pytest.raises(ArgumentError, match="immovable"):
            arguments[0](*arguments[1:])
    else:
        assert told(*arguments) == []


# -- the first probable mistakes of a program, and the number of the others ---------------------


@pytest.fixture
def chaos():
    with ssduck.load("chaos") as chaos:
        yield chaos


def unknown(count, first=0):
    """Returns a query with so many names that nothing has."""
    names = ", ".join(f"'thing {number}'" for number in range(first, first + count))
    return f"SELECT this FROM chaos WHERE this IN ({names}) AS list;"


def more(count):
    return f"and {count} more such warnings of this program"


# Mistakes of one statement are limited already, but not those of texts in lists, nor all statements'.
PROGRAMS = {
    "a list": unknown(MAX_WARNINGS + 7),
    "statements": "".join(unknown(1, first=number) for number in range(MAX_WARNINGS + 7)),
    "a program within": f"eval({unknown(MAX_WARNINGS + 6)!r}); {unknown(1, first=99)}",
}


@pytest.mark.parametrize("program", PROGRAMS.values(), ids=PROGRAMS)
def test_a_program_shows_the_first(chaos, program):
    *first, last = told(chaos.eval, program)
    assert len(first) == len(set(first)) == MAX_WARNINGS
    assert all(f"'thing {number}'" in text for number, text in enumerate(first))
    assert last == more(7)


def test_as_many_as_are_shown_have_no_others(chaos):
    assert len(told(chaos.eval, unknown(MAX_WARNINGS))) == MAX_WARNINGS


def test_the_next_program_has_its_own(chaos):
    told(chaos.eval, unknown(MAX_WARNINGS + 7))
    (text,) = told(chaos.eval, unknown(1, first=99))
    assert "'thing 99'" in text
    with pytest.warns(ProgramWarning, match="thing_98"):
        chaos.sql("SELECT id FROM entities WHERE name = 'thing_98'")


def test_an_explanation_and_a_failed_program_say_it_too(chaos):
    assert told(chaos.eval, f"EXPLAIN {unknown(MAX_WARNINGS + 7)}")[-1] == more(7)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        with pytest.raises(ssduck.SelectScriptError):
            chaos.eval(unknown(MAX_WARNINGS + 5, first=100) + " 1 / 0 + none;")
    assert str(caught[-1].message) == more(5)


def test_a_warning_that_is_an_error_leaves_an_interpreter_for_others(chaos):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        warnings.filterwarnings("error", message="and .* more such")
        with pytest.raises(ProgramWarning):
            chaos.eval(unknown(MAX_WARNINGS + 7))
    with ThreadPoolExecutor(1) as other:
        assert other.submit(chaos.eval, "1 + 1;").result(timeout=60) == 2


def test_collected_doubts_are_as_many(chaos):
    with collected_doubts(chaos) as doubts:
        assert told(chaos.eval, unknown(MAX_WARNINGS + 7)) == []
    assert len(doubts) == MAX_WARNINGS
