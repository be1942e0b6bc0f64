"""Programs in a sandbox ask worlds of this process, call its functions, and fire its triggers."""

from __future__ import annotations

import pybullet
import pytest

import ssduck
from ssduck.errors import FunctionError, LimitError, UnknownNameError, UnsupportedError
from ssduck.sandbox import SandboxedInterpreter
from ssduck.simulators.scenes import find_scene
from tests.interpreter.test_mirrors import PROGRAMS, STATEMENTS, plain

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


@pytest.mark.slow
@pytest.mark.parametrize("program", PROGRAMS)
def test_programs_ask_a_world_of_this_process(pair, program):
    ss, box = pair
    assert plain(box.eval(program)) == plain(ss.eval(program))


@pytest.mark.slow
@pytest.mark.parametrize("statement", STATEMENTS)
def test_sql_asks_a_world_of_this_process(pair, statement):
    ss, box = pair
    rows = box.sql(statement).fetchall()
    assert rows == ss.sql(statement).fetchall()
    assert rows


@pytest.mark.slow
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


@pytest.mark.slow
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
        assert (world.tick_number, [entity.name for entity in world]) == before


@pytest.mark.slow
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


@pytest.mark.slow
def test_what_sensors_perceive_is_asked_of_the_simulation(zygote):
    with ssduck.load("kitchen") as ss, SandboxedInterpreter(zygote=zygote) as box:
        box["kitchen"] = ss["kitchen"]
        query = "SELECT a.this, b.this FROM a=kitchen, b=kitchen WHERE isSensing(a.this, b.this);"
        assert plain(box.eval(query)) == plain(ss.eval(query)) != []
        statement = "SELECT sensor, entity FROM sensings ORDER BY ALL"
        assert box.sql(statement).fetchall() == ss.sql(statement).fetchall()


def plus(a: float, b: float = 2.0) -> float:
    """Adds numbers."""
    if a < 0:
        raise ValueError("negative")
    return a + b


@pytest.mark.slow
def test_functions_of_this_process_are_called(zygote):
    with SandboxedInterpreter.load("kitchen", zygote=zygote) as box, ssduck.load("kitchen") as ss:
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


@pytest.mark.slow
def test_a_function_that_is_called_cannot_ask_back(zygote):
    with SandboxedInterpreter.load("kitchen", zygote=zygote) as box:
        box.add_function("place", lambda entity: entity.position)
        with pytest.raises(FunctionError, match="cannot ask the sandbox"):
            box.eval("place(kitchen.fridge);")
        assert box.eval("1 + 1;") == 2


@pytest.mark.slow
def test_callbacks_of_triggers_are_called_here(zygote):
    fired = []
    with SandboxedInterpreter.load("kitchen", zygote=zygote) as box:
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


@pytest.mark.slow
def test_a_new_process_has_worlds_functions_and_triggers_again(zygote):
    fired = []
    with ssduck.load("kitchen") as ss, SandboxedInterpreter.load("kitchen", zygote=zygote) as box:
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
    "'news', 'nothing', []",
    "'news', 'kitchen', 5",
    "'fired', 'plus', 1",
    "'shutdown'",
    "5",
]


@pytest.mark.slow
@pytest.mark.parametrize("call", CALLS)
def test_what_nobody_offers_cannot_be_called(zygote, call):
    with ssduck.load("kitchen") as ss, SandboxedInterpreter(zygote=zygote) as box:
        box["kitchen"] = ss["kitchen"]
        box.add_function("plus", plus)
        with pytest.raises(LimitError, match="sent no answer"):
            box.ask("worker.python", f"worker.call({call})")
        assert box.eval("plus(z(kitchen.table));") == plus(ss["kitchen"]["table"].position[2])
