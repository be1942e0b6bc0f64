"""WHY names the parts of a condition, their margins, and what would change it."""

from __future__ import annotations

import random

import numpy as np
import pytest

import ssduck
from ssduck.errors import ArgumentError
from ssduck.logic.why import Move, Why
from tests.support.cases import generated
from tests.support.mjcf import simulated
from tools import check_why


@pytest.fixture(scope="module")
def kitchen():
    with ssduck.load("kitchen", recording=ssduck.Recording()) as ss:
        world = ss.call_variable("kitchen")
        ss.add_variable("table", world["table"])
        ss.add_variable("cup", world["cup_905a"])
        world["cup_905a"].move([1.0, 0.433, 1.3])
        ss.run(1.0)
        yield ss


def test_each_part_has_its_value_and_its_margin(kitchen):
    why = kitchen.why("on(table, cup) AND NOT z(cup) > 2;")
    assert why.value is True
    assert [(depth, part.text, part.value) for depth, part in why.walk()] == [
        (0, "on(table, cup) AND NOT z(cup) > 2", True),
        (1, "on(table, cup)", True),
        (1, "NOT z(cup) > 2", True),
        (2, "z(cup) > 2", False),
    ]
    z = kitchen.eval("z(cup);")
    _, on, high, low = (part.margin for _, part in why.walk())
    assert on is None
    assert (high, low) == (2 - z, z - 2)
    assert kitchen.eval("WHY on(table, cup) AND NOT z(cup) > 2;") == str(why)
    assert [row["depth"] for row in why.rows()] == [0, 1, 1, 2]


def test_the_tick_that_decides_is_named(kitchen):
    rows = kitchen.eval("SELECT time, z AS z FROM kitchen{} WHERE name = 'cup_905a';")
    lowest = min(rows, key=lambda row: row["z"])
    _, part = (part for _, part in kitchen.why("historically(z(cup) > 0.9);").walk())
    assert (part.time, part.margin) == (lowest["time"], lowest["z"] - 0.9)
    why = kitchen.why("always(z(cup) > 1.2 IMPLIES eventually(touching(table, cup), 0, 0.2));")
    assert why.value is False
    texts = {part.text: part for _, part in why.walk()}
    assert texts["z(cup) > 1.2"].time == 0.0
    assert texts["NOT z(cup) > 1.2"].value is False
    assert texts["touching(table, cup)"].value is False
    held = kitchen.why("heldSince(z(cup) < 1.0, touching(table, cup));")
    start = held.parts[-1]
    assert start.text == "touching(table, cup)"
    assert start.time == kitchen.eval("holds(touching(table, cup));")[0][0]


@pytest.mark.slow
def test_the_moves_that_it_names_change_answers_and_smaller_ones_do_not(capsys, monkeypatch):
    monkeypatch.setattr("sys.argv", ["check_why", str(generated(60)), "--seed", "9"])
    assert check_why.main() == 0, capsys.readouterr().out


WALLS = """
<mujoco><worldbody>
  <body name="walls"><geom type="box" size=".1 3 3" pos=".5 0 0"/>
    <geom type="box" size=".1 3 3" pos="-.5 0 0"/></body>
  <body name="ball" pos=".1 0 0"><freejoint/><geom size=".1"/></body>
</worldbody></mujoco>
"""


@pytest.mark.parametrize(
    ("text", "way"),
    [
        ("near(walls, ball, 0.05)", 0.15),
        ("near(walls, ball, 0.25)", -0.05),
        ("near(walls, ball, 0.35)", -1.15),  # out through the other wall
        ("clearance(walls, ball) > 0.25", -0.05),
        ("0.1 >= clearance(walls, ball)", 0.1),
        ("penetration(walls, ball) <= 0.01", 0.21),
        ("collides(walls, ball, 0.02)", 0.22),
        ("touching(walls, ball)", 0.199),
        ("distance(walls, ball) < 0.3", 0.2),
        ("x(ball) > 0", -0.1),
        ("near(walls, ball, -1)", None),
        ("clearance(walls, ball) >= 0", None),
        ("near(ball, ball, 1)", None),
    ],
)
def test_what_is_between_walls_is_moved_until_the_answer_changes(text, way):
    model, data = simulated(WALLS)
    with ssduck.Interpreter() as ss:
        sim = ss.add_variable("sim", ssduck.World.attach((model, data)))
        for name in ("walls", "ball"):
            ss.add_variable(name, sim[name])
        for told in (text, f"once({text})"):  # now, and at the tick of the record
            moves = [part.move for _, part in ss.why(f"{told};").walk()]
            move = next(filter(None, moves), None)
            if way is None:
                assert move is None
            else:
                assert move.translation == pytest.approx((way, 0, 0), abs=1e-7)


def test_what_is_near_moves_away_along_the_line_between():
    with ssduck.load("kitchen") as ss:
        ss.add_variable("can", ss.call_variable("kitchen")["can"])
        ss.add_variable("table", ss.call_variable("kitchen")["table"])
        why = ss.why("near(table, can, 3);")
        margin = ss.eval("robustness(near(table, can, 3));")
        assert why.margin == margin > 0
        can = ss.call_variable("kitchen")["can"]
        place = can.position
        for share, near in ((0.9, True), (1.001, False)):
            moves = zip(place, why.move.translation, strict=True)
            can.move([at + share * by for at, by in moves])
            assert ss.eval("near(table, can, 3);") is near


@pytest.mark.parametrize("seed", range(generated(8)))
def test_a_row_of_a_query_is_told_by_its_conditions(seed, kitchen):
    draw = random.Random(seed)  # noqa: S311  # for a test
    thing = draw.choice([each for each in kitchen["kitchen"] if each.kind == "kinbody"])
    height, gap = draw.uniform(0.2, 1.4), draw.uniform(0.1, 2.0)
    where = f"z(this) > {height} AND near(table, this, {gap})"
    kitchen.add_variable("thing", thing)
    margins = [thing.position[2] - height, gap - kitchen.eval("clearance(table, thing);")]
    negated = draw.choice(["", "NOT "])
    why = kitchen.why(
        f"kitchen['{thing.name}'] {negated}IN (SELECT obj FROM kitchen WHERE {where});"
    )
    if negated:
        assert why.value is not all(margin > 0 for margin in margins)
        (why,) = why.parts
    (row,) = why.parts
    assert (why.value, row.value) == (all(margin > 0 for margin in margins),) * 2
    assert row.text == where
    assert row.detail == f"this is {thing.name}"
    assert row.margin == pytest.approx(min(margins))
    assert [part.margin for part in row.parts] == pytest.approx(margins)
    assert [part.move.entity for part in row.parts] == [thing.name] * 2


def test_of_two_sources_the_other_one_that_comes_nearest_is_told(kitchen):
    """The conditions are those of the robot that is nearest to the can."""
    can, robots = kitchen["kitchen"]["can"], []
    for robot in (each for each in kitchen["kitchen"] if each.kind == "robot"):
        clearance = kitchen.eval("clearance(a, b);", {"a": can, "b": robot})
        robots += [] if clearance is None else [(clearance, robot.name)]
    nearest, name = min(robots)
    limit = nearest / 2
    query = f"""SELECT a.obj FROM a=kitchen, b=kitchen
        WHERE near(a.this, b.this, {limit!r}) AND isRobot(b.this)"""
    (row,) = kitchen.why(f"kitchen.can IN ({query});").parts
    assert row.detail == f"a is can; b is {name}"
    assert row.margin == pytest.approx(limit - nearest)
    assert [part.value for part in row.parts] == [False, True]


@pytest.mark.slow
def test_of_rows_that_fail_one_with_the_fewest_failures_is_told(kitchen):
    """What has no margin counts as the farthest, whatever the other conditions say."""
    why = kitchen.why("EXISTS (SELECT this FROM kitchen WHERE on(table, this) AND z > 2);")
    (row,) = why.parts
    assert (why.value, row.detail) == (False, "this is cup_905a")
    # A thing is not near itself, though its distance to itself is 0.
    why = kitchen.why("SELECT a.this FROM a=kitchen, b=kitchen WHERE near(a.this, b.this, 1e-4);")
    assert why.parts[0].detail.split("; ")[0] != why.parts[0].detail.split("; ")[1]


@pytest.mark.slow
def test_of_recorded_rows_the_tick_is_told(kitchen):
    rows = kitchen.eval("SELECT time, z AS z FROM kitchen{} WHERE name = 'cup_905a';")
    highest = max(row["z"] for row in rows)
    text = "SELECT this FROM kitchen{} WHERE name = 'cup_905a' AND z(this) > 5"
    for why in (kitchen.why(f"{text};"), kitchen.why(f"EXISTS ({text});")):
        _, z = why.parts[0].parts
        assert (z.margin, z.time) == (highest - 5, 0.0)
    why = kitchen.why("SELECT this FROM kitchen WHERE historically(z(this) > 9 OR z(this) > 1.2);")
    (row,) = why.parts[0].parts
    assert why.parts[0].value is row.value is True


def test_what_a_query_yields_is_told_where_no_row_can_be(kitchen):
    assert kitchen.why("7 IN (SELECT this FROM [1, 2] AS list);").detail == "no row of FROM is 7"
    assert kitchen.why("2 IN (SELECT this FROM [1, 2] AS list);").detail == "this is 2"
    for query, unfit in {
        "SELECT max(z) FROM kitchen": "groups or aggregates",
        "SELECT kind FROM kitchen GROUP BY kind AS list": "groups or aggregates",
        "SELECT a.z FROM a=kitchen, b=kitchen, c=kitchen LIMIT 1 OFFSET 1": "LIMIT or OFFSET",
        "SELECT a.z FROM a=kitchen, b=kitchen, c=kitchen WHERE a.z > b.z": "more than two sources",
        "SELECT z FROM kitchen LIMIT 1": "LIMIT or OFFSET",
    }.items():
        why = kitchen.why(f"2 > 1 AND 1.0 IN ({query});")
        assert why.parts[1].detail == f"WHY tells no more, as the SELECT has {unfit}"
        assert why.value is kitchen.eval(f"1.0 IN ({query});")
    with pytest.warns(ssduck.errors.ProgramWarning, match="write AS list"):
        why = kitchen.why("cup IN (SELECT obj FROM kitchen);")
    assert why.detail.endswith("dicts as rows: write AS list")


def test_a_condition_that_is_wrong_elsewhere_is_evaluated_where_it_is_right(kitchen):
    text = "SELECT this FROM [1, 'a'] WHERE this == 1 AND this + 1 > 5"
    assert kitchen.eval(f"{text};") == []
    assert kitchen.why(f"{text};").parts[0].detail == "this is 1"


def test_between_and_not_in_are_written_as_what_they_are_made_of(kitchen):
    texts = {part.text for _, part in kitchen.why("z(cup) NOT BETWEEN 1 AND 2;").walk()}
    assert {"z(cup) >= 1", "z(cup) <= 2", "NOT (z(cup) >= 1 AND z(cup) <= 2)"} < texts
    why = kitchen.why("kitchen.can NOT IN (SELECT this FROM kitchen WHERE z > 9);")
    assert why.text == "NOT kitchen.can IN (SELECT this FROM kitchen WHERE z > 9)"


def test_all_that_and_joins_is_on_one_level(kitchen):
    why = kitchen.why("z(cup) > 0 AND z(cup) > 1 AND (z(cup) > 2 OR x(cup) > 3 OR y(cup) > 4);")
    assert [depth for depth, _ in why.walk()] == [0, 1, 1, 1, 2, 2, 2]


def test_a_notebook_and_a_terminal_show_the_tree(kitchen):
    why = kitchen.why("'<b>' == 'a' OR z(cup) > 0;")
    assert repr(why) == str(why)
    lines = why._repr_html_().split("</div>")
    assert [line.count("✓") for line in lines] == [1, 0, 1, 0]
    assert "&lt;b&gt;" in lines[1]
    assert "<b>'" not in lines[1]
    assert [line.partition("padding-left: ")[2][:3] for line in lines[:3]] == ["0em", "2em", "2em"]


def test_texts_of_strangers_control_no_terminal():
    why = Why("a", False, detail="this is a\x1b[2J\u202e", move=Move("b\n", (0.0, 0.0, 1.0)))
    assert str(why).isprintable()
    assert "\x1b" not in why._repr_html_()


def test_scaled_and_lifted_conditions_are_told_as_they_are_written(kitchen):
    kitchen.add_variable("unit", 0.1)
    z, start = kitchen.eval("[z(cup), initially(z(cup))];")
    whole = kitchen.why("scale(z(cup) > 0.9, unit) AND NOT lifted(cup, 0.3);")
    scaled, raised = whole.parts[0].parts[0], whole.parts[1].parts[0]
    texts = (whole.parts[0].text, scaled.text, raised.text)
    assert texts == ("scale(z(cup) > 0.9, unit)", "z(cup) > 0.9", "lifted(cup, 0.3)")
    assert whole.parts[0].margin == pytest.approx((z - 0.9) / 0.1)
    assert scaled.margin == pytest.approx(z - 0.9)
    assert scaled.detail.startswith("z(cup) is ")
    assert raised.margin == pytest.approx(z - start - 0.3)
    assert raised.detail == f"cup has risen by {z - start:.6g} m"
    assert whole.margin == pytest.approx(min(whole.parts[0].margin, -raised.margin))
    for part in (scaled, raised):
        place = np.add(kitchen["cup"].position, part.move.translation)
        world = kitchen["kitchen"].what_if({"cup_905a": [1, 0, 0, 0, *place]})
        with ssduck.Interpreter() as ss:
            cup = ss.add_variable("moved", world)["cup_905a"]
            limit = {scaled.text: 0.9, raised.text: start + 0.3}[part.text]
            assert (cup.position[2] > limit) is not part.value


def test_rows_of_lifted_bodies_and_ticks_of_scaled_margins_are_told(kitchen):
    text = "SELECT name FROM kitchen WHERE isKinbody(this) AND lifted(this, -0.1)"
    assert kitchen.why(f"{text};").parts[0].value is True
    (part,) = kitchen.why("historically(scale(z(cup) > 0.9, 2));").parts
    rows = kitchen.eval("SELECT time, z AS z FROM kitchen{} WHERE name = 'cup_905a';")
    lowest = min(rows, key=lambda row: row["z"])
    assert (part.time, part.margin) == (lowest["time"], (lowest["z"] - 0.9) / 2)


def test_points_show_what_a_coordinate_lacks(kitchen):
    x, y, z = kitchen["cup"].position
    why = kitchen.why("2 >= y(cup);")
    assert why.points == ((x, y, z), (x, pytest.approx(2), z))
    assert why.entities == ("cup_905a",)
    assert kitchen.why("near(table, cup, 0.1);").entities == ("table", "cup_905a")
    rows = kitchen.eval("SELECT time, z AS z FROM kitchen{} WHERE name = 'cup_905a';")
    lowest = min(rows, key=lambda row: row["z"])
    why = kitchen.why("isRobot(table) OR NOT historically(z(cup) > 0);")
    assert (why.decided_at, why.parts[1].decided_at) == (None, lowest["time"])
    part = why.parts[1].parts[0].parts[0]
    assert (part.points[0][2], part.points[1][2]) == (lowest["z"], pytest.approx(0))


def test_what_is_no_condition_is_told_of(kitchen):
    with pytest.raises(ArgumentError, match="WHY takes a condition"):
        kitchen.eval("WHY SELECT name FROM kitchen;")
    with pytest.raises(ArgumentError, match="this one has groups"):
        kitchen.eval("WHY SELECT max(z) FROM kitchen WHERE z > 1;")
    for text in ("3", "'a'", "z(cup) + 1", "z(cup)", "[1, 2]"):
        with pytest.raises(ArgumentError, match="WHY takes a condition"):
            kitchen.eval(f"WHY {text};")
    assert kitchen.eval("why = 2; why + 1;") == 3
