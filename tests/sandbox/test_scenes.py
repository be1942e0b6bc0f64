"""Scenes of strangers: they read their folder alone, and what crashes a simulator is an error."""

from __future__ import annotations

import json
import shutil
from functools import partial
from pathlib import Path

import pytest

import ssduck
from ssduck.errors import (
    ArgumentError,
    LimitError,
    SceneError,
    SelectScriptError,
    UnsupportedError,
)
from ssduck.limits import Limits
from ssduck.sandbox import opening
from ssduck.simulators.scenes import shipped_scenes
from tests.support.cases import generated, sampled
from tests.support.urdf import collision, joint, link, robot
from tools.fuzz_scenes import Fuzz
from tools.fuzzing.models import DAE, FORMATS, VISUAL_MESH

# PyBullet looks for the geometry of no name; no check of ssduck knows of this.
CRASHING = DAE.replace('<instance_geometry url="#g"/>', "<instance_geometry/>", 1)
BOX = robot(link("base", shapes=collision('<box size="1 1 1"/>')))
ENDED = "the process of the program ended; .* crashed"


@pytest.fixture
def folder(tmp_path):
    """A folder for a scene, beside another that it is not to read."""
    folder = tmp_path / "scene"
    folder.mkdir()
    write(tmp_path / "outside", {"secret.obj": obj(5), "m.obj": obj(5), "o.urdf": BOX})
    (tmp_path / "outside" / "inc.xml").write_text(INCLUDED.format(MESH))
    return folder


def obj(size):
    """Returns a tetrahedron of some size, m."""
    corners = "".join(f"v {x} {y} {z}\n" for x, y, z in ((0, 0, 0), (size, 0, 0), (0, size, 0)))
    return f"{corners}v 0 0 {size}\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"


def write(folder, files):
    """Writes files by their paths; -> begins a link to a file outside."""
    outside = folder.parent / "outside"
    for name, content in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        if content.startswith("->"):
            path.symlink_to(outside / content[2:])
        else:
            path.write_text(content.replace("{outside}", str(outside)))


MESH = '<mesh name="m" file="m.obj"/>'
BODY = '<worldbody><body name="b"><geom type="mesh" mesh="m"/></body></worldbody>'
INCLUDED = "<mujoco><asset>{}</asset></mujoco>"
# The files of scenes: stage.xml has <mujoco> around the first.
FORMS = {
    "a mesh": {"stage.xml": f"<asset>{MESH}</asset>", "m.obj": "->secret.obj"},
    "an absolute path": {
        "stage.xml": '<asset><mesh name="m" file="{outside}/secret.obj"/></asset>',
    },
    "a folder of meshes": {
        "stage.xml": f'<compiler meshdir="../outside"/><asset>{MESH}</asset>',
    },
    "an included text": {
        "stage.xml": '<include file="inc.txt"/>',
        "inc.txt": INCLUDED.format('<mesh name="m" file="{outside}/secret.obj"/>'),
    },
    "an include elsewhere": {"stage.xml": '<include file="../outside/inc.xml"/>', "m.obj": obj(1)},
    "a folder of meshes in an included file": {
        "stage.xml": f'<include file="inc.xml"/><asset>{MESH}</asset>',
        "inc.xml": '<mujoco><compiler meshdir="link"/></mujoco>',
        "m.obj": obj(1),
        "link": "->.",
    },
    "an included file in a folder": {
        "stage.xml": '<include file="sub/inc.xml"/>',
        "sub/inc.xml": INCLUDED.format(MESH),
        "sub/m.obj": obj(1),
        "m.obj": "->secret.obj",
    },
    "names without their folders": {
        "stage.xml": '<compiler strippath="true"/><asset><mesh name="m" file="sub/m.obj"/></asset>',
        "sub/m.obj": obj(1),
        "m.obj": "->secret.obj",
    },
}
URDF = robot(link("base", shapes=collision('<mesh filename="{}"/>')))
SDF = (
    '<sdf version="1.6"><model name="m"><link name="l"><collision name="c"><geometry><mesh>'
    "<uri>{}</uri></mesh></geometry></collision></link></model></sdf>"
)
SCENE = '[[body]]\nname = "a"\nurdf = "{}"\n'
NAMES = {
    "stage.urdf": ("../outside/m.obj", "{outside}/m.obj", "file://{outside}/m.obj", "m.obj"),
    "stage.sdf": ("../outside/m.obj", "model://{outside}/m.obj", "sub/m.obj"),
    "stage.toml": ("../outside/o.urdf", "{outside}/o.urdf", "sub/o.urdf"),
}
TEXTS = {"stage.urdf": URDF, "stage.sdf": SDF, "stage.toml": SCENE}
CASES = [("stage.xml", form) for form in FORMS]
CASES += [(file, name) for file, names in NAMES.items() for name in names]


@sampled(("file", "form"), CASES, every=3)
def test_no_file_outside_is_read(zygote, folder, file, form):
    """What is there is as large as the file in the folder, or there is an error."""
    if file == "stage.xml":
        pytest.importorskip("mujoco")
        parts = FORMS[form]
        write(folder, {**parts, file: f"<mujoco>{parts[file]}{BODY}</mujoco>"})
    else:
        write(folder, {file: TEXTS[file].replace("{}", form), "m.obj": "->m.obj", "sub": "->."})
    try:
        with opening.load(folder / file, zygote=zygote) as ss:
            assert ss.sql("SELECT max(xmax - xmin) < 2 FROM shapes").fetchall() == [(True,)]
            assert file == "stage.xml"
    except SelectScriptError as error:
        assert isinstance(error, SceneError)


INSIDE = {
    "an included file in a folder": {
        "stage.xml": '<include file="sub/inc.txt"/>',
        "sub/inc.txt": INCLUDED.format(MESH),
        "m.obj": obj(1),
    },
    "a folder of meshes in an included file": {
        "stage.xml": f'<include file="inc.xml"/><asset>{MESH}</asset>',
        "inc.xml": '<mujoco><compiler meshdir="meshes"/></mujoco>',
        "meshes/m.obj": obj(1),
    },
    "links outside of other names": {
        "stage.xml": f"<asset>{MESH}</asset>",
        "m.obj": obj(1),
        "other.obj": "->secret.obj",
        "venv": "->.",
    },
}


@sampled("form", INSIDE, every=3)
def test_files_inside_are_read(zygote, folder, form):
    pytest.importorskip("mujoco")
    parts = INSIDE[form]
    write(folder, {**parts, "stage.xml": f"<mujoco>{parts['stage.xml']}{BODY}</mujoco>"})
    with opening.load(folder / "stage.xml", zygote=zygote) as ss:
        assert ss.eval("SELECT id FROM stage AS list;") == ["b"]


@pytest.mark.slow
@sampled("name", shipped_scenes(), every=3)
def test_copies_of_the_shipped_scenes_are_read(zygote, tmp_path, name):
    shutil.copytree(shipped_scenes()[name].parent, tmp_path / name)
    with opening.load(tmp_path / name, zygote=zygote) as ss:
        assert ss.eval(f"SELECT count(*) AS n FROM {name} AS value;") > 0


def test_a_crash_is_an_error_and_the_host_lives(zygote, folder):
    write(folder, {"c.urdf": VISUAL_MESH % "c.dae", "c.dae": CRASHING, "b.urdf": BOX})
    (folder / "lab.toml").write_text('[[body]]\nname="c"\nurdf="c.urdf"\n')
    for name in ("c.urdf", "lab.toml"):
        with pytest.raises(LimitError, match=rf"{name}: {ENDED}"):
            opening.load(folder / name, simulator="pybullet", zygote=zygote)
    with opening.load(folder / "b.urdf", zygote=zygote) as ss:
        assert ss.eval("SELECT id FROM b AS list;") == ["b"]


ATTACH = '<attach model="m" prefix="a"/>'
# MJCF files of a few lines that crash MuJoCo, or take more memory or time than there is.
BOMBS = {
    "a model that attaches itself": '<asset><model name="m" file="bomb.xml"/></asset>'
    f"<worldbody>{ATTACH}</worldbody>",
    "memory": '<size memory="100G"/>',
    "a texture": '<asset><texture name="t" type="2d" builtin="flat" width="100000" '
    'height="100000"/></asset>',
    "a sensor": '<sensor><user name="n" dim="2000000000"/></sensor>',
    "bodies": '<worldbody><replicate count="100000000" offset="1 0 0"><body><geom size=".1"/>'
    "</body></replicate></worldbody>",
}


@pytest.mark.slow
@sampled("name", BOMBS, every=3)
def test_a_bomb_is_an_error(zygote, folder, name):
    pytest.importorskip("mujoco")
    (folder / "bomb.xml").write_text(f"<mujoco>{BOMBS[name]}</mujoco>")
    with pytest.raises((LimitError, SceneError), match=r"bomb\.xml"):
        opening.load(folder / "bomb.xml", zygote=zygote)


def test_errors_are_those_of_loading(zygote, folder):
    model = robot(link("a"), link("b"), joint("door", "revolute", "a", "b"))
    write(folder, {"door.urdf": model, "b.urdf": BOX, "none.xml": "<mujoco><worldbody>"})
    scenes = {
        "joint": '[[body]]\nname="b"\nurdf="door.urdf"\njoints={dor=1}\n',
        "constraint": '[[body]]\nname="b"\nurdf="b.urdf"\n[[constraint]]\ntype="fixed"\non="b"\n'
        'link="bas"\n',
        "simulator": 'simulator="mujoco"\n[[body]]\nname="b"\nsdf="b.sdf"\n',
        "mjcf": '[[body]]\nmjcf="none.xml"\n',
    }
    for name, text in scenes.items():
        (folder / f"{name}.toml").write_text(text)
        errors = []
        for load in (ssduck.load, partial(opening.load, zygote=zygote)):
            with pytest.raises((SceneError, UnsupportedError)) as raised:
                load(folder / f"{name}.toml")
            errors.append((type(raised.value), raised.value.message, raised.value.suggestions))
        assert errors[0] == errors[1]
        assert errors[0][1]


@pytest.mark.slow
def test_what_the_caller_says_is_readable_is_read(folder, zygote):
    pytest.importorskip("mujoco")
    scene = folder / "stage.xml"
    asset = f'<asset><mesh name="m" file="{folder.parent}/outside/m.obj"/></asset>'
    scene.write_text(f"<mujoco>{asset}{BODY}</mujoco>")
    with pytest.raises(SceneError, match="cannot be loaded"):
        opening.load(scene, zygote=zygote)
    limits = Limits.strict(readable=[folder.parent / "outside" / "m.obj"])
    with opening.load(scene, limits=limits, zygote=zygote) as ss:
        assert ss.eval("SELECT count(*) FROM stage AS value;") == 1
    with pytest.raises(ArgumentError, match="list of paths"):
        Limits.strict(readable="m.obj")


# -- mutated files ---------------------------------------------------------------------------


@pytest.mark.slow
@sampled("format", FORMATS, every=len(FORMATS))
def test_a_mutated_file_is_loaded_or_an_error(format: str, tmp_path: Path) -> None:
    """The short form of `python -m tools.fuzz_scenes`."""
    if format == "mujoco":
        pytest.importorskip("mujoco")
    fuzz = Fuzz()
    for seed in range(6, 6 + generated(4)):
        fuzz.add(format, seed)
    assert fuzz.faults == []
    assert any(text == "loaded" for _, text in fuzz.outcomes), json.dumps(list(fuzz.outcomes))


@pytest.mark.slow
def test_a_folder_of_long_names_is_readable_and_ends_no_other_sandbox(tmp_path, zygote, empty):
    folder = tmp_path / ("x" * 200)
    folder.mkdir()
    (folder / "box.urdf").write_text(BOX)
    for number in range(490):
        (folder / f"{number:03d}{'y' * 240}").write_text("")
    worker = empty._worker
    with opening.load(folder / "box.urdf", zygote=zygote) as ss:
        assert ss.eval("SELECT id FROM box AS list;") == ["box"]
    assert empty.eval("1 + 1;") == 2
    assert empty._worker is worker
