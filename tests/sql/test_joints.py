"""Where joints are, and whether they are open: by every door, at the limits, and what is no joint."""

import math

import pytest

import ssduck
from ssduck.errors import (
    ArgumentError,
    SelectScriptError,
    SqlError,
    UnknownNameError,
    UnsupportedError,
)
from ssduck.recording.spec import Recording
from tests.support.cases import sampled
from tests.support.stage import Stage
from tests.support.urdf import collision, joint, link, robot

LIMIT = '<limit lower="{}" upper="{}" effort="1" velocity="1"/>'
EDGE = 1e-6


def cabinet():
    """Joints whose closed ends are their lower limit, their upper one, or not at 0; and others."""
    parts = [link("case", shapes=collision('<box size="0.4 0.4 0.4"/>'))]
    for name, kind, lower, upper in (
        ("drawer", "prismatic", 0.0, 0.4),
        ("door", "revolute", -1.6, 0.0),
        ("flap", "revolute", 0.5, 1.5),
        ("valve", "revolute", -1.0, 1.0),
    ):
        limit = LIMIT.format(lower, upper)
        parts += [link(f"{name}_link"), joint(name, kind, "case", f"{name}_link", limit=limit)]
    parts += [link("knob"), joint("turn", "continuous", "case", "knob")]
    parts += [link("shelf"), joint("weld", "fixed", "case", "shelf")]
    return robot(*parts)


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """A cabinet, a chest with a drawer of its own, a box without joints, and a robot's wheel."""
    place = tmp_path_factory.mktemp("models")
    stage = Stage()
    texts = {
        "cabinet": cabinet(),
        "chest": robot(
            link("base"), link("tray"),
            joint("drawer", "prismatic", "base", "tray", limit=LIMIT.format(0.0, 0.2)),
        ),
        "cart": robot(link("base"), link("wheel"), joint("axle", "continuous", "base", "wheel")),
    }  # fmt: skip
    for number, (name, text) in enumerate(texts.items()):
        path = place / f"{name}.urdf"
        path.write_text(text)
        stage.urdf(name, path, (0, number, 0))
    stage.box("crate", (0, 5, 0))
    world = stage.open()
    ss, slow = stage.interpreters(sim=world)
    for one in (ss, slow):
        one.record("sim", Recording(tables=("joints",)))
    closed = {"drawer": 0.0, "door": 0.0, "flap": 0.5, "valve": -1.0}
    yield ss, slow, world, closed
    stage.close()


def put(world, closed, **joints):
    world["cabinet"].move(joints=closed | joints)


# (joint, its position, how far it is open)
SHARES = [
    ("drawer", 0.0, 0.0), ("drawer", 0.1, 0.25), ("drawer", 0.4, 1.0),
    ("door", 0.0, 0.0), ("door", -0.4, 0.25), ("door", -1.6, 1.0),
    ("flap", 0.5, 0.0), ("flap", 0.75, 0.25), ("flap", 1.5, 1.0),
    ("valve", -1.0, 0.0), ("valve", -0.5, 0.25), ("valve", 1.0, 1.0),
]  # fmt: skip


@pytest.mark.slow
@sampled(("name", "position", "share"), SHARES, every=3)
def test_shares_are_of_the_range_from_the_closed_end(scene, name, position, share):
    ss, slow, world, closed = scene
    put(world, closed, **{name: position})
    (state,) = [one for one in world["cabinet"].joints if one.name == name]
    assert state.openness == pytest.approx(share, abs=1e-9)
    for one in (ss, slow):
        assert one.eval(f"joint(cabinet, '{name}');") == pytest.approx(position, abs=1e-9)
        for wanted in (0.0, 0.25, 0.5, 1.0):
            expected = [share >= wanted, share <= wanted]
            program = (
                f"[isOpen(cabinet, '{name}', {wanted}), isClosed(cabinet, '{name}', {wanted})];"
            )
            assert one.eval(program) == expected
        assert one.eval(f"isOpen(cabinet, '{name}');") is (share >= 0.5)
        assert one.eval("isOpen(cabinet);") is (share >= 0.5)
        assert one.eval("isClosed(cabinet);") is (share <= 0.05)
    rows = ss.sql(
        f"SELECT joint(e, '{name}'), isOpen(e), isOpen(e, '{name}'), isOpen(e, '{name}', 0.25), "
        f"isClosed(e), isClosed(e, '{name}', 0.25) FROM entities e WHERE name = 'cabinet'"
    ).fetchall()
    assert rows == [
        (pytest.approx(position), share >= 0.5, share >= 0.5, share >= 0.25, share <= 0.05, share <= 0.25)
    ]  # fmt: skip


# Of a drawer of 0.4 m: (position, open by half, closed to a 20th)
EDGES = [
    (0.2 - EDGE, False, False),
    (0.2, True, False),
    (0.2 + EDGE, True, False),
    (0.02 - EDGE, False, True),
    (0.02, False, True),
    (0.02 + EDGE, False, False),
]


@pytest.mark.parametrize(("position", "is_open", "is_closed"), EDGES)
def test_open_and_closed_at_their_edges(scene, position, is_open, is_closed):
    ss, slow, world, closed = scene
    put(world, closed, drawer=position)
    for one in (ss, slow):
        assert one.eval("[isOpen(cabinet), isClosed(cabinet)];") == [is_open, is_closed]
        assert one.eval("[isOpen(cabinet, 'drawer'), isClosed(cabinet, 'drawer')];") == [is_open, is_closed]  # fmt: skip


def test_what_has_no_joint_with_limits_is_neither(scene):
    ss, slow, world, closed = scene
    put(world, closed, drawer=0.3)
    for one in (ss, slow):
        assert one.eval("SELECT id FROM sim WHERE isOpen(this) AS list;") == ["cabinet"]
        assert one.eval("SELECT id FROM sim WHERE isClosed(this) AS list;") == ["chest"]
        assert one.eval("SELECT id FROM sim WHERE NOT isClosed(this) AS list;") == ["cabinet", "cart", "crate"]  # fmt: skip
    rows = ss.sql("SELECT name, isOpen(e), isClosed(e) FROM entities e ORDER BY name").fetchall()
    assert rows == [
        ("cabinet", True, False), ("cart", False, False), ("chest", False, True), ("crate", False, False)
    ]  # fmt: skip


WRONG = [
    ("joint(cabinet, 'drawr')", "cabinet has no joint 'drawr'; did you mean 'drawer'"),
    ("isOpen(cabinet, 'dor')", "cabinet has no joint 'dor'; did you mean 'door'"),
    ("isClosed(cabinet, '')", "cabinet has no joint ''"),
    ("isOpen(cabinet, 'DOOR', 0.5)", "cabinet has no joint 'DOOR'"),
    ("joint(crate, 'drawer')", "crate has no joints"),
    ("isOpen(crate, 'drawer')", "crate has no joints"),
    ("isOpen(cart, 'axle')", "joint 'axle' is revolute and has no range between two limits"),
    ("isOpen(cabinet, 'weld')", "joint 'weld' is fixed and has no range"),
    ("joint(cabinet, 'weld')", "joint 'weld' is fixed"),
]


@pytest.mark.parametrize(("call", "told"), WRONG)
def test_what_is_no_such_joint_is_an_error(scene, call, told):
    ss, slow, _, _ = scene
    of_row = call.replace("(cabinet", "(this").replace("(crate", "(this").replace("(cart", "(this")
    name = call.partition("(")[2].partition(",")[0]
    for one in (ss, slow):
        for program in (
            f"{call};",
            f"SELECT {of_row} FROM sim WHERE id(this) == '{name}' AS list;",
            f"SELECT id FROM sim WHERE id(this) == '{name}' AND {of_row} != 7;",
            f"SELECT id FROM sim WHERE {call} != 7;",
        ):
            with pytest.raises(SelectScriptError, match=told):
                one.eval(program)


# In raw SQL, of all entities: (expression, what is told of it, or the entities it is known of)
OF_ROWS = [
    ("joint(e, 'drawr')", "no entity of 'sim' has a joint 'drawr'; did you mean 'drawer'"),
    ("isOpen(e, 'dor')", "no entity of 'sim' has a joint 'dor'; did you mean 'door'"),
    ("isOpen(e, 'axle')", "joint 'axle' is revolute and has no range"),
    ("joint(e, 'drawer')", {"cabinet", "chest"}),
    ("isOpen(e, 'door')", {"cabinet"}),
    ("isClosed(e, 'drawer', 0.1)", {"cabinet", "chest"}),
]


@pytest.mark.parametrize(("expression", "told"), OF_ROWS)
def test_raw_sql_does_not_know_of_joints_that_others_have(scene, expression, told):
    ss, _, _, _ = scene
    query = f"SELECT name FROM entities e WHERE {expression} IS NOT NULL"
    if isinstance(told, str):
        with pytest.raises(UnknownNameError, match=told):
            ss.sql(query)
    else:
        assert {name for (name,) in ss.sql(query).fetchall()} == told


@pytest.mark.parametrize(
    "program",
    ["isOpen(cabinet, 0.5);", "joint(cabinet, 3);", "isOpen(cabinet, 'door', 'half');", "joint(cabinet);"],
)  # fmt: skip
def test_what_is_given_is_checked(scene, program):
    for one in scene[:2]:
        with pytest.raises(SelectScriptError):
            one.eval(program)


@pytest.mark.parametrize("share", ["-0.01", "1.01", "50"])
@pytest.mark.parametrize("name", ["isOpen", "isClosed"])
def test_a_share_is_from_0_to_1(scene, name, share):
    told = f"{name}: the share is a number from 0 to 1, not {share}"
    ss, slow, *_ = scene
    for one in (ss, slow):
        with pytest.raises(ArgumentError, match=told):
            one.eval(f"{name}(cabinet, 'drawer', {share});")
    with pytest.raises(SqlError, match=told):
        ss.sql(f"SELECT {name}(e, 'drawer', {share}) FROM entities e WHERE name = 'cabinet'")


@pytest.mark.slow
def test_a_condition_before_it_leaves_out_what_has_no_such_joint(scene):
    ss, slow, world, closed = scene
    put(world, closed, drawer=0.3)
    for one in (ss, slow):
        for _ in range(3):
            for condition in (
                "(id(this) == 'cabinet' OR id(this) == 'chest') AND isOpen(this, 'drawer')",
                "('c' in id(this)) AND id(this) == 'cabinet' AND joint(this, 'door') <= 0",
            ):
                assert one.eval(f"SELECT id FROM sim WHERE {condition} AS list;") == ["cabinet"]


@pytest.mark.slow
def test_past_ticks_and_records(scene, tmp_path):
    ss, slow, world, closed = scene
    times = []
    for position in (0.0, 0.1, 0.3, 0.4, 0.01):
        world.step(1)
        put(world, closed, drawer=position)
        times.append((world.time, position))
    for one in (ss, slow):
        for time, position in times:
            of_then = f"FROM sim{{{time}}} WHERE id(this) == 'cabinet'"
            told = one.eval(
                f"SELECT joint(this, 'drawer'), isOpen(this), isOpen(this, 'drawer', 0.25), isClosed(this) {of_then} AS list;"
            )
            assert told == [
                pytest.approx(position),
                position >= 0.2,
                position >= 0.1,
                position < 0.02,
            ]
        found = one.eval("holds(isOpen(cabinet, 'drawer'));")
        start, end = found[-1]
        assert (start, end) == (pytest.approx(times[2][0]), pytest.approx(times[4][0]))
        assert one.eval("since(isClosed(cabinet));") == pytest.approx(times[4][0])
        assert one.eval("least(0 - joint(cabinet, 'drawer'));")[1] == pytest.approx(-0.4)
        window = one.eval("SELECT time FROM sim{} WHERE id(this) == 'cabinet' AND isOpen(this, 'drawer') AS list;")  # fmt: skip
        assert {times[2][0], times[3][0]} <= set(window)
    rows = ss.sql(
        "SELECT e.time, joint(e, 'drawer') FROM entities_history e "
        "WHERE name = 'cabinet' AND isOpen(e, 'drawer') ORDER BY tick"
    ).fetchall()
    assert dict(rows)[times[2][0]] == pytest.approx(0.3)
    ss.export(tmp_path / "run")
    with ssduck.open(tmp_path / "run") as opened:
        opened.eval("cabinet = SELECT obj FROM sim WHERE id(this) == 'cabinet' AS value;")
        assert opened.eval("isClosed(cabinet);") is True
        assert opened.eval("holds(isOpen(cabinet, 'drawer'));") == ss.eval("holds(isOpen(cabinet, 'drawer'));")  # fmt: skip
        told = opened.eval(f"SELECT joint(this, 'drawer') FROM sim{{{times[3][0]}}} WHERE id(this) == 'cabinet' AS list;")  # fmt: skip
        assert told == [pytest.approx(0.4)]
        with pytest.raises(UnknownNameError, match="did you mean 'drawer'"):
            opened.eval("isOpen(cabinet, 'drawr');")


def test_what_if(scene):
    ss, slow, world, closed = scene
    put(world, closed)
    for one in (ss, slow):
        one.add_variable("what", world.what_if(joints={"cabinet": {"drawer": 0.35}}))
        program = "SELECT isOpen(this), joint(this, 'drawer') FROM {} WHERE id(this) == 'cabinet' AS list;"
        assert one.eval(program.format("what")) == [True, pytest.approx(0.35)]
        assert one.eval(program.format("sim")) == [False, pytest.approx(0.0)]


@pytest.mark.slow
def test_joints_that_were_not_recorded(write):
    stage = Stage()
    stage.urdf("cabinet", write("cabinet.urdf", cabinet()))
    world = stage.open()
    for one in stage.interpreters(sim=world):
        one.record("sim", Recording())
        world.step(2)
        then = world.time
        world.step(2)
        assert one.eval("isOpen(cabinet);") is True  # the valve, in the middle of its range
        with pytest.raises(UnsupportedError, match="joints"):
            one.eval(f"SELECT isOpen(this) FROM sim{{{then}}} AS list;")
    stage.close()


def test_beyond_the_limits_and_unknown():
    from ssduck.simulators.interface import Joint
    from ssduck.simulators.kinematics import EntityJoints, openness

    slide = Joint("slide", "prismatic", 1, 0.0, 0.5, None, None)
    assert openness(slide, -0.05) == pytest.approx(-0.1)
    assert openness(slide, 0.55) == pytest.approx(1.1)
    assert EntityJoints("e", [slide], [-0.05]).most_open() == pytest.approx(-0.1)
    assert EntityJoints("e", [slide], [math.nan]).most_open() is None
    assert EntityJoints("e", [slide], [math.nan]).openness("slide") is None
    assert EntityJoints("e", [slide], [math.nan]).position("slide") is None
    assert EntityJoints("e", [], []).most_open() == -math.inf
    for lower, upper in ((None, 1.0), (0.0, None), (1.0, 1.0), (2.0, 1.0), (-math.inf, math.inf)):
        assert openness(Joint("j", "revolute", 1, lower, upper, None, None), 0.0) is None
