"""Programs in a sandbox ask worlds of this process, call its functions, and fire its triggers."""

from __future__ import annotations

import time

import mujoco
import pybullet
import pytest

import ssduck
from ssduck.errors import FunctionError, LimitError, UnknownNameError, UnsupportedError
from ssduck.interpreter.mirrors import Mirror
from ssduck.limits import Limits
from ssduck.sandbox import SandboxedInterpreter, opening
from ssduck.simulators.scenes import find_scene
from tests.interpreter.test_mirrors import PROGRAMS, STATEMENTS
from tests.simulators.mujoco.test_pair_margins import CASES, MODEL, PAIR, THINGS
from tests.simulators.mujoco.test_pair_margins import pressed as presses
from tests.support.environments import by_name

pytestmark = pytest.mark.slow

EXIT = "__import__('os')._exit(0)"


@pytest.fixture(scope="module")
def pair(zygote):
    """An interpreter of a world, and a sandbox that has the world, with all ticks of both."""
    with ssduck.Interpreter() as ss, SandboxedInterpreter(zygote=zygote) as box:
        world = ssduck.World.load(find_scene("kitchen"))
        world.name = "kitchen"
        for one in (ss, box):
            one.add_variable("kitchen", world)
        for _ in range(2):
            world.run(0.05)
            box.eval("1;")
        x, y, z = world["cup_905a"].position
        world["cup_905a"].move([x, y, z + 0.3])
        world.run(0.02)
        yield ss, box


@pytest.mark.parametrize("program", PROGRAMS)
def test_programs_ask_a_world_of_this_process(pair, program):
    ss, box = pair
    assert by_name(box.eval(program)) == by_name(ss.eval(program))


@pytest.mark.parametrize("statement", STATEMENTS)
def test_sql_asks_a_world_of_this_process(pair, statement):
    ss, box = pair
    rows = box.sql(statement).fetchall()
    assert rows == ss.sql(statement).fetchall()
    assert rows


@pytest.mark.parametrize("case", ["pair", "pair of less", "override of a pair", "both"])
def test_relations_hold_in_copies_where_the_simulator_presses(zygote, case):
    parts = dict.fromkeys(("option", "table", "cup", "ball", "pair"), "") | CASES[case]
    model = mujoco.MjModel.from_xml_string(MODEL.format(**parts))
    data = mujoco.MjData(model)
    with ssduck.Interpreter() as ss, SandboxedInterpreter(zygote=zygote) as box:
        world = ss.add_variable("s", ssduck.World.attach(model, data))
        mirror = Mirror(ss, world, "s", Limits())
        box["s"] = world
        for gap in (-0.001, 0.015, 0.045, 0.075, 0.105):
            data.qpos[2] = data.qpos[9] = 0.25 + gap
            mujoco.mj_forward(model, data)
            world.tick()
            mirror.update()
            for thing in THINGS:
                expected = presses(model, data, thing)
                for asked in (box, mirror.interpreter):
                    assert asked.eval(f"touching(s.table, s.{thing});") is expected, (thing, gap)
        mirror.close()


def test_margins_that_change_reach_the_copy(zygote):
    pair = PAIR.format('margin=".1"')
    text = MODEL.format(option="", table="", cup="", ball="", pair=pair)
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    data.qpos[2] = 0.25 + 0.09
    mujoco.mj_forward(model, data)
    with SandboxedInterpreter(zygote=zygote) as box:
        world = box["s"] = ssduck.World.attach(model, data)
        assert box.eval("[touching(s.table, s.cup), touching(s.table, s.ball)];") == [True, False]
        for margin in (0.02, 0.2):
            model.pair_margin[0] = margin
            world.tick()
            assert box.eval("touching(s.table, s.cup);") is (margin > 0.09)
        assert box.sql("SELECT min(margin) FROM shapes").fetchall() == [(0.0,)]
        model.geom_margin[:] = 0.03
        world.tick()
        assert box.sql("SELECT min(margin) > 0 FROM shapes").fetchall() == [(True,)]


def test_each_question_sees_the_last_tick_of_the_simulation(zygote):
    with ssduck.load("kitchen") as ss, SandboxedInterpreter(zygote=zygote) as box:
        world = ss["kitchen"]
        assert box.add_variable("room", world) is world is box["room"]
        for _ in range(3):
            world.step(3)
            assert box.eval("z(room.cup_905a);") == world["cup_905a"].position[2]
            assert box.sql("SELECT tick FROM ticks").fetchone() == (world.tick_number,)
        world.remove("cup_905a")
        world.add_sensor("range_finder", "table", "eye", max_range=1.0)
        world.tick()
        assert box.eval("SELECT count(*) FROM room AS value;") == len(world)
        with pytest.raises(UnknownNameError, match="cup_905a"):
            box.eval("room.cup_905a;")
        assert box.eval("z(it);", {"it": world["table"]}) == world["table"].position[2]
        assert box.eval("room.table;").position == list(world["table"].position)


def test_a_program_cannot_change_the_world(zygote):
    with ssduck.load("kitchen") as ss, SandboxedInterpreter(zygote=zygote) as box:
        world = ss["kitchen"]
        box["kitchen"] = world
        before = world.tick_number, [entity.name for entity in world]
        box.sql("CREATE TABLE mine AS SELECT * FROM entities")
        with pytest.raises(ssduck.SelectScriptError):
            box.sql("UPDATE entities SET z = 0")
        (copy,) = box.worlds
        with pytest.raises(ssduck.SelectScriptError, match="ends at"):
            copy.step()
        box["kitchen"] = 1
        assert (box.eval("kitchen;"), box["kitchen"], box.worlds) == (1, 1, [])
        assert box.sql("SELECT count(*) FROM kitchen.entities").fetchone() == (len(world),)
        assert (world.tick_number, [entity.name for entity in world]) == before


def test_a_world_that_cannot_be_copied_is_not_there(zygote):
    with ssduck.load("kitchen") as ss, SandboxedInterpreter(zygote=zygote) as box:
        box["kitchen"] = ss["kitchen"]
        with pytest.raises(ssduck.SelectScriptError, match="SQL ignores case"):
            box["KITCHEN"] = ss["kitchen"]
        assert list(box) == ["kitchen"]


def test_masses_that_change_are_seen(zygote):
    with ssduck.load("kitchen") as ss, SandboxedInterpreter(zygote=zygote) as box:
        world = box.add_variable("kitchen", ss["kitchen"])
        cup = world["cup_905a"]
        assert box.eval("mass(kitchen.cup_905a);") == cup.mass
        (body,) = (one.body for one in world.snapshot.entities if one.name == "cup_905a")
        client = world.simulator.client
        pybullet.changeDynamics(body.handle, -1, mass=7.5, physicsClientId=client)
        world.step()
        assert box.eval("mass(kitchen.cup_905a);") == pytest.approx(7.5)


def test_what_sensors_perceive_is_asked_of_the_simulation(zygote):
    with ssduck.load("kitchen") as ss, SandboxedInterpreter(zygote=zygote) as box:
        box["kitchen"] = ss["kitchen"]
        with pytest.raises(UnsupportedError, match="no world"):
            box.ask("worker.python", "worker.call('sensed', 'other')")
        with pytest.raises(UnsupportedError, match="once for each question"):
            box.ask("worker.python", "[worker.call('sensed', 'kitchen') for _ in range(2)]")
        query = "SELECT a.this, b.this FROM a=kitchen, b=kitchen WHERE isSensing(a.this, b.this);"
        assert by_name(box.eval(query)) == by_name(ss.eval(query)) != []
        statement = "SELECT sensor, entity FROM sensings ORDER BY ALL"
        assert box.sql(statement).fetchall() == ss.sql(statement).fetchall()


def plus(a: float, b: float = 2.0) -> float:
    """Adds numbers."""
    if a < 0:
        raise ValueError("negative")
    return a + b


def test_functions_of_this_process_are_called(zygote):
    with opening.load("kitchen", zygote=zygote) as box, ssduck.load("kitchen") as ss:
        for one in (box, ss):
            one.add_function("plus", plus)
            one.add_function("nameOf", lambda entity: entity.name, "Returns the name.")
        for program in (
            "plus(3);",
            "plus(3, 4.5);",
            "SELECT plus(abs(z)) FROM kitchen LIMIT 3 AS list;",
            "SELECT nameOf(this) FROM kitchen WHERE plus(abs(z), 1) > 2 AS list;",
            "help('plus');",
            "help('nameOf');",
        ):
            assert box.eval(program) == ss.eval(program)
        statement = "SELECT plus(abs(z), 1.0) FROM entities"
        assert box.sql(statement).fetchall() == ss.sql(statement).fetchall()
        told = []
        for one in (box, ss):
            for program in ("plus(-1);", "plus(1, 2, 3);", "plus();"):
                with pytest.raises(ssduck.SelectScriptError) as caught:
                    one.eval(program)
                told.append((type(caught.value), str(caught.value)))
        assert told[:3] == told[3:]
        box.del_function("plus")
        with pytest.raises(UnknownNameError):
            box.eval("plus(1);")


def test_a_function_that_is_called_cannot_ask_back(zygote):
    with opening.load("kitchen", zygote=zygote) as box:
        box.add_function("place", lambda entity: entity.position)
        with pytest.raises(FunctionError, match="cannot ask it"):
            box.eval("place(kitchen.fridge);")
        assert box.eval("1 + 1;") == 2


def test_callbacks_of_triggers_are_called_here(zygote):
    fired = []
    with opening.load("kitchen", zygote=zygote) as box:
        box.add_trigger("clock", "getTime();", 0.25, fired.append)
        box.run(1.0)
        assert fired == [0.0, 0.25, 0.5, 0.75, 1.0]
        with pytest.raises(ssduck.errors.ArgumentError, match="clock"):
            box.add_trigger("clock", "1;", 0.25, print)
        box.del_trigger("clock")
        box.run(0.5)
        assert len(fired) == 5
        with pytest.raises(UnsupportedError, match="queue"):
            box.add_trigger("other", "1;", 0.25, print, queue=3)


def test_triggers_see_the_tick_of_each_question(zygote):
    times, sensed = [], []
    query = "SELECT count(*) FROM a=kitchen, b=kitchen WHERE isSensing(a.this, b.this) AS value;"
    with ssduck.load("kitchen") as ss, SandboxedInterpreter(zygote=zygote) as box:
        world = box.add_variable("kitchen", ss["kitchen"])
        box.add_trigger("clock", "getTime();", 0.1, times.append)
        box.add_trigger("eyes", query, 0.1, sensed.append)
        for _ in range(3):
            world.run(0.15)
            box.eval("1;")
        assert times == [0.0, *(pytest.approx(0.15 * i) for i in (1, 2, 3))]
        assert sensed[-1] == ss.eval(query)


def pressed(_: float) -> float:
    """Ctrl-C is pressed while this function runs."""
    raise KeyboardInterrupt


@pytest.mark.parametrize("question", ["eval", "sql"])
def test_ctrl_c_in_a_function_ends_the_program_and_keeps_its_variables(zygote, question):
    programs = {
        "eval": "SELECT pressed(z) FROM kitchen AS list;",
        "sql": "SELECT pressed(z) FROM entities",
    }
    with opening.load("kitchen", zygote=zygote) as box:
        box.add_function("pressed", pressed)
        box.eval("mine = 7;")
        with pytest.raises(KeyboardInterrupt):
            getattr(box, question)(programs[question])
        assert box.eval("mine;") == 7


def test_a_new_process_has_worlds_functions_and_triggers_again(zygote):
    fired = []
    with ssduck.load("kitchen") as ss, opening.load("kitchen", zygote=zygote) as box:
        box["other"] = ss["kitchen"]
        box.add_function("plus", plus)
        box.add_trigger("clock", "plus(getTime());", 1.0, fired.append)
        ss["kitchen"].run(0.05)
        ss["kitchen"]["cup_905a"].move([0, 0, 3])
        with pytest.raises(LimitError):
            box.ask("worker.python", EXIT)
        assert box.eval("plus(z(other.cup_905a));") == 5.0
        assert box.eval("SELECT count(*) FROM other{} AS value;") > len(ss["kitchen"])
        box.run(1.0)
        assert fired == [2.0, 2.0, 3.0]


# What a worker that was taken over calls.
CALLS = [
    "'function', 'nothing', 1",
    "'sensed', 5",
    "'sensed', 'kitchen', ['shapes']",
    "'fired', 'plus', 1",
    "'shutdown'",
    "5",
]


@pytest.mark.parametrize("call", CALLS)
def test_what_nobody_offers_cannot_be_called(zygote, call):
    with ssduck.load("kitchen") as ss, SandboxedInterpreter(zygote=zygote) as box:
        box["kitchen"] = ss["kitchen"]
        box.add_function("plus", plus)
        with pytest.raises(LimitError, match="sent no answer"):
            box.ask("worker.python", f"worker.call({call})")
        assert box.eval("plus(z(kitchen.table));") == plus(ss["kitchen"]["table"].position[2])


# Sends calls without waiting for the replies, so that the host has always something to read.
FLOOD = """
import os, threading
from ssduck.sandbox.messages import send

def drain():
    while True:
        os.read(connection, 1 << 16)

threading.Thread(target=drain, daemon=True).start()
call = b'["function", ["pause", 0]]' + b" " * 8192
while True:
    send(connection, worker._number, call, is_call=True)
"""


def test_calls_without_end_end_in_time(zygote):
    limits = Limits.strict(seconds=0.2)
    with SandboxedInterpreter(limits=limits, zygote=zygote) as box:
        box.add_function("pause", lambda _: time.sleep(0.002))
        with pytest.raises(LimitError, match="more than"):
            box.ask("worker.python", FLOOD)
        assert box.eval("1 + 1;") == 2
