"""Primitives and the floor of scene files, compared with bodies that PyBullet is told to make."""

import pybullet
import pytest

import ssduck
from ssduck.errors import SceneError
from ssduck.simulators.scene_bodies import Material, Primitive
from ssduck.simulators.scenes import find_scene, read_scene
from tests.support.bodies import client_of
from tests.support.cases import sampled

HALF_TURN = 0.7071067811865476
# (keys of the body, PyBullet's arguments of the collision shape, mass)
BODIES = {
    "crate": ("box = [0.4, 0.2, 0.3]\nmass = 2", {"halfExtents": [0.2, 0.1, 0.15]}, 2.0),
    "ball": ("sphere = 0.15\nmass = 0.5", {"radius": 0.15}, 0.5),
    "can": ("cylinder = [0.1, 0.3]", {"radius": 0.1, "height": 0.3}, 1.0),
    "pill": ("capsule = [0.1, 0.3]\nmass = 3", {"radius": 0.1, "height": 0.3}, 3.0),
    "wall": ("box = [2, 0.1, 0.6]\nfixed = true", {"halfExtents": [1, 0.05, 0.3]}, 0.0),
    "slope": ("plane = [0, 3, 4]", {"planeNormal": [0, 0.6, 0.8]}, 0.0),
}
SHAPES = {
    "box": pybullet.GEOM_BOX,
    "sphere": pybullet.GEOM_SPHERE,
    "cylinder": pybullet.GEOM_CYLINDER,
    "capsule": pybullet.GEOM_CAPSULE,
    "plane": pybullet.GEOM_PLANE,
}
POSE = f"position = [1, 2, 3]\norientation = [{HALF_TURN}, {HALF_TURN}, 0, 0]\n"
STACK = """
floor = true
[[body]]
name = "crate"
box = [0.4, 0.4, 0.4]
position = [0, 0, 0.2]
colour = [0.8, 0.2, 0.2]
[[body]]
name = "ball"
sphere = 0.1
position = [0, 0, 0.5]
friction = 0.9
rolling_friction = 0.01
spinning_friction = 0.02
restitution = 0.25
colour = [0, 0.5, 1, 0.5]
velocity = [0, 0, 0, 0, 0, 3]
"""


@pytest.mark.slow
@sampled("name", BODIES, every=2)
def test_a_primitive_is_what_pybullet_makes(load, client, name):
    keys, arguments, mass = BODIES[name]
    kind = keys.split(" ", 1)[0]
    ss, world = load(f'[[body]]\nname = "{name}"\n{keys}\n{POSE}')
    shape = pybullet.createCollisionShape(SHAPES[kind], physicsClientId=client, **arguments)
    turn = [HALF_TURN, 0, 0, HALF_TURN]
    body = pybullet.createMultiBody(mass, shape, -1, [1, 2, 3], turn, physicsClientId=client)
    own = client_of(world)
    for get in (
        lambda c: pybullet.getBasePositionAndOrientation(body, c),
        lambda c: pybullet.getAABB(body, -1, c),
        lambda c: pybullet.getDynamicsInfo(body, -1, c)[:10],
        lambda c: pybullet.getCollisionShapeData(body, -1, c)[0][2:],
    ):
        assert get(own) == get(client)
    entity = world[name]
    assert entity.mass == mass
    assert entity.kind == "kinbody"
    ((type, exact),) = ss.sql(
        "SELECT type, exact FROM shapes JOIN geometries ON shapes.geometry = geometries.id"
    ).fetchall()
    assert (type, exact) == (kind, True)
    if kind != "plane":
        low, high = entity.aabb
        theirs = pybullet.getAABB(body, -1, client)
        assert low == pytest.approx(theirs[0], abs=2.1e-3)  # PyBullet's boxes are padded
        assert high == pytest.approx(theirs[1], abs=2.1e-3)


def test_material_and_velocity_arrive_in_pybullet(load):
    _, world = load(STACK)
    own = client_of(world)
    floor, crate, ball = range(3)
    info = pybullet.getDynamicsInfo(ball, -1, own)
    assert (info[1], info[6], info[7], info[5]) == (0.9, 0.01, 0.02, 0.25)
    info = pybullet.getDynamicsInfo(crate, -1, own)
    assert (info[1], info[6], info[7], info[5]) == (0.5, 0.0, 0.0, 0.0)
    assert pybullet.getBaseVelocity(ball, own) == ((0, 0, 0), (0, 0, 3))
    colours = [pybullet.getVisualShapeData(body, physicsClientId=own)[0][7] for body in range(3)]
    assert colours[floor] == pytest.approx((0.7, 0.7, 0.7, 1), abs=1e-6)
    assert colours[crate] == pytest.approx((0.8, 0.2, 0.2, 1), abs=1e-6)
    assert colours[ball] == pytest.approx((0, 0.5, 1, 0.5), abs=1e-6)


@pytest.mark.slow
def test_bodies_rest_on_the_floor(load):
    ss, world = load(STACK + '[[body]]\nname = "low"\nbox = [1, 1, 0.1]\nposition = [3, 0, 1]\n')
    assert world["floor"].position == [0, 0, 0]
    world.step(480)
    assert world["crate"].position == pytest.approx([0, 0, 0.2], abs=2e-3)
    assert world["low"].position == pytest.approx([3, 0, 0.05], abs=2e-3)
    query = "SELECT id FROM room WHERE touching(room.floor, this) AS list;"
    assert sorted(ss.eval(query)) == ["crate", "low"]
    assert ss.eval("inContact(room.floor, room.low);")


@pytest.mark.slow
def test_the_table_of_the_floor(load):
    _, world = load(
        "[floor]\nheight = -0.5\nfriction = 0.2\nrestitution = 1\ncolour = [0, 1, 0]\n"
        '[[body]]\nname = "box"\nbox = [1, 1, 1]\n'
    )
    assert [entity.name for entity in world] == ["floor", "box"]
    assert world["floor"].position == [0, 0, -0.5]
    own = client_of(world)
    info = pybullet.getDynamicsInfo(0, -1, own)
    assert (info[0], info[1], info[5]) == (0.0, 0.2, 1.0)
    assert pybullet.getVisualShapeData(0, physicsClientId=own)[0][7] == (0, 1, 0, 1)
    assert world.step(240)["box"].aabb[0][2] == pytest.approx(-0.5, abs=2e-3)


@pytest.mark.slow
@pytest.mark.parametrize(("floor", "height"), [(0.0, 0.1), (1.0, 0.33)])
def test_restitution_takes_both_bodies(load, floor, height):
    """From 1 m above the floor, a ball of restitution 0.5 bounces to about a quarter of that."""
    _, world = load(
        f'[floor]\nrestitution = {floor}\n[[body]]\nname = "ball"\nsphere = 0.1\n'
        "restitution = 0.5\nposition = [0, 0, 1.1]\n"
    )
    world.run(0.5)  # it meets the floor after 0.45 s
    heights = [world.step(4)["ball"].position[2] for _ in range(25)]
    assert max(heights) == pytest.approx(height, abs=0.04)


@pytest.mark.slow
def test_without_a_floor_bodies_fall(load):
    for text in ("", "floor = false\n"):
        _, world = load(text + '[[body]]\nname = "box"\nbox = [1, 1, 1]\n')
        assert len(world) == 1
        assert world.step(240)["box"].position[2] < -4


def test_a_floor_is_drawn(load):
    _, world = load('[floor]\ncolour = [0, 1, 0]\n[[body]]\nname = "b"\nbox = [0.1, 0.1, 0.1]\n')
    picture = world.render(width=64, height=48).astype(int)
    red, green, blue = picture[40, 32]  # below the horizon
    assert green > red + 50
    assert green > blue + 50


@pytest.mark.slow
def test_a_saved_primitive_is_read_back(load, tmp_path):
    _, world = load(STACK)
    world.step(60)
    world.save(tmp_path / "saved")
    text = (tmp_path / "saved" / "scene.toml").read_text(encoding="utf-8")
    assert "urdf" not in text
    before, after = find_scene(tmp_path / "room.toml"), read_scene(tmp_path / "saved/scene.toml")
    assert [after.bodies[0].model, *(b.model for b in after.bodies[1:])] == [
        before.floor.model,
        *(body.model for body in before.bodies),
    ]
    with ssduck.load(tmp_path / "saved") as copy:
        again = copy.call_variable("room")
        names = [entity.name for entity in world]
        for entity in world:
            other = again[entity.name]
            assert (other.kind, other.mass) == (entity.kind, entity.mass)
            assert other.pose == pytest.approx(entity.pose, abs=1e-15)
            assert other.velocity == pytest.approx(entity.velocity, abs=1e-15)
            number = names.index(entity.name)
            ours, theirs = (
                pybullet.getDynamicsInfo(number, -1, client_of(one))[:10] for one in (world, again)
            )
            assert ours == theirs


@pytest.mark.slow
def test_an_excerpt_of_primitives_goes_on_as_the_original(load):
    ss, world = load(STACK)
    world.step(30)
    copy = ss.eval("SELECT this FROM room AS environment;")
    for one, other in zip(world.step(100), copy.step(100), strict=True):
        assert other.name == one.name
        assert other.pose == pytest.approx(one.pose, abs=1e-3)  # it finds its contacts anew


BODY = '[[body]]\nname = "a"\n'
BOX = BODY + "box = [1, 1, 1]\n"
# (text, key, words of the reason, nearest right names)
MISTAKES = [
    (BODY, "body[0].urdf", "missing; a body has one of urdf, sdf, mjcf, box, sphere", ()),
    (BODY + "boxs = [1, 1, 1]", "body[0].boxs", "there is no such key", ("box",)),
    (BODY + "Sphere = 1", "body[0].Sphere", "there is no such key", ("sphere",)),
    (BOX + "scale = 1", "body[0].scale", "there is no such key", ()),
    (BOX + "sphere = 1", "body[0].sphere", "there is 'box' already", ()),
    (BOX + "urdf = 'cup.urdf'", "body[0].box", "there is 'urdf' already", ()),
    (
        BODY + "box = 1",
        "body[0].box",
        "expected 3 finite numbers (its lengths along x, y and z), found 1",
        (),
    ),
    (BODY + "box = [1, 1]", "body[0].box", "expected 3 finite numbers", ()),
    (BODY + "box = [1, 0, 1]", "body[0].box", "must be above 0, found [1.0, 0.0, 1.0]", ()),
    (BODY + "box = [1, inf, 1]", "body[0].box", "expected 3 finite numbers", ()),
    (BODY + "sphere = 0", "body[0].sphere", "0 is not above 0", ()),
    (BODY + "sphere = [1]", "body[0].sphere", "expected a finite number", ()),
    (BODY + "cylinder = [1, 1, 1]", "body[0].cylinder", "2 finite numbers (its radius and", ()),
    (BODY + "cylinder = [1, -1]", "body[0].cylinder", "its radius and its length must be", ()),
    (BODY + "capsule = [0, 1]", "body[0].capsule", "must be above 0", ()),
    (BODY + "plane = [0, 0, 0]", "body[0].plane", "not a direction", ()),
    (BODY + "plane = [0, 0, 1]\nfixed = false", "body[0].fixed", "a plane cannot move", ()),
    (BODY + "plane = [0, 0, 1]\nmass = 1", "body[0].mass", "a fixed body has no mass", ()),
    (BOX + "mass = 0", "body[0].mass", "a body that never moves has fixed = true", ()),
    (BOX + "mass = -1", "body[0].mass", "-1 is less than 0", ()),
    (BOX + "mass = 1\nfixed = true", "body[0].mass", "a fixed body has no mass", ()),
    (BOX + "mas = 1", "body[0].mas", "there is no such key", ("mass",)),
    (BOX + "color = [1, 1, 1]", "body[0].color", "there is no such key", ("colour",)),
    (BOX + "colour = [1, 1]", "body[0].colour", "expected 3 or 4 numbers from 0 to 1", ()),
    (BOX + "colour = [1, 1, 1.001]", "body[0].colour", "expected 3 or 4 numbers", ()),
    (BOX + "colour = [1, 1, true]", "body[0].colour", "expected 3 or 4 numbers", ()),
    (BOX + "friction = -0.1", "body[0].friction", "-0.1 is less than 0", ()),
    (BOX + "restitution = 1.1", "body[0].restitution", "1.1 is more than 1", ()),
    (BOX + "joints = { j = 1 }", "body[0].joints", "a body with 'box' has no such key", ()),
    (BOX + "hold = true", "body[0].hold", "a body with 'box' has no such key", ()),
    ("floor = 1", "floor", "expected true, false or a table, found 1", ()),
    ("floor = [1]", "floor", "expected true, false or a table", ()),
    ("[floor]\nheigth = 1", "floor.heigth", "there is no such key", ("height",)),
    ("[floor]\nheight = inf", "floor.height", "expected a finite number", ()),
    ("[floor]\ncolour = 'red'", "floor.colour", "expected 3 or 4 numbers", ()),
    ("flor = true", "flor", "there is no such key", ("floor",)),
    ("floor = true\n" + BOX.replace('"a"', '"floor"'), "body[0].name", "'floor' is there", ()),
    (
        'floor = true\n[[sensor]]\nname = "s"\non = "flor"\ntype = "contact_sensor"',
        "sensor[0].on",
        "the scene has no body 'flor'",
        ("floor",),
    ),
]


@pytest.mark.parametrize(("text", "key", "words", "nearest"), MISTAKES)
def test_mistakes(write, text, key, words, nearest):
    path = write("room.toml", text)
    with pytest.raises(SceneError) as caught:
        find_scene(path)
    assert caught.value.message.startswith(f"{path}: {key}: ")
    assert words in caught.value.message
    if nearest is not None:
        assert caught.value.suggestions == nearest


# Just inside what is refused above.
BOUNDARIES = {
    "sphere = 1e-9": Primitive("sphere", (1e-9,)),
    "box = [1, 1, 1]\nmass = 1e-9": Primitive("box", (1, 1, 1), 1e-9),
    "box = [1, 1, 1]\ncolour = [0, 1, 0]": Primitive(
        "box", (1, 1, 1), material=Material(colour=(0, 1, 0, 1))
    ),
    "box = [1, 1, 1]\nfriction = 0\nrestitution = 1": Primitive(
        "box", (1, 1, 1), material=Material(friction=0, restitution=1)
    ),
}


@pytest.mark.parametrize("keys", BOUNDARIES)
def test_boundaries(write, keys):
    (body,) = read_scene(write("room.toml", BODY + keys)).bodies
    assert body.model == BOUNDARIES[keys]
