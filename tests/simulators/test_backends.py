"""A simulator of two boxes, connected as the manual says: no part of it knows PyBullet."""

import inspect
import re
import sys
import types
from pathlib import Path

import numpy as np
import pytest

import ssduck
from ssduck import Interpreter, World
from ssduck.errors import ArgumentError, SceneError, UnsupportedError
from ssduck.geometry.poses import IDENTITY
from ssduck.geometry.shapes import Geometry, PlacedGeometry
from ssduck.simulators.backends import BACKENDS, Backend, drawn_shapes
from ssduck.simulators.backends import backend as backend_of
from ssduck.simulators.clock import Clock
from ssduck.simulators.interface import Body, ContactPoints, Link, LinkPoses
from ssduck.simulators.partial import PartialSimulator
from ssduck.simulators.scenes import Scene, find_scene


def cube(handle, name, mass):
    shape = PlacedGeometry(0, Geometry.primitive("box", (1, 1, 1)), np.zeros(3), IDENTITY)
    return Body(handle, name, "kinbody", mass > 0, (Link(name, -1, mass),), (), (shape,))


class TwoBoxes(PartialSimulator):
    """A box at rest, and one that falls onto it."""

    backend = "two_boxes"
    is_external = False
    timestep = 0.01
    disabled = hidden = frozenset()

    def __init__(self, height=3.0):
        self.clock = Clock(self.timestep)
        self.bodies = [cube(0, "ground", 0.0), cube(1, "box", 1.0)]
        self.heights = {0: 0.0, 1: height}
        self.speed = 0.0
        self._is_described = False

    @property
    def time(self):
        return self.clock.time

    def describe(self):
        if self._is_described:
            return None
        self._is_described = True
        return list(self.bodies), []

    def read_link_poses(self, bodies):
        states = np.zeros((len(bodies), 13))
        states[:, 2] = [self.heights[body.handle] for body in bodies]
        states[:, 3] = 1.0
        states[:, 9] = [self.speed if body.movable else 0.0 for body in bodies]
        return LinkPoses(states[:, :3], states)

    def read_joints(self, bodies):
        return np.zeros((0, 3))

    def read_contacts(self):
        return ContactPoints.none()

    def step(self, count):
        for _ in range(count):
            self.speed -= 9.81 * self.timestep
            self.heights[1] += self.speed * self.timestep
            if self.heights[1] < 1.0:
                self.heights[1], self.speed = 1.0, 0.0
        self.clock = self.clock.after(count, self.timestep)


@pytest.fixture
def backend(monkeypatch):
    """The backend of `TwoBoxes`, in a module of its own as any other."""
    module = types.ModuleType("two_boxes_backend")

    def load(scene):
        return TwoBoxes()

    def attach(client, names, kinds, shapes):
        return client

    def excerpt(source, originals, tick):
        (original,) = [one for one in originals if one.body.movable]
        return TwoBoxes(float(original.link_poses.positions[0, 2]))

    def scene_of(simulator, originals, tick, folder, target):
        raise UnsupportedError("two boxes have no scene")

    module.load, module.attach, module.excerpt, module.scene_of = load, attach, excerpt, scene_of
    monkeypatch.setitem(sys.modules, module.__name__, module)
    monkeypatch.setitem(BACKENDS, "two_boxes", module.__name__)


@pytest.mark.slow
def test_queries_ask_a_simulator_of_two_boxes(tmp_path, backend):
    world = World.load(Scene("boxes", tmp_path / "scene.toml"), simulator="two_boxes")
    with Interpreter() as ss:
        ss.add_variable("boxes", world)
        ss.add_variable("ground", world["ground"])
        apart = ss.eval("SELECT id, z FROM boxes WHERE above(ground, this) AS list;")
        assert apart == ["box", 3.0]
        assert ss.eval("SELECT id FROM boxes WHERE clearance(ground, this) == 2 AS list;") == [
            "box"
        ]
        world.run(1.0)
        assert world.time == pytest.approx(1.0)
        assert ss.eval("SELECT id FROM boxes WHERE on(ground, this) AS list;") == ["box"]
        assert ss.eval("SELECT id FROM boxes WHERE inContact(ground, this) AS list;") == []
        assert not ss.eval("SELECT id FROM boxes WHERE collides(ground, this) AS list;")
        world.simulator.heights[1] = 0.9
        world.tick()
        assert ss.eval("SELECT id FROM boxes WHERE collides(ground, this) AS list;") == ["box"]


def test_worlds_are_copied_and_saved_by_the_backend_of_their_own_simulator(tmp_path, backend):
    world = World.attach(TwoBoxes(2.5), simulator="two_boxes")
    copy = world.excerpt(["ground", "box"])
    assert copy["box"].position[2] == 2.5
    assert isinstance(copy.simulator, TwoBoxes)
    with pytest.raises(UnsupportedError, match="no scene"):
        world.save(tmp_path / "saved")


def test_a_world_of_a_simulator_without_a_backend_is_recorded(tmp_path):
    world = World(TwoBoxes(2.5))
    with Interpreter() as ss:
        ss.add_variable("boxes", world)
        world.run(0.1)
        ss.export(tmp_path / "run")
    with ssduck.open(tmp_path / "run") as record:
        assert record.eval("SELECT z FROM boxes{0.0} WHERE id = 'box' AS value;") == 2.5


def test_collision_shapes_are_drawn_where_a_backend_tells_no_others(backend):
    def visual_shapes(simulator, body):
        raise UnsupportedError("two boxes have no looks")

    backend_of("two_boxes").visual_shapes = visual_shapes
    world = World(TwoBoxes(2.5))
    body = world.simulator.bodies[1]
    (drawn,) = drawn_shapes(world.simulator, body)
    assert drawn.geometry is body.shapes[0].geometry


CHANGES = {
    "move bodies": lambda world: world["box"].move([0, 0, 2]),
    "switch collisions": lambda world: setattr(world["box"], "enabled", False),
    "show or hide": lambda world: setattr(world["box"], "visible", False),
    "connect bodies": lambda world: world["box"].hold(world["ground"]),
    "remove bodies": lambda world: world.remove("box"),
    "draw images": lambda world: world.render(10, 10),
}


@pytest.mark.parametrize("action", CHANGES)
def test_what_a_simulator_lacks_is_unsupported(action):
    world = World(TwoBoxes(1.0))
    with pytest.raises(UnsupportedError, match=f"TwoBoxes cannot {action}"):
        CHANGES[action](world)
    assert world.tick().time == 0.0


@pytest.mark.parametrize("name", BACKENDS)
def test_backends_have_the_functions_of_the_protocol(name):
    functions = [f for n, f in vars(Backend).items() if inspect.isfunction(f) and n[0] != "_"]
    assert functions
    for function in functions:
        _, *expected = inspect.signature(function).parameters
        assert list(inspect.signature(getattr(backend_of(name), function.__name__)).parameters) == (
            expected
        )


@pytest.mark.parametrize("protocol", [Backend, PartialSimulator])
def test_the_guide_names_each_function(protocol):
    guide = (Path(__file__).parents[2] / "docs/how-to/add-a-simulator.md").read_text("utf-8")
    names = [name for name, value in vars(protocol).items() if callable(value) and name[0] != "_"]
    assert len(names) >= 6
    assert [name for name in names if not re.search(rf"`{name}\b", guide)] == []


def test_a_world_is_loaded_of_a_scene_that_its_simulator_has(backend):
    with pytest.raises(ArgumentError, match=r"load: 'kitchen' is no Scene; find_scene"):
        World.load("kitchen")
    with pytest.raises(SceneError, match="there is no body 'fridge' for the sensor"):
        World.load(find_scene("kitchen"), simulator="two_boxes")
