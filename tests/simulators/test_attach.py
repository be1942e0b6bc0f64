"""A client that the user made and goes on using: bodies come, go and move behind ssduck's back."""

import gc
import warnings

import pybullet
import pybullet_data
import pytest
from pybullet_utils.bullet_client import BulletClient

import ssduck
from ssduck.errors import ArgumentError, RemovedEntityError, SelectScriptError, SimulatorError
from ssduck.simulators.pybullet.simulator import PyBulletSimulator
from ssduck.simulators.scenes import SensorSpec, find_scene
from tests.support.bodies import solid
from tests.support.cases import sampled


@pytest.fixture
def make(client):
    """Makes a box in the client."""
    shape = pybullet.createCollisionShape(
        pybullet.GEOM_BOX, halfExtents=[0.1] * 3, physicsClientId=client
    )

    def made(position=(0, 0, 0), mass=1.0):
        return pybullet.createMultiBody(mass, shape, basePosition=position, physicsClientId=client)

    return made


def test_names_and_kinds_are_the_users_or_the_models(client, make, write):
    urdf = '<robot name="cube"><link name="l"/></robot>'
    path = str(write("cube.urdf", urdf))
    first = pybullet.loadURDF(path, physicsClientId=client)
    pybullet.loadURDF(path, physicsClientId=client)
    named, plain = make(), make()
    world = ssduck.World.attach(
        client, names={named: "mine", first: "cube"}, kinds={named: "robot"}
    )
    assert [entity.name for entity in world] == ["cube", "cube_2", "mine", f"body_{plain}"]
    assert world["mine"].kind == "robot"
    assert world["cube_2"].kind == "kinbody"


# (the name in the model file, the name of the body)
MODEL_NAMES = [
    ("cube", "cube"),
    ("cube.urdf", "cube"),
    ("TABLE.URDF", "TABLE"),
    ("Amazon Pod", "Amazon_Pod"),
    ("roboschool/models_outdoor/part0.obj", "part0"),
    ("C:\\models\\part1.obj", "part1"),
    ("arm/left", "arm_left"),
    ("robot_v1.2", "robot_v1_2"),
    ("a - b", "a_b"),
    ("(crate)", "crate"),
    ("_hidden__", "_hidden__"),
    ("2nd", "body_2nd"),
    ("Küche", "Küche"),
    ("!?", "body_0"),
    (".urdf", "body_0"),
    ("x.urdf.urdf", "x_urdf"),
]


@sampled(("model", "name"), MODEL_NAMES, every=4)
def test_the_name_of_a_body_is_its_models_as_an_identifier(client, write, model, name):
    urdf = f'<robot name="{model}"><link name="l"/></robot>'
    pybullet.loadURDF(str(write("model.urdf", urdf)), physicsClientId=client)
    with ssduck.Interpreter() as ss:
        ss.add_variable("sim", ssduck.World.attach(client))
        assert ss.eval(f"sim.{name} == sim.{name};")
        assert ss.eval(f"SELECT id FROM sim WHERE this == sim.{name} AS list;") == [name]


def test_names_of_pybullets_own_models(client):
    pybullet.setAdditionalSearchPath(pybullet_data.getDataPath(), physicsClientId=client)
    for file in (
        "plane.urdf",
        "table/table.urdf",
        "cube.urdf",
        "lego/lego.urdf",
        "duck_vhacd.urdf",
    ):
        pybullet.loadURDF(file, physicsClientId=client)
    pybullet.loadSDF("kiva_shelf/model.sdf", physicsClientId=client)
    models = [pybullet.getBodyInfo(body, client)[1] for body in range(6)]
    assert models == [b"plane", b"table.urdf", b"cube", b"cube.urdf", b"cube.urdf", b"Amazon Pod"]
    names = ["plane", "table", "cube", "lego", "duck", "Amazon_Pod"]
    assert [entity.name for entity in ssduck.World.attach(client)] == names
    world = ssduck.World.attach(client, names={3: "cube", 4: "rubber duck"})
    names = ["plane", "table", "cube_2", "cube", "rubber duck", "Amazon_Pod"]
    assert [entity.name for entity in world] == names  # the user's names are as they are


@pytest.mark.parametrize(
    ("files", "names"),
    [
        (["duck_vhacd.urdf"], ["duck"]),  # its model is cube.urdf
        (["soccerball.urdf", "sphere_1cm.urdf"], ["soccerball", "urdf_robot"]),  # one has no mesh
        (["cube.urdf", "domino/domino.urdf"], ["cube", "domino"]),  # two meshes, both called cube
        (["domino/domino.urdf"], ["cube"]),
        (["tray/traybox.urdf"], ["tabletop"]),
        (["cube.urdf", "cube.urdf", "cube_small.urdf"], ["cube", "cube_2", "cube_3"]),
        (["plane.urdf", "plane_transparent.urdf"], ["plane", "plane_2"]),
        (["random_urdfs/000/000.urdf"], ["blob000"]),
    ],
)
def test_a_mesh_names_a_body_whose_models_name_is_a_leftover(client, files, names):
    pybullet.setAdditionalSearchPath(pybullet_data.getDataPath(), physicsClientId=client)
    for file in files:
        pybullet.loadURDF(file, physicsClientId=client)
    assert [entity.name for entity in ssduck.World.attach(client)] == names


def test_a_body_that_comes_later_takes_no_name_of_another_model(client):
    pybullet.setAdditionalSearchPath(pybullet_data.getDataPath(), physicsClientId=client)
    pybullet.loadURDF("domino/domino.urdf", physicsClientId=client)
    world = ssduck.World.attach(client)
    pybullet.loadURDF("cloth_z_up.urdf", physicsClientId=client)
    world.tick(steps=0)
    assert [entity.name for entity in world] == ["cube", "cloth_z_up"]
    assert repr(world) == "<World 'world': 2 entities (2 kinbodies: cube, cloth_z_up), t=0 s>"


def test_an_empty_client_is_an_empty_world(client, make):
    world = ssduck.World.attach(client)
    assert len(world) == 0
    with ssduck.Interpreter() as ss:
        ss.add_variable("sim", world)
        assert ss.eval("SELECT id FROM sim;") == []
        make()
        world.tick()
        assert len(ss.eval("SELECT id FROM sim;")) == 1


def test_a_body_that_took_the_number_of_another(client, make):
    """PyBullet gives numbers again at once; an equal box in the same place is another body."""
    body = make((0, 0, 1))
    world = ssduck.World.attach(client, names={body: "box"})
    old = world["box"]
    pybullet.removeBody(body, client)
    assert make((0, 0, 1)) == body
    world.tick()
    (new,) = world
    assert new.id != old.id
    assert new != old
    for act in (lambda: old.position, lambda: old.links, lambda: old.move([0, 0, 0])):
        with pytest.raises(RemovedEntityError, match="'box' is no longer in world"):
            act()
    assert old.name == "box"


@pytest.mark.parametrize("mass", [0.0, 1.0])
def test_bodies_that_are_moved_behind_our_back(client, make, mass):
    """Even those that cannot move by themselves."""
    body = make((0, 0, 0), mass)
    world = ssduck.World.attach(client, names={body: "it"})
    pybullet.resetBasePositionAndOrientation(body, [3, 2, 1], [0, 0, 0, 1], client)
    assert world["it"].position == pytest.approx([0, 0, 0])
    world.tick()
    assert world["it"].position == pytest.approx([3, 2, 1])
    assert world["it"].aabb[0] == pytest.approx([2.9, 1.9, 0.9])


def test_two_worlds_on_one_client(client, make):
    body = make()
    worlds = [ssduck.World.attach(client, names={body: name}) for name in ("one", "other")]
    second = make((1, 0, 0))
    for world, name in zip(worlds, ("one", "other"), strict=True):
        assert len(world) == 1  # until the next tick
        world.tick()
        assert [entity.name for entity in world] == [name, f"body_{second}"]
        assert world[f"body_{second}"].position == pytest.approx([1, 0, 0])
    pybullet.removeBody(body, client)
    for world in worlds:
        world.tick()
        assert len(world) == 1


def test_a_client_object_will_do():
    client = BulletClient(pybullet.DIRECT)
    client.createMultiBody()
    assert len(ssduck.World.attach(client)) == 1
    client.disconnect()


@pytest.mark.parametrize("client", [99, "no client", None, "disconnected"])
def test_what_is_no_client(client):
    client = next_number() if client == "disconnected" else client
    with pytest.raises(SimulatorError, match="no connected PyBullet client"):
        ssduck.World.attach(client)


@pytest.mark.parametrize(
    ("arguments", "error", "said"),
    [
        ({"names": {7: "x"}}, SelectScriptError, "no body 7"),
        ({"kinds": {7: "robot"}}, SelectScriptError, "no body 7"),
        ({"names": {0: "box", 1: "ball", 2: "box"}}, ArgumentError, "box"),
        *(
            ({"kinds": {0: kind}}, SelectScriptError, "neither 'robot' nor 'kinbody'")
            for kind in ("sensor", "Robot", "", None)
        ),
    ],
)
def test_names_and_kinds_that_bodies_cannot_have(client, make, arguments, error, said):
    for _ in range(3):
        make()
    with pytest.raises(error, match=said):
        ssduck.World.attach(client, **arguments)


def test_names_are_made_unique_whatever_they_end_in(client, tmp_path):
    for number, name in enumerate(("box", "box_2", "box", "box", "box_2")):
        file = tmp_path / f"{number}.urdf"
        file.write_text(f'<robot name="{name}"><link name="base"/></robot>')
        pybullet.loadURDF(str(file), physicsClientId=client)
    world = ssduck.World.attach(client)
    assert [e.name for e in world] == ["box", "box_2", "box_3", "box_4", "box_2_2"]


def test_the_order_of_bodies_is_that_of_their_coming(client, make):
    first, second, _ = make(), make(), make()
    world = ssduck.World.attach(client)
    ids = [e.id for e in world]
    pybullet.removeBody(first, client)
    pybullet.removeBody(second, client)
    again = {make((1, 0, 0)), make((2, 0, 0))}
    assert again == {first, second}
    world.tick()
    assert [e.id for e in world] == [ids[2], 4, 5]


def test_equal_bodies_after_a_reset_are_new_ones(client, make):
    make()
    world = ssduck.World.attach(client)
    (old,) = world
    pybullet.resetSimulation(physicsClientId=client)
    assert len(world.tick()) == 0
    solid(client, pybullet.GEOM_BOX, 1.0, halfExtents=[0.1] * 3)
    pybullet.addUserData(0, "someone's", "1", physicsClientId=client)
    (new,) = world.tick()
    assert new.id == old.id + 1


def test_a_world_leaves_nothing_behind_in_the_users_client(client, make):
    body = make()
    pybullet.addUserData(body, "mine", "1", physicsClientId=client)
    world = ssduck.World.attach(client)
    assert pybullet.getNumUserData(body, client) == 2
    world.close()
    assert pybullet.getNumUserData(body, client) == 1
    with pytest.raises(SimulatorError, match="the world is closed"):
        world.tick()
    assert len(ssduck.World.attach(client)) == 1


def test_many_steps_do_not_add_up_errors(client):
    assert ssduck.World.attach(client).step(24_000).time == 100.0


# -- clients whose numbers PyBullet gives again -----------------------------------------------------


def next_number():
    """The number of the next client."""
    number = pybullet.connect(pybullet.DIRECT)
    pybullet.disconnect(number)
    return number


@pytest.mark.slow
def test_a_closed_world_does_not_close_the_next_one():
    first = ssduck.World.load(find_scene("kitchen"))
    first.close()
    second = ssduck.World.load(find_scene("kitchen"))
    assert second.simulator.client == first.simulator.client
    first.close()
    for act in (first.tick, first.step, first.render):
        with pytest.raises(SimulatorError, match="the world is closed"):
            act()
    del first
    gc.collect()
    assert len(second.step()) == 37
    second.close()


def test_a_lost_client_stays_lost():
    """The next client of its number is none of the world's."""
    number = pybullet.connect(pybullet.DIRECT)
    world = ssduck.World.attach(number)
    pybullet.disconnect(number)
    with pytest.raises(SimulatorError, match=f"PyBullet client {number} is disconnected"):
        world.tick()
    assert pybullet.connect(pybullet.DIRECT) == number
    with pytest.raises(SimulatorError, match=f"PyBullet client {number} is disconnected"):
        world.step()
    world.close()
    assert pybullet.isConnected(number)
    pybullet.disconnect(number)


@pytest.mark.slow
def test_the_record_of_a_lost_client_is_written(tmp_path):
    number = pybullet.connect(pybullet.DIRECT)
    body = solid(number, pybullet.GEOM_SPHERE, 1, [0, 0, 2], radius=0.1)
    with ssduck.Interpreter() as ss:
        world = ss.add_variable("sim", ssduck.World.attach(number, names={body: "ball"}))
        world.step(3)
        z = pybullet.getBasePositionAndOrientation(body, number)[0][2]
        pybullet.disconnect(number)
        with pytest.warns(UserWarning, match=r"is disconnected: collision shapes stand in"):
            ss.export(tmp_path / "run")
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            ss.export(tmp_path / "run")
        with pytest.raises(SimulatorError, match=f"PyBullet client {number} is disconnected"):
            world.save(tmp_path / "scene")
        with pytest.raises(SimulatorError, match=f"PyBullet client {number} is disconnected"):
            ssduck.simulators.backends.backend("pybullet").visual_shapes(
                world.simulator, world["ball"].info.body
            )
    with ssduck.open(tmp_path / "run") as record:
        assert record.eval("SELECT z FROM sim AS value;") == z


@pytest.mark.slow
def test_a_world_that_nobody_holds_frees_its_client():
    number = next_number()
    world = ssduck.World.load(find_scene("kitchen"))
    cup = world["cup_905a"]
    del world
    gc.collect()
    assert next_number() > number  # the handle holds it
    assert cup.position[2] > 0
    del cup
    gc.collect()
    assert next_number() == number


# -- sensors on bodies that go ------------------------------------------------------------------------


def test_the_sensors_of_a_removed_body_go_with_it(client, make):
    carrier, other = make(), make()
    specs = [
        SensorSpec(
            f"eye_{body}", f"body_{body}", None, "range_finder", (0, 0, 1), (1, 0, 0, 0), 0, 1, {}
        )
        for body in (carrier, other)
    ]
    world = ssduck.World(PyBulletSimulator(client, owned=False), sensors=specs)
    assert [e.name for e in world] == ["eye_0", "eye_1", "body_0", "body_1"]
    assert [e.id for e in world] == [1, 2, 3, 4]
    eye = world["eye_0"]
    pybullet.removeBody(carrier, client)
    assert [e.name for e in world.tick()] == ["eye_1", "body_1"]
    assert world["eye_1"].position == pytest.approx([0, 0, 1])
    with pytest.raises(RemovedEntityError, match="'eye_0'"):
        eye.position  # noqa: B018


def test_bodies_that_the_list_of_the_client_lacks(client):
    """`batchPositions` makes bodies of which the list gets the last one; holes are filled first."""
    shape = pybullet.createCollisionShape(pybullet.GEOM_SPHERE, radius=0.1, physicsClientId=client)

    def make(places):
        return pybullet.createMultiBody(1, shape, batchPositions=places, physicsClientId=client)

    def seen():
        return sorted(entity.position[0] for entity in world.tick(steps=0))

    places = [[n, 0, 0] for n in range(4)]
    handles = make(places)
    pybullet.addUserData(handles[0], "mine", "1", physicsClientId=client)
    world = ssduck.World.attach(client, names={handles[1]: "second"})
    assert seen() == [0, 1, 2, 3]
    assert world["second"].position[0] == 1
    assert pybullet.getUserDataId(handles[0], "mine", physicsClientId=client) >= 0
    for handle in handles[1:3]:
        pybullet.removeBody(handle, client)
    assert seen() == [0, 3]
    make([[n, 0, 0] for n in range(5, 9)])
    assert seen() == [0, 3, 5, 6, 7, 8]


@pytest.mark.slow
def test_contacts_of_a_body_that_the_list_still_lacks():
    """They are of no entity at the tick that meets the body first, and then of this body."""
    mine = pybullet.connect(pybullet.DIRECT)
    shape = pybullet.createCollisionShape(pybullet.GEOM_SPHERE, radius=0.1, physicsClientId=mine)
    first = pybullet.createMultiBody(1, shape, physicsClientId=mine)
    world = ssduck.World.attach(mine)
    pybullet.createMultiBody(
        1, shape, batchPositions=[[0, 0, 0.15], [0, 0, 9]], physicsClientId=mine
    )
    pybullet.removeBody(2, mine)  # what the list has; body 1 remains
    with ssduck.Interpreter() as ss:
        ss.add_variable("sim", world)
        pybullet.stepSimulation(mine)
        rows = []
        for _ in range(2):
            world.tick()
            rows.append(ss.sql("SELECT a, b FROM sim.contacts").fetchall())
        ids = sorted(entity.id for entity in world)
        assert rows == [[], [tuple(ids)]]
        assert first == 0
    pybullet.disconnect(mine)
