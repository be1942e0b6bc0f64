"""Worlds that queries make: contents, errors, removal, cost, saved scenes."""

import gc
import os
import warnings
from pathlib import Path

import numpy as np
import pybullet
import pytest

import ssduck
from ssduck.errors import (
    ArgumentError,
    RemovedEntityError,
    SceneError,
    SelectScriptError,
    SimulatorError,
    UnknownNameError,
    UnsupportedError,
)
from ssduck.simulators.scenes import shipped_scenes
from tests.support.bodies import solid
from tests.support.cases import sampled
from tests.support.environments import MOTORS, constraints, dynamics, farthest, relations, state
from tests.support.urdf import collision, joint, link, robot

# Nothing that these rest on moves, and nothing else touches them.
CLOSED = ("kitchen", "sink", "toaster", "knife_block")

# What these tell depends on what else is there: on what rays meet, and on the solver.
OF_THE_REST = {
    *("isSensing", "sensingAmount", "sensingEnvIDs", "inContact", "contactForce", "force"),
    "hasContact",
    "environmentID",  # which counts entities
}


# -- what there is -------------------------------------------------------------------------------


@pytest.mark.slow
@sampled("scene", shipped_scenes(), every=3)
def test_an_excerpt_of_all_is_the_same_and_stays_so(scene):
    ss = ssduck.load(scene)
    world = ss.call_variable(scene)
    copy = ss.eval(f"SELECT obj FROM {scene} AS environment;")
    assert copy is not world
    assert [(e.name, e.kind) for e in copy] == [(e.name, e.kind) for e in world]
    assert (copy.time, copy.timestep, copy.camera) == (0.0, world.timestep, world.camera)
    assert farthest(world, copy) < 1e-12
    world.step(240)
    copy.step(240)
    assert copy.time == world.time == pytest.approx(1.0)
    assert farthest(world, copy) < 1e-6


@pytest.mark.slow
@sampled("chosen", [CLOSED, None], every=2, ids=["some", "all"])
def test_relations_agree(kitchen, chosen):
    names = [entity.name for entity in kitchen] if chosen is None else list(chosen)
    copy = kitchen.excerpt(names)
    skipped = OF_THE_REST if chosen else frozenset()
    assert relations(copy, names, skipped=skipped) == relations(kitchen, names, skipped=skipped)


@pytest.mark.slow
def test_it_holds_exactly_what_is_selected(kitchen):
    ss = ssduck.Interpreter()
    ss.add_variable("kitchen", kitchen)
    near = ss.eval(
        "roomba = SELECT obj FROM kitchen WHERE id(this) == 'roomba_625x' AS value;"
        "SELECT obj FROM kitchen WHERE distance(roomba, this) <= 1.5 AS environment;"
    )
    asked = ss.eval("SELECT id(this) FROM kitchen WHERE distance(roomba, this) <= 1.5 AS list;")
    assert [entity.name for entity in near] == asked
    assert farthest(kitchen, near, asked) < 1e-12
    assert isinstance(near["roomba_625x"], ssduck.Robot)
    assert type(near["table"]) is ssduck.KinBody


@pytest.mark.slow
def test_a_sensor_brings_its_body_and_a_body_no_sensor(kitchen):
    kitchen["fridge_webcam"].power(False)
    with_body = kitchen.excerpt(["fridge_webcam"])
    assert [entity.name for entity in with_body] == ["fridge_webcam", "fridge"]
    assert not with_body["fridge_webcam"].powered
    assert [entity.name for entity in kitchen.excerpt(["fridge"])] == ["fridge"]


def test_nothing_selected_is_an_empty_world_of_the_same_settings(client):
    pybullet.setGravity(0, 0, -1.5, client)
    pybullet.setTimeStep(0.01, client)
    pybullet.setPhysicsEngineParameter(numSolverIterations=20, physicsClientId=client)
    ss = ssduck.Interpreter()
    ss.add_variable("w", ssduck.World.attach(client))
    empty = ss.eval("SELECT obj FROM w WHERE mass(this) > 1000 AS environment;")
    assert len(empty) == 0
    assert pybullet.getPhysicsEngineParameters(
        empty.simulator.client
    ) == pybullet.getPhysicsEngineParameters(client)
    assert empty.step(3).time == pytest.approx(0.03)


@pytest.mark.slow
def test_neither_knows_of_the_other(kitchen):
    copy = kitchen.excerpt(kitchen)
    before = state(kitchen)
    copy["table"].move([5, 5, 5])
    copy["barrett_4918"].move(joints={"j1": 0.1})
    copy["can"].enabled = False
    copy["mixer"].visible = False
    copy.remove("shaker")
    copy.step(10)
    after = state(kitchen.tick())
    assert all(np.array_equal(after[name], before[name]) for name in before)
    kitchen.close()
    assert copy.step(1).time == pytest.approx(11 / 240)
    with pytest.raises(SimulatorError, match="closed"):
        kitchen.step(1)


@pytest.mark.slow
def test_what_was_switched_off_is_so_there(kitchen):
    kitchen["can"].enabled = False
    kitchen["mixer"].visible = False
    copy = kitchen.excerpt(["can", "mixer", "kitchen"])
    assert {e.name: (e.enabled, e.visible) for e in copy} == {
        "can": (False, True),
        "mixer": (True, False),
        "kitchen": (True, True),
    }
    copy["mixer"].visible = True
    third = copy.excerpt(copy)
    assert {e.name: (e.enabled, e.visible) for e in third} == {
        "can": (False, True),
        "mixer": (True, True),
        "kitchen": (True, True),
    }


@pytest.mark.slow
def test_motors_hold_where_they_do(kitchen):
    """Not where joints happen to be: the arm sags under its weight."""
    kitchen.step(240)
    copy = kitchen.excerpt(["barrett_4918"])
    held = {kitchen.simulator.loaded.motor_positions[handle].__repr__() for handle in (2,)}
    assert held == {repr(positions) for positions in copy.simulator.loaded.motor_positions.values()}
    copy["barrett_4918"].move(joints={"j1": 0.1})
    again = copy.excerpt(copy)
    (held,) = again.simulator.loaded.motor_positions.values()
    assert 0.1 in held.values()


# -- errors --------------------------------------------------------------------------------------


@pytest.mark.slow
def test_entities_of_other_worlds_and_ticks(kitchen, client, recorded):
    ss, _ = recorded
    other = ssduck.World.attach(client, name="other")
    with pytest.raises(ArgumentError, match="in world 'kitchen', not in 'other'"):
        other.excerpt([kitchen["table"]])
    with pytest.raises(UnknownNameError, match="did you mean 'table'"):
        kitchen.excerpt(["tabel"])
    with pytest.raises(SelectScriptError, match="several ticks"):
        ss.eval("SELECT obj FROM kitchen{-0.5} AS environment;")
    with pytest.raises(SelectScriptError, match="no column holds an entity"):
        ss.eval("SELECT x(this) FROM kitchen AS environment;")
    copy = kitchen.excerpt(["table", "can"])
    can = copy["can"]
    copy.remove(can)
    with pytest.raises(RemovedEntityError):
        copy.excerpt([can])


@pytest.mark.slow
def test_entities_of_two_worlds(kitchen):
    ss = ssduck.Interpreter()
    ss.add_variable("kitchen", kitchen)
    ss.add_variable("other", kitchen.excerpt(["table"]))
    with pytest.raises(SelectScriptError, match="entities of one world"):
        ss.eval("SELECT obj(a.this), obj(b.this) FROM a = kitchen, b = other AS environment;")


# -- removing, OpenRAVE's names ------------------------------------------------------------------


@pytest.mark.slow
def test_copies_after_a_removal(tmp_path):
    """Removing a body changes PyBullet's order of the others, by which it restores states."""
    text = "".join(
        f'[[body]]\nname = "{name}"\nbox = [1, 1, 1]\nposition = [{3 * number}, 0, 2]\n'
        for number, name in enumerate("abcd")
    )
    (tmp_path / "boxes.toml").write_text(text)
    with ssduck.load(tmp_path / "boxes.toml") as ss:
        world = ss.call_variable("boxes")
        world.remove("a")
        world.step(10)
        positions = {entity.name: entity.position for entity in world}
        assert {entity.name: entity.position for entity in world.excerpt(world)} == positions
        world.save(tmp_path / "later")
    with ssduck.load(tmp_path / "later") as ss:
        saved = {entity.name: entity.position for entity in ss.call_variable("boxes")}
    assert saved == positions


@pytest.mark.slow
def test_removing(kitchen, client):
    copy = kitchen.excerpt(kitchen)
    copy.remove("fridge_webcam")
    copy.remove(copy["roomba_625x"])
    gone = {"fridge_webcam", "roomba_625x", *(e.name for e in kitchen if "roomba" in e.name)}
    assert [e.name for e in copy] == [e.name for e in kitchen if e.name not in gone]
    again = copy.excerpt(copy)
    assert [e.name for e in again] == [e.name for e in copy]
    number = solid(client, pybullet.GEOM_SPHERE, 1, radius=0.1)
    theirs = ssduck.World.attach(client, names={number: "ball"})
    with pytest.raises(UnsupportedError, match="client of yours"):
        theirs.remove("ball")
    with pytest.raises(UnsupportedError, match="what-if"):
        kitchen.what_if().remove("can")


@pytest.mark.slow
def test_cloning_nothing(kitchen):
    assert len(kitchen.CloneSelf(8)) == 0
    clone = kitchen.CloneSelf(1)
    assert len(clone) == len(kitchen)
    clone.Destroy()
    with pytest.raises(SimulatorError):
        clone.step()


# -- what they take ------------------------------------------------------------------------------


def memory():
    pages = Path("/proc/self/statm").read_text(encoding="ascii").split()[1]
    return int(pages) * os.sysconf("SC_PAGE_SIZE") / 1e6


def connected():
    return sum(map(pybullet.isConnected, range(1024)))


@pytest.mark.long
def test_closed_worlds_and_forgotten_ones_give_all_back(kitchen):
    chosen = ["kitchen", "table", "cup_905a", "roomba_625x"]
    gc.collect()  # what other tests have left
    before = connected()
    for number in range(60):
        copy = kitchen.excerpt(chosen)
        assert connected() <= before + 1
        if number % 2:
            copy.close()
        del copy
        if number == 10:
            gc.collect()
            first = memory()
    assert connected() == before
    gc.collect()
    assert memory() - first < 100  # a client takes some ten: 50 of them would be more


@pytest.mark.long
def test_worlds_in_circles_make_room(kitchen, monkeypatch):
    """What waits for the collector holds a client; there are so many only."""
    copy = kitchen.excerpt(["table"])
    copy.myself = copy
    used = copy.simulator.client
    del copy
    assert pybullet.isConnected(used)
    real, answers = pybullet.connect, iter([-1])
    monkeypatch.setattr(pybullet, "connect", lambda mode: next(answers, None) or real(mode))
    kitchen.excerpt(["table"])
    assert not pybullet.isConnected(used) or used == connected()
    monkeypatch.setattr(pybullet, "connect", lambda _: -1)
    with pytest.raises(SimulatorError, match="could not make another client"):
        kitchen.excerpt(["table"])


# -- scenes --------------------------------------------------------------------------------------


@pytest.mark.slow
@sampled("steps", [0, 120], every=2)
def test_a_saved_kitchen_is_the_same(kitchen, tmp_path, steps):
    kitchen.step(steps)
    kitchen["can"].enabled = False
    kitchen["mixer"].visible = False
    kitchen["fridge_webcam"].power(False)
    file = kitchen.save(tmp_path / "saved")
    assert file == tmp_path / "saved" / "scene.toml"
    assert "\neye = [3.55, -4.1, 3.45]\n" in file.read_text(encoding="utf-8")
    loaded = ssduck.load(tmp_path / "saved").call_variable("kitchen")
    assert loaded.time == pytest.approx(kitchen.time)
    assert loaded.camera == kitchen.camera
    assert [(e.name, e.kind) for e in loaded] == [(e.name, e.kind) for e in kitchen]
    assert farthest(kitchen, loaded) < 1e-12
    specs = [[e.spec for e in world if e.kind == "sensor"] for world in (kitchen, loaded)]
    assert [s.name for s in specs[0]] == [s.name for s in specs[1]]
    assert not loaded["fridge_webcam"].powered
    ours, theirs = loaded.simulator.loaded.motor_positions, kitchen.simulator.loaded.motor_positions
    assert list(ours.values()) == list(theirs.values())
    again = ssduck.load(loaded.save(tmp_path / "again")).worlds[0]
    assert farthest(loaded, again) < 1e-12


@pytest.mark.slow
def test_saved_bodies_of_others(menagerie, tmp_path):
    menagerie.step(100)
    with pytest.warns(UserWarning, match=MOTORS):
        menagerie.save(tmp_path / "saved")
    with pytest.warns(UserWarning, match=MOTORS):
        copy = menagerie.excerpt(menagerie)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        loaded = ssduck.load(tmp_path / "saved").worlds[0]
    assert farthest(menagerie, loaded) < 1e-6
    assert dynamics(loaded) == dynamics(menagerie)
    assert constraints(loaded) == constraints(menagerie)
    copy.step(20)
    loaded.step(20)
    first, second = state(copy), state(loaded)
    for name in ("ground", "arm", "first", "second"):  # which touch nothing
        assert first[name] == pytest.approx(second[name], abs=1e-6)


@pytest.mark.slow
def test_saved_names_are_made_fit(client, write, tmp_path):
    """Of links and joints without names, of several of one name, of odd ones."""
    text = robot(
        link("a", shapes=collision('<sphere radius="0.1"/>')),
        link("b"),
        joint("j", "revolute", "a", "b", limit='<limit lower="-1" upper="1" effort="5"/>'),
        name='rob\u00f6ter "x"',
    ).replace('"rob\u00f6ter "x""', "'rob\u00f6ter \"x\"'")
    number = pybullet.loadURDF(str(write("r.urdf", text)), physicsClientId=client)
    pybullet.resetJointState(number, 0, 0.25, physicsClientId=client)
    names = {number: 'odd "name" \\ \t/..'}
    world = ssduck.World.attach(client, names=names, name='the "world"; 2')
    world.add_sensor("range_finder", 'odd "name" \\ \t/..', "eye", "b", max_range=2.0)
    with pytest.warns(UserWarning, match="the motors are not known"):
        world.save(tmp_path / "saved")
    loaded = ssduck.load(tmp_path / "saved").worlds[0]
    assert loaded.name == "the__world___2"  # a variable
    assert farthest(world, loaded) < 1e-12
    assert loaded['odd "name" \\ \t/..'].joints[0].upper == 1.0


@pytest.mark.slow
def test_a_joint_beyond_its_limit_is_saved_where_it_is(client, write, tmp_path):
    """Solvers leave joints there."""
    text = robot(
        link("a", mass=0, shapes=collision('<sphere radius="0.1"/>')),
        link("b"),
        joint("j", "revolute", "a", "b", limit='<limit lower="-1" upper="1" effort="5"/>'),
    )
    number = pybullet.loadURDF(str(write("r.urdf", text)), physicsClientId=client)
    pybullet.resetJointState(number, 0, 1.0009, physicsClientId=client)
    world = ssduck.World.attach(client)
    with pytest.warns(UserWarning, match="the motors are not known"):
        world.save(tmp_path / "saved")
    assert ssduck.load(tmp_path / "saved").worlds[0]["model"].joints[0].position == 1.0009


def test_nothing_is_saved_over(kitchen, tmp_path):
    (tmp_path / "mine").write_text("mine", encoding="utf-8")
    with pytest.raises(
        SceneError, match=r"^\S+ is not empty: a scene is saved into a folder of its own$"
    ):
        kitchen.save(tmp_path)
    with pytest.raises(SceneError, match="mine"):
        kitchen.save(tmp_path / "mine")
    assert [file.name for file in tmp_path.iterdir()] == ["mine"]


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["new", "empty", "link"])
def test_half_a_scene_is_not_left(kitchen, tmp_path, monkeypatch, kind):
    folder = tmp_path / "scene"
    if kind == "empty":
        folder.mkdir()
    if kind == "link":
        (tmp_path / "place").mkdir()
        folder.symlink_to(tmp_path / "place")

    def fails(scene, folder):
        assert any(folder.rglob("*"))
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("ssduck.world.copies.write_scene", fails)
    with pytest.raises(SceneError, match="scene: No space left on device"):
        kitchen.save(folder)
    assert folder.exists() == (kind != "new")
    assert not list(folder.rglob("*"))
