"""Every relation takes links as it takes entities, in each language, live and past."""

import math

import pytest

from ssduck.errors import SelectScriptError
from ssduck.sql.relations.registry import RELATIONS
from tests.support.cases import generated, sampled

ARGUMENTS = {"double": "0.05", "place": "[0.5, 0, 0]", "integer": "0", "string": "'panda_joint1'"}
PLACE_IN_SQL = "{'x': 0.5, 'y': 0, 'z': 0}"
LINKS = ("panda.panda_leftfinger", "panda.panda_hand", "cube.baseLink")
FINGER, HAND, BASE = LINKS[:3]
PAIRS = [
    (FINGER, "cube"),
    ("cube", FINGER),
    ("panda", FINGER),
    (HAND, "panda"),
    (FINGER, HAND),
    (BASE, FINGER),
    (HAND, HAND),
    ("table", BASE),
]
ONE = [r for r in RELATIONS.values() if sum(p.type == "entity" for p in r.parameters) == 1]
TWO = [r for r in RELATIONS.values() if sum(p.type == "entity" for p in r.parameters) == 2]


def required(relation):
    return relation.parameters[: relation.required_count]


def call(relation, *entities):
    """A call of a relation in both languages: of these entities and fixed other arguments."""
    rest = iter(entities)
    arguments = [
        next(rest) if p.type == "entity" else ARGUMENTS[p.type] for p in required(relation)
    ]
    return f"{relation.name}({', '.join(arguments)})"


def plain(value):
    """A value with links and entities by their full names, and numbers that compare."""
    if hasattr(value, "full_name"):
        return value.full_name
    if isinstance(value, list):
        return [plain(part) for part in value]
    if isinstance(value, float):
        return str(value) if not math.isfinite(value) else pytest.approx(value, abs=1e-9)
    return value


def outcome(run):
    try:
        return plain(run())
    except SelectScriptError as error:
        return type(error).__name__


def same(a, b):
    """Checks whether two outcomes are the same; either may have approximate numbers."""
    if isinstance(a, list) and isinstance(b, list):
        return len(a) == len(b) and all(map(same, a, b))
    return getattr(a, "expected", a) == b


def late(cell):
    """The last recorded tick: other tests look at all of them."""
    return f"sim{{{cell.world.time}}}"


@pytest.mark.slow
@sampled("relation", ONE, every=12, ids=lambda r: r.name)
@sampled("name", LINKS, every=2)
def test_of_one_link(cell, relation, name):
    owner, _, link = name.partition(".")
    expected = outcome(lambda: cell.ss.eval(f"{call(relation, f'sim.{name}')};"))
    of_rows = f"SELECT {call(relation, 'this')} FROM links(sim) WHERE this == sim.{name} AS value;"
    past = f"SELECT {call(relation, 'this')} FROM links({late(cell)}) WHERE this == sim.{name} "
    for ss in cell.interpreters:
        assert same(outcome(lambda ss=ss: ss.eval(f"{call(relation, f'sim.{name}')};")), expected)
        assert same(outcome(lambda ss=ss: ss.eval(of_rows)), expected)
        last = outcome(lambda ss=ss: ss.eval(past + "AS list;"))
        assert same(last if isinstance(last, str) else last[-1], expected)
    if relation.result == "entity":
        return
    sql = call(relation, "l").replace(relation.name, f'"{relation.name}"', 1)
    sql = sql.replace(ARGUMENTS["place"], PLACE_IN_SQL)
    where = f"WHERE l.name = '{link}' AND l.entity = {cell.world[owner].id}"
    if relation.name == "id":
        expected = link  # raw SQL has the full name as a column
    for source in ("sim.links l", "(FROM sim.links_history ORDER BY tick DESC LIMIT 200) l"):
        rows = outcome(
            lambda source=source: cell.ss.sql(
                f"SELECT sim.{sql} FROM {source} {where} ORDER BY l.tick DESC"
            ).fetchall()
        )
        assert same(rows if isinstance(rows, str) else rows[0][0], expected)


@pytest.mark.slow
@sampled("relation", TWO, every=12, ids=lambda r: r.name)
def test_of_a_link_and_another(cell, relation):
    # Every relation with half of the pairs, and every pair with half of the relations.
    half = PAIRS[TWO.index(relation) % 2 :: 2]
    for a, b in PAIRS if generated(1) > 1 else half:
        handles = call(relation, f"sim.{a}", f"sim.{b}")
        expected = outcome(lambda handles=handles: cell.ss.eval(f"{handles};"))
        own = a.split(".")[0] == b or b.split(".")[0] == a or a == b
        if own and relation.result == "boolean":
            assert expected is False, (a, b)
        sources = ["links(sim)" if "." in name else "sim" for name in (a, b)]
        where = f"WHERE a.this == sim.{a} AND b.this == sim.{b} AS value;"
        query = f"SELECT {call(relation, 'a.this', 'b.this')} FROM a = {{}}, b = {{}} {where}"
        past = query.format(*(source.replace("sim", late(cell)) for source in sources))
        past, query = past.replace("AS value", "AS list"), query.format(*sources)
        assert same(outcome(lambda query=query: cell.ss.eval(query)), expected), query
        last = outcome(lambda past=past: cell.ss.eval(past))
        assert same(last if isinstance(last, str) else last[-1], expected), past
        tables = ["links" if "." in name else "entities" for name in (a, b)]
        names = ["full_name" if "." in name else "name" for name in (a, b)]
        sql = call(relation, "a", "b").replace(relation.name, f'"{relation.name}"', 1)
        sql = sql.replace(ARGUMENTS["place"], PLACE_IN_SQL)
        condition = f"a.{names[0]} = '{a}' AND b.{names[1]} = '{b}'"
        condition += f" AND tick = {cell.ticks[-1]}"  # other tests look at all of them
        for history in ("", "_history"):
            text = (
                f"SELECT sim.{sql} FROM sim.{tables[0]}{history} a "
                f"JOIN sim.{tables[1]}{history} b USING (tick) WHERE {condition}"
            )
            rows = outcome(lambda text=text: cell.ss.sql(text).fetchall())
            (value,) = rows if isinstance(rows, list) else [[rows]]
            assert same(value[0], expected), text
