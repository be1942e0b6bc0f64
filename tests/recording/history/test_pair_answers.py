"""Questions about pairs of entities at many ticks: decided together, as at each tick, and once."""

import math

import numpy as np
import pybullet
import pytest
from hypothesis import given
from hypothesis import strategies as st

import ssduck
from ssduck.geometry.distance import CallCounter
from ssduck.geometry.pair_batch import PairQuestion
from ssduck.geometry.poses import unit_quaternions
from ssduck.limits import Limits, UsageMeter
from ssduck.recording.replay import batch_queries
from ssduck.recording.replay import record as records
from ssduck.recording.replay.pair_answers import PairQueries
from ssduck.recording.stores.base import PairRequest
from tests.support.bodies import solid
from tests.support.urdf import box_obj, collision, joint, link, robot

TICKS = 12
QUESTIONS = {
    "clearance": lambda shapes, a, b: shapes.clearance(a, b),
    "gap": lambda shapes, a, b: shapes.gap(a, b),
    "penetration": lambda shapes, a, b: shapes.penetration(a, b),
    "on": lambda shapes, a, b: shapes.on(a, b),
    "supports": lambda shapes, a, b: shapes.supports(a, b),
    "resting": lambda shapes, a, b: shapes.rests_on(a, b),
    "touching": lambda shapes, a, b: shapes.touching(a, b, 0.001),
    "within": lambda shapes, a, b: shapes.near(a, b, 0.05),
    "colliding": lambda shapes, a, b: shapes.collides(a, b, 0.001),
}
DISTANCES = {"touching": 0.001, "within": 0.05, "colliding": 0.001}


def _question(kind):
    return PairQuestion(kind, DISTANCES.get(kind, 0.0))


@pytest.fixture(scope="module")
def heap(tmp_path_factory):
    """Bodies of every kind of shape that fall on a plane, on a table and on each other."""
    folder = tmp_path_factory.mktemp("heap")
    client = pybullet.connect(pybullet.DIRECT)
    own = {"physicsClientId": client}
    pybullet.setGravity(0, 0, -9.81, **own)
    chance = np.random.default_rng(3)
    (folder / "cube.obj").write_text(box_obj((-0.1, -0.1, -0.1), (0.1, 0.1, 0.1)))
    legs = "".join(
        collision('<box size="0.06 0.06 0.4"/>', xyz=(x, y, -0.22))
        for x in (-0.4, 0.4)
        for y in (-0.4, 0.4)
    )
    limit = '<limit lower="-9" upper="9" effort="1" velocity="1"/>'
    arm = robot(
        link("base", shapes=collision('<mesh filename="cube.obj"/>')),
        link("arm", shapes=collision('<cylinder radius="0.05" length="0.3"/>')),
        joint("turn", "revolute", "base", "arm", xyz=(0.2, 0, 0.05), limit=limit),
    )
    texts = {
        "table": (robot(link("t", shapes=collision('<box size="1 1 0.04"/>') + legs)), 0.42),
        "arm": (arm, 0.7),
    }
    names = {}
    names[solid(client, pybullet.GEOM_PLANE, 0)] = "ground"
    for name, (text, height) in texts.items():
        (folder / f"{name}.urdf").write_text(text)
        names[pybullet.loadURDF(str(folder / f"{name}.urdf"), (0, 0, height), **own)] = name
    kinds = {
        "box": {"kind": pybullet.GEOM_BOX, "halfExtents": [0.06, 0.05, 0.04]},
        "ball": {"kind": pybullet.GEOM_SPHERE, "radius": 0.06},
        "can": {"kind": pybullet.GEOM_CYLINDER, "radius": 0.05, "height": 0.1},
        "pill": {"kind": pybullet.GEOM_CAPSULE, "radius": 0.04, "height": 0.1},
        "stone": {"kind": pybullet.GEOM_MESH, "vertices": chance.normal(size=(9, 3)) * 0.05},
    }
    for n, (name, kind) in enumerate(kinds.items()):
        place = (*chance.uniform(-0.25, 0.25, 2), 0.55 + 0.12 * n)
        names[solid(client, mass=1, place=place, **kind)] = name
    world = ssduck.World.attach(client, names=names)
    with ssduck.Interpreter(recording=ssduck.Recording(every=40)) as ss:
        ss.add_variable("sim", world)
        for tick in range(TICKS):
            if tick == 8:
                world["ball"].move([0.3, 0.3, 0.44 + 0.06 - 1e-5])
            world.step(40)
        for name in names.values():
            ss.add_variable(name, world[name])
        yield ss
    pybullet.disconnect(client)


def _singly(ss, kind):
    """The answer about each two entities at each tick, by the queries of that tick."""
    past = ss.past("sim")
    found = {}
    for tick in past.ticks:
        world = past.at(tick)
        shapes = world.shapes()
        ids = [entity.id for entity in world]
        for a in ids:
            for b in ids:
                if a != b:
                    found[tick, a, b] = QUESTIONS[kind](shapes, a, b)
    return found


def _together(ss, kind):
    """The same, decided for all ticks at once: all pairs where the question allows it."""
    past = ss.past("sim")
    record = past.record
    question = _question(kind)
    ids = sorted(record.members)
    pairs = [(0, 0)]
    if math.isinf(question.max_gap):
        pairs = [(a, b) for a in ids for b in ids if a != b]
    found = {(tick, a, b): 0.0 for tick in past.ticks for a in ids for b in ids if a != b}
    for a, b in pairs:
        request = PairRequest(past.first, past.last, a, b, 0.0)
        answers = PairQueries(record, UsageMeter(Limits())).answers(request, question)
        columns = answers.ticks, answers.first, answers.second, answers.values
        for tick, p, q, value in zip(*map(np.ndarray.tolist, columns), strict=True):
            found[tick, p, q] = None if math.isnan(value) else value
    return found


@pytest.mark.slow
@pytest.mark.parametrize("kind", QUESTIONS)
def test_all_ticks_together_have_the_answers_of_each_tick(heap, kind):
    together, singly = _together(heap, kind), _singly(heap, kind)
    assert together.keys() == singly.keys()
    for place, value in singly.items():
        wanted = None if value is None else float(value)
        assert repr(together[place]) == repr(wanted), (kind, place)
    assert len({repr(value) for value in together.values()}) > 1


@pytest.mark.slow
def test_each_tick_has_the_answers_that_it_had_live(client):
    own = {"physicsClientId": client}
    pybullet.setGravity(0, 0, -9.81, **own)
    board = solid(client, pybullet.GEOM_BOX, 0, halfExtents=[0.5, 0.5, 0.05])
    can = solid(client, pybullet.GEOM_CYLINDER, 1, (0, 0, 0.3), radius=0.1, height=0.2)
    names = {board: "board", can: "can"}
    world = ssduck.World.attach(client, names=names)
    asked = ("clearance(board, can)", "clearance(can, board)", "penetration(can, board)")
    asked = (*asked, "on(board, can)", "supports(board, can)", "restsOn(board, can)")
    with ssduck.Interpreter() as ss:
        ss.add_variable("sim", world)
        for name in names.values():
            ss.add_variable(name, world[name])
        live = []
        for _ in range(60):
            world.step()
            live.append(ss.eval(f"[{', '.join(asked)}];"))
        assert repr([row[0] for row in live]) == repr([row[1] for row in live])
        past = [
            ss.eval(f"SELECT [{text}, time(this)] FROM sim{{}} WHERE this == can AS list;")
            for text in asked
        ]
        times = {row[1] for row in past[0]}
        assert len(times) >= 60
        for place, rows in enumerate(past):
            assert repr([value for value, _ in rows[-60:]]) == repr([row[place] for row in live])
        assert {row[3] for row in live} == {True, False}


# -- work, by counts ----------------------------------------------------------------------------


def _work(ss):
    statistics = ss.statistics()["sim"]
    return statistics.calls, statistics.pairs


ASKED = {
    "touching(table, box)": 0,
    "on(table, box)": 1,
    "supports(table, box)": 1,
    "clearance(table, box)": 3,
    "contactGap(table, box)": 3,
    "clearance(can, stone)": 3,
    "restsOn(ground, box)": 6,
}


@pytest.mark.slow
@pytest.mark.parametrize("asked", ASKED)
def test_a_second_question_about_the_same_ticks_compares_nothing(heap, asked):
    heap.past("sim").record.answer_cache.clear()
    before = _work(heap)
    first = heap.eval(f"changes({asked});")
    after = _work(heap)
    assert after[1] > before[1]
    assert after[0] - before[0] <= ASKED[asked] * len(heap.past("sim").ticks)
    assert heap.eval(f"changes({asked});") == first
    assert _work(heap) == after
    assert heap.eval(f"changes({asked}, -0.5);")
    assert _work(heap) == after


def test_a_symmetric_question_is_answered_in_the_other_order(heap):
    first = heap.eval("changes(clearance(table, ball));")
    before = _work(heap)
    assert heap.eval("changes(clearance(ball, table));") == first
    assert _work(heap) == before


@pytest.mark.slow
def test_of_two_orders_one_is_compared(heap):
    heap.past("sim").record.answer_cache.clear()
    rows = (
        "SELECT [tick(a.this), id(a.this), id(b.this)] FROM a=sim{}, b=sim{} "
        "WHERE near(a.this, b.this, 0.05) AS list;"
    )
    _, before = _work(heap)
    found = heap.eval(rows)
    _, compared = _work(heap)
    entities = len(heap.past("sim").record.members)
    assert len(found) // 2 <= compared - before <= TICKS * 2 * entities * (entities - 1) // 2
    assert sorted([t, b, a] for t, a, b in found) == sorted(found) != []
    assert heap.eval(rows) == found
    assert _work(heap)[1] == compared


@pytest.fixture
def stool(client, tmp_path):
    """A stool with four legs that slides over a board, and a shelf that stands there."""
    own = {"physicsClientId": client}
    legs = "".join(
        collision('<box size="0.04 0.04 0.4"/>', xyz=(x, y, 0.2))
        for x in (-0.2, 0.2)
        for y in (-0.2, 0.2)
    )
    text = robot(link("seat", mass=0, shapes=legs))
    (tmp_path / "stool.urdf").write_text(text)
    names = {solid(client, pybullet.GEOM_BOX, 0, (0, 0, -0.1), halfExtents=[2, 2, 0.1]): "board"}
    for name, x in (("stool", -1), ("shelf", 1)):
        body = pybullet.loadURDF(str(tmp_path / "stool.urdf"), (x, 0, 0), useFixedBase=True, **own)
        names[body] = name
    world = ssduck.World.attach(client, names=names)
    with ssduck.Interpreter(recording=ssduck.Recording(every=1)) as ss:
        ss.add_variable("sim", world)
        for name in names.values():
            ss.add_variable(name, world[name])
        for tick in range(TICKS):
            world["stool"].move([-1 + 0.01 * tick, 0, 0])
            world.step()
        yield ss


@pytest.mark.slow
def test_what_stands_still_is_compared_once(stool):
    legs, (before, _) = 4, _work(stool)
    assert stool.eval("least(clearance(board, shelf));")[0] == 0.0
    at_once, _ = _work(stool)
    stool.past("sim").record.answer_cache.clear()
    assert len(stool.eval("changes(clearance(board, shelf));")) == 1
    assert 0 < _work(stool)[0] - at_once <= legs * (at_once - before)
    at_once, _ = _work(stool)
    stool.eval("changes(clearance(board, stool));")  # which moves
    assert _work(stool)[0] - at_once >= TICKS


@pytest.mark.slow
def test_only_new_ticks_are_compared(client):
    names = {
        solid(client, pybullet.GEOM_SPHERE, 0, (0.3 * n, 0, 0), radius=0.1): name
        for n, name in enumerate(("p", "q"))
    }
    world = ssduck.World.attach(client, names=names)
    with ssduck.Interpreter(recording=ssduck.Recording(ticks=40)) as ss:
        ss.add_variable("sim", world)
        ss.add_variable("p", world["p"])
        ss.add_variable("q", world["q"])
        for _ in range(10):
            world.step()
        ss.eval("holds(clearance(p, q) < 0.05);")
        _, before = _work(ss)
        for _ in range(5):
            world.step()
        ss.eval("holds(clearance(p, q) < 0.05);")
        assert _work(ss)[1] - before == 5
        # What is dropped from the record is dropped from the answers, too.
        for _ in range(300):
            world.step()
        ss.eval("holds(clearance(p, q) < 0.05);")
        cache = ss.past("sim").record.answer_cache
        assert len(cache) <= len(ss.past("sim").ticks) < 200
        # A new record has no answers.
        ss.record("sim", ssduck.Recording())
        world.step()
        assert len(ss.past("sim").record.answer_cache) == 0


@pytest.mark.slow
def test_the_answers_are_bounded(heap, monkeypatch):
    cache = heap.past("sim").record.answer_cache
    cache.clear()
    ticks = len(heap.past("sim").ticks)
    monkeypatch.setattr(records, "MAX_ANSWERS", 2 * ticks + 1)
    for other in ("box", "ball", "can", "pill"):
        heap.eval(f"holds(clearance(table, {other}) < 0.05);")
    assert len(cache) == 2 * ticks
    before = _work(heap)
    heap.eval("[holds(clearance(table, can) < 0.05), holds(clearance(table, pill) < 0.05)];")
    assert _work(heap) == before
    heap.eval("least(clearance(table, box));")
    assert _work(heap)[1] == before[1] + ticks
    monkeypatch.setattr(records, "MAX_ANSWERS", 3)
    first = heap.eval("changes(on(table, box));")
    assert len(cache) <= 3
    assert heap.eval("changes(on(table, box));") == first


# -- any shapes and poses -----------------------------------------------------------------------

_PLACES = st.floats(-0.5, 0.5, width=32)
_POSES = st.tuples(_PLACES, _PLACES, _PLACES, *[st.floats(-1, 1, width=16)] * 4)


@pytest.mark.slow
@given(poses=st.lists(st.tuples(_POSES, _POSES), min_size=1, max_size=8), data=st.data())
def test_answers_at_any_poses_are_those_of_each_pair(heap, poses, data):
    record = heap.past("sim").record
    shapes = record.entity_shapes
    single = [id for id, member in record.members.items() if len(member.body.links) == 1]
    a, b = data.draw(st.sampled_from([(a, b) for a in single for b in single if a != b]))
    kind = data.draw(
        st.sampled_from(["clearance", "gap", "penetration", "on", "colliding", "within"])
    )
    columns = np.array(poses, dtype=np.float64)
    columns[..., 3:] = unit_quaternions(columns[..., 3:].reshape(-1, 4)).reshape(-1, 2, 4)
    count = len(poses)
    sides = [
        batch_queries.PairSide(
            np.full(count, id),
            columns[:, n],
            lambda *_: pytest.fail("these bodies have one link"),
        )
        for n, id in enumerate((a, b))
    ]
    answers = shapes.answers(*sides, _question(kind), CallCounter())
    for row in range(count):
        by_id = {a: columns[row, :1], b: columns[row, 1:]}
        places = batch_queries._Places()
        numbers = {id: places.number(id, by_id[id]) for id in sorted((a, b))}
        queries = shapes._queries(places, CallCounter())
        wanted = QUESTIONS[kind](queries, numbers[a], numbers[b])
        if answers.is_open[row]:
            assert kind == "on"
            continue
        expected = math.nan if wanted is None else float(wanted)
        assert repr(float(answers.values[row])) == repr(expected), (kind, a, b)
        if kind == "clearance":
            assert repr(queries.clearance(numbers[b], numbers[a])) == repr(wanted)
