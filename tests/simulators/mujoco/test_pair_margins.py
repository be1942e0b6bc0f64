"""Margins of pairs of geoms: `touching` and `on` hold where MuJoCo presses, by its own rule.

The oracle is MuJoCo: a contact presses if it is among the constraints.
"""

import mujoco
import pytest

import ssduck
from tests.support.cases import sampled
from tests.support.mjcf import simulated

pytestmark = pytest.mark.slow

MODEL = """
<mujoco>{option}<worldbody>
  <body name="table" pos="0 0 .1"><geom name="t" type="box" size=".3 .3 .1" {table}/></body>
  <body name="cup" pos="0 0 .4"><freejoint/><geom name="c" type="box" size=".05 .05 .05" {cup}/></body>
  <body name="ball" pos=".2 0 .4"><freejoint/><geom name="b" type="sphere" size=".05" {ball}/></body>
</worldbody>{pair}</mujoco>
"""
PAIR = '<contact><pair geom1="t" geom2="c" {}/></contact>'
PAIRED = MODEL.format(option="", table="", cup="", ball="", pair=PAIR.format('margin=".1"'))
OVERRIDE = '<option o_margin=".06"><flag override="enable"/></option>'
CASES = {
    "pair": {"pair": PAIR.format('margin=".1"')},
    "pair of less": {"pair": PAIR.format('margin="0"'), "table": 'margin=".05"'},
    "pair with a gap": {"pair": PAIR.format('margin=".1" gap=".04"')},
    "override": {"option": OVERRIDE},
    "override of a pair": {"option": OVERRIDE, "pair": PAIR.format('margin=".1" gap=".02"')},
    "one": {"table": 'margin=".05"'},
    "gap": {"table": 'margin=".05" gap=".05"'},
    "both": {"table": 'margin=".05"', "cup": 'margin=".05"', "ball": 'margin=".02"'},
    "gaps": {"table": 'margin=".05" gap=".04"', "cup": 'margin=".02" gap=".03"'},
}
THINGS = {"cup": 7, "ball": 14}
WAYS = {
    "called": lambda ss, relation, thing: ss.eval(f"{relation}(s.table, s.{thing});"),
    "selected": lambda ss, relation, thing: ss.eval(
        f"SELECT id FROM s WHERE {relation}(s.table, this) AS list;"
    ).count(thing),
    "links": lambda ss, relation, thing: ss.eval(f"{relation}(s.table.table, s.{thing});"),
    "raw": lambda ss, relation, thing: ss.sql(
        f'SELECT count(*) FROM entities a, entities b WHERE "{relation}"(a, b) '
        f"AND a.name = 'table' AND b.name = '{thing}'"
    ).fetchone()[0],
}


def pressed(model, data, thing):
    """Whether MuJoCo presses a thing from the table."""
    geoms = sorted((model.geom("t").id, model.geom(thing[0]).id))
    return any(sorted(c.geom) == geoms and c.efc_address >= 0 for c in data.contact)


@pytest.mark.parametrize("way", WAYS.values(), ids=WAYS)
@sampled("case", CASES, every=3)
def test_they_hold_where_the_simulator_presses(case, way):
    parts = dict.fromkeys(("option", "table", "cup", "ball", "pair"), "") | CASES[case]
    model, data = simulated(MODEL.format(**parts))
    with ssduck.Interpreter(recording=None) as ss:
        world = ss.add_variable("s", ssduck.World.attach(model, data))
        seen = {thing: [] for thing in THINGS}
        # Not at the margins themselves; `touching` and `on` add a millimetre.
        for gap in (-0.001, 0.005, 0.015, 0.035, 0.045, 0.055, 0.065, 0.075, 0.085, 0.105):
            data.qpos[2] = data.qpos[9] = 0.25 + gap
            mujoco.mj_forward(model, data)
            world.tick()
            for thing in THINGS:
                expected = pressed(model, data, thing)
                for relation in ("touching", "on") if way is not WAYS["links"] else ("touching",):
                    assert bool(way(ss, relation, thing)) is expected, (case, thing, gap, relation)
                seen[thing].append(expected)
        assert all(answers[0] for answers in seen.values())
        assert not any(answers[-1] for answers in seen.values())


def test_margins_that_change_count_from_the_next_tick():
    model, data = simulated(PAIRED)
    data.qpos[2] = 0.25 + 0.09
    mujoco.mj_forward(model, data)
    with ssduck.Interpreter() as ss:
        world = ss.add_variable("s", ssduck.World.attach(model, data))
        assert ss.eval("[touching(s.table, s.cup), touching(s.table, s.ball)];") == [True, False]
        model.pair_margin[0] = 0.02
        world.tick()
        assert ss.eval("touching(s.table, s.cup);") is False
        model.pair_margin[0] = 0.2
        world.tick()
        assert ss.eval("touching(s.table, s.cup);") is True
        assert ss.eval("touching(s.cup, s.ball);") is False


def test_past_ticks_tell_that_they_have_a_margin_for_each_shape():
    model, data = simulated(PAIRED)
    data.qpos[2] = data.qpos[9] = 0.25 + 0.08
    mujoco.mj_forward(model, data)
    with ssduck.Interpreter() as ss:
        world = ss.add_variable("s", ssduck.World.attach(model, data))
        for _ in range(3):
            mujoco.mj_step(model, data)
            world.tick()
        assert ss.eval("[on(s.table, s.cup), on(s.table, s.ball)];") == [True, False]
        with pytest.warns(UserWarning, match="pairs of shapes have margins of their own"):
            assert ss.eval("on(s{0.002}.table, s{0.002}.cup);") is True
