"""Scenes of strangers read files of their own folder only, wherever a simulator looks for them."""

from __future__ import annotations

import os
import shutil

import pytest

import ssduck
from ssduck.errors import SceneError
from ssduck.simulators import scene_files
from ssduck.simulators.scenes import find_scene, shipped_scenes
from tests.support.cases import sampled

OBJ = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
MESH = '<mesh name="m" file="m.obj"/>'
BODY = '<body name="stolen"><geom type="mesh" mesh="m"/></body>'
# The files of a MuJoCo scene: stage.xml has <mujoco> around the first.
INCLUDED = "<mujoco><asset>{}</asset></mujoco>"
FORMS = {
    "a mesh": {"stage.xml": f"<asset>{MESH}</asset>", "m.obj": "->secret.obj"},
    "an included text": {
        "stage.xml": '<include file="inc.txt"/>',
        "inc.txt": INCLUDED.format('<mesh name="m" file="{outside}/secret.obj"/>'),
    },
    "an included file without a suffix": {
        "stage.xml": '<include file="inc"/>',
        "inc": INCLUDED.format('<mesh name="m" file="{outside}/secret.obj"/>'),
    },
    "an include in an included text": {
        "stage.xml": '<include file="inc.txt"/>',
        "inc.txt": '<mujoco><include file="{outside}/inc.xml"/></mujoco>',
    },
    "an include of a namespace": {
        "stage.xml": '<include xmlns="a" file="inc.txt"/>',
        "inc.txt": INCLUDED.format('<mesh name="m" file="{outside}/secret.obj"/>'),
    },
    "a model of another suffix": {
        "stage.xml": '<asset><model name="c" file="child.txt" content_type="text/xml"/></asset>'
        '<worldbody><attach model="c" prefix="p"/></worldbody>',
        "child.txt": '<mujoco><asset><mesh name="m" file="{outside}/secret.obj"/></asset></mujoco>',
    },
    "a folder of meshes for an included file": {
        "stage.xml": '<compiler meshdir="link"/><include file="inc.xml"/>',
        "inc.xml": INCLUDED.format(MESH),
        "m.obj": OBJ,
        "link": "->folder",
    },
    "a folder of meshes in an included file": {
        "stage.xml": f'<include file="inc.xml"/><asset>{MESH}</asset>',
        "inc.xml": '<mujoco><compiler meshdir="link"/></mujoco>',
        "m.obj": OBJ,
        "link": "->folder",
    },
    "an included file in a folder": {
        "stage.xml": '<include file="sub/inc.xml"/>',
        "sub/inc.xml": INCLUDED.format(MESH),
        "sub/m.obj": OBJ,
        "m.obj": "->secret.obj",
    },
    "names without their folders": {
        "stage.xml": '<compiler strippath="true"/><asset><mesh name="m" file="sub/m.obj"/></asset>',
        "sub/m.obj": OBJ,
        "m.obj": "->secret.obj",
    },
    "a name with a tab": {
        "stage.xml": '<asset><mesh name="m" file="a\tm.obj"/></asset>',
        "a m.obj": OBJ,
        "a\tm.obj": "->secret.obj",
    },
}


def write(folder, outside, files):
    """Writes files by their paths; -> begins a link to a file outside, | is a pipe."""
    for name, content in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        if content.startswith("->"):
            path.symlink_to(outside / content[2:])
        elif content == "|":
            os.mkfifo(path)
        else:
            path.write_text(content.replace("{outside}", str(outside)))


@pytest.fixture
def outside(tmp_path):
    outside = tmp_path / "outside"
    write(
        outside,
        outside,
        {
            "secret.obj": OBJ,
            "folder/m.obj": OBJ,
            "inc.xml": INCLUDED.format(""),
            "folder/p.png": "",
            "s.mtl": "newmtl a\n",
        },
    )
    return outside


@pytest.fixture
def folder(tmp_path):
    folder = tmp_path / "scene"
    folder.mkdir()
    return folder


def strict(path, **options):
    return ssduck.load(path, limits=ssduck.Limits.strict(), **options)


def mjcf(files):
    """Returns the files of a MuJoCo scene whose body has the mesh."""
    stage = files["stage.xml"]
    body = "" if "attach" in stage else f"<worldbody>{BODY}</worldbody>"
    return {**files, "stage.xml": f"<mujoco>{stage}{body}</mujoco>"}


@pytest.mark.parametrize("form", FORMS)
def test_mujoco_reads_no_file_outside(folder, outside, form):
    write(folder, outside, mjcf(FORMS[form]))
    with pytest.raises(SceneError, match=r"is not in .*files elsewhere are not read") as caught:
        strict(folder / "stage.xml", simulator="mujoco")
    assert str(outside) in str(caught.value)


INSIDE = {
    "an included file in a folder": {
        "stage.xml": '<include file="sub/inc.txt"/>',
        "sub/inc.txt": INCLUDED.format(MESH),
        "m.obj": OBJ,
    },
    "a folder of meshes in an included file": {
        "stage.xml": f'<include file="inc.xml"/><asset>{MESH}</asset>',
        "inc.xml": '<mujoco><compiler meshdir="meshes"/></mujoco>',
        "meshes/m.obj": OBJ,
    },
    "names without their folders": {
        "stage.xml": '<compiler strippath="true"/><asset><mesh name="m" file="sub/m.obj"/></asset>',
        "m.obj": OBJ,
    },
    "links outside of other names": {
        "stage.xml": f"<asset>{MESH}</asset>",
        "m.obj": OBJ,
        "other.obj": "->secret.obj",
        "venv": "->folder",
    },
}


@pytest.mark.slow
@sampled("form", INSIDE, every=2)
def test_files_inside_are_read(folder, outside, form):
    pytest.importorskip("mujoco")
    write(folder, outside, mjcf(INSIDE[form]))
    with strict(folder / "stage.xml", simulator="mujoco") as ss:
        assert ss.eval("SELECT id(this) FROM stage AS list;") == ["stolen"]


@pytest.mark.slow
def test_a_link_inside_is_followed(folder, outside):
    pytest.importorskip("mujoco")
    files = {"stage.xml": f"<asset>{MESH}</asset>", "meshes/n.obj": OBJ}
    write(folder, outside, mjcf(files))
    (folder / "m.obj").symlink_to(folder / "meshes" / "n.obj")
    (folder / "meshes" / "loop").symlink_to(folder)
    with strict(folder / "stage.xml", simulator="mujoco") as ss:
        assert ss.eval("SELECT id(this) FROM stage AS list;") == ["stolen"]


def test_another_encoding_is_refused(folder, outside):
    """MuJoCo takes the bytes of a name as they are."""
    head = '<?xml version="1.0" encoding="latin-1"?>'
    text = f'{head}<mujoco><asset><mesh name="m" file="ä.obj"/></asset></mujoco>'
    (folder / "stage.xml").write_bytes(text.encode("latin-1"))
    (folder / "ä.obj").write_text(OBJ)
    (folder / os.fsdecode(b"\xe4.obj")).symlink_to(outside / "secret.obj")
    with pytest.raises(SceneError, match=r"stage.xml cannot be read"):
        strict(folder / "stage.xml", simulator="mujoco")


URDF = (
    '<robot name="t"><link name="l"><inertial><mass value="1"/>'
    '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
    '<visual><geometry><mesh filename="m.obj"/></geometry></visual>'
    '<collision><geometry><mesh filename="m.obj"/></geometry></collision></link></robot>'
)
SECOND = "newmtl a\nmap_Kd {}\n"
PICTURES = {
    "a picture": ("f.mtl", {"f.mtl": SECOND.format("p.png"), "p.png": "->folder/p.png"}),
    "a picture after options": (
        "f.mtl",
        {"f.mtl": SECOND.format("-s 1 1 1 p.png"), "p.png": "->folder/p.png"},
    ),
    "a picture before options": (
        "f.mtl",
        {"f.mtl": SECOND.format("{outside}/folder/p.png -s 1 1 1")},
    ),
    "a picture in a linked folder": (
        "f.mtl",
        {"f.mtl": SECOND.format("x/p.png"), "x": "->folder"},
    ),
    "a picture with a blank": (
        "f.mtl",
        {"f.mtl": SECOND.format("a p.png"), "a p.png": "->folder/p.png"},
    ),
    "materials": ("f.mtl", {"f.mtl": "->s.mtl"}),
    "materials with a blank": ("f g.mtl", {"f": "", "f g.mtl": "->s.mtl"}),
    "materials on two lines": ("\\\nf.mtl", {"f.mtl": "->s.mtl"}),
    "materials elsewhere": ("{outside}/s.mtl", {}),
    "materials on a pipe": ("f.mtl", {"f.mtl": "|"}),
    "a picture on a pipe": ("f.mtl", {"f.mtl": SECOND.format("p.png"), "p.png": "|"}),
    "a long line": (" ".join(["f.mtl"] * 17), {}),
}


@pytest.mark.parametrize("form", PICTURES)
def test_materials_and_pictures_are_in_the_folder(folder, outside, form):
    name, files = PICTURES[form]
    mesh = f"mtllib {name}\nusemtl a\n{OBJ}"
    write(folder, outside, {"t.urdf": URDF, "m.obj": mesh, **files})
    words = r"files elsewhere are not read|is no regular file|has more than 16 words"
    with pytest.raises(SceneError, match=words):
        strict(folder / "t.urdf", simulator="pybullet")


def test_a_mesh_is_a_regular_file(folder, outside):
    write(folder, outside, {"t.urdf": URDF, "m.obj": "|"})
    with pytest.raises(SceneError, match=r"m.obj is no regular file"):
        strict(folder / "t.urdf")


def test_a_picture_of_collada_is_in_the_folder(folder, outside):
    files = {
        "t.urdf": URDF.replace("m.obj", "m.dae"),
        "m.dae": '<COLLADA xmlns="c"><!-- a --><init_from>&#47;etc/p.png</init_from></COLLADA>',
    }
    write(folder, outside, files)
    with pytest.raises(SceneError, match=r"m.dae: '/etc/p.png' is not in"):
        strict(folder / "t.urdf")


@pytest.mark.slow
@pytest.mark.parametrize("above", ["scene/../m.obj", "work/m.obj", "data/m.obj"])
def test_a_file_of_that_name_elsewhere_is_refused(folder, outside, monkeypatch, tmp_path, above):
    """PyBullet looks into the working directory and the folders above first."""
    write(folder, outside, {"t.urdf": URDF, "m.obj": OBJ})
    (tmp_path / "work").mkdir()
    (tmp_path / "data").mkdir()
    monkeypatch.chdir(tmp_path / "work")
    with strict(folder / "t.urdf") as ss:
        assert ss.eval("SELECT count(*) AS n FROM t AS value;") == 1
    (tmp_path / above).write_text(OBJ)
    with pytest.raises(SceneError, match=r"m.obj' is not in"):
        strict(folder / "t.urdf")


@pytest.mark.slow
def test_materials_inside_are_read(folder, outside):
    files = {
        "t.urdf": URDF,
        "m.obj": f"mtllib f.mtl\nusemtl a\n{OBJ}",
        "f.mtl": SECOND.format("-s 1 1 1 gone.png"),
    }
    write(folder, outside, files)
    with strict(folder / "t.urdf", simulator="pybullet") as ss:
        assert ss.eval("SELECT count(*) AS n FROM t AS value;") == 1


@pytest.mark.slow
@sampled("name", shipped_scenes(), every=3)
def test_copies_of_the_shipped_scenes_are_read(tmp_path, name):
    shutil.copytree(shipped_scenes()[name].parent, tmp_path / name)
    with strict(tmp_path / name / "scene.toml") as ss:
        assert ss.eval(f"SELECT count(*) AS n FROM {name} AS value;") > 0


SDF = (
    '<sdf version="1.6"><model name="m"><link name="l"><!-- the body --><collision name="c">'
    "<geometry><mesh><uri>{}</uri></mesh></geometry></collision></link></model></sdf>"
)
# The names as PyBullet and ElementTree read them differ: the first is a link, the other a file.
UNEQUAL_NAMES = {
    "m.obj<!-- -->x": ("m.obj", "m.objx"),
    "m.obj<?a b?>x": ("m.obj", "m.objx"),
    "m.obj<![CDATA[x]]>": ("m.obj", "m.objx"),
    "m.obj<b/>x": ("m.obj", "m.objx"),
    " m.obj": (" m.obj", "m.obj"),
    "\nm.obj": ("\nm.obj", "m.obj"),
    "m.obj ": ("m.obj ", "m.obj"),
}


@pytest.mark.parametrize("main", ["t.sdf", "scene.toml"])
@pytest.mark.parametrize("text", UNEQUAL_NAMES)
def test_a_uri_of_sdf_is_one_plain_text(folder, outside, text, main):
    link, file = UNEQUAL_NAMES[text]
    files = {
        "scene.toml": '[[body]]\nname = "b"\nsdf = "t.sdf"\n',
        "t.sdf": SDF.format(text),
        link: "->secret.obj",
        file: OBJ,
    }
    write(folder, outside, files)
    with pytest.raises(
        SceneError, match=r"t.sdf: <(uri> has blanks, comments|!\[CDATA\[\]\]> is not)"
    ):
        strict(folder / main, simulator="pybullet")


@pytest.mark.slow
def test_a_plain_uri_of_sdf_is_read(folder, outside):
    pytest.importorskip("pybullet")
    write(folder, outside, {"t.sdf": SDF.format("m.obj"), "m.obj": OBJ})
    with strict(folder / "t.sdf", simulator="pybullet") as ss:
        assert ss.eval("SELECT count(*) AS n FROM t AS value;") == 1


def test_a_picture_of_collada_is_one_plain_text(folder, outside):
    files = {
        "t.urdf": URDF.replace("m.obj", "m.dae"),
        "m.dae": "<COLLADA><init_from>p.png<!-- -->x</init_from></COLLADA>",
        "p.png": "->folder/p.png",
    }
    write(folder, outside, files)
    with pytest.raises(SceneError, match=r"m.dae: <init_from> has blanks, comments"):
        strict(folder / "t.urdf")


ELSEWHERE = '[[body]]\nname = "secret"\nbox = [1, 1, 1]\nmass = 1.0\n'


@pytest.mark.parametrize("main", ["", "scene.toml", "t.urdf"])
@pytest.mark.parametrize("content", [ELSEWHERE, "secret: not TOML", URDF])
def test_a_scene_that_is_a_link_outside_is_not_read(folder, outside, main, content):
    (outside / "secret").write_text(content)
    (folder / (main or "scene.toml")).symlink_to(outside / "secret")
    with pytest.raises(SceneError, match=r"outside/secret' is not in") as caught:
        strict(folder / main)
    assert "TOML" not in str(caught.value)


@pytest.mark.slow
def test_a_scene_that_is_a_link_inside_is_read(folder):
    (folder / "other.toml").write_text(ELSEWHERE)
    (folder / "scene.toml").symlink_to(folder / "other.toml")
    with strict(folder) as ss:
        assert ss.sql("SELECT name FROM entities").fetchall() == [("secret",)]


NAMING = (
    '<robot name="r"><link name="b"><visual><geometry><mesh filename="a.obj"/></geometry></visual>'
    "</link></robot>"
)
LINES_OF_NAMES = 30  # of materials, each of 16 words, which stand for 136 names


def many_names(folder):
    lines = (f"mtllib {' '.join(f'w{i}_{k}' for k in range(16))}\n" for i in range(LINES_OF_NAMES))
    (folder / "a.obj").write_text(OBJ + "".join(lines))
    (folder / "m.urdf").write_text(NAMING)
    return folder / "m.urdf"


def many_folders(folder):
    meshes = "".join(f'<mesh name="m{i}" file="m{i}.obj"/>' for i in range(100))
    folders = "".join(f'<compiler meshdir="d{i}"/>' for i in range(60))
    for i in range(100):
        (folder / f"m{i}.obj").write_text(OBJ)
    (folder / "m.xml").write_text(f"<mujoco>{folders}<asset>{meshes}</asset></mujoco>")
    return folder / "m.xml"


def large_mesh(folder):
    (folder / "a.obj").write_text(OBJ)
    os.truncate(folder / "a.obj", scene_files.MAX_READ)
    (folder / "m.urdf").write_text(NAMING)
    return folder / "m.urdf"


def large_scene(folder):
    (folder / "scene.toml").write_text("#" * (scene_files.MAX_TOML + 1))
    return folder / "scene.toml"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("make", "words"),
    [
        (many_names, "more than 20,000 places"),
        (many_folders, "more than 20,000 places"),
        (large_mesh, "at most 134,217,728 bytes in all"),
        (large_scene, "more than 4,194,304 bytes"),
    ],
)
def test_files_whose_check_would_take_long_are_refused(tmp_path, make, words, monkeypatch):
    monkeypatch.setattr(scene_files, "MAX_PLACES", 20_000)
    scene = make(tmp_path)
    for trial in (True, False):
        with pytest.raises(SceneError, match=words):
            ssduck.load(scene, limits=ssduck.Limits.strict(trial=trial))


@pytest.mark.long
def test_the_bounds_of_what_is_checked(tmp_path, monkeypatch):
    scene = find_scene(many_names(tmp_path))
    monkeypatch.setattr(scene_files, "MAX_PLACES", 10**7)
    checks = scene_files._SceneFiles(tmp_path)
    checks.add_model(scene.path, scene.path)
    assert len(checks.check()) == 2
    size = sum(file.stat().st_size for file in tmp_path.iterdir())
    for name, bound in (("MAX_PLACES", checks._place_count), ("MAX_READ", size)):
        with monkeypatch.context() as changed:
            changed.setattr(scene_files, name, bound)
            scene_files.check_files_inside(scene)
            changed.setattr(scene_files, name, bound - 1)
            with pytest.raises(SceneError, match=r"\(Limits: files\)"):
                scene_files.check_files_inside(scene)
