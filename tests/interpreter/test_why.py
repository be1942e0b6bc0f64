"""WHY names the parts of a condition, their margins, and what would change it."""

from __future__ import annotations

import random

import pytest

import ssduck
from ssduck.errors import ArgumentError
from tests.support.cases import generated


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


@pytest.mark.parametrize("seed", range(generated(12)))
def test_the_move_that_it_names_changes_the_answer_and_a_smaller_one_does_not(seed):
    draw = random.Random(seed)  # noqa: S311  # for a test
    with ssduck.load("kitchen") as ss:
        world = ss.call_variable("kitchen")
        bodies = [entity for entity in world if entity.kind == "kinbody"]
        while True:
            a, b = draw.sample(bodies, 2)
            ss.add_variable("a", a)
            ss.add_variable("b", b)
            clearance = ss.eval("clearance(a, b);")
            if 0.05 < clearance < 5:
                break
        limit = clearance * draw.uniform(0.2, 0.9)
        z = ss.eval("z(b);") + draw.uniform(-0.5, 0.5)
        texts = (f"near(a, b, {limit!r});", f"z(b) > {z!r};", f"{z!r} >= z(b);")
        text = draw.choice(texts)
        why = ss.why(text)
        assert why.move is not None
        assert why.move.entity == b.name
        place, answer = b.position, ss.eval(text)
        assert why.value is answer
        for share, changes in ((1.0001, True), (0.9, False)):
            b.move([at + share * by for at, by in zip(place, why.move.translation, strict=True)])
            assert (ss.eval(text) is not answer) is changes, (text, a.name, b.name, share)


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


def test_what_is_no_condition_is_told_of(kitchen):
    with pytest.raises(ArgumentError, match="WHY takes a condition"):
        kitchen.eval("WHY SELECT name FROM kitchen;")
    assert kitchen.eval("why = 2; why + 1;") == 3
