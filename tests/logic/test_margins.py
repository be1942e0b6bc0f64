"""The margin of a condition is more than 0 where it holds, and less where it does not."""

from __future__ import annotations

import math

import mujoco
import numpy as np
import pytest

import ssduck
from ssduck.errors import ArgumentError
from ssduck.sql.relations.registry import RELATIONS
from tests.support.mjcf import simulated

OF_PAIRS = sorted(
    relation.name
    for relation in RELATIONS.values()
    if relation.margin and [p.type for p in relation.parameters[:2]] == ["entity", "entity"]
)
OTHERS = [
    "inBox(this, [0, 0, 0], [2, 3, 1.5])",
    "inBox(this, [-2, -0.5, -0.5], [0.5, 2, 1], viewer)",
    "fitsBox(this, [0, 0, 0], [3, 3, 2])",
    "inSphere(this, [1, 1, 1], 1.2)",
    "upright(this, 1e-5)",
]
OF_JOINTS = ["isOpen(this)", "isClosed(this)"]  # see the test of these


@pytest.fixture(scope="module")
def kitchen():
    with ssduck.load("kitchen") as ss:
        ss.add_variable("viewer", ss["kitchen"]["chair_12d0"])
        ss.run(0.5)
        yield ss


@pytest.fixture(scope="module", params=["kitchen", "hall"])
def scene(request):
    with ssduck.load(request.param) as ss:
        ss.add_variable("scene", ss[request.param])
        ss.add_variable("viewer", next(iter(ss[request.param])))
        ss.run(0.5)
        yield ss


def check(holds, margin):
    """Checks the sign of a margin; at a boundary, rounding decides."""
    assert margin > -1e-12 if holds else margin < 1e-12


@pytest.mark.filterwarnings("ignore:.*shapes of .* overlap")
@pytest.mark.parametrize("name", OF_PAIRS)
def test_the_margin_of_a_relation_of_pairs_has_the_sign_of_the_relation(scene, name):
    relation = RELATIONS[name]
    third = [", viewer" if p.type == "entity" else ", 0.1" for p in relation.parameters[2:]]
    for options in {*third, *([] if relation.required_count > 2 else [""])}:
        call = f"{name}(a.this, b.this{options})"
        rows = scene.eval(
            f"SELECT {call} AS holds, robustness({call}) AS margin FROM a=scene, b=scene "
            "WHERE NOT isSensor(a.this) AND NOT isSensor(b.this);"
        )
        assert len(rows) > 500
        assert {row["holds"] for row in rows} >= {False}
        for row in rows:
            check(row["holds"], row["margin"])


@pytest.mark.parametrize("name", OF_PAIRS)
def test_of_an_entity_with_itself_no_relation_holds_and_no_margin_says_so(kitchen, name):
    has_viewer = any(p.name == "viewer" for p in RELATIONS[name].parameters)
    call = f"{name}(viewer, other{', fridge' if has_viewer else ''})"
    kitchen.add_variable("other", kitchen["kitchen"]["chair_12d0"])
    kitchen.add_variable("fridge", kitchen["kitchen"]["fridge"])
    if RELATIONS[name].required_count > 2 and not has_viewer:
        call = f"{name}(viewer, other, 0.1)"
    assert kitchen.eval(f"[{call}, robustness({call})];") == [False, -math.inf]


@pytest.mark.parametrize("condition", OTHERS)
def test_the_margin_of_a_relation_of_one_entity_has_its_sign(kitchen, condition):
    rows = kitchen.eval(
        f"SELECT {condition} AS holds, robustness({condition}) AS margin FROM kitchen "
        "WHERE isKinbody(this);"
    )
    assert {row["holds"] for row in rows} == {True, False}
    for row in rows:
        check(row["holds"], row["margin"])


def test_the_margin_of_a_position_below_or_above_is_the_way_to_where_it_is_not(kitchen):
    world = kitchen["kitchen"]
    rows = kitchen.eval(
        "SELECT a.name AS a, b.name AS b, below(a.this, b.this) AS below "
        "FROM a=kitchen, b=kitchen "
        "WHERE isKinbody(a.this) AND isKinbody(b.this) "
        "AND (below(a.this, b.this) OR above(a.this, b.this));"
    )
    for row in rows[::3]:
        name = "below" if row["below"] else "above"
        kitchen.add_variable("a", world[row["a"]])
        kitchen.add_variable("b", world[row["b"]])
        margin, pose = kitchen.eval(f"[robustness({name}(a, b)), pose(b)];")
        for share, flips in ((0.999, {False}), (1.001, {False, True})):
            answers = set()
            for place in range(6):
                moved = [*pose]
                moved[4 + place % 3] += (1 if place < 3 else -1) * share * margin
                with ssduck.Interpreter() as ss:
                    other = ss.add_variable("k", world.what_if({row["b"]: moved}))
                    ss.add_variable("a", other[row["a"]])
                    ss.add_variable("b", other[row["b"]])
                    answers.add(not ss.eval(f"{name}(a, b);"))
            assert answers == flips, row


def test_a_position_in_a_frame_is_that_of_the_rotation_of_the_frame(kitchen):
    rows = kitchen.eval(
        "SELECT positionIn(a.this, b.this) AS whole, positionIn(a.this, b.this, viewer) AS way, "
        "position(a.this) AS a, pose(b.this) AS b FROM a=kitchen, b=kitchen;"
    )
    origin = np.array(kitchen["viewer"].position)
    assert len(rows) > 500
    for row in rows:
        axes, matrix = np.array(row["b"]), np.zeros(9)
        mujoco.mju_quat2Mat(matrix, axes[:4])
        inverse = matrix.reshape(3, 3).T
        assert row["whole"] == pytest.approx(inverse @ (row["a"] - axes[4:]), abs=1e-12)
        assert row["way"] == pytest.approx(inverse @ (row["a"] - origin), abs=1e-12)


@pytest.mark.parametrize("margin", [0.0, 0.01])
def test_the_gap_of_two_balls_is_their_distance_less_radii_and_margins(margin):
    geom = f"<geom size='.1' margin='{margin}'/>"
    model, data = simulated(
        f"<mujoco><worldbody><body name='a'><freejoint/>{geom}</body>"
        f"<body name='b' pos='0 0 .5'><freejoint/>{geom}</body></worldbody></mujoco>"
    )
    with ssduck.Interpreter() as ss:
        sim = ss.add_variable("sim", ssduck.World.attach((model, data)))
        for name in "ab":
            ss.add_variable(name, sim[name])
        added = ss.eval("clearance(a, b) - contactGap(a, b);")
        assert added == pytest.approx(margin and 2 * margin)
        assert ss.eval("contactGap(a, b);") == pytest.approx(0.3 - added)
        assert ss.eval("robustness(touching(a, b));") == pytest.approx(0.001 + added - 0.3)
        assert ss.eval("robustness(touching(a, b, 0.5));") == pytest.approx(0.5 + added - 0.3)


def test_the_margin_of_an_open_joint_is_that_of_its_share():
    model = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><body name='door'><joint name='hinge' type='hinge' limited='true' "
        "range='0 80'/><geom size='.1'/></body><body name='box'><geom size='.1'/></body>"
        "</worldbody></mujoco>"
    )
    data = mujoco.MjData(model)
    with ssduck.Interpreter() as ss:
        sim = ss.add_variable("sim", ssduck.World.attach((model, data)))
        for share in (0.0, 0.02, 0.3, 0.5, 0.8, 1.0):
            data.joint("hinge").qpos[0] = share * model.joint("hinge").range[1]
            mujoco.mj_forward(model, data)
            sim.tick()
            assert ss.eval("openness(sim.door, 'hinge');") == pytest.approx(share)
            for text, margin in (
                ("isOpen(sim.door)", share - 0.5),
                ("isOpen(sim.door, 'hinge')", share - 0.5),
                ("isOpen(sim.door, 'hinge', 0.7)", share - 0.7),
                ("isClosed(sim.door)", 0.05 - share),
                ("isClosed(sim.door, 'hinge', 0.4)", 0.4 - share),
            ):
                found = ss.eval(f"robustness({text});")
                assert found == pytest.approx(margin, abs=1e-8)
                check(ss.eval(f"{text};"), found)
        assert ss.eval("openness(sim.box);") == -math.inf
        for condition in ("isOpen(sim.box)", "isClosed(sim.box)"):
            assert ss.eval(f"[{condition}, robustness({condition})];") == [False, -math.inf]


def test_a_region_of_a_site_has_no_margin():
    model, data = simulated(
        "<mujoco><worldbody><body name='tray' euler='0 0 45'><geom size='.1'/>"
        "<site name='zone' type='box' size='1 .1 1'/></body><body name='ball' pos='.5 -.4 0'>"
        "<freejoint/><geom size='.1'/></body></worldbody></mujoco>"
    )
    with ssduck.Interpreter() as ss:
        ss.add_variable("sim", ssduck.World.attach((model, data)))
        text = "within(sim.tray.zone, sim.ball)"
        assert ss.eval(f"[{text}, robustness({text})];") == [False, -math.inf]


def test_each_margin_is_checked():
    conditions = OTHERS + OF_JOINTS
    checked = {*OF_PAIRS, *(condition.partition("(")[0] for condition in conditions)}
    having = {relation.name for relation in RELATIONS.values() if relation.margin}
    assert not having - checked, "add a condition of it to OTHERS"
    assert {"above", "collides", "contains", "near", "overlaps", "within"} <= having
    assert {"inBox", "fitsBox", "inSphere", "upright"} <= having


@pytest.mark.parametrize(
    ("condition", "margin"),
    [
        ("2 < 5", 3),
        ("2 >= 5", -3),
        ("2 < 5 AND 7 > 6", 1),
        ("2 < 5 OR 7 > 6", 3),
        ("NOT 2 < 5", -3),
        ("2 < 5 IMPLIES 1 > 3", -2),
        ("2 BETWEEN 1 AND 6", 1),
        ("scale(2 < 5, 10) AND 7 > 6", 0.3),
        ("1 < 2 AND 2 < 5 AND 9 > 4", 1),
        ("True", math.inf),
        ("2 == 5", -math.inf),
        ("2 < 5 AND True", 3),
    ],
)
def test_the_margin_of_operators(condition, margin):
    with ssduck.Interpreter() as ss:
        assert ss.eval(f"robustness({condition});") == pytest.approx(margin)


def test_the_margin_of_an_operator_of_time_is_the_least_or_the_largest():
    with ssduck.load("kitchen", recording=ssduck.Recording()) as ss:
        ss.run(0.2)
        rows = ss.eval("SELECT time, speed(this) AS v FROM kitchen{} WHERE name = 'plate_835a';")
        speeds = [row["v"] for row in rows]
        text = "speed(kitchen.plate_835a) < 0.01"
        assert ss.eval(f"robustness(historically({text}));") == 0.01 - max(speeds)
        assert ss.eval(f"robustness(once({text}));") == 0.01 - min(speeds)
        assert ss.eval(f"robustness(eventually({text}, 0, 0.1));") == 0.01 - min(
            row["v"] for row in rows if row["time"] <= 0.1 + 1e-9
        )
        assert ss.eval(f"robustness(always({text}));") is None  # it may still be less
        assert ss.eval(f"greatest(robustness({text}));")[1] == 0.01 - min(speeds)


def test_the_margin_of_lifted_is_that_of_the_expression_it_stands_for():
    with ssduck.load("kitchen", recording=ssduck.Recording()) as ss:
        cup = ss["kitchen"]["cup_905a"]
        ss.run(0.02)
        cup.move([1.0, 0.433, 1.3])
        ss.run(0.02)
        rise = ss.eval("z(kitchen.cup_905a) - initially(z(kitchen.cup_905a));")
        for text, margin in (
            ("lifted(kitchen.cup_905a, 0.1)", rise - 0.1),
            ("once(scale(lifted(kitchen.cup_905a, 0.1), 0.5), 0, 0)", (rise - 0.1) / 0.5),
        ):
            assert ss.eval(f"robustness({text});") == pytest.approx(margin, abs=1e-9)


def test_the_margin_of_what_is_unknown_is_nothing():
    model, data = simulated(
        "<mujoco><worldbody><body name='box' pos='0.5 0 0'><freejoint/><geom size='.1'/></body>"
        "<body name='ball' pos='0 0 1'><freejoint/><geom size='.1'/></body></worldbody></mujoco>"
    )
    conditions = ["z(b) > 0 AND x(a) > 0", "z(b) > 0 OR x(a) > 0", "z(b) == 1", "touching(a, b)"]
    with ssduck.Interpreter() as ss:
        sim = ss.add_variable("sim", ssduck.World.attach((model, data)))
        ss.add_variable("a", sim["box"])
        ss.add_variable("b", sim["ball"])
        data.time = 0.1
        data.body("ball").xpos[:] = math.nan
        with pytest.warns(UserWarning, match="no number"):
            sim.tick()
        for condition in conditions:
            for text in (condition, f"NOT ({condition})"):
                margins = [v for _, v in ss.eval(f"changes(robustness({text}));")]
                assert (margins[0] > 0) is ss.eval(f"initially({text});")
                assert margins[1:] == [None], text
                assert ss.eval(f"robustness(historically({text}, 0, 0));") is None


@pytest.mark.parametrize(
    ("call", "message"),
    [
        ("robustness()", "robustness takes 1"),
        ("robustness(lifted(1))", "lifted takes 2"),
        ("robustness(scale(1 < 2, 0))", "scale: the unit is a number above 0"),
        ("robustness(scale(1 < 2, -1))", "scale: the unit is a number above 0"),
        ("once(scale(1 < 2, -2))", "scale: the unit is a number above 0"),
        ("once(scale(1 < 2, 0))", "scale: the unit is a number above 0"),
        ("WHY unit", "WHY takes a condition"),
        ("robustness(scale(1 < 2, unit))", "scale: the unit is a number above 0.*not -0.1"),
        ("WHY scale(1 < 2, unit)", "scale: the unit is a number above 0.*not -0.1"),
        (
            "SELECT robustness(scale(this < 2, unit)) FROM [1, 2]",
            "scale: the unit is a number above 0.*not -0.1",
        ),
        ("robustness(z(cup))", "robustness takes a condition"),
        ("robustness(once(1 < 2 AND -z(cup)))", "robustness takes a condition"),
        ("robustness(robustness(z(cup) > 1))", "robustness takes a condition"),
        ("robustness(heldFor(z(cup) > 1))", "robustness takes a condition"),
        ("robustness('high')", "robustness takes a condition"),
    ],
)
def test_mistakes_are_told_of(call, message):
    with ssduck.Interpreter() as ss:
        ss.add_variable("unit", -0.1)
        with pytest.raises(ArgumentError, match=message):
            ss.eval(f"{call};")


def test_a_unit_may_have_a_plus():
    with ssduck.Interpreter() as ss:
        assert ss.eval("robustness(scale(1 < 2, +2));") == 0.5
        assert ss.eval("scale(1 < 2, +2);") is True
