"""Worlds saved as MJCF: those of MuJoCo with all that they have, those of PyBullet for MuJoCo."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import ssduck
from ssduck.errors import SceneError, UnknownNameError, UnsupportedError
from ssduck.simulators.scenes import read_scene
from tests.support.bodies import solid
from tests.support.cases import sampled
from tests.support.mjcf import simulated
from tests.support.solids import box as solid_box
from tests.support.solids import mesh_of
from tests.support.warned import heard

mujoco = pytest.importorskip("mujoco")

CELL = """<mujoco model="cell">
<compiler angle="degree" meshdir="meshes" texturedir="pictures"/>
<option timestep="0.00123456789" gravity="0.1 0 -9.80665" integrator="implicitfast"/>
<default><default class="part"><geom friction=".7 .01 .001" density="500"/></default></default>
<asset>
  <mesh name="wedge" file="wedge.obj" scale=".1 .1 .1"/><mesh file="cube.obj"/>
  <texture name="wood" type="2d" file="wood.png"/><material name="wood" texture="wood"/>
  <hfield name="hills" file="hills.png" size="1 1 .2 .1"/>
</asset>
<worldbody>
  <light pos="0 0 3"/>
  <geom name="floor" type="plane" size="0 0 1" material="wood"/>
  <geom name="picture" type="box" size=".1 .01 .1" pos="0 3 1" contype="0" conaffinity="0"/>
  <body name="land" pos="5 0 0.123456789"><geom type="hfield" hfield="hills"/></body>
  <body name="arm" pos="-0.123456789012 .2 .5" euler="10 20 30">
    <geom class="part" type="capsule" fromto="0 0 0 .1 .2 .3" size=".0512345678"/>
    <body name="upper" pos=".1 .2 .3"><joint name="elbow" axis="1 2 3" pos=".01 .02 .03" range="-90 90" damping=".5"/>
      <geom class="part" type="mesh" mesh="wedge" pos=".05 0 .02" euler="5 6 7"/>
      <site name="tip" pos="0 0 .123456789" size=".0123456789" euler="40 0 0"/>
      <body name="fore" pos="0 0 .3"><joint name="slide" type="slide" axis="0 1 0" range="-1 1"/>
        <geom type="ellipsoid" size=".05 .0712345678 .1"/></body>
      <body name="ball" pos="0 .3 0"><joint name="socket" type="ball"/><geom type="cylinder" size=".05 .1"/></body>
    </body>
  </body>
  <body name="box" pos="1 0 2"><freejoint/><inertial pos=".01 0 0" mass="1.23456789" diaginertia=".01 .02 .025"/>
    <geom type="mesh" mesh="cube"/></body>
  <body name="hand" mocap="true" pos="0 1 1"><geom type="sphere" size=".05"/></body>
</worldbody>
<actuator><position name="servo" joint="elbow" kp="20"/><motor joint="slide"/></actuator>
<equality><weld name="grip" body1="hand" body2="box" active="false"/></equality>
<keyframe><key name="home"/></keyframe>
</mujoco>"""


@pytest.fixture(scope="module")
def cell(tmp_path_factory):
    """The file of a model with meshes, a picture and heights in folders beside it."""
    folder = tmp_path_factory.mktemp("cell")
    (folder / "meshes").mkdir()
    (folder / "pictures").mkdir()
    wedge = "v 0 0 0\nv 1 0 0\nv 0 2 0\nv 0 0 3\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"
    (folder / "meshes" / "wedge.obj").write_text(wedge)
    cube = mesh_of(solid_box(0.2, 0.2, 0.3))
    lines = [f"v {x} {y} {z}" for x, y, z in cube.vertices.tolist()]
    lines += ["f " + " ".join(str(n + 1) for n in face) for face in cube.faces.tolist()]
    (folder / "meshes" / "cube.obj").write_text("\n".join(lines) + "\n")
    heights = np.random.default_rng(0).integers(0, 255, (6, 8), dtype=np.uint8)
    Image.fromarray(heights).save(folder / "meshes" / "hills.png")
    Image.fromarray(np.full((8, 8, 3), 120, np.uint8)).save(folder / "pictures" / "wood.png")
    (folder / "cell.xml").write_text(CELL)
    return folder / "cell.xml"


def content(world):
    """What the tables of a world hold now, and the state of its model."""
    tables = ("links", "shapes", "joints")
    world.request_tables(tables)
    world.tick()
    rows = {name: world.snapshot.tables[name].arrow.to_pylist() for name in ("entities", *tables)}
    data = world.simulator.data
    return rows | {
        name: np.array(getattr(data, name)).tolist()
        for name in ("time", "qpos", "qvel", "ctrl", "mocap_pos", "mocap_quat", "xpos", "xquat")
    }


@pytest.mark.slow
def test_a_saved_world_is_the_same(cell, tmp_path):
    """With each digit of poses, sizes and the state; without the files that it was loaded from."""
    with ssduck.load(cell) as ss:
        world = ss["cell"]
        data = world.simulator.data
        data.ctrl[:] = 0.7, 0.123456789
        data.mocap_pos[0] = 0.3, 0.123456789, 1.1
        world.step(57)
        world.add_sensor("range_finder", "arm", "eye", "upper", max_range=5.0)
        mujoco.mj_forward(world.simulator.model, data)  # MuJoCo's poses are a step behind
        file = world.save(tmp_path / "saved")
        expected = content(world)
        copies = sorted(path.name for path in (tmp_path / "saved" / "assets").iterdir())
    assert copies == ["cube.obj", "hills.png", "wedge.obj", "wood.png"]
    with ssduck.load(file) as again:
        found = again["cell"]
        assert found.simulator.backend == "mujoco"
        assert "eye" in found
        actual = content(found)
        entities = [row for row in actual.pop("entities") if row["kind"] != "sensor"]
        before = [row for row in expected.pop("entities") if row["kind"] != "sensor"]
        assert [row["name"] for row in entities] == [row["name"] for row in before]
        for key in ("qpos", "qvel", "time", "ctrl", "mocap_pos", "mocap_quat", "xpos", "xquat"):
            assert actual[key] == expected[key], key
        for table in ("links", "shapes", "joints"):
            assert len(actual[table]) == len(expected[table])
            for row, other in zip(actual[table], expected[table], strict=True):
                for key in set(row) - {"tick", "entity", "geometry"}:
                    assert row[key] == pytest.approx(other[key], abs=1e-6), (table, key)
        model = found.simulator.model
        assert model.opt.timestep == 0.00123456789
        assert model.mat_texid.max() == 0
        assert not model.eq_active0[model.equality("grip").id]
        found.step(20)  # it goes on
        assert np.isfinite(found.simulator.data.qpos).all()


FRAMES = """<mujoco model="frames">
<worldbody>
  <frame pos="1 1 1" euler="0 0 33"><geom name="first" type="box" size=".1 .2 .3"/></frame>
  <geom name="second" type="box" size=".1 .2 .3"/>
  <body name="outer">
    <frame pos="1 0 0" euler="10 2 3">
      <frame pos="0 1 0" euler="3 40 5">
        <geom name="inner" type="box" size=".1 .2 .3" pos="0 0 .123456789" euler="1 2 3"/>
        <body name="arm" pos=".1 .2 .3"><joint name="elbow" axis="1 0 2" pos=".5 0 0"/>
          <geom type="box" size=".1 .2 .3"/></body>
      </frame>
      <site name="tip" pos=".1 0 0" size=".01"/>
    </frame>
    <geom name="other" type="box" size=".1 .2 .3"/>
    <site name="base" size=".02"/>
    <frame euler="0 0 80"><joint name="shoulder" axis="1 0 2" pos=".5 0 0"/></frame>
  </body>
  <replicate count="3" offset=".5 0 0.123456789" euler="0 0 20">
    <body name="ball" pos="0 3 2"><freejoint/><geom type="ellipsoid" size=".1 .2 .3"/></body>
  </replicate>
</worldbody>
</mujoco>"""


@pytest.mark.slow
def test_frames_and_copies_are_saved(tmp_path):
    (tmp_path / "frames.xml").write_text(FRAMES)
    with ssduck.load(tmp_path / "frames.xml", simulator="mujoco") as ss:
        model = ss["frames"].simulator.model
        with ssduck.load(ss["frames"].save(tmp_path / "saved")) as again:
            found = again["frames"].simulator.model
            poses = [f"{of}_{part}" for of in ("body", "geom", "site") for part in ("pos", "quat")]
            for name in (*poses, "jnt_pos", "jnt_axis", "geom_size", "site_size"):
                expected = getattr(model, name)
                assert getattr(found, name) == pytest.approx(expected, abs=1e-12), name


@pytest.mark.slow
def test_a_saved_world_goes_on_alike(cell, tmp_path):
    """What has six digits differs a little: friction, density."""
    with ssduck.load(cell) as ss:
        world = ss["cell"]
        world.step(10)
        with ssduck.load(world.save(tmp_path / "saved")) as again:
            copy = again["cell"]
            for one in (world, copy):
                one.step(100)
            data, other = world.simulator.data, copy.simulator.data
            assert other.qpos == pytest.approx(data.qpos, abs=1e-5)
            assert not np.array_equal(data.qpos[:2], world.simulator.model.qpos0[:2])


@pytest.mark.slow
def test_an_assumed_world_is_saved_as_it_is(cell, tmp_path):
    with ssduck.load(cell) as ss:
        world = ss["cell"]
        assumed = world.what_if({"box": [1, 0, 0, 0, 7, 7, 7]}, {"arm": {"elbow": 0.2}})
        with pytest.warns(UserWarning, match="has the present controls"):
            file = assumed.save(tmp_path / "assumed")
    with ssduck.load(file) as again:
        assert tuple(again["world"]["box"].position) == (7.0, 7.0, 7.0)
        assert next(joint.position for joint in again["world"]["arm"].joints) == 0.2


@pytest.mark.slow
def test_a_moved_fixed_body_is_saved_where_it_is(cell, tmp_path):
    with ssduck.load(cell) as ss:
        ss["cell"]["land"].move([1.0, 2.0, 0.123456789123])
        file = ss["cell"].save(tmp_path / "saved")
    with ssduck.load(file) as again:
        assert tuple(again["cell"]["land"].position) == (1.0, 2.0, 0.123456789123)
        shown = again["cell"].simulator.model.geom("picture")
        assert shown.rgba[3] == 1.0


def test_the_model_that_mujoco_read_last_can_be_saved(tmp_path):
    text = '<mujoco><worldbody><body name="{}" pos="0 0 1"><freejoint/><geom size=".1"/></body></worldbody></mujoco>'
    model, data = simulated(text.format("one"))
    world = ssduck.World.attach(model, data)
    world.step(10)
    mujoco.mj_forward(model, data)
    world.tick()
    file = world.save(tmp_path / "saved")
    with ssduck.load(file) as ss:
        assert tuple(ss["world"]["one"].position) == tuple(world["one"].position)
    world.save(tmp_path / "again")  # reading what was written did not make it the last
    other = mujoco.MjModel.from_xml_string(text.format("other"))
    with pytest.raises(UnsupportedError, match=r"source of this MuJoCo model is not known.*to_xml"):
        world.save(tmp_path / "late")
    assert other.nbody == 2


def test_a_mujoco_world_is_not_saved_for_pybullet(cell, tmp_path):
    with ssduck.load(cell) as ss:
        with pytest.raises(UnsupportedError, match="saved as MJCF, of which PyBullet reads little"):
            ss["cell"].save(tmp_path / "p", "pybullet")
        with pytest.raises(UnknownNameError, match=r"no simulator 'mujoko'.*did you mean 'mujoco'"):
            ss["cell"].save(tmp_path / "m", "mujoko")


def test_a_missing_file_is_named(cell, tmp_path):
    (tmp_path / "meshes").mkdir()
    (tmp_path / "pictures").mkdir()
    for path in [*cell.parent.glob("meshes/*"), *cell.parent.glob("pictures/*")]:
        (tmp_path / path.relative_to(cell.parent)).write_bytes(path.read_bytes())
    (tmp_path / "cell.xml").write_text(CELL)
    with ssduck.load(tmp_path / "cell.xml") as ss:
        (tmp_path / "meshes" / "wedge.obj").unlink()
        with pytest.raises(UnsupportedError, match=r"wedge\.obj"):
            ss["cell"].save(tmp_path / "saved")


SCENE = 'name = "task"\nsimulator = "mujoco"\n{}[[body]]\nmjcf = "world.xml"\n{}'
BALL = '<mujoco><worldbody><body name="ball"><geom size=".1"/></body></worldbody></mujoco>'


@pytest.mark.parametrize(
    ("first", "last"),
    [
        ("gravity = [0.0, 0.0, -1.0]\n", ""),
        ("floor = true\n", ""),
        ("timestep = 0.1\n", ""),
        ("", "position = [0.0, 0.0, 1.0]\n"),
        ("", "fixed = true\n"),
        ("", '[[body]]\nname = "b"\nbox = [1.0, 1.0, 1.0]\n'),
    ],
)
def test_a_scene_for_mujoco_is_a_model_and_sensors(tmp_path, first, last):
    (tmp_path / "world.xml").write_text(BALL)
    file = tmp_path / "scene.toml"
    file.write_text(SCENE.format(first, last))
    with pytest.raises(
        UnsupportedError, match="has an MJCF file beside other things: describe everything in one"
    ):
        ssduck.load(file)


def test_a_scene_names_its_simulator(tmp_path):
    (tmp_path / "world.xml").write_text(BALL)
    file = tmp_path / "scene.toml"
    sensor = '[[sensor]]\nname = "eye"\ntype = "range_finder"\non = "{}"\nmax_range = 1.0\n'
    file.write_text(SCENE.format("", sensor.format("ball")))
    assert read_scene(file).simulator == "mujoco"
    with ssduck.load(file) as ss:
        assert {entity.name for entity in ss["task"]} == {"eye", "ball"}
    file.write_text(SCENE.format("", sensor.format("bal")))
    with pytest.raises(SceneError, match=r"no body 'bal'.*did you mean 'ball'"):
        ssduck.load(file)
    file.write_text(SCENE.format("", "").replace('"mujoco"', '"mujoko"'))
    with pytest.raises(UnknownNameError, match=r"no simulator 'mujoko'.*did you mean 'mujoco'"):
        ssduck.load(file)


# -- worlds of PyBullet -----------------------------------------------------------------------


def saved(world, folder):
    """Saves a PyBullet world for MuJoCo; returns the file and the warnings."""
    return heard(lambda: world.save(folder, "mujoco"))


def joints_of(entity):
    """The joints of a body that have a position, without the name of the body in front."""
    if entity.kind == "sensor":
        return None
    return [
        (joint.name.removeprefix(f"{entity.name}_"), joint.type, pytest.approx(joint.position))
        for joint in entity.joints
        if joint.type in ("revolute", "prismatic")
    ]


@pytest.mark.slow
@pytest.mark.parametrize("scene", ["kitchen", "hall", "chaos"])
def test_shipped_scenes_have_the_same_bodies_in_mujoco(scene, tmp_path):
    pytest.importorskip("pybullet")
    with ssduck.load(scene) as ss:
        world = ss[scene]
        world.step(3)
        file, _ = saved(world, tmp_path / "saved")
        with ssduck.load(file) as again:
            other = again[scene]
            assert [(e.name, e.kind) for e in other] == [(e.name, e.kind) for e in world]
            for one in world:
                copy = other[one.name]
                assert copy.position == pytest.approx(one.position, abs=1e-12), one.name
                assert copy.mass == pytest.approx(one.mass, rel=1e-12), one.name
                boxes = np.array([one.aabb, copy.aabb])
                finite = np.isfinite(boxes).all(axis=0)
                assert np.array_equal(boxes[0][~finite], boxes[1][~finite])
                assert boxes[0][finite] == pytest.approx(boxes[1][finite], abs=1e-6), one.name
                assert joints_of(copy) == joints_of(one)


@pytest.mark.slow
def test_the_model_loads_by_itself_and_in_mujoco(tmp_path):
    pytest.importorskip("pybullet")
    with ssduck.load("kitchen") as ss:
        file, warned = saved(ss["kitchen"], tmp_path / "saved")
        heavy = ss.eval("SELECT id FROM kitchen WHERE mass(this) > 3 AS list;")
    assert warned == [
        "barrett_4918, roomba_625x: its motors are left out: friction brakes its joints instead"
    ]
    model = mujoco.MjModel.from_xml_path(str(Path(file).parent / "world.xml"))
    assert model.key("ssduck").time[0] == 0.0
    with ssduck.load(Path(file).parent / "world.xml") as alone:
        assert alone.eval("SELECT id FROM world WHERE mass(this) > 3 AS list;") == heavy
        assert alone["world"]["fridge"].kind == "robot"
        assert not [entity for entity in alone["world"] if entity.kind == "sensor"]


CABINET = """<robot name="cabinet">
  <link name="case"><collision><geometry><box size="1 1 1"/></geometry></collision></link>
  <link name="drawer"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><geometry><box size=".8 .8 .3"/></geometry></collision></link>
  <link name="door"><inertial><origin xyz="0 .2 0"/><mass value="2"/><inertia ixx="1" iyy="1" izz=".5" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><origin xyz="0 .2 0"/><geometry><box size=".02 .4 .4"/></geometry></collision></link>
  <joint name="slide" type="prismatic"><parent link="case"/><child link="drawer"/><origin xyz=".2 0 .1" rpy=".1 .2 .3"/>
    <axis xyz="1 0 0"/><limit lower="0" upper="0.4" effort="10" velocity="1"/></joint>
  <joint name="turn" type="revolute"><parent link="case"/><child link="door"/><origin xyz=".5 -.4 -.3"/>
    <axis xyz="0 0 1"/><limit lower="-1.5" upper="0" effort="5" velocity="1"/></joint>
</robot>"""
CABINETS = """name = "room"
gravity = [0, 0, 0]
[[body]]
name = "one"
urdf = "cabinet.urdf"
own_inertia = true
fixed = true
joints = {{ slide = {0}, turn = {1} }}
[[body]]
name = "other"
urdf = "cabinet.urdf"
own_inertia = true
position = [3, 0, 0]
fixed = true
[[constraint]]
type = "fixed"
on = "one"
link = "drawer"
to = "other"
"""


@pytest.mark.slow
@sampled(("slide", "turn"), [(0.0, 0.0), (0.02, -0.05), (0.21, -0.8), (0.4, -1.5)], every=2)
def test_drawers_agree(tmp_path, slide, turn):
    """Two bodies of one file: names of parts that both have get that of the body in front."""
    pytest.importorskip("pybullet")
    (tmp_path / "cabinet.urdf").write_text(CABINET)
    (tmp_path / "room.toml").write_text(CABINETS.format(slide, turn))
    with ssduck.load(tmp_path / "room.toml") as ss:
        file, warned = saved(ss["room"], tmp_path / "saved")
        assert warned == ["one, other: its motors are left out: friction brakes its joints instead"]
        ss.add_variable("m", ssduck.World.load(read_scene(file)))
        for asked in ("one", "one, 'slide'", "one, 'turn'"):
            shares = [ss.eval(f"openness({world}.{asked});") for world in ("room", "m")]
            assert shares[0] == pytest.approx(shares[1], abs=1e-9)
            assert 0.0 <= shares[0] <= 1.0
        for relation in ("isOpen", "isClosed"):
            for joint in ("slide", "turn"):
                for share in ("", ", 0.3", ", 0.9"):
                    one, other = (
                        ss.eval(f"{relation}({world}.one, '{joint}'{share});")
                        for world in ("room", "m")
                    )
                    assert one is other, (relation, joint, share)
        names = [joint.name for joint in ss["m"]["other"].joints]
        assert names == ["other_slide", "other_turn"]
        for entity in ("one", "other"):
            boxes = [np.array(ss[world][entity].aabb) for world in ("room", "m")]
            assert boxes[0] == pytest.approx(boxes[1], abs=1e-6)
        model = ss["m"].simulator.model
        assert model.eq_active0.sum() == 1
        assert model.jnt_range.tolist() == [[0, 0.4], [-1.5, 0]] * 2
        assert model.body("other_door").inertia.tolist() == [1, 1, 0.5]


def test_what_mjcf_has_not_is_named(tmp_path):
    pybullet = pytest.importorskip("pybullet")
    client = pybullet.connect(pybullet.DIRECT)
    corners = [[0, 0, 0], [1, 0, 0], [1, 0.2, 0], [0.2, 0.2, 0], [0.2, 1, 0], [0, 1, 0]]
    corners += [[x, y, 0.5] for x, y, _ in corners]
    sides = [(n, (n + 1) % 6, (n + 1) % 6 + 6, n + 6) for n in range(6)]
    faces = [face for a, b, c, d in sides for face in ((a, b, c), (a, c, d))]
    faces += [(0, 3, 2), (0, 2, 1), (0, 5, 4), (0, 4, 3)]
    faces += [(6, 8, 9), (6, 7, 8), (6, 10, 11), (6, 9, 10)]
    corner = solid(
        client,
        pybullet.GEOM_MESH,
        0,
        vertices=corners,
        indices=np.ravel(faces).tolist(),
        flags=pybullet.GEOM_FORCE_CONCAVE_TRIMESH,
    )
    one, other = (solid(client, pybullet.GEOM_SPHERE, 1, [x, 0, 2], radius=0.1) for x in (0, 1))
    pybullet.createConstraint(
        one, -1, other, -1, pybullet.JOINT_POINT2POINT, [0, 0, 1], [1, 0, 0], [0, 0, 0],
        physicsClientId=client,
    )  # fmt: skip
    names = {corner: "corner", one: "one", other: "other"}
    with ssduck.Interpreter(recording=None) as ss:
        world = ss.add_variable(
            "w", ssduck.World.attach(client, names, shapes={corner: (corners, faces)})
        )
        world["other"].enabled = False
        _, warned = saved(world, tmp_path / "saved")
    pybullet.disconnect(client)
    assert any("corner: MuJoCo collides the hull of its mesh" in text for text in warned)
    assert any("one: its point constraint is left out" in text for text in warned)
    assert any("other: its collisions are off" in text for text in warned)


@pytest.mark.long
def test_the_kitchen_is_at_rest_in_both(tmp_path):
    """After two seconds of simulation, the same things are on each other."""
    pytest.importorskip("pybullet")
    on = "SELECT id(a) AS a, id(b) AS b FROM a=SIM, b=SIM WHERE on(a, b) ORDER BY id(a), id(b);"
    with ssduck.load("kitchen") as ss:
        world = ss["kitchen"]
        file, _ = saved(world, tmp_path / "saved")
        other = ss.add_variable("m", ssduck.World.load(read_scene(file)))
        before = {entity.name: np.array(entity.position) for entity in world}
        assert before == {name: pytest.approx(other[name].position) for name in before}
        for one in (world, other):
            one.run(2.0)
        found = [ss.eval(on.replace("SIM", name)) for name in ("kitchen", "m")]
        assert len(found[0]) > 20
        assert found[0] == found[1]
        for name, position in before.items():
            assert other[name].position == pytest.approx(position, abs=0.02), name
