"""MuJoCo loads scenes of URDF files and primitives as PyBullet does, which may not be installed."""

import math
import sys

import numpy as np
import pytest

import ssduck
from ssduck.errors import SceneError, UnsupportedError

pytest.importorskip("mujoco")

CART = """<robot name="cart">
<material name="red"><color rgba="1 0 0 1"/></material>
<link name="base"><inertial><origin xyz="0 0 .1"/><mass value="4"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
  <visual><geometry><box size=".6 .4 .2"/></geometry><material name="red"/></visual>
  <collision><geometry><box size=".6 .4 .2"/></geometry></collision></link>
<link name="arm"><inertial><mass value="1"/><inertia ixx=".1" iyy=".1" izz=".1" ixy="0" ixz="0" iyz="0"/></inertial>
  <collision><origin xyz=".5 0 0"/><geometry><box size="1 .1 .1"/></geometry></collision></link>
<link name="wheel"><inertial><mass value="1"/><inertia ixx=".1" iyy=".1" izz=".1" ixy="0" ixz="0" iyz="0"/></inertial>
  <collision><origin rpy="1.5707963267948966 0 0"/><geometry><cylinder radius=".1" length=".05"/></geometry></collision></link>
<link name="tip"><inertial><mass value=".5"/><inertia ixx=".1" iyy=".1" izz=".1" ixy="0" ixz="0" iyz="0"/></inertial>
  <collision><geometry><mesh filename="package://cart/meshes/wedge.obj" scale=".1 .1 .1"/></geometry></collision></link>
<joint name="lift" type="revolute"><parent link="base"/><child link="arm"/><origin xyz=".3 0 .2"/><axis xyz="0 -1 0"/>
  <limit lower="0.2" upper="1.5" effort="40" velocity="1"/></joint>
<joint name="roll" type="continuous"><parent link="base"/><child link="wheel"/><origin xyz="0 .3 0"/><axis xyz="0 1 0"/>
  <limit effort="5" velocity="9"/></joint>
<joint name="end" type="fixed"><parent link="arm"/><child link="tip"/><origin xyz="1 0 0"/></joint>
</robot>"""
WEDGE = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
ROOM = """name = "room"
time = 2.5
floor = true
[[body]]
name = "one"
urdf = "cart/urdf/cart.urdf"
own_inertia = true
position = [0, 0, 0.6]
orientation = [0.8, 0, 0, 0.6]
joints = { lift = 0.9 }
fixed = true
[[body]]
name = "wheel"
urdf = "cart/urdf/cart.urdf"
own_inertia = true
position = [3, 0, 1]
kind = "kinbody"
joint_velocities = { roll = 0.25 }
velocity = [0.5, 0, 0, 0, 0, 0.1]
[[body]]
name = "ball"
sphere = 0.2
mass = 2.0
position = [0, 3, 1]
[[body]]
name = "post"
cylinder = [0.1, 1.0]
fixed = true
position = [0, -3, 0.5]
enabled = false
visible = false
[[body]]
name = "crate"
box = [0.2, 0.4, 0.6]
mass = 3.0
position = [-3, 0, 0.3]
[[body]]
name = "pill"
capsule = [0.1, 0.4]
position = [-3, 3, 2]
[[body]]
name = "slope"
plane = [0.6, 0, 0.8]
fixed = true
position = [-9, 0, 0]
[[sensor]]
name = "eye"
type = "range_finder"
period = 0.1
on = "one"
link = "tip"
position = [0, 0, 0]
max_range = 3.0
"""
ENTITIES = ["floor", "one", "wheel", "ball", "post", "crate", "pill", "slope"]


@pytest.fixture
def room(write):
    write("cart/urdf/cart.urdf", CART)
    write("cart/meshes/wedge.obj", WEDGE)
    return write("room.toml", ROOM)


def are_same(one, other):
    """Checks that two worlds have the same entities, with the same links, joints and numbers."""
    assert [entity.name for entity in one] == [entity.name for entity in other]
    for first in one:
        second = other[first.name]
        # PyBullet numbers links as the file has them; MuJoCo's tree is depth first.
        names = [sorted(link.name for link in entity.links) for entity in (first, second)]
        assert names[0] == names[1] or names[0] == ["link0"]  # PyBullet's name in primitives
        for key in ("kind", "enabled", "visible"):
            assert getattr(first, key) == getattr(second, key), (first.name, key)
        for key in ("position", "mass", "aabb"):
            expected = np.array(getattr(first, key)).ravel()
            found = np.array(getattr(second, key)).ravel()
            assert found == pytest.approx(expected, abs=1e-6), (first.name, key)
        for joint in first.joints:
            found = [j.position for j in second.joints if j.name == joint.name]
            assert found == ([] if joint.type == "fixed" else [pytest.approx(joint.position)])


@pytest.mark.slow
def test_a_scene_is_what_it_says(room):
    with ssduck.load(room, simulator="mujoco") as ss:
        world = ss["room"]
        assert (world.simulator.backend, world.time) == ("mujoco", 2.5)
        assert [entity.name for entity in world] == ["eye", *ENTITIES]
        one, other = world["one"], world["wheel"]
        for cart in (one, other):
            assert [link.name for link in cart.links] == ["base", "arm", "tip", "wheel"]
        assert (one.kind, other.kind, other.mass) == ("robot", "kinbody", 6.5)
        assert ss.eval("[joint(room.one, 'lift'), joint(room.wheel, 'lift')];") == [0.9, 0.2]
        # The tip is 1 m from the joint at (0.3, 0, 0.2) of the base, which is turned.
        tip = np.array([0.3 + math.cos(0.9), 0, 0.2 + math.sin(0.9)])
        turned = [0.28 * tip[0], 0.96 * tip[0], tip[2] + 0.6]
        assert ss.eval("position(room.one.tip);") == pytest.approx(turned)
        assert ss.eval("velocity(room.wheel);") == pytest.approx([0.5, 0, 0])
        assert np.array(world["crate"].aabb).ravel() == pytest.approx(
            [-3.1, -0.2, 0, -2.9, 0.2, 0.6]
        )
        assert np.array(world["pill"].aabb)[:, 2] == pytest.approx([1.7, 2.3])
        assert (world["post"].enabled, world["post"].visible) == (False, False)
        assert ss.eval("clearance(room.slope, room.ball);") == pytest.approx(9 * 0.6 + 0.8 - 0.2)


@pytest.mark.slow
def test_a_scene_is_the_same_with_pybullet(room):
    pytest.importorskip("pybullet")
    with (
        ssduck.load(room, simulator="pybullet") as ss,
        ssduck.load(room, simulator="mujoco") as other,
    ):
        are_same(ss["room"], other["room"])


@pytest.mark.slow
def test_bodies_fall_are_held_and_driven(room):
    with ssduck.load(room, simulator="mujoco") as ss:
        world = ss["room"]
        joint = "joint(room.{}, '{}');"
        world.run(0.1)
        assert world["ball"].position[2] == pytest.approx(1 - 9.81 * 0.1**2 / 2, abs=3e-3)
        world.run(0.9)
        assert world["ball"].position == pytest.approx([0, 3, 0.2], abs=5e-3)
        assert world["one"].position == pytest.approx([0, 0, 0.6], abs=1e-9)
        # The weight of the arm pulls with some 10 N m of the 40 that its motor has.
        assert ss.eval(joint.format("one", "lift")) == pytest.approx(0.9, abs=0.01)
        before = ss.eval(joint.format("one", "roll"))
        world["one"].drive({"lift": 1.2}, velocities={"roll": 0.5})
        world.run(1.0)
        assert ss.eval(joint.format("one", "lift")) == pytest.approx(1.2, abs=0.01)
        assert ss.eval(joint.format("one", "roll")) - before == pytest.approx(0.5, abs=0.03)


@pytest.mark.slow
def test_it_is_copied_and_saved(room, tmp_path):
    with ssduck.load(room, simulator="mujoco") as ss:
        world = ss["room"]
        copy = world.excerpt(["one", "floor"])
        assert [link.name for link in copy["one"].links] == ["base", "arm", "tip", "wheel"]
        with pytest.warns(UserWarning, match="post: MJCF has no bodies that are disabled"):
            file = world.save(tmp_path / "saved")
        with ssduck.load(file) as again:
            found = again["room"]
            assert found["wheel"].kind == "kinbody"
            assert found["one"].aabb == pytest.approx(np.array(world["one"].aabb), abs=1e-9)


def test_a_urdf_file_by_itself_moves_freely(room):
    with ssduck.load(room.parent / "cart/urdf/cart.urdf", simulator="mujoco") as ss:
        assert [entity.name for entity in ss["cart"]] == ["cart"]
        ss["cart"].run(0.5)
        assert ss.eval("z(cart.cart);") == pytest.approx(-9.81 * 0.5**2 / 2, abs=0.02)


@pytest.mark.parametrize(
    ("old", "new", "error", "message"),
    [
        ("floor = true", "elastic = true", UnsupportedError, "this scene has elastic = true: describe"),
        ("lift = 0.9", "lifd = 0.9", SceneError, r"body\[0\].joints.lifd: cart.urdf has no such joint; did you mean 'lift'"),
        ("lift = 0.9", "lift = 1.9", SceneError, r"1\.9 is not from 0\.2 to 1\.5, the joint's limits"),
        ("lift = 0.9", "end = 1", SceneError, r"body\[0\].joints.end: cart.urdf has no such joint"),
    ],
)  # fmt: skip
def test_what_a_scene_cannot_have_is_told(room, write, old, new, error, message):
    file = write("other.toml", ROOM.replace(old, new, 1))
    with pytest.raises(error, match=message):
        ssduck.load(file, simulator="mujoco")


def test_files_that_mujoco_cannot_read_are_told(room, write):
    urdf = write("cart/urdf/cart.urdf", CART.replace("wedge.obj", "gone.obj"))
    with pytest.raises(SceneError, match=r"gone\.obj"):
        ssduck.load(room, simulator="mujoco")
    urdf.write_text(CART.replace('<child link="arm"/>', ""))
    with pytest.raises(SceneError, match=r"body\[0\]\.urdf: .*cart\.urdf cannot be loaded: "):
        ssduck.load(room, simulator="mujoco")
    painted = CART.replace('<box size=".6 .4 .2"/>', '<mesh filename="skin.dae"/>', 1)
    urdf.write_text(painted)
    with pytest.warns(UserWarning, match=r"are not drawn: skin\.dae"):
        ssduck.load(room, simulator="mujoco").close()


def test_without_pybullet_mujoco_loads_scenes(room, monkeypatch):
    monkeypatch.setitem(sys.modules, "pybullet", None)  # as where it is not installed
    with ssduck.load(room) as ss:
        assert ss["room"].simulator.backend == "mujoco"


@pytest.mark.slow
def test_the_kitchen_is_the_same_in_both():
    """Where each thing is, its size, mass, links and joints; also what is on what."""
    pytest.importorskip("pybullet")
    on = "SELECT id(a) AS a, id(b) AS b FROM a=kitchen, b=kitchen WHERE on(a, b) ORDER BY id(a), id(b);"
    worlds = [ssduck.load("kitchen", simulator=name) for name in ("pybullet", "mujoco")]
    are_same(*(ss["kitchen"] for ss in worlds))
    for ss in worlds:
        ss["kitchen"].run(1.0)
    pairs = [ss.eval(on) for ss in worlds]
    assert pairs[0] == pairs[1]
    assert len(pairs[0]) > 20
    for entity in worlds[0]["kitchen"]:
        found = worlds[1]["kitchen"][entity.name].position
        assert found == pytest.approx(entity.position, abs=0.02), entity.name
    for ss in worlds:
        ss.close()


def refused(tmp_path, text, words):
    (tmp_path / "m.xml").write_text(f"<mujoco>{text}</mujoco>")
    with pytest.raises(SceneError, match=words) as caught:
        ssduck.load(tmp_path / "m.xml")
    assert "m.xml" in str(caught.value)


def test_what_mujoco_does_not_know_is_an_error_of_the_scene(tmp_path, monkeypatch):
    def fails(path):
        raise RuntimeError("Caught an unknown exception!")

    monkeypatch.setattr("mujoco.MjSpec.from_file", fails)
    refused(tmp_path, "", "cannot be loaded: Caught an unknown exception")


def test_a_file_that_includes_itself_is_an_error(tmp_path):
    refused(tmp_path, '<include file="m.xml"/>', "include")


@pytest.mark.parametrize("timestep", ["0", "-1", "nan", "inf"])
def test_a_timestep_is_above_0(tmp_path, timestep):
    option = f'<option timestep="{timestep}"/>'
    refused(tmp_path, f'{option}<worldbody><geom size="1"/></worldbody>', "timestep|nan|inf")
