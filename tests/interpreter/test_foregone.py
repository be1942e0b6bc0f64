"""Conditions that always hold, or never, are told of: no value of a quantity changes them."""

from __future__ import annotations

import itertools
import random

import pytest

import ssduck
from ssduck.errors import ArgumentError
from ssduck.interpreter.lint.foregone import RANGES, conclusions
from ssduck.language.parser import parse
from ssduck.sql.relations.registry import RELATIONS
from tests.support.warned import told

NEVER = [
    ("z(sim.cup) > 1 AND z(sim.cup) < 0.5;", "whatever z(sim.cup) is; write OR"),
    ("z(sim.cup) > 1 AND x(sim.cup) > 0 AND z(sim.cup) < 0.5;", "whatever z(sim.cup) is"),
    ("0.5 < z(sim.cup) < 0.2;", "whatever z(sim.cup) is"),
    ("z(sim.cup) < 0.5 AND NOT z(sim.cup) < 1;", "whatever z(sim.cup) is"),
    ("touching(sim.cup, sim.tray) AND NOT touching(sim.cup, sim.tray);", "whatever touching("),
    ("near(sim.cup, sim.tray, 0.1) AND clearance(sim.cup, sim.tray) > 0.5;", "whatever clearance("),
    ("upright(sim.cup, 0.2) AND tilt(sim.cup) > 0.5;", "whatever tilt(sim.cup) is"),
    ("heldFor(z(sim.cup) > 1 AND z(sim.cup) < 0.5) > 1;", "whatever z(sim.cup) is"),
    ("robustness(z(sim.cup) > 1 AND z(sim.cup) < 0.5);", "whatever z(sim.cup) is"),
    ("robustness(scale(z(sim.cup) > 1 AND z(sim.cup) < 0.5, 3)) > 0;", "whatever z(sim.cup) is"),
    ("x(sim.cup) > 7 OR z(sim.cup) == 1 AND z(sim.cup) == 2;", "whatever z(sim.cup) is"),
    ("SELECT id FROM sim WHERE id = 'cup' AND id = 'tray';", "whatever id is"),
    ("SELECT id FROM sim WHERE id IN ('cup', 'cup') AND id = 'tray' OR z < 9;", "whatever id is"),
    ("SELECT a.id FROM a=sim, b=sim WHERE a.z > b.z AND b.z > a.z;", "whatever a.z and b.z are"),
    ("SELECT id FROM sim WHERE IF(z > 1 AND z < 0; True; False);", "whatever z is"),
    ("distance(sim.cup, sim.tray) < 0 OR z(sim.cup) > 5;", "distance is never negative"),
    ("NOT distance(sim.cup, sim.tray) >= 0;", "distance is never negative"),
    ("near(sim.cup, sim.tray, -1);", "clearance is never negative"),
    ("heldFor(z(sim.cup) > 1) < 0;", "heldFor is never negative"),
    ("inside(sim.tray, sim.cup) > 100 / 2;", "inside is from 0 to 1"),
    ("-0.1 > tilt(sim.cup);", "tilt is from 0 to 3.14"),
]
ALWAYS = [
    ("z(sim.cup) < 1 OR z(sim.cup) > 0.5;", "whatever z(sim.cup) is; write AND"),
    ("z(sim.cup) > 1 IMPLIES z(sim.cup) > 0.5;", "whatever z(sim.cup) is"),
    ("SELECT id FROM sim WHERE id <> 'cup' OR id <> 'tray';", "whatever id is"),
    ("x(sim.cup) > 1 XOR x(sim.cup) <= 1;", "whatever x(sim.cup) is"),
    ("distance(sim.cup, sim.tray) >= 0;", "distance is never negative"),
    ("once(heldFor(z(sim.cup) > 1) > -1);", "heldFor is never negative"),
    ("distance(sim.cup, sim.tray) >= 0 OR z(sim.cup) > 1;", "distance is never negative"),
]
OPEN = [
    "z(sim.cup) > 1 AND z(sim.cup) > 2;",
    "z(sim.cup) > 1 AND z(sim.tray) < 0.5;",
    "z(sim.cup) > 0.5 IMPLIES z(sim.cup) > 1;",
    "z(sim.cup) < 1 OR z(sim.cup) > 1;",
    "z(sim.cup) > 1 AND previous(z(sim.cup)) < 0.5;",
    "once(z(sim.cup) > 1) AND z(sim.cup) < 0.5;",
    "distance(sim.cup, sim.tray) BETWEEN 0 AND 0.1;",
    "distance(sim.cup, sim.tray) == 0;",
    "near(sim.cup, sim.tray, 0);",
    "tilt(sim.cup) > 3.1415926;",
    "inside(sim.tray, sim.cup) >= 1;",
    "clearance(sim.cup, sim.tray) > 0.1 AND near(sim.cup, sim.tray, most);",
    "z(sim.cup) > most AND z(sim.cup) < least_z;",
    "z(sim.cup) > 1 OR True;",
    "getTime() >= 0;",
    "drawn(1) > 1 AND drawn(1) < 0.5;",
    "x(sim.cup) != x(sim.cup);",
    "SELECT id FROM sim WHERE id = 'cup' OR id = 'tray';",
    "SELECT a.id FROM a=sim, b=sim WHERE a.z > b.z AND b.x > a.x;",
    "SELECT a.id FROM a=sim, b=sim WHERE a.id = 'cup' AND b.id = 'tray';",
]


@pytest.fixture(scope="module")
def ss(stage):
    stage.box("tray")
    stage.box("cup", (0, 0, 1), mass=1)
    with ssduck.Interpreter() as ss:
        ss.add_variable("sim", stage.open())
        ss.add_variable("most", 2.0)
        ss.add_variable("least_z", 1.0)
        numbers = itertools.cycle([2.0, 0.0])
        ss.add_function("drawn", lambda _: next(numbers))
        yield ss


@pytest.mark.parametrize(
    ("program", "why", "word"),
    [*((*one, "never") for one in NEVER), *((*one, "always") for one in ALWAYS)],
)
def test_they_are_told_of_once_and_are_errors_where_mistakes_are(ss, program, why, word):
    (message,) = told(ss.eval, program)
    assert message.startswith(f"this {word} holds")
    assert why in message.splitlines()[0]
    assert told(ss.eval, program) == []
    ss.strict = True
    with pytest.raises(ArgumentError, match=f"this {word} holds"):
        ss.eval(program)
    ss.strict = False


@pytest.mark.parametrize("program", OPEN)
def test_others_are_not(ss, program):
    assert told(ss.eval, program) == []


def test_a_function_of_the_same_name_has_other_values(ss):
    ss.add_variable("d", -1.0)
    with pytest.warns(UserWarning, match="replaces"):
        ss.add_function("distance", lambda *_: -1.0)
    assert told(ss.eval, "distance(sim.cup, sim.tray) < 0;") == []
    ss.del_function("distance")


RUN = {
    2: "SELECT {}(a.this, b.this) FROM a=kitchen, b=kitchen WHERE a.id != b.id AS list;",
    1: "SELECT {}(this) FROM kitchen AS list;",
}


@pytest.mark.filterwarnings("ignore:.*overlap, and inside")
@pytest.mark.parametrize("name", sorted(RANGES))
def test_values_are_in_the_ranges(falling, name):
    """Of relations in a scene in which things fall, of functions for numbers that they take."""
    low, high = RANGES[name]
    if name in RELATIONS:
        program = RUN[RELATIONS[name].required_count].format(name)
        if name == "sensingAmount":
            program = program.replace("a.id != b.id", "isSensor(a.this)")
        values = falling.eval(program)
    elif name == "heldFor":
        values = falling.eval("changes(heldFor(z(kitchen.can) < 1.19))")
        values = [value for _, value in values]
    else:
        lists = {"norm": "[{}, 1]", "stddev": "[{}, 1]", "count": "[{}]", "atan2": "{}, 1 - {}"}
        given = lists.get(name, "abs({})" if name == "sqrt" else "{}")
        numbers = [-1.0, -0.3, 0.0, 0.7, 1.0]
        values = [falling.eval(f"{name}({given.replace('{}', str(x))});") for x in numbers]
    assert len(set(values)) > 1 or name == "count"
    assert all(low - 1e-9 <= value <= high + 1e-9 for value in values if value is not None)


@pytest.fixture(scope="module")
def falling():
    with ssduck.load("kitchen", recording=ssduck.Recording()) as ss:
        ss.call_variable("kitchen")["can"].move([0.42, -0.1, 1.2])
        ss.run(0.3)
        yield ss


class Made:
    """A random condition: its text, its text in Python, and the conditions that it joins."""

    def __init__(self, draw, quantities, depth, above=""):
        joining = [sign for sign in ("AND", "OR") if sign != above]
        kind = draw.choice(["leaf", "NOT", *joining] if depth else ["leaf"])
        self.parts = []
        if kind == "leaf":
            sides = [draw.choice(quantities), str(draw.choice([1, 2, 3]))]
            draw.shuffle(sides)
            self.text = draw.choice(["<", "<=", ">", ">=", "==", "!="]).join(sides)
            self.python = self.text
        elif kind == "NOT":
            self.parts = [Made(draw, quantities, depth - 1)]
            self.text = f"NOT ({self.parts[0].text})"
            self.python = f"not ({self.parts[0].python})"
        else:
            count = draw.choice([2, 3])
            self.parts = [Made(draw, quantities, depth - 1, kind) for _ in range(count)]
            self.text = f" {kind} ".join(f"({part.text})" for part in self.parts)
            self.python = f" {kind.lower()} ".join(f"({part.python})" for part in self.parts)

    def values(self, quantities):
        """Its values for all quantities at, between and beside the constants."""
        code = compile(self.python, "made", "eval")
        places = [half / 2 for half in range(1, 8)]
        cases = itertools.product(places, repeat=len(quantities))
        named = (dict(zip(quantities, case, strict=True)) for case in cases)
        return {eval(code, values) for values in named}  # noqa: S307  # made above

    def smallest(self, quantities):
        """The texts of the smallest parts with one value, and these values."""
        found = [one for part in self.parts for one in part.smallest(quantities)]
        values = self.values(quantities)
        return found or ([(self.text, *values)] if len(values) == 1 else [])


def test_of_one_quantity_all_such_conditions_are_found():
    draw, count = random.Random(3), 0  # noqa: S311
    for _ in range(400):
        made = Made(draw, ["q"], 3)
        text = f"{made.text};"
        found = [
            (text[one.node.span.start : one.node.span.end], one.holds)
            for one in conclusions(parse(text).statements[0])
        ]
        expected = made.smallest(["q"])
        assert [value for _, value in found] == [value for _, value in expected], text
        count += len(expected)
    assert count > 100


def test_of_several_quantities_what_is_told_is_so():
    draw, count = random.Random(4), 0  # noqa: S311
    for _ in range(400):
        made = Made(draw, ["p", "q", "r"], 3)
        expected = made.smallest(["p", "q", "r"])
        found = list(conclusions(parse(f"{made.text};").statements[0]))
        if found:
            count += 1
            assert {one.holds for one in found} <= {value for _, value in expected}, made.text
            assert len(found) <= len(expected), made.text
    assert count > 20
