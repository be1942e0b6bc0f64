"""Queries over a batch have the rows, groups and aggregates of each environment, all at once."""

from itertools import chain

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import ssduck
from ssduck.errors import LimitError, SelectScriptError, UnsupportedError
from ssduck.interpreter.batches.queries import BatchQuery
from tests.batches.conftest import each, simulations
from tests.support.cases import generated

PAIRS = "FROM a=sim, b=sim"
QUERIES = [
    f"SELECT env, a.id AS a, b.id AS b {PAIRS} WHERE touching(a.this, b.this);",
    f"SELECT env, a.id AS a, b.id AS b {PAIRS} WHERE near(a.this, b.this, 0.1) AND a.id < b.id;",
    f"SELECT env, a.id AS a, b.id AS b, clearance(a.this, b.this) AS c {PAIRS} WHERE above(a.this, b.this);",
    f"SELECT a.id AS a, b.id AS b {PAIRS} WHERE inContact(a.this, b.this) AND env > 1 AS list;",
    f"SELECT env, a.id AS a, contactForce(a.this, b.this) AS f {PAIRS} WHERE hasContact(a.this, b.this);",
    f"SELECT a.id AS a {PAIRS} WHERE touching(a.this, sim.table) OR z(b.this) < goal[2];",
    f"SELECT a.id AS a, c.id AS c {PAIRS}, c=sim WHERE above(a.this, b.this) AND above(b.this, c.this);",
    f"SELECT count(*) {PAIRS} WHERE touching(a.this, b.this) AND a.id <> b.id AS value;",
    f"SELECT env, min(distance(a.this, b.this)) AS least {PAIRS} WHERE a.id < b.id;",
    "SELECT env, count(*) AS n, max(z) AS m, avg(x) AS q, sum(y) AS s FROM sim WHERE z > 0.37;",
    "SELECT count(*) AS n, min(z) AS low, sum(id <> 'cube') AS others FROM sim WHERE z > 1;",
    "SELECT kind, count(*) AS n, max(z) AS top FROM sim WHERE z > low GROUP BY kind;",
    "SELECT env, count(*) AS n FROM sim WHERE z > 0.37 GROUP BY env;",
    "SELECT env, kind, id FROM sim GROUP BY kind, z > 0.37;",
    "SELECT kind, count(*) AS n FROM sim GROUP BY kind HAVING n > 1 ORDER BY n LIMIT 1;",
    "SELECT env, id, z AS h FROM sim ORDER BY h DESC LIMIT 2;",
    "SELECT id FROM sim WHERE z > low ORDER BY kind DESC, id DESC LIMIT 2 OFFSET 1 AS list;",
    "SELECT id, str(z(this)) AS text FROM sim WHERE z > low ORDER BY text;",
    "SELECT DISTINCT kind FROM sim AS list;",
    "SELECT env, id(this) FROM sim WHERE z(this) > 0.35 AS list;",
    "SELECT env, id(this), z(this) FROM sim WHERE touching(sim.table, this) AS records;",
    "SELECT env, id(this), distance(this, sim.ball) FROM sim WHERE id(this) <> 'ball';",
    "SELECT env, id(this) FROM sim WHERE inContact(this, sim.table) AS list;",
    "SELECT env, count(*) AS n FROM sim WHERE above(this, sim.table);",
    f"SELECT env, a.id AS u, b.id AS v {PAIRS} WHERE above(a.this, b.this) ORDER BY u, v;",
    "SELECT id(this) FROM sim WHERE env = 3 AND z(this) > goal[2] AS list;",
    "SELECT env, z(sim.cube) FROM [0] AS list;",
    "SELECT id, z(sim.cube) - z AS below FROM sim WHERE z < z(sim.cube);",
    "SELECT env, median(z) AS middle, max(distance(this, sim.cube)) AS far FROM sim WHERE id <> 'cube';",
]
# Those that no environment evaluates by itself.
AT_ONCE = [
    text
    for text in QUERIES
    if not any(
        w in text for w in ("HAVING", "str(", "DISTINCT", "median", "goal", "kind, z", "[0]")
    )
]


class Worlds:
    """A batch of 64 environments, and the answers of a world at the state of each of them.

    All bodies of a third of the environments are at the same places; one diverged, where asked.
    """

    def __init__(self, *, diverged=False, count=64):
        self.model, self.states = simulations(count)
        for number in range(0, count, 3):
            self.states[number].xpos[2:4] = self.states[0].xpos[2:4]
        if diverged:
            self.states[5].xpos[2] = np.nan
        goal = np.linspace(0.3, 0.4, count)[:, None] * np.ones(3)
        self.parameters = {"env": range(count), "goal": goal.tolist(), "low": [0.37] * count}
        self.ss = ssduck.Interpreter(recording=None)
        self.ss.add_variable("sim", ssduck.World.batch(self.model, count)).tick(self.states)
        self.ss.add_variable("goal", goal)
        self.ss.add_variable("low", 0.37)

    def each(self, text):
        return each(self.model, self.states, text, self.parameters)

    def close(self):
        self.ss.close()
        self.states.close()


@pytest.fixture(scope="module")
def many():
    worlds = Worlds()
    yield worlds
    worlds.close()


def together(answers):
    """Returns the rows of all worlds, those of a group by its key; or the values of all."""
    if isinstance(answers[0], dict):
        keys = dict.fromkeys(chain.from_iterable(answers))
        return {key: together([own[key] for own in answers if key in own]) for key in keys}
    return list(chain.from_iterable(answers)) if isinstance(answers[0], list) else answers


def plain(value):
    if isinstance(value, dict):
        return {key: plain(each) for key, each in value.items()}
    if isinstance(value, list | np.ndarray):
        return [plain(each) for each in value]
    is_float = isinstance(value, float)
    return pytest.approx(value, rel=1e-12, nan_ok=True) if is_float else value


def check(many, text):
    try:
        expected = together(many.each(text))
    except SelectScriptError as error:  # of the environment that diverged
        with pytest.raises(type(error), match=r"^environment 5: "):
            many.ss.eval(text)
        return None
    found = many.ss.eval(text)
    found = found.tolist() if isinstance(found, np.ndarray) else found
    assert found == plain(expected), text
    assert not isinstance(found, dict) or [*found] == [*expected]
    return found


@pytest.mark.parametrize("text", QUERIES)
def test_queries(many, monkeypatch, text):
    if text in AT_ONCE:
        monkeypatch.setattr(BatchQuery, "_one", None)
    assert check(many, text)


ENTITY = st.sampled_from(["a.this", "b.this", "sim.table", "sim.ball"])
NUMBER = st.builds("z({})".format, ENTITY) | st.sampled_from(["low", "goal[0]", "0.36"])
CONDITION = st.one_of(
    st.builds("{} < {}".format, NUMBER, NUMBER),
    st.builds(
        "{}({}, {})".format,
        st.sampled_from(["touching", "above", "inContact", "hasContact", "collides", "on"]),
        ENTITY,
        ENTITY,
    ),
    st.builds("near({}, {}, 0.15)".format, ENTITY, ENTITY),
    st.sampled_from(["a.id < b.id", "a.kind = b.kind", "env > 3", "NOT a.id == 'world'"]),
)
WHERE = st.lists(CONDITION, max_size=3).flatmap(
    lambda parts: st.sampled_from([" AND ", " OR "]).map(
        lambda word: f" WHERE {word.join(parts)}" if parts else ""
    )
)
ROWS = st.builds(
    "SELECT {} FROM a=sim, b=sim{}{}{};".format,
    st.sampled_from(["env, a.id AS a, b.id AS b", "env, a.id AS a, z(b.this) AS z", "a.kind AS a"]),
    WHERE,
    st.sampled_from(["", " ORDER BY b.z, a.id", " ORDER BY z(a.this) DESC, b.kind, env, b.id"]),
    st.sampled_from(["", " LIMIT 3", " LIMIT 5 OFFSET 2"]),
)
AGGREGATED = st.builds(
    "SELECT env, count(*) AS n, {}({}) AS x FROM a=sim, b=sim{}{};".format,
    st.sampled_from(["min", "max", "sum", "avg", "count"]),
    st.sampled_from(["z(a.this)", "distance(a.this, b.this)", "a.x - b.y", "int(a.z > b.z)"]),
    WHERE,
    st.sampled_from(["", " GROUP BY a.id", " GROUP BY env", " GROUP BY b.kind, a.z > 0.37"]),
)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::ssduck.errors.ProgramWarning", "ignore:.*that is no number")
@pytest.mark.parametrize("diverged", [False, True])
def test_generated_queries(diverged):
    worlds = Worlds(diverged=diverged, count=16)

    @settings(max_examples=generated(12))
    @given(ROWS | AGGREGATED)
    def queries(text):
        check(worlds, text)

    queries()
    worlds.close()


def test_environments_without_rows_are_there(many):
    found = many.ss.eval("SELECT env, count(*) AS n, max(z) AS m FROM sim WHERE env = 3 AND z > 0;")
    assert [row["n"] > 0 for row in found] == [number == 3 for number in range(64)]
    assert found[4] == {"env": 4, "n": 0, "m": None}
    assert [*many.ss.eval("SELECT env, count(*) AS n FROM sim WHERE env = 3 GROUP BY env;")] == [
        "3"
    ]


def test_bodies_of_other_environments_are_far_away():
    model, states = simulations(4)
    for number, data in enumerate(states):  # each cube is where only other balls are
        data.xpos[2] = [number, 0, 5]
        data.xpos[3] = [(number + 1) % 4, 0, 5]
    with ssduck.Interpreter(recording=None) as ss:
        ss.add_variable("sim", ssduck.World.batch(model, 4)).tick(states)
        for condition in ("touching(a.this, b.this)", "distance(a.this, b.this) < 0.5"):
            where = f"{PAIRS} WHERE {condition} AND a.id = 'cube' AND b.id = 'ball'"
            assert ss.eval(f"SELECT env {where} AS list;") == []
            assert ss.eval(f"SELECT count(*) {where} AS value;").tolist() == [0] * 4
        for condition in ("touching", "collides", "hasContact"):
            assert not ss.eval(f"{condition}(sim.cube, sim.ball);").any()
        assert ss.eval("SELECT env, id(this) FROM sim WHERE touching(sim.cube, this);") == []


def test_an_error_in_a_group_has_the_number_of_its_environment(many):
    with pytest.raises(SelectScriptError, match=r"^environment 0: .*zero"):
        many.ss.eval("SELECT 1 / (max(z) - max(z)) AS x FROM sim GROUP BY kind;")
    with pytest.raises(UnsupportedError, match="paths"):
        many.ss.eval(
            "SELECT id(this) FROM sim START WITH p = sim.table CONNECT BY p = this "
            "STOP WITH p == sim.table;"
        )


def test_without_contacts_no_pair_has_one():
    model, states = simulations(4)
    arrays = {name: np.stack([getattr(d, name) for d in states]) for name in ("xpos", "xquat")}
    with ssduck.Interpreter(recording=None) as ss:
        sim = ss.add_variable("sim", ssduck.World.batch(model, 4))
        sim.tick(**arrays, contact={"geom": np.zeros((4, 0, 2), int), "dist": np.zeros((4, 0))})
        assert ss.eval(f"SELECT env {PAIRS} WHERE hasContact(a.this, b.this) AS list;") == []


def test_limits_are_of_the_rows_of_an_environment():
    model, states = simulations(6)
    with ssduck.Interpreter(recording=None, limits=ssduck.Limits(rows=10)) as ss:
        ss.add_variable("sim", ssduck.World.batch(model, 6)).tick(states)
        assert len(ss.eval("SELECT env, z FROM sim;")) == 30
        with pytest.raises(LimitError, match="more than 10 rows"):
            ss.eval(f"SELECT env, a.id AS a {PAIRS};")
