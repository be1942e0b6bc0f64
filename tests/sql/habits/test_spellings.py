"""SQL's aggregates, conditions and values."""

import math
from collections import defaultdict

import numpy as np
import pytest

from ssduck.errors import ArgumentError
from tests.support.habits import OF_ROWS


@pytest.fixture(scope="module")
def entities(world):
    """Name, type and height of each entity, in the order of queries."""
    found = [(e.name, e.kind, float(e.position[2])) for e in world]
    assert len({kind for _, kind, _ in found}) == 3
    return found


def by_kind(entities):
    groups = defaultdict(list)
    for name, kind, z in entities:
        groups[kind].append((name, z))
    return groups


# -- aggregates ----------------------------------------------------------------------------------


@pytest.mark.parametrize("text", OF_ROWS)
def test_aggregates_of_groups(ss, entities, text):
    """One row a group, whose value is that of the group's rows."""
    found = ss.eval(f"SELECT count(*) AS n, {text} AS v FROM kitchen GROUP BY type;")
    groups = by_kind(entities)
    assert list(found) == list(groups)
    for kind, rows in groups.items():
        wanted = [kind] if text == "uniq(type)" else OF_ROWS[text](rows)
        assert found[kind] == [{"n": len(rows), "v": pytest.approx(wanted)}]


@pytest.mark.parametrize("order", ["", " DESC"])
@pytest.mark.parametrize("text", ["count(*)", "count(*) + 1", "-max(z)", "count(*), id"])
def test_order_of_groups(ss, entities, text, order):
    keys = {
        "count(*)": len,
        "count(*) + 1": len,
        "-max(z)": lambda rows: -max(z for _, z in rows),
        "count(*), id": len,
    }
    groups = by_kind(entities)
    wanted = sorted(groups, key=lambda kind: keys[text](groups[kind]), reverse=bool(order))
    if text.endswith("id"):
        text = f"count(*){order}, id"
        order = ""
    found = ss.eval(f"SELECT id FROM kitchen GROUP BY type ORDER BY {text}{order} LIMIT 2 AS list;")
    assert list(found) == wanted[:2]
    for kind, names in found.items():
        rows = [name for name, _ in groups[kind]]
        assert names == (sorted(rows) if text.endswith("id") else rows)


def test_groups_of_no_rows(ss):
    nothing = "FROM kitchen WHERE z(this) > 100"
    assert ss.eval(
        f"SELECT count(*), sum(z), uniq(z), min(z), max(z), avg(z) {nothing} AS list;"
    ) == [*(0, 0, []), *(None, None, None)]
    assert ss.eval(f"SELECT type, count(*) {nothing} GROUP BY type;") == {}
    assert ss.eval(f"SELECT id {nothing} HAVING count(*) == 0 AS list;") == []


@pytest.mark.parametrize(
    ("program", "value"),
    [
        ("SELECT count(this) FROM [[1, 2], [3]] AS list;", [2, 1]),
        ("SELECT sum(this) FROM [[1, 2], [3]] WHERE count(this) > 1 AS list;", [3]),
        ("SELECT count(ints), max(ints) FROM [1, 2] AS list;", [4, 3, 4, 3]),
        ("SELECT id FROM kitchen WHERE count(ints) == 4 LIMIT 1 AS value;", "fridge_webcam"),
        ("SELECT this FROM [[2, 1], [3]] ORDER BY count(this) AS list;", [[3], [2, 1]]),
        (
            "SELECT this, count(ints) FROM [1, 2] GROUP BY this % 2 AS list;",
            {"1": [1, 4], "0": [2, 4]},
        ),
        ("SELECT max([this, 2]) FROM [1, 3] GROUP BY 'all' AS list;", {"all": [2, 3]}),
        (
            "SELECT this FROM [1, 2, 3, 4] GROUP BY this % 2 HAVING sum(this) > 4 AS list;",
            {"0": [2, 4]},
        ),
        ("count('abc');", 3),
        (
            "SELECT count(SELECT x.this FROM x=[1, 2, 3] WHERE x.this > y.this AS list) FROM y=[1, 2] AS list;",
            [2, 1],
        ),
    ],
)
def test_aggregates_of_lists_are_as_they_were(ss, program, value):
    assert ss.eval(program) == value


AGGREGATES = ["count", "sum", "min", "max", "avg", "uniq"]
OF_TEXTS = {
    **dict.fromkeys(("id", "id(this)"), "kitchen"),
    **dict.fromkeys(("a.id", "id(a.this)"), "a=kitchen"),
    **dict.fromkeys(("name", "this.name"), "people"),
    "p.name": "p=people",
}


@pytest.mark.parametrize("name", AGGREGATES)
@pytest.mark.parametrize("argument", OF_TEXTS)
def test_an_aggregate_of_a_text_is_over_the_rows(ss, entities, name, argument):
    """Of entities, and of dicts."""
    condition = "z(this) > 1" if "id" in argument else "this.age IS NOT NULL"
    program = f"SELECT {name}({argument}) AS v FROM {OF_TEXTS[argument]} WHERE {condition};"
    high = [entity[0] for entity in entities if entity[2] > 1]
    names = high if "id" in argument else ["Ada", "Cy"]
    if name in ("sum", "avg"):
        with pytest.raises(ArgumentError, match="does not take a text") as caught:
            ss.eval(program)
        span = caught.value.span
        assert program[span.start : span.end] == f"{name}({argument})"
        return
    values = {"count": len(names), "min": min(names), "max": max(names), "uniq": names}
    assert ss.eval(program) == [{"v": values[name]}]


@pytest.mark.parametrize("name", AGGREGATES)
@pytest.mark.parametrize("argument", ["age", "this.age", "p.age"])
def test_an_aggregate_of_what_may_be_a_list_shows_the_right_spelling(ss, name, argument):
    source = "p=people" if "p." in argument else "people"
    program = f"SELECT {name}({argument}) FROM {source} WHERE this.age IS NOT NULL;"
    with pytest.raises(ArgumentError) as caught:
        ss.eval(program)
    spelled = f"{name}(SELECT {argument} FROM {source} WHERE this.age IS NOT NULL AS list)"
    assert f"write {spelled}" in caught.value.message
    assert program[caught.value.span.start : caught.value.span.end] == f"{name}({argument})"
    ss.eval(f"{spelled};")


@pytest.mark.parametrize(
    ("program", "offending", "told"),
    [
        ("SELECT max(age) FROM people;", "max(age)", "max(SELECT age FROM people AS list)"),
        (
            "SELECT id FROM kitchen WHERE count(*) > 3;",
            "count(*)",
            "count(SELECT * FROM kitchen AS list)",
        ),
        ("SELECT id FROM kitchen ORDER BY count(*);", "count(*)", "count(SELECT *"),
        ("SELECT sum(id) FROM kitchen GROUP BY type;", "sum(id)", "does not take a text"),
        ("SELECT min(this) FROM [1, 'a'] GROUP BY 'x';", "min(this)", "a number and a text"),
        ("SELECT max(obj) FROM kitchen GROUP BY type;", "max(obj)", "does not take"),
        ("SELECT id FROM kitchen HAVING z > 1;", "z", "WHERE"),
        ("SELECT id FROM kitchen HAVING count(*) > 3 AND id == 'can';", "id", "WHERE"),
        ("SELECT id, count(*) FROM kitchen;", "id", "GROUP BY"),
        ("SELECT this.z FROM kitchen;", "z", "z(this)"),
        ("SELECT k.this.z FROM kitchen k;", "z", "k.z"),
        ("kitchen.can.id;", "id", "functions tell of an entity"),
    ],
)
def test_what_aggregates_and_elements_cannot_mean(ss, program, offending, told):
    with pytest.raises(ArgumentError) as caught:
        ss.eval(program)
    assert program[caught.value.span.start : caught.value.span.end] == offending
    assert told in caught.value.message


def test_aggregates_of_missing_values_and_nan(ss):
    known = "SELECT sum(age) FROM people WHERE this.age IS NOT NULL GROUP BY group AS list;"
    assert ss.eval(known) == {"a": [60]}
    program = (
        "SELECT count(*), count(age), sum(age), avg(age), max(age), count(DISTINCT age) {} AS list;"
    )
    of_groups = {"a": [2, 2, 60, 30.0, 36, 2], "b": [1, 0, 0, None, None, 0]}
    assert ss.eval(program.format("FROM people GROUP BY group")) == of_groups
    ages = "FROM (SELECT age, group FROM people) HAVING count(*) = 3"
    assert ss.eval(program.format(ages)) == [3, 2, 60, 30.0, 36, 2]
    ss.add_variable("reals", [1.0, math.nan])
    (total,) = ss.eval("SELECT sum(this) FROM reals HAVING count(*) == 2 AS list;")
    assert math.isnan(total)


# -- conditions and values -----------------------------------------------------------------------


CONDITIONS = {
    "z(this) = 0.75": lambda e: e[2] == 0.75,
    "(z(this) = 0.75)": lambda e: e[2] == 0.75,
    "z + 0 NOT BETWEEN 0.5 + 0.25 AND 1.5 AND isRobot": (
        lambda e: not 0.75 <= e[2] <= 1.5 and e[1] == "robot"
    ),
    "id(this) LIKE 'c_n'": lambda e: e[0] == "can",
    "id LIKE 'c.n' OR id LIKE '%.%'": lambda _: False,
    "id IN ('can', 'sink')": lambda e: e[0] in ("can", "sink"),
    "id(this) NOT IN ('can', 'sink')": lambda e: e[0] not in ("can", "sink"),
    "id IN ()": lambda _: False,
    "z(this) IS NOT NULL AND isRobot(this)": lambda e: e[1] == "robot",
    "CASE WHEN isRobot THEN z > 1 WHEN z > 1 THEN False ELSE True END": (
        lambda e: e[2] > 1 if e[1] == "robot" else not e[2] > 1
    ),
    "CASE type(this) WHEN 'robot' THEN 1 WHEN 'sensor' THEN 2 ELSE 3 END == 2": (
        lambda e: e[1] == "sensor"
    ),
}


@pytest.mark.parametrize("text", CONDITIONS)
def test_conditions(ss, entities, text):
    wanted = [entity[0] for entity in entities if CONDITIONS[text](entity)]
    assert ss.eval(f"SELECT id FROM kitchen WHERE {text} AS list;") == wanted
    other = text.replace("(this)", "(k.this)")
    if "this" in text:
        assert ss.eval(f"SELECT k.id FROM k=kitchen WHERE {other} AS list;") == wanted


@pytest.mark.parametrize(
    ("program", "value"),
    [
        ("'it''s';", "it's"),
        ('"say ""hi""";', 'say "hi"'),
        ("'' + '''' + 'a''';", "'a'"),
        ("\"it''s\";", "it''s"),
        ("5--3;", 8),
        ("5 - -3;", 8),
        ("1 -- one\n + 2; -- 'and no text\n", 3),
        ("'-- no comment' + '//';", "-- no comment//"),
        ("1; --", 1),
        ("// a -- b\n 2; # -- c", 2),
        ("/* -- */ 3;", 3),
        ("2 IN (1, 2);", True),
        ("[-1 IN (-1), 1 IN (-1), -1 NOT IN (+1), 1 IN (NOT False)];", [True, False, True, True]),
        ("[1, 2] IN ([1, 2], [3]);", True),
        ("3 IN ((1), (2));", False),
        ("2 IN ([1, 2]);", True),
        ("'ca' IN 'can';", True),
        ("1 <> 2;", True),
        ("'a%b' LIKE 'a%b';", True),
        ("'a\nb' LIKE 'a%b';", True),
        ("'ab' LIKE 'a';", False),
        ("1 IS NULL;", False),
        ("CASE WHEN 1 > 2 THEN 'a' ELSE 'b' END;", "b"),
        ("CASE 1 + 1 WHEN 2 THEN 'two' ELSE 'other' END;", "two"),
        ("case = 3; case + 1;", 4),
        ("distinct = [1]; SELECT distinct FROM [1] AS list;", [[1]]),
        ("SELECT name FROM people WHERE this.age IS NULL AS list;", ["Bob"]),
        (
            "SELECT p.name FROM people p WHERE p.age IS NOT NULL ORDER BY p.age AS list;",
            ["Cy", "Ada"],
        ),
        ("SELECT DISTINCT group FROM people AS list;", ["a", "b"]),
        ("SELECT DISTINCT (group) FROM people AS list;", ["a", "b"]),
        ("SELECT DISTINCT group FROM people ORDER BY group DESC LIMIT 1;", [{"group": "b"}]),
        ("SELECT DISTINCT this FROM [2, 1, 2.0, [1], [1]] AS list;", [2, 1, [1]]),
        ("SELECT DISTINCT this FROM [1, 1, 2] GROUP BY this % 2 AS list;", {"1": [1], "0": [2]}),
        ("count(SELECT DISTINCT type FROM kitchen AS list);", 3),
        ("SELECT DISTINCT -1 FROM [1, 2] AS list;", [-1]),
        ("SELECT DISTINCT -this FROM [1, 1, 2] AS list;", [-1, -2]),
        ("SELECT DISTINCT -this, +this FROM [1, 1] AS list;", [-1, 1]),
        ("SELECT DISTINCT [this] FROM [1, 1] AS list;", [[1]]),
        ("SELECT DISTINCT NOT this FROM [True, True] AS list;", [False]),
        (
            "count(SELECT DISTINCT z FROM kitchen AS list) - "
            "(SELECT count(DISTINCT -z) FROM kitchen AS value);",
            0,
        ),
        ("distinct = 3; SELECT distinct - this FROM [1, 1] AS list;", [2, 2]),
        ("distinct = 3; SELECT distinct-this FROM [1, 1] AS list;", [2, 2]),
        ("(SELECT count(*) FROM kitchen AS value) + 1;", 38),
        ("SELECT this + 1 AS next FROM [1, 2];", [{"next": 2}, {"next": 3}]),
        ("SELECT -this AS minus FROM [1, 2] ORDER BY minus AS LIST;", [-2, -1]),
        ("SELECT a.this + b.this FROM [1] AS a, [10, 20] AS b WHERE b.this > 10 AS LIST;", [21]),
        ("SELECT a.this FROM [1, 2] a, [3] b AS List;", [1, 2]),
        ("SELECT id FROM kitchen LIMIT 1 AS Val;", "fridge_webcam"),
        ("SELECT this FROM [1] AS DICTIONARY;", [{"this": 1}]),
        ("[SELECT this FROM [1] AS list, 3];", [[1], 3]),
        ("f = 2; SELECT f.this FROM f=[1] AS list;", [1]),
        ("r = people[0]; SELECT r.name, r.this FROM r=[1] AS list;", ["Ada", 1]),
    ],
)
def test_values(ss, program, value):
    found = ss.eval(program)
    assert found == value
    assert type(found) is type(value)


@pytest.mark.parametrize("keyword", ["select", "Select", "SELECT"])
@pytest.mark.parametrize("form", ["list", "List", "LIST", "val", "VALUE", "Dict", "dictionary"])
def test_forms_in_any_case(ss, keyword, form):
    program = f"{keyword} this From [1, 2] Where this > 1 {{}}"
    assert ss.eval(program.format(f"As {form};")) == ss.eval(program.format(f"AS {form.lower()};"))
    nested = f"count({keyword} this FROM [1, 2] AS {form})" if form.lower() == "list" else "2"
    assert ss.eval(f"{nested};") == 2


@pytest.mark.slow
def test_forms_of_users_in_any_case(ss, monkeypatch):
    from ssduck.adapters import registry as adapters

    monkeypatch.setattr(adapters, "_ADAPTERS", dict(adapters._ADAPTERS))
    adapters.adapter("many")(lambda selection: len(selection.rows))
    program = "SELECT this FROM [1, 2] AS {};"
    assert ss.eval(program.format("MANY")) == 2
    adapters.adapter("Many")(lambda selection: -len(selection.rows))
    assert [ss.eval(program.format(name)) for name in ("many", "Many")] == [2, -2]
    with pytest.raises(ArgumentError, match="AS Many or many"):
        ss.eval(program.format("MANY"))
    with pytest.raises(ArgumentError, match="own forms"):
        adapters.adapter("LIST")


def test_numbers_are_clipped_as_numpy_does(ss):
    rows = ss.eval("SELECT z, clip(z, 0.2, 0.8) AS c, tanh(3 * z - 2) AS t FROM kitchen;")
    heights = np.array([row["z"] for row in rows])
    assert [row["c"] for row in rows] == np.clip(heights, 0.2, 0.8).tolist()
    assert [row["t"] for row in rows] == pytest.approx(np.tanh(3 * heights - 2), rel=1e-15)
    assert ss.eval("SELECT id FROM kitchen WHERE tanh(z) > 0.9 OR clip(z, 0, 2) != z AS list;") == [
        row
        for row, z in zip(ss.eval("SELECT id FROM kitchen AS list;"), heights, strict=True)
        if math.tanh(z) > 0.9 or not 0 <= z <= 2
    ]
    assert ss.eval("[clip(5, 3, 2), clip(-1, 0, 1)];") == np.clip([5, -1], [3, 0], [2, 1]).tolist()
