"""Model files that PyBullet reads otherwise than they say, or not: repaired, warned of, or refused."""

import json
import warnings
from pathlib import Path

import numpy as np
import pybullet
import pytest
import trimesh

import ssduck
from ssduck.errors import ArgumentError, SceneError, SimulatorError
from ssduck.world.world import World
from tests.support.bodies import client_of
from tests.support.command_line import ssduck_
from tests.support.models import mjcf_body, mjcf_of, sdf_link, sdf_model, sdf_of
from tests.support.urdf import box_obj, collision, joint, link, robot
from tests.support.warned import heard

BOX = '<box size="1 1 1"/>'
LIMIT = '<limit lower="-1" upper="1" effort="1" velocity="1"/>'
POINTER = "version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 9\n"
LOW, HIGH = [0, 0, 0], [1, 2, 3]


@pytest.fixture
def load(write):
    """Loads a model by its name and text; returns the only entity, and what is warned of."""
    opened = []

    def loaded(name, text, **options):
        path = text if isinstance(text, Path) else write(name, text)
        ss, told = heard(lambda: ssduck.load(path, simulator="pybullet", **options))
        opened.append(ss)
        (loaded.world,) = ss.worlds
        (entity,) = loaded.world
        return entity, told

    yield loaded
    for ss in opened:
        ss.close()


# -- XML that expat refuses ----------------------------------------------------------------------

ROOT = robot(link("a", shapes=collision(BOX)))
# What PyBullet reads: XML that expat refuses, or reads otherwise.
TOLERATED = {
    "an unbound prefix": ROOT.replace("<link", "<gz:note gz:x='1'/><link", 1),
    "two hyphens in a comment": "<!-- a -- b -->" + ROOT,
    "a declaration after a comment": "<!-- a -->\n<?xml version='1.0'?>" + ROOT,
    "a declaration after a blank": " <?xml version='1.0'?>" + ROOT,
    "a single ampersand": ROOT.replace("<link", "<note text='a & b'/><link", 1),
    "Latin-1": ("<!-- M\xfcller -->" + ROOT).encode("latin-1"),
    "a null character at the end": ROOT + "\0",
    "entities": '<!DOCTYPE r [<!ENTITY one "1">]>' + ROOT.replace('"1 1 1"', '"&one; 1 1"'),
    "a default namespace": ROOT.replace("<robot", '<robot xmlns="http://a.b"'),
}


@pytest.mark.parametrize("name", TOLERATED)
def test_what_pybullet_reads_is_checked(load, tmp_path, name):
    content = TOLERATED[name]
    content = content if isinstance(content, bytes) else content.encode()
    (tmp_path / "a.urdf").write_bytes(content)
    entity, told = load("", tmp_path / "a.urdf")
    assert [np.round(corner, 6).tolist() for corner in entity.aabb] == [[-0.5] * 3, [0.5] * 3]
    assert not told
    for old, new, words in (
        (b'<mass value="1.0"/>', b'<mass value="-1"/>', "is negative: '-1'"),
        (b"</robot>", b'<link name="b"/></robot>', "2 links without a parent"),
    ):
        (tmp_path / "b.urdf").write_bytes(content.replace(old, new))
        with pytest.raises(SceneError, match=words):
            load("", tmp_path / "b.urdf")


@pytest.mark.parametrize(
    "text", ["<robot name='r'><link name='a'></robot>", "", POINTER, "<a b='<'/>"]
)
@pytest.mark.parametrize("file", ["a.urdf", "a.sdf", "a.xml"])
def test_what_is_no_xml_is_an_error(load, text, file):
    with pytest.raises(
        SceneError, match=rf"{file} cannot be loaded: it cannot be read as XML: .*line"
    ):
        load(file, text)


def test_a_static_model_that_expat_refuses_stays(load):
    model = sdf_model("m", "<static>true</static><gz:a/>", sdf_link(mass=2), pose="0 0 3 0 0 0")
    load("a.sdf", sdf_of(model))
    assert pybullet.getDynamicsInfo(0, -1, client_of(load.world))[0] == 0.0


# -- numbers -------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("blank", ["\n", "\t", "\r\n", " \n "])
def test_white_space_between_numbers(load, blank):
    def spaced(text):
        return text.replace("_", blank)

    shapes = collision(spaced('<box size="_1_2_3_"/>'))
    pair = robot(
        link("a"), link("b", shapes=shapes), joint("j", "fixed", "a", "b", xyz=("_4", "_5", "_6_"))
    )
    entity, _ = load("a.urdf", spaced(pair))
    assert entity.links[-1].position == pytest.approx([4, 5, 6])
    assert np.subtract(*reversed(entity.aabb)) == pytest.approx([1, 2, 3])
    model = sdf_of(sdf_model("m", sdf_link(geometry="<box><size>_1_2_3_</size></box>"), pose="Y"))
    entity, _ = load("a.sdf", spaced(model.replace("Y", "_4_5_6_0_0_0_")))
    assert entity.position == pytest.approx([4, 5, 6])
    assert np.subtract(*reversed(entity.aabb)) == pytest.approx([1, 2, 3])
    text = mjcf_of(mjcf_body("b", pos="4_5_6", parts='<geom type="box" size="_1_2_3"/>'))
    entity, _ = load("a.xml", spaced(text))
    assert entity.position == pytest.approx([4, 5, 6])


ORIGIN = robot(link("a"), link("b"), joint("j", "fixed", "a", "b", xyz=("X",)))
NUMBERS = [
    ("a.urdf", ORIGIN, "1 x 3", [1, 0, 3], "<origin xyz> of j has 'x', which is no number: .* 0"),
    ("a.urdf", ORIGIN, "1 1.5f 3", [1, 1.5, 3], "'1.5f', .* takes 1.5, its beginning"),
    ("a.urdf", ORIGIN, "${pi} 2 3", [0, 2, 3], r"'\$\{pi\}', which is no number"),
    ("a.urdf", ORIGIN, "1,2,3", [0, 0, 0], "<origin xyz> of j has '1,2,3' for 3 numbers: .* 0 for all"),
    ("a.urdf", ORIGIN, "1 2", [0, 0, 0], "'1 2' for 3 numbers"),
    ("a.sdf", sdf_of(sdf_model("m", pose="X")), "1 x 3 0 0 0", [1, 0, 3], "<pose> of m has 'x'"),
    ("a.xml", mjcf_of(mjcf_body("b", pos="X")), "1 x 3", [1, 0, 3], "<body pos> of b has 'x'"),
    ("a.xml", mjcf_of(mjcf_body("b", pos="X")), "1 2", [0, 0, 0], "<body pos> of b has '1 2' for 3"),
]  # fmt: skip


@pytest.mark.parametrize(("file", "text", "number", "position", "words"), NUMBERS)
def test_what_is_no_number_is_warned_of(load, file, text, number, position, words):
    entity, told = load(file, text.replace("X", number))
    assert entity.links[-1].position == pytest.approx(position)
    assert len(told) == 1
    with pytest.warns(UserWarning, match=f"{file} .*{words}"):
        warnings.warn(told[0], stacklevel=1)


def test_a_pose_of_three_numbers(load):
    """PyBullet takes the angles from anywhere in the memory."""
    with pytest.raises(SceneError, match="<pose> has 3 numbers, not 6: '1 2 3'"):
        load("a.sdf", sdf_of(sdf_model("m", pose="1 2 3")))
    link = sdf_link().replace(">", "><pose degrees='true'>1 2 3</pose>", 1)
    with pytest.raises(SceneError, match="the <pose> of 'l' has 3 numbers, not 6"):
        load("a.sdf", sdf_of(sdf_model("m", link)))


@pytest.mark.slow
def test_many_doubts_are_few_words(load):
    joints = [joint(f"j{n}", "fixed", "a", f"b{n}", xyz=("x", 1, 2)) for n in range(9)]
    links = [link("a"), *(link(f"b{n}") for n in range(9))]
    _, (told,) = load("a.urdf", robot(*links, *joints))
    assert told.endswith("4 more such numbers")
    drawn = "".join(shape("visual", f"{number}.obj") for number in range(9))
    _, (told,) = load("b.urdf", robot(link("a", shapes=drawn + collision(BOX))))
    assert told.endswith("4 more such meshes")


# -- meshes --------------------------------------------------------------------------------------


@pytest.fixture
def meshes(tmp_path):
    """A box as a mesh in several formats."""
    box = trimesh.creation.box(bounds=[LOW, HIGH])
    for suffix in ("glb", "ply", "off", "stl"):
        box.export(tmp_path / f"box.{suffix}")
    (tmp_path / "ascii.stl").write_text(trimesh.exchange.stl.export_stl_ascii(box))
    for name, content in trimesh.Scene(box).export(file_type="gltf").items():
        (tmp_path / name).write_bytes(content)
    (tmp_path / "box.obj").write_text(box_obj(LOW, HIGH))
    return tmp_path


def shape(kind, name):
    return f'<{kind}><geometry><mesh filename="{name}"/></geometry></{kind}>'


FORMATS = ["box.glb", "model.gltf", "box.ply", "box.off", "ascii.stl", "box.stl", "box.obj"]


@pytest.mark.slow
@pytest.mark.parametrize("name", FORMATS)
def test_meshes_of_other_formats(load, meshes, name):
    shapes = shape("visual", name) + collision(BOX)
    drawn, told = load("a.urdf", robot(link("a", shapes=shapes)))
    assert not told
    assert [corner[2] for corner in drawn.aabb] == pytest.approx([-0.5, 0.5])
    (visual,) = pybullet.getVisualShapeData(0, physicsClientId=client_of(load.world))
    bounds = trimesh.load_mesh(visual[4].decode()).bounds
    assert np.allclose(bounds, [LOW, HIGH])
    solid, told = load("b.urdf", robot(link("a", shapes=shape("collision", name))))
    assert not told
    assert np.allclose(solid.aabb, [LOW, HIGH], atol=1e-6)


@pytest.mark.parametrize(
    "name", ["none.obj", "none.glb", "pointer.stl", "pointer.dae", "empty.obj"]
)
def test_a_drawing_that_cannot_be_read_is_left_out(load, tmp_path, name):
    (tmp_path / f"pointer{Path(name).suffix}").write_text(POINTER)
    (tmp_path / "empty.obj").write_text("")
    entity, (told,) = load(
        "a.urdf", robot(link("a", shapes=shape("visual", name) + collision(BOX)))
    )
    assert f"a.urdf (a): the mesh {name!r} of a is not drawn: " in told
    assert ("git lfs pull" in told) == name.startswith("pointer")
    assert entity.aabb[1] == pytest.approx([0.5, 0.5, 0.5])


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["pointer.obj", "pointer.stl", "pointer.dae", "empty.stl", "empty.obj"]
)
def test_a_shape_that_cannot_be_read_is_warned_of(load, tmp_path, name):
    (tmp_path / f"pointer{Path(name).suffix}").write_text(POINTER)
    (tmp_path / f"empty{Path(name).suffix}").write_text("")
    _, (told,) = load("a.urdf", robot(link("a", shapes=shape("collision", name))))
    assert f"a.urdf (a): the mesh {name!r} of a does not collide: " in told
    model = sdf_model("m", sdf_link("a", geometry=f"<mesh><uri>{name}</uri></mesh>"))
    _, (told,) = load("a.sdf", sdf_of(model))
    assert f"the mesh {name!r} of c does not collide: " in told


def test_a_collada_file_without_a_scene_is_warned_of(load, tmp_path):
    from tests.simulators.test_foreign_scenes import COLLADA

    dae = COLLADA.replace('<scene><instance_visual_scene url="#s"/></scene>', "")
    (tmp_path / "m.dae").write_text(dae)
    _, (told,) = load("a.urdf", robot(link("a", shapes=shape("collision", "m.dae"))))
    assert "(a): cannot extract mesh from '" in told


@pytest.mark.parametrize("name", ["none.obj", "none.glb"])
def test_a_shape_that_is_not_there_is_an_error(load, name):
    with pytest.raises(SceneError, match=name):
        load("a.urdf", robot(link("a", shapes=shape("collision", name))))


@pytest.mark.slow
def test_files_of_a_repaired_model_are_where_they_were(load, meshes):
    """The model that PyBullet gets is in another folder."""
    (meshes / "robots" / "one").mkdir(parents=True)
    for name in ("package://box.obj", "../../box.obj", str(meshes / "box.obj"), "file://box.obj"):
        model = robot(link("a", shapes=shape("collision", name))).replace(
            "<link", "<gz:a/><link", 1
        )
        entity, told = load("robots/one/a.urdf", model)
        assert not told
        assert np.allclose(entity.aabb, [LOW, HIGH], atol=1e-6)
    (meshes / "parts").mkdir()
    (meshes / "box.obj").rename(meshes / "parts" / "box.obj")
    geom = '<geom type="mesh" mesh="m"/>'
    assets = '<compiler meshdir="parts/"/><asset><mesh name="m" file="box.obj"/></asset>'
    text = mjcf_of(mjcf_body("b", parts=geom), before=assets)
    plain, _ = load("plain.xml", text)
    for old, new in (
        ("<worldbody>", "<gz:a/><worldbody>"),
        ('"parts/"', '"parts"'),  # PyBullet would look for partsbox.obj
        ('meshdir="parts/"', 'assetdir="parts"'),
    ):
        entity, told = load("a.xml", text.replace(old, new))
        assert not told
        assert np.subtract(*reversed(entity.aabb)) == pytest.approx([1, 2, 3], abs=0.05)
        assert np.allclose(entity.aabb, plain.aabb)


def test_a_gltf_file_names_files_of_its_folder_only(load, meshes):
    (meshes / "inside").mkdir()
    content = json.loads((meshes / "model.gltf").read_text())
    for buffer in content["buffers"]:
        buffer["uri"] = "../" + buffer["uri"]
    (meshes / "inside" / "model.gltf").write_text(json.dumps(content))
    shapes = shape("visual", "inside/model.gltf") + collision(BOX)
    _, (told,) = load("a.urdf", robot(link("a", shapes=shapes)))
    assert "the mesh 'inside/model.gltf' of a is not drawn: " in told
    assert "is not beside it" in told


@pytest.mark.slow
def test_a_copy_of_a_repaired_model(load, meshes):
    entity, _ = load("a.urdf", robot(link("a", shapes=shape("collision", "box.glb"))))
    world = load.world
    (copy,) = world.excerpt(world)
    assert np.allclose(copy.aabb, entity.aabb)
    world.save(meshes / "saved")
    with ssduck.load(meshes / "saved") as ss:
        (again,) = ss.worlds[0]
        assert np.allclose(again.aabb, entity.aabb, atol=1e-6)


# -- joints --------------------------------------------------------------------------------------


def chain(count):
    parts = [link(f"l{number}") for number in range(count + 1)]
    parts += [
        joint(f"j{n}", "fixed" if n % 2 else "revolute", f"l{n}", f"l{n + 1}", limit=LIMIT)
        for n in range(count)
    ]
    return robot(*(f"{part}\n" for part in parts))


@pytest.mark.slow
def test_as_many_joints_as_pybullet_has_room_for(load):
    entity, _ = load("a.urdf", chain(127))
    assert len(entity.links) == 128


def test_more_joints_are_an_error_that_names_mujoco(load, write, client):
    with pytest.raises(SceneError, match=r'has 128 joints, .* 127 .*simulator="mujoco"'):
        load("a.urdf", chain(128))
    pybullet.loadURDF(str(write("b.urdf", chain(128))), physicsClientId=client)
    with pytest.raises(SimulatorError, match="'model' has 128 joints"):
        World.attach(client)


def test_continuous_joints_have_no_range(load):
    """PyBullet keeps their ranges, URDF does not."""
    wheel = joint("j", "continuous", "a", "b", limit='<limit lower="0" upper="0" effort="3"/>')
    entity, told = load("a.urdf", robot(link("a"), link("b"), wheel))
    assert not told
    (turned,) = entity.joints
    assert (turned.lower, turned.upper) == (None, None)
    entity.move(joints={"j": 7.0})
    load.world.tick()
    (turned,) = entity.joints
    assert turned.position == pytest.approx(7.0)


def test_an_attribute_where_sdf_has_a_text(load):
    """As in a gripper of PyBullet's own; it would crash PyBullet."""
    model = sdf_model("m", sdf_link(extra='<contact><lateral_friction value="0.25"/></contact>'))
    load("a.sdf", sdf_of(model))
    assert pybullet.getDynamicsInfo(0, -1, client_of(load.world))[1] == 0.25
    for tag in ("rolling_friction", "spinning_friction", "restitution", "stiffness"):
        model = sdf_model("m", sdf_link(extra=f"<contact><{tag}/></contact>"))
        with pytest.raises(SceneError, match=f"a <{tag}> is empty"):
            load("a.sdf", sdf_of(model))


def test_mujoco_reads_what_expat_refuses(write):
    pytest.importorskip("mujoco")
    path = write("a.urdf", TOLERATED["two hyphens in a comment"].replace("<link", "<gz:a/><link"))
    with ssduck.load(path, simulator="mujoco") as ss:
        (entity,) = ss.worlds[0]
        assert entity.aabb[1] == pytest.approx([0.5, 0.5, 0.5])


@pytest.mark.slow
def test_mujoco_keeps_the_names_of_links_at_fixed_joints(write):
    pytest.importorskip("mujoco")
    with ssduck.load(write("a.urdf", chain(140)), simulator="mujoco") as ss:
        (entity,) = ss.worlds[0]
        assert [link.name for link in entity.links] == [f"l{number}" for number in range(141)]


# -- names ---------------------------------------------------------------------------------------

WORDS = ["main", "temp", "memory", "system", "select", "this", "as"]


@pytest.mark.slow
@pytest.mark.parametrize("word", WORDS)
def test_a_file_whose_name_is_a_word(write, word):
    path = write(f"{word}.urdf", ROOT)
    with pytest.warns(UserWarning, match=f"the world is 'world_{word}'; load"):
        ss = ssduck.load(path)
    with ss:
        assert ss.sql(f"SELECT count(*) FROM world_{word}.entities").fetchall() == [(1,)]
        assert len(ss.eval(f"SELECT id FROM world_{word} AS list;")) == 1


@pytest.mark.slow
def test_the_name_of_a_world(write):
    path = write("main.urdf", ROOT)
    with ssduck.load(path, name="lab") as ss:
        assert ss["lab"].name == "lab"
        assert len(ss.eval("SELECT id FROM lab AS list;")) == 1
        assert "main" not in ss
    for name in ("select", "main", "a b", ""):
        with pytest.raises(ArgumentError):
            ssduck.load(path, name=name)


@pytest.mark.slow
@pytest.mark.filterwarnings("default")
def test_commands_find_such_names_too(write):
    path = write("main.urdf", ROOT)
    result = ssduck_("query", str(path), "SELECT id FROM world_main AS list;")
    assert "model" in result.stdout
    assert "the world is 'world_main'" in result.stderr


def test_world_files_are_sdf(load):
    entity, _ = load("a.world", sdf_of(sdf_model("m", pose="1 2 3 0 0 0")))
    assert entity.position == pytest.approx([1, 2, 3])
