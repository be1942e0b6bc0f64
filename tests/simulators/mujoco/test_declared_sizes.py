"""MJCF files of a few lines that describe more than a computer can hold."""

from __future__ import annotations

import pytest

import ssduck
from ssduck.errors import SceneError

mujoco = pytest.importorskip("mujoco")
from ssduck.simulators.mujoco.declared_sizes import (  # noqa: E402
    MAX_ELEMENTS,
    MAX_ITERATIONS,
    MAX_NUMBERS,
    check_declared_sizes,
)

GEOM = '<geom size=".1"/>'
TOO_LARGE = {
    "replicate": f'<replicate count="100000000"><body>{GEOM}</body></replicate>',
    "a number of another form": f'<replicate count="1e9">{GEOM}</replicate>',
    "within each other": f'<replicate count="2000"><replicate count="2000">{GEOM}</replicate></replicate>',
    "in a frame": f'<replicate count="2000"><frame><replicate count="2000">{GEOM}</replicate></frame></replicate>',
    "composite": '<body><composite type="cable" count="100000000 1 1" size="1"/></body>',
    "flexcomp": '<flexcomp name="f" type="grid" count="900 900 900" spacing="1 1 1"/>',
    "points of flexcomp": '<flexcomp name="f" type="grid" count="100 100 99" spacing="1 1 1"/>',
    "cells of flexcomp": '<flexcomp name="f" type="grid" count="4 4 4" cellcount="90 90 90" spacing="1 1 1"/>',
    "flexcomp in replicate": '<replicate count="900"><flexcomp name="f" type="grid" count="90 90 1"/></replicate>',
}
ASSETS = {
    "texture": '<texture name="t" type="2d" builtin="flat" width="100000" height="100000"/>',
    "channels": '<texture name="t" type="2d" builtin="flat" width="10000" height="1000" nchannel="100"/>',
    "skybox": '<texture name="t" type="skybox" builtin="flat" width="30000"/>',
    "cube": '<texture name="t" builtin="flat" width="30000" height="1"/>',
    "hfield": '<hfield name="h" nrow="100000" ncol="100000" size="1 1 1 1"/>',
    "cone": '<mesh name="m" builtin="cone" params="400 1"/>',
    "plate": '<mesh name="m" builtin="plate" params="400 400"/>',
    "wedge": '<mesh name="m" builtin="wedge" params="400 400 60 60 0"/>',
    "supersphere": '<mesh name="m" builtin="supersphere" params="400 1 1"/>',
    "supertorus": '<mesh name="m" builtin="supertorus" params="400 1 1 1"/>',
}
SECTIONS = {
    "user": '<sensor><user name="n" dim="200000000"/></sensor>',
    "contact": '<sensor><contact name="n" geom1="g" num="200000000"/></sensor>',
    "delay of a sensor": '<sensor><jointpos name="n" joint="j" nsample="200000000" delay=".1"/></sensor>',
    "delay of an actuator": '<actuator><motor name="n" joint="j" nsample="200000000" delay=".1"/></actuator>',
    "activations": '<actuator><general name="a" joint="j" dyntype="user" actdim="500000000"/></actuator>',
    "numeric": '<custom><numeric name="n" size="200000000" data="1"/></custom>',
    "memory": '<size memory="10T"/>',
    "bytes of memory": '<size memory="5000000000"/>',
    "off-screen": '<visual><global offwidth="100000" offheight="100000"/></visual>',
}
# Each is small enough by itself.
MANY = {
    "textures": "<asset>{}</asset>",
    "height fields": "<asset>{}</asset>",
    "user's sensors": "<sensor>{}</sensor>",
}
EACH = {
    "textures": '<texture name="t{}" type="2d" builtin="flat" width="10000" height="1000"/>',
    "height fields": '<hfield name="t{}" nrow="10000" ncol="1000" size="1 1 1 1"/>',
    "user's sensors": '<user name="t{}" dim="10000000"/>',
}
SIZES = [
    'nuserdata="2000000000"',
    'nkey="2000000000"',
    'nuser_geom="2000000000"',
    'nconmax="1e300"',
]


def refused(tmp_path, text, words, **files):
    for name, content in files.items():
        (tmp_path / f"{name}.xml").write_text(content)
    (tmp_path / "bomb.xml").write_text(text)
    with pytest.raises(SceneError, match=words) as caught:
        ssduck.load(tmp_path / "bomb.xml")
    assert "bomb.xml" in str(caught.value)


@pytest.mark.parametrize("name", TOO_LARGE)
def test_millions_of_elements_are_refused(tmp_path, name):
    text = f"<mujoco><worldbody>{TOO_LARGE[name]}</worldbody></mujoco>"
    refused(tmp_path, text, "more than 1,000,000 elements")


@pytest.mark.parametrize("odd", ["<!-- a -- b -->", "<gz:a/>", "<!-- a --><?xml version='1.0'?>"])
def test_files_that_expat_refuses_are_checked(tmp_path, odd):
    """MuJoCo reads them."""
    body = f"<worldbody>{TOO_LARGE['replicate']}</worldbody>"
    inside, before = (odd, "") if odd.startswith("<gz") else ("", odd)
    file = tmp_path / "a.xml"
    file.write_text(f"{before}<mujoco>{inside}{body}</mujoco>")
    with pytest.raises(SceneError, match="elements"):
        check_declared_sizes(file)


@pytest.mark.parametrize("name", ASSETS)
def test_large_assets_are_refused(tmp_path, name):
    refused(tmp_path, f"<mujoco><asset>{ASSETS[name]}</asset></mujoco>", "is more than 100,000,000")


@pytest.mark.parametrize("name", SECTIONS)
def test_large_sections_are_refused(tmp_path, name):
    refused(tmp_path, f"<mujoco>{SECTIONS[name]}</mujoco>", ">: .* is more than")


@pytest.mark.parametrize("name", MANY)
def test_many_numbers_in_all_are_refused(tmp_path, name):
    many = "".join(EACH[name].format(number) for number in range(11))
    refused(tmp_path, f"<mujoco>{MANY[name].format(many)}</mujoco>", "100,000,000 numbers in all")


def test_defaults_of_actuators_count_for_each(tmp_path):
    default = '<default><general actdim="50000000" dyntype="user"/></default>'
    actuators = "".join(f'<general name="a{number}" joint="j"/>' for number in range(3))
    text = f"<mujoco>{default}<actuator>{actuators}</actuator></mujoco>"
    refused(tmp_path, text, "100,000,000 numbers in all")


@pytest.mark.parametrize(
    "mesh",
    [
        '"wedge" params="100 100 60 60 0"',
        '"plate" params="200 200"',
        '"supersphere" params="200 1 1"',
    ],
)
def test_meshes_of_usual_resolution_are_read(tmp_path, mesh):
    file = tmp_path / "a.xml"
    file.write_text(f'<mujoco><asset><mesh name="m" builtin={mesh}/></asset></mujoco>')
    check_declared_sizes(file)


@pytest.mark.parametrize("size", ["nuser_geom", "nkey"])
def test_numbers_of_each_element_count_for_each(tmp_path, size):
    world = f'<worldbody><replicate count="2000">{GEOM}</replicate></worldbody>'
    (tmp_path / "few.xml").write_text(f'<mujoco><size {size}="40000"/>{world}</mujoco>')
    check_declared_sizes(tmp_path / "few.xml")
    text = f'<mujoco><size {size}="60000"/>{world}</mujoco>'
    refused(tmp_path, text, "100,000,000 numbers in all")


def test_rays_of_a_range_finder_count(tmp_path):
    camera = '<worldbody><camera name="c" resolution="30000 30000"/></worldbody>'
    (tmp_path / "camera.xml").write_text(f"<mujoco>{camera}</mujoco>")
    check_declared_sizes(tmp_path / "camera.xml")
    finder = '<sensor><rangefinder name="r" camera="c" data="dist"/></sensor>'
    refused(tmp_path, f"<mujoco>{camera}{finder}</mujoco>", "100,000,000 numbers in all")


def test_what_mujoco_does_not_know_is_an_error_of_the_scene(tmp_path, monkeypatch):
    def fails(path):
        raise RuntimeError("Caught an unknown exception!")

    monkeypatch.setattr(mujoco.MjSpec, "from_file", fails)
    refused(tmp_path, f"<mujoco>{BALL}</mujoco>", "cannot be loaded: Caught an unknown exception")


@pytest.mark.parametrize("size", SIZES)
def test_large_numbers_of_numbers_are_refused(tmp_path, size):
    refused(tmp_path, f"<mujoco><size {size}/></mujoco>", "is more than 100,000,000")


def test_copies_of_an_included_file_count(tmp_path):
    inner = f'<mujocoinclude><replicate count="2000">{GEOM}</replicate></mujocoinclude>'
    text = '<mujoco><worldbody><replicate count="2000"><include file="inner.xml"/></replicate></worldbody></mujoco>'
    refused(tmp_path, text, "more than 1,000,000 elements", inner=inner)


HEAVY = f'<worldbody><replicate count="1100000">{GEOM}</replicate></worldbody>'
ATTACH = '<worldbody><attach model="m" prefix="p"/></worldbody>'
# (the main file, other files)
ELSEWHERE = {
    "beside the including file": (
        '<include file="sub/a.xml"/>',
        {"sub/a.xml": '<include file="b.xml"/>', "sub/b.xml": HEAVY},
    ),
    "three deep": (
        '<include file="sub/a.xml"/>',
        {
            "sub/a.xml": '<include file="c/d.xml"/>',
            "sub/c/d.xml": '<include file="e.xml"/>',
            "sub/c/e.xml": HEAVY,
        },
    ),
    "a model beside an included file": (
        f'<include file="sub/a.xml"/>{ATTACH}',
        {"sub/a.xml": '<asset><model name="m" file="m.xml"/></asset>', "sub/m.xml": HEAVY},
    ),
    "a backslash": ('<include file="sub\\a.xml"/>', {"sub/a.xml": HEAVY}),
}


@pytest.mark.parametrize("name", ELSEWHERE)
def test_files_are_looked_for_where_mujoco_looks(tmp_path, name):
    text, files = ELSEWHERE[name]
    for file, content in files.items():
        (tmp_path / file).parent.mkdir(parents=True, exist_ok=True)
        tag = "mujoco" if file.endswith("m.xml") else "mujocoinclude"
        (tmp_path / file).write_text(f"<{tag}>{content}</{tag}>")
    refused(tmp_path, f"<mujoco>{text}</mujoco>", "more than 1,000,000 elements")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("form", "words"),
    [
        ('<include file="{}"/>', "more than 200 files are included"),
        ('<asset><model name="m" file="{}"/></asset>', "more than 200 models are attached"),
    ],
)
def test_a_chain_of_files_ends(tmp_path, form, words):
    tag = "mujocoinclude" if "include" in form else "mujoco"
    for number in range(1_500):
        text = f"<{tag}>{form.format(f'{number + 1}.xml')}</{tag}>"
        (tmp_path / f"{number}.xml").write_text(text)
    (tmp_path / "bomb.xml").write_text(f"<mujoco>{form.format('0.xml')}</mujoco>")
    with pytest.raises(SceneError, match=words):
        check_declared_sizes(tmp_path / "bomb.xml")


ATTACHED = f'<mujoco model="own"><worldbody><replicate count="2000"><body name="b">{GEOM}</body></replicate></worldbody></mujoco>'


@pytest.mark.parametrize("body", ["", 'body="b"'])
@pytest.mark.parametrize("name", ["m", None])
def test_copies_of_an_attached_model_count(tmp_path, name, body):
    model = '<model file="inner.xml"/>' if name is None else '<model name="m" file="inner.xml"/>'
    attach = f'<attach model="{name or "own"}" {body} prefix="a"/>'
    world = f'<worldbody><replicate count="2000">{attach}</replicate></worldbody>'
    for text in (f"<asset>{model}</asset>{world}", f"{world}<asset>{model}</asset>"):
        refused(tmp_path, f"<mujoco>{text}</mujoco>", "1,000,000 elements", inner=ATTACHED)


def test_models_that_attach_models_count(tmp_path):
    """Ten copies of ten copies of …, in six files that are alike."""
    for number in range(6):
        attach = f'<attach model="m" prefix="a{number}"/>'
        (tmp_path / f"m{number}.xml").write_text(
            f'<mujoco><asset><model name="m" file="m{number + 1}.xml"/></asset><worldbody>'
            f'<replicate count="10">{attach}</replicate></worldbody></mujoco>'
        )
    included = '<mujocoinclude><body><geom size=".1"/></body></mujocoinclude>'
    (tmp_path / "m6.xml").write_text(
        '<mujoco><worldbody><include file="i.xml"/></worldbody></mujoco>'
    )
    text = (tmp_path / "m0.xml").read_text()
    refused(tmp_path, text, "more than 1,000,000 elements", i=included)


def test_assets_of_attached_models_are_checked(tmp_path):
    inner = f'<mujoco model="own"><asset>{ASSETS["hfield"]}</asset></mujoco>'
    (tmp_path / "inner.xml").write_text(inner)
    file = tmp_path / "a.xml"
    file.write_text('<mujoco><asset><model name="m" file="inner.xml"/></asset></mujoco>')
    with pytest.raises(SceneError, match=r"inner\.xml: <hfield>: nrow times ncol"):
        ssduck.load(file)


@pytest.mark.parametrize("files", [["bomb.xml"], ["inner.xml", "bomb.xml"]])
def test_a_model_that_attaches_itself_is_an_error(tmp_path, files):
    """MuJoCo 3 crashes the process."""
    texts = [
        f'<mujoco><asset><model name="m" file="{file}"/></asset><worldbody>'
        '<attach model="m" prefix="a"/></worldbody></mujoco>'
        for file in files
    ]
    refused(tmp_path, texts[0], "attaches itself", **dict(zip(["inner"], texts[1:], strict=False)))


def test_attached_models_of_a_usual_size_are_read(tmp_path):
    (tmp_path / "inner.xml").write_text(ATTACHED.replace("2000", "2"))
    (tmp_path / "a.xml").write_text(
        '<mujoco><asset><model name="m" file="inner.xml"/></asset><worldbody>'
        '<replicate count="3" offset="1 0 0"><attach model="m" prefix="a"/></replicate>'
        "</worldbody></mujoco>"
    )
    check_declared_sizes(tmp_path / "a.xml")


def test_a_file_that_includes_itself_is_an_error(tmp_path):
    refused(tmp_path, '<mujoco><include file="bomb.xml"/></mujoco>', "include")


@pytest.mark.parametrize("timestep", ["0", "-1", "nan", "inf"])
def test_a_timestep_is_above_0(tmp_path, timestep):
    text = f'<mujoco><option timestep="{timestep}"/><worldbody><body>{GEOM}</body></worldbody></mujoco>'
    refused(tmp_path, text, "timestep|nan|inf")


def test_the_bounds(tmp_path):
    file = tmp_path / "many.xml"
    form = "<mujoco><worldbody><replicate count='{}'><a/></replicate></worldbody></mujoco>"
    file.write_text(form.format(MAX_ELEMENTS - 3))
    check_declared_sizes(file)
    file.write_text(form.format(MAX_ELEMENTS - 2))
    with pytest.raises(SceneError, match="elements"):
        check_declared_sizes(file)
    form = "<mujoco><asset><hfield nrow='{}' ncol='1'/></asset></mujoco>"
    file.write_text(form.format(MAX_NUMBERS))
    check_declared_sizes(file)
    file.write_text(form.format(MAX_NUMBERS + 1))
    with pytest.raises(SceneError, match="nrow times ncol"):
        check_declared_sizes(file)


ITERATIONS = ["iterations", "ls_iterations", "noslip_iterations", "ccd_iterations"]
ITERATIONS += ["sdf_iterations", "sdf_initpoints"]
BALL = f"<worldbody><body><freejoint/>{GEOM}</body></worldbody>"


@pytest.mark.parametrize("name", ITERATIONS)
def test_iterations_without_end_are_refused(tmp_path, name):
    option = f'<option {name}="2000000000" tolerance="0" noslip_tolerance="0" solver="PGS"/>'
    text, words = f"<mujoco>{option}{BALL}</mujoco>", f"bomb.xml: <option>: {name} is 2,000,000,000"
    refused(tmp_path, text, words)
    refused(tmp_path, f'<mujoco><include file="i.xml"/>{BALL}</mujoco>', words, i=text)


@pytest.mark.parametrize(
    ("options", "product"),
    [
        ('iterations="10000" ls_iterations="101"', "iterations times ls_iterations is 1,010,000"),
        ('sdf_iterations="5000" sdf_initpoints="5000"', "sdf_initpoints is 25,000,000"),
    ],
)
def test_iterations_within_iterations_are_bounded(tmp_path, options, product):
    refused(tmp_path, f"<mujoco><option {options}/>{BALL}</mujoco>", product)


def test_the_bound_of_iterations(tmp_path):
    (tmp_path / "row.xml").write_text(
        f'<mujoco><option iterations="{MAX_ITERATIONS}" ls_iterations="100"/>{BALL}</mujoco>'
    )
    with ssduck.load(tmp_path / "row.xml") as ss:
        assert ss.eval("SELECT count(*) AS n FROM row AS value;") == 1


def test_elements_of_a_namespace_count(tmp_path):
    text = f'<mujoco><worldbody><replicate xmlns="a" count="100000000">{GEOM}</replicate></worldbody></mujoco>'
    refused(tmp_path, text, "more than 1,000,000 elements")


def test_a_usual_model_loads(tmp_path):
    text = f'<mujoco><worldbody><replicate count="40" offset="1 0 0"><body name="b">{GEOM}</body></replicate></worldbody></mujoco>'
    (tmp_path / "row.xml").write_text(text)
    with ssduck.load(tmp_path / "row.xml") as ss:
        assert ss.eval("SELECT count(*) AS n FROM row;") == [{"n": 40}]
