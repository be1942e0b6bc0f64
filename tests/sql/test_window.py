"""What a query of many ticks costs, by counts, and that none of its short ways changes an answer."""

import re

import numpy as np
import pyarrow as pa
import pybullet
import pytest
from hypothesis import given
from hypothesis import strategies as st

import ssduck
from ssduck.geometry.poses import flat_rotation_matrices, multiply, rotation_matrices
from ssduck.recording.replay import batch_queries as many_ticks
from ssduck.recording.stores.base import PAIR_COLUMNS, PairRequest
from ssduck.recording.stores.history_sql import near_pair_rows
from ssduck.recording.stores.memory import _near_pair
from ssduck.schema import POSE
from ssduck.sql.relations.relation import BOX
from tests.support.bodies import solid
from tests.support.cases import sampled


@pytest.fixture(scope="module")
def comings():
    """A ball that falls past a board; another one that is there from the 20th to the 40th tick."""
    client = pybullet.connect(pybullet.DIRECT)
    pybullet.setGravity(0, 0, -9.81, client)
    board = solid(client, pybullet.GEOM_BOX, 0, [0, 0, 0.5], halfExtents=[0.5, 0.5, 0.05])
    ball = solid(client, pybullet.GEOM_SPHERE, 1, [0.7, 0, 0.8], radius=0.1)
    names = {board: "board", ball: "ball"}
    world = ssduck.World.attach(client, names=names)
    with ssduck.Interpreter() as ss:
        ss.add_variable("lab", world)
        for name in names.values():
            ss.add_variable(name, world[name])
        for tick in range(60):
            if tick == 20:
                guest = solid(client, pybullet.GEOM_SPHERE, 0, [0.75, 0.1, 0.6], radius=0.1)
                world.tick()
                ss.add_variable("guest", next(e for e in world if e.name not in names.values()))
            if tick == 40:
                pybullet.removeBody(guest, client)
            world.step()
        yield ss
    pybullet.disconnect(client)


def _told(ss, program):
    """What a program gives, and its statements."""
    told = []
    ss._database.connection._tracer = told.append
    try:
        return ss.eval(program), told
    finally:
        ss._database.connection._tracer = None


# -- the statement ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("compared", "holds"),
    [
        ("== 0", lambda rest: rest == 0),
        ("!= 0", lambda rest: rest != 0),
        ("== 3", lambda rest: rest == 3),
        ("> 4", lambda rest: rest > 4),
    ],
)
def test_the_remainder_of_a_tick_is_one_operation(comings, compared, holds):
    found, told = _told(
        comings, f"SELECT tick(this) FROM lab{{}} WHERE tick(this) % 7 {compared} AS list;"
    )
    (sql,) = [sql for sql in told if "entities_history" in sql]
    assert sql.count("%") == 1
    assert "CASE" not in sql
    ticks = [e.moment.tick for e in comings.past("lab")]
    assert found == [tick for tick in ticks if holds(tick % 7)] != []


def test_the_remainder_of_what_may_be_below_0_has_the_sign_of_the_divisor(comings):
    program = "SELECT (tick(this) - 30) % 7 FROM lab{} WHERE this == board AS list;"
    found, _ = _told(comings, program)
    assert found == [(tick - 30) % 7 for tick in comings.past("lab").ticks]
    nested = "SELECT (tick(this) % 7 - 5) % 4 FROM lab{} WHERE this == board AS list;"
    found, _ = _told(comings, nested)
    assert found == [(tick % 7 - 5) % 4 for tick in comings.past("lab").ticks]


CONDITIONS = {
    "near({0}, this, 0.12)": 2,
    "collides({0}, this)": 2,
    "near({0}, this, 0.12) AND z({0}) > 0.55": 3,
    "near({0}, this, 0.12) OR above({0}, this)": 3,
    "near({0}, board, 0.12) AND near({0}, this, 5)": 4,
}


@pytest.mark.slow
@pytest.mark.parametrize("handle", ["board", "guest"])
@sampled("condition", CONDITIONS, every=3)
def test_a_handles_row_is_read_where_a_column_of_it_is(comings, condition, handle):
    asked = condition.format(handle)
    program = f"SELECT tick(this) FROM lab{{}} WHERE this == ball AND {asked} AS list;"
    found, told = _told(comings, program)
    (sql,) = [sql for sql in told if re.search(r"^(PREPARE|SELECT).*entities_history", sql)]
    # Of the row itself once, and of each handle, which may not have been there. What it is now is
    # asked for, too, so that Python tells of one that is gone.
    if handle == "board":
        assert len(re.findall("entities_history", sql)) == CONDITIONS[condition]
    rows = ssduck.Interpreter(row_by_row=True, recording=None)
    try:
        rows._database = rows._execution.database = rows._planner._database = comings._database
        rows._execution.variables = comings._execution.variables
        assert found == rows.eval(program)
    finally:
        rows._finalized = True


@pytest.mark.parametrize(
    "relation",
    [
        *("near({0}, {1}, 5)", "near({0}, {1}, 0.01)", "collides({0}, {1})", "on({0}, {1})"),
        *("above({0}, {1})", "inContact({0}, {1})", "hasContact({1}, {0})", "touching({0}, {1})"),
        "enclosed({1}, {0})",
    ],
)
def test_neither_a_relation_nor_its_negation_holds_before_an_entity_came(comings, relation):
    past = "SELECT tick(this) FROM lab{{}} WHERE this == board AND {} AS list;"
    guest = comings["guest"].id
    there = [e.moment.tick for e in comings.past("lab") if e.id == guest]
    assert 0 < len(there) < len(comings.past("lab").ticks)
    asked = relation.format("this", "guest")
    holds, fails = (comings.eval(past.format(c)) for c in (asked, f"NOT ({asked})"))
    assert sorted(holds + fails) == there


# -- two entities in memory ---------------------------------------------------------------------

_PLACES = st.one_of(st.none(), st.sampled_from([0.0, 0.5, 0.5 + 2e-9, 0.5 + 5e-10, 1.0, np.inf]))


@st.composite
def _rows(draw):
    """Rows of three entities at some ticks, in parts of whole ticks; not all are there always."""
    numbers = draw(st.lists(st.integers(1, 12), unique=True, max_size=6).map(sorted))
    there = [(tick, id) for tick in numbers for id in (1, 2, 3) if draw(st.booleans())]
    columns = {"tick": [t for t, _ in there], "id": [id for _, id in there]}
    for name in (*POSE, *BOX):
        columns[name] = [draw(_PLACES) for _ in there]
    types = [("tick", pa.int64()), ("id", pa.int64()), *((n, pa.float64()) for n in (*POSE, *BOX))]
    rows = pa.table(columns, schema=pa.schema(types))
    last = draw(st.integers(0, 13))
    cut = sum(tick <= last for tick, _ in there)
    return [rows.slice(0, cut), rows.slice(cut)]


@pytest.fixture(scope="module")
def writer():
    """A connection of a history's own."""
    with ssduck.Interpreter() as ss:
        yield ss._database.connection.writer()


@pytest.mark.slow
@given(
    parts=_rows(),
    pair=st.sampled_from([(1, 2), (2, 1), (3, 1), (1, 9), (-1, 2)]),
    apart=st.sampled_from([0.0, 0.5]),
    ends=st.tuples(st.integers(0, 13), st.integers(0, 13)),
)
def test_two_entities_picked_out_of_memory_are_those_of_sql(writer, parts, pair, apart, ends):
    rows = pa.concat_tables(parts)
    asked = PairRequest(*ends, *pair, apart)
    found, wanted = _near_pair(rows, asked), near_pair_rows(writer, None, asked, rows)
    assert tuple(found.column_names) == tuple(wanted.column_names) == PAIR_COLUMNS
    for name in PAIR_COLUMNS:
        assert np.array_equal(
            np.asarray(found[name].to_numpy(), dtype=float),
            np.asarray(wanted[name].to_numpy(), dtype=float),
            equal_nan=True,
        )


# -- together -----------------------------------------------------------------------------------


@pytest.mark.parametrize("together", [1, 2, 7, 1 << 15])
def test_pairs_are_the_same_however_many_are_compared_together(comings, monkeypatch, together):
    program = (
        "SELECT tick(a.this), id(a.this), id(b.this) FROM a=lab{}, b=lab{} "
        "WHERE near(a.this, b.this, 0.12) AS list;"
    )
    monkeypatch.setattr(many_ticks, "MAX_BATCH_SIZE", together)
    found = comings.eval(program)
    wanted = []
    for tick in comings.past("lab").ticks:
        then = comings.past("lab").at(tick)
        shapes = then.shapes()
        for a in then:
            wanted += [
                part
                for b in then
                if a.id != b.id and shapes.near(a.id, b.id, 0.12)
                for part in (tick, a.name, b.name)
            ]
    assert found == wanted != []


@pytest.mark.parametrize("count", [0, 1, 1023, 1024, 1025, 3000])
def test_products_of_many_rows_are_those_of_each(count):
    turns = np.random.default_rng(count).normal(size=(count, 4))
    turns /= np.sqrt((turns * turns).sum(axis=1))[:, None]
    each = [rotation_matrices(turn[None])[0] for turn in turns]
    wanted = np.array(each).reshape(-1, 3, 3)
    assert np.array_equal(rotation_matrices(turns), wanted)  # to the last bit
    assert np.array_equal(flat_rotation_matrices(turns).T.reshape(-1, 3, 3), wanted)
    products = np.array([multiply(turn[None], turn[None])[0] for turn in turns]).reshape(-1, 4)
    assert np.array_equal(multiply(turns, turns), products)
