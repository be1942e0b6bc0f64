"""EXISTS with a relation of two entities: it takes the pairs of the tick, and has DuckDB's rows."""

import math
from random import Random

import duckdb
import pybullet
import pytest

import ssduck
from ssduck.database.plans import RUNS_BEFORE_PLAN
from ssduck.database.statement_names import words_of
from tests.support.bodies import solid
from tests.support.cases import generated, sampled

RUNS = RUNS_BEFORE_PLAN + 2
# Relations with their further arguments.
RELATIONS = {
    "collides": "",
    "near": ", 0.05",
    "touching": ", 0.02",
    "supports": "",
    "onTop": "",
    "contains": "",
    "above": "",
}


@pytest.fixture(scope="module")
def ss():
    """An interpreter with a pile of boxes, one of whose poses is unknown."""
    client, places = pybullet.connect(pybullet.DIRECT), Random(5)  # noqa: S311
    sizes = [[0.1, 0.1, 0.1], [0.05, 0.1, 0.02], [0.3, 0.3, 0.01]]
    for number in range(11):
        place = [places.uniform(0, 0.5), places.uniform(0, 0.5), 0.1 * (number % 4)]
        place = [math.nan, 0, 0] if number == 5 else place
        solid(client, pybullet.GEOM_BOX, 1, place, halfExtents=sizes[number % 3])
    with ssduck.Interpreter(recording=None) as interpreter:
        with pytest.warns(UserWarning, match="no number"):
            interpreter.add_variable("sim", ssduck.World.attach(client))
        yield interpreter
    pybullet.disconnect(client)


@pytest.fixture(scope="module")
def plain(ss):
    """DuckDB with the entities, and a macro for each relation that looks up what holds."""
    connection = ss._database.connection
    ss.sql("SELECT count(*) FROM duckdb_functions()")  # makes all macros
    with duckdb.connect() as own:
        own.execute("CREATE SCHEMA sim; SET search_path = 'main,sim'")
        tables = {"entities": "FROM sim.entities"}
        for name, more in RELATIONS.items():
            call = f'sim."{name}"(a, b{more})'
            tables[f"all_{name}"] = (
                f"SELECT a.id x, b.id y, {call} holds FROM sim.entities a, sim.entities b"
            )
        for table, sql in tables.items():
            with ss._database.pinned({"shapes"}):
                ss._database._raw_sql._describe(words_of(sql))
                copied = connection.table(sql, None)
            own.register("copied", copied)
            own.execute(f"CREATE TABLE sim.{table} AS FROM copied")
            own.unregister("copied")
        for name, more in RELATIONS.items():
            names = "p, q, d" if more else "p, q"  # unlike the sources of statements
            holds = "x = struct_extract(p, 'id') AND y = struct_extract(q, 'id')"
            body = f"(SELECT holds FROM sim.all_{name} WHERE {holds})"
            own.execute(f'CREATE MACRO sim."{name}"({names}) AS {body}')
        yield own


def rows(found):
    return sorted(map(repr, found))


# The sources and conditions of subqueries over b, around which is a.
INNER = (
    "entities b",
    "sim.entities AS b",
    '(FROM entities) "B"',
    "entities b JOIN entities c ON c.id = b.id",
    "entities c, entities b",
    "entities b LEFT JOIN entities c ON c.z > b.z",
)
CONDITIONS = (
    "b.z > 0.05",
    "a.id <> b.id",
    "a.id < b.id",
    "b.z < A.z OR b.x > 0.2",
    "b.name <> a.name",
    "b.kind = 'kinbody'",
    "z > 0.05",
    "b.z IS NOT NULL",
    "NOT (b.z > a.z)",
    "b.x + b.y > a.x",
    "b.id IN (SELECT id FROM entities WHERE z > 0)",
    "a.kind = b.kind",
    "b.vx IS NULL",
)
SELECTED = ("SELECT 1 ", "SELECT * ", "SELECT b.id, 'a' ", "SELECT a.name ", "", "SELECT count(*) ")
OUTER = (
    "SELECT a.name FROM entities a WHERE {e}",
    "SELECT * EXCLUDE (tick, time) FROM sim.entities AS a WHERE NOT {e}",
    "SELECT a.name, {e} AS found FROM entities a",
    "SELECT a.name FROM entities a WHERE a.z > 0.05 AND ({e} OR a.z > 0.2)",
    "SELECT CASE WHEN {e} THEN a.name ELSE 'none' END FROM entities a",
    "SELECT c.name, a.name FROM entities c LEFT JOIN entities a ON a.z > c.z + 0.1 WHERE NOT {e}",
    "SELECT c.name, a.name, {e} FROM entities c LEFT JOIN entities a ON a.z > c.z + 0.1",
    "WITH a AS (SELECT * FROM entities WHERE z > 0.05) SELECT name FROM a WHERE {e}",
    "SELECT name FROM (FROM entities WHERE z < 0.2) a WHERE NOT {e}",
    "SELECT count(*) FILTER (WHERE a.z > 0.1) FROM entities a WHERE {e}",
    "SELECT {e} AS found, count(*), sum(a.id) FROM entities a GROUP BY ALL",
    "FROM entities a SELECT a.name WHERE {e} AND EXISTS (FROM entities d WHERE d.z > a.z)",
)


def statement(choices):
    """Returns a random statement with an EXISTS."""
    name = choices.choice(list(RELATIONS))
    pair = choices.choice(["a, b", "b, a"])
    call = f'{choices.choice(["", "sim."])}"{name}"({pair}{RELATIONS[name]})'
    parts = [call, *choices.sample(CONDITIONS, choices.choice([0, 0, 1, 1, 2]))]
    choices.shuffle(parts)
    parts = [f"({part})" for part in parts]
    sources = choices.choice(INNER)
    if "entities c" in sources:  # a column without a table would be ambiguous
        parts = [part for part in parts if part != "(z > 0.05)"]
    selected = choices.choice(SELECTED)
    exists = f"exists( {selected}FROM {sources} WHERE {' AND '.join(parts)} )"
    return choices.choice(OUTER).format(e=exists)


@pytest.mark.slow
@sampled("seed", range(4), every=2)
def test_rows_are_those_of_plain_duckdb(ss, plain, seed):
    choices = Random(seed)  # noqa: S311
    for _ in range(generated(12)):
        sql = statement(choices)
        expected = rows(plain.execute(sql).fetchall())
        assert rows(ss.sql(sql).fetchall()) == expected, sql


@pytest.mark.slow
@pytest.mark.parametrize(
    "subquery",
    [
        "SELECT count(*) FROM entities b WHERE {r}",
        "SELECT 1 FROM entities b WHERE {r} LIMIT 0",
        "SELECT DISTINCT b.kind FROM entities b WHERE {r}",
        "SELECT b.kind FROM entities b WHERE {r} GROUP BY b.kind HAVING count(*) > 1",
        "SELECT unnest([]) FROM entities b WHERE {r}",
        "SELECT 1 FROM entities b WHERE {r} UNION ALL SELECT 1 WHERE false",
        "SELECT 1 FROM entities b WHERE z > 0.05 AND a.id < b.id AND {r}",
        "SELECT 1 FROM entities b WHERE {r} AND b.z > k.z",
        "SELECT 1 FROM entities b WHERE {r} AND (k.z, b.id) IN (SELECT z, id FROM entities)",
        "SELECT 1 FROM entities b WHERE {r} AND collides(b, a)",
        "SELECT 1 FROM entities b WHERE {r} OR b.z > 0.1",
        "SELECT 1 FROM entities b WHERE NOT {r}",
        "SELECT 1 FROM entities b JOIN entities a ON a.id = b.id WHERE {r}",
        "FROM entities b SELECT b.id WHERE {r}",
        "WITH n AS (SELECT 1) SELECT 1 FROM entities b, n WHERE {r}",
    ],
)
def test_other_subqueries_have_the_rows_of_plain_duckdb(ss, plain, subquery):
    exists = subquery.format(r="collides(a, b)")
    sql = f"SELECT a.name, k.name FROM entities a, entities k WHERE EXISTS ({exists})"
    expected = rows(plain.execute(sql).fetchall())
    assert [rows(ss.sql(sql).fetchall()) for _ in range(RUNS)] == [expected] * RUNS
