"""Scenes from elsewhere: what is wrong with them is a SceneError."""

import pytest

import ssduck
from ssduck.errors import SceneError, UnknownNameError
from ssduck.simulators.pybullet.model_repairs import PIECE
from tests.support.cases import sampled
from tests.support.models import mjcf_body, mjcf_of, sdf_link, sdf_model, sdf_of
from tests.support.urdf import collision, joint, link, robot

CUBE = "".join(f"v {x} {y} {z}\n" for x in (0, 1) for y in (0, 1) for z in (0, 1)) + (
    "f 1 2 3\nf 2 3 4\nf 5 6 7\nf 6 7 8\nf 1 2 5\nf 2 5 6\n"
)


def urdf(geometry='<box size="1 1 1"/>', *, mass="1", more=""):
    return robot(link("base", mass=mass, shapes=collision(geometry) + more), name="r")


def mesh(name, scale="1 1 1"):
    return urdf(f'<mesh filename="{name}" scale="{scale}"/>')


def sdf(geometry, mass="1"):
    return sdf_of(sdf_model("m", sdf_link(geometry=geometry, mass=mass)))


def mjcf(geom):
    return mjcf_of(mjcf_body("b", parts=f"<geom {geom}/>"))


# -- numbers, depth and meshes ------------------------------------------------------------------------


def deep(tag, count=100_000):
    return f"<{tag}>" * count + f"</{tag}>" * count


def joints(first, second, *children):
    """Returns a model of three links and two joints; some crash PyBullet 3.2.7."""
    names = zip((first, second), children, strict=True)
    parts = [joint(name, "fixed", "a", child) for name, child in names]
    return robot(*map(link, "abc"), *parts, name="r")


# (file, text, words of the error)
WRONG = [
    *(("s.urdf", urdf(mass=value), f"<mass value> {words}") for value, words in
      [("-1", "is negative"), ("nan", "is not a number"), ("inf", "is not finite"),
       ("1e400", "is not finite")]),
    *(("s.urdf", urdf(f'<box size="{value} 1 1"/>'), f"<box size> {words}") for value, words in
      [("-1", "is negative"), ("nan", "is not a number"), ("inf", "is not finite")]),
    ("s.urdf", urdf('<sphere radius="-1"/>'), "<sphere radius> is negative"),
    ("s.urdf", urdf('<cylinder radius="1" length="nan"/>'), "<cylinder length> is not a number"),
    ("s.urdf", urdf().replace('ixx="0.1"', 'ixx="nan"'), "<inertia ixx> is not a number"),
    ("s.urdf", urdf(more='<visual><origin xyz="inf 0 0"/></visual>'), "<origin xyz> is not finite"),
    ("s.urdf", mesh("m.obj", "0 0 0"), "<mesh scale> is 0"),
    ("s.urdf", mesh("m.obj", "nan 1 1"), "<mesh scale> is not a number"),
    ("s.sdf", sdf("<box><size>nan 1 1</size></box>"), "<size> is not a number"),
    ("s.sdf", sdf("<sphere><radius>-1</radius></sphere>"), "<radius> is negative"),
    ("s.sdf", sdf("<box><size>1 1 1</size></box>", "-1"), "<mass> is negative"),
    ("s.xml", mjcf('type="sphere" size="-1"'), "<geom size> is negative"),
    ("s.xml", mjcf('type="box" size="nan 1 1"'), "<geom size> is not a number"),
    ("s.urdf", urdf(more=deep("a")), "nesting is too deep"),
    ("s.sdf", sdf(deep("a")), "nesting is too deep"),
    ("s.xml", f"<mujoco><worldbody>{deep('body')}</worldbody></mujoco>", "nesting is too deep"),
    ("s.urdf", joints("j", "j2", "b", "b"), "2 joints have the child 'b'"),
    ("s.urdf", joints("j", "j", "b", "c"), "2 joints have the name 'j'"),
    ("s.urdf", urdf().replace('"base"', f'"{"b" * 9000}"'), "a name of 9000 bytes; at most 1023"),
    ("s.urdf", urdf().replace('"r"', f'"{"b" * 9000}"'), "a name of 9000 bytes; at most 1023"),
    ("s.urdf", mesh("/etc/passwd"), "cannot be read as a mesh"),
    ("s.urdf", mesh("x" * 5000 + ".obj"), "cannot find"),
    ("s.toml", "a = " + "[" * 100_000 + "]" * 100_000, "nested too deeply"),
    ("s.toml", "timestep = 1" + "0" * 400, "expected a finite number"),
    ("s.toml", "timestep = 1" + "0" * 5000, "s.toml: "),
    ("s.toml", "gravity = [inf, 0, 0]", "expected 3 finite numbers"),
    ("s.toml", '[[body]]\nname = "a"\nbox = [nan, 1, 1]', "expected 3 finite numbers"),
    ("s.toml", '[[body]]\nname = "a"\nbox = [-1, 1, 1]', "must be above 0"),
    ("s.toml", '[[body]]\nname = "a"\nbox = [1, 1, 1]\nmass = -1', "less than 0"),
    ("s.toml", '[[body]]\nname = "a"\nurdf = "a\\u0000.urdf"', "there is no file"),
    ("s.toml", f'[[body]]\nname = "a"\nurdf = "{"x" * 5000}.urdf"', "there is no file"),
]  # fmt: skip


@pytest.mark.slow
@sampled(("name", "text", "words"), WRONG, every=3)
def test_what_is_wrong_is_an_error(tmp_path, name, text, words):
    (tmp_path / "m.obj").write_text(CUBE)
    (tmp_path / name).write_text(text)
    with pytest.raises(SceneError, match=words) as error:
        ssduck.load(tmp_path / name, simulator="pybullet")
    assert name in str(error.value)


@pytest.mark.parametrize(
    "corners", ["1 2 3", "-1 -2 -3", "1 2 2000000000", "1 2 99999999999999999999"]
)
def test_a_mesh_whose_faces_are_nowhere(tmp_path, corners):
    """PyBullet would read beyond the vertices, and crash."""
    (tmp_path / "m.obj").write_text(("v 0 0 0\n" if "9" in corners else "") + f"f {corners}\n")
    for text in (mesh("m.obj"), urdf(more="<visual><geometry>M</geometry></visual>")):
        (tmp_path / "s.urdf").write_text(text.replace("M", '<mesh filename="m.obj"/>'))
        with pytest.raises(SceneError, match=r"m.obj: a face refers to a missing vertex"):
            ssduck.load(tmp_path / "s.urdf", simulator="pybullet")


FAR = "".join(f"v {number} 0 0\n" for number in range(9))
# (the mesh, words of the error)
OBJECTS = {
    "before the vertices": ("f -4 -3 -2\n" + CUBE, "a missing vertex"),
    "before the vertices of another object": (f"v 0 0 0\no a\nf 1 2 9\no b\n{FAR}", "a missing"),
    "before those of another material": (f"v 0 0 0\nf 1 2 9\nusemtl b\n{FAR}", "a missing vertex"),
    "0": (f"{FAR}f 0 0 0\n", "a missing vertex"),
    "no numbers": (f"{FAR}f / // ///\n", "a missing vertex"),
    "no corners": ("f \n", "no face has three corners"),
    "two corners": (f"{FAR}f 1 2\n", "no face has three corners"),
    "behind a null character": (f"{FAR}f 1 2 \0 3\n", "no face has three corners"),
    "a texture 0": (f"{FAR}f 1 2 3\no b\nf 1 2/0 3\n", "a corner that is none: '1 2/0 3'"),
    "no normal": (f"{FAR}f 1 2 3\no b\nf 1 2 3//\n", "a corner that is none"),
    "no text": (f"{FAR}f 1 2 3\no b\nf 1 2 \udcff\n", "a corner that is none: .*xff"),
    "two corners of none": (f"{FAR}f 1 2 3\no b\nf 1 2//\n", "a corner that is none"),
    "behind a long comment": ("#" + "x" * 1022 + f"f 1 2 99999999\n{CUBE}", "line 1 has 1,0.. bytes"),
    "a long line": (f"{FAR}o {'a' * 1021}\n{CUBE}", "line 10 has 1,023 bytes"),
}  # fmt: skip


@pytest.mark.parametrize("name", OBJECTS)
def test_what_pybullet_would_read_beyond_is_an_error(tmp_path, name):
    content, words = OBJECTS[name]
    (tmp_path / "m.obj").write_text(content, errors="surrogateescape")
    (tmp_path / "s.urdf").write_text(mesh("m.obj"))
    with pytest.raises(SceneError, match=f"m.obj: .*{words}"):
        ssduck.load(tmp_path / "s.urdf", simulator="pybullet")


# (before a part that a comment hides from XML, the part, behind it)
HIDDEN = {
    "s.urdf": (
        f'<robot name="r">{link("a").removesuffix("</link>")}',
        '<collision><geometry><mesh filename="../secret/m.obj"/></geometry></collision>',
        "</link></robot>",
    ),
    "s.sdf": (
        '<sdf version="1.6"><world name="w"><model name="m"><link name="a">',
        "<collision name='c'><geometry><mesh><uri>../secret/m.obj</uri><scale>1 1 1</scale></mesh>"
        "</geometry></collision>",
        "</link></model></world></sdf>",
    ),
    "s.xml": (
        "<mujoco><asset>",
        '<mesh name="m" file="../secret/m.obj"/>',
        '</asset><worldbody><body><joint type="free"/><geom type="box" size="1 1 1"/></body></worldbody></mujoco>',
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", HIDDEN)
def test_a_comment_hides_nothing_from_the_check(tmp_path, name):
    """PyBullet reads pieces of 8,191 bytes of a line; `<!-` and `-` are no comment then."""
    before, hidden, after = HIDDEN[name]
    text = f"{before}{' ' * (8191 - 3 - len(before))}<!-- >{hidden}-->{after}"
    (tmp_path / name).write_text(text)
    with ssduck.load(tmp_path / name, simulator="pybullet") as ss:
        assert len(ss.worlds[0]) == 1
        assert "mesh" not in {row[0] for row in ss.sql("SELECT type FROM geometries").fetchall()}
    if name != "s.xml":  # in which nothing has the mesh
        (tmp_path / name).write_text(text.replace(f"<!-- >{hidden}-->", hidden))
        with pytest.raises(SceneError, match="secret"):
            ssduck.load(tmp_path / name, simulator="pybullet")


def test_a_count_of_triangles_that_overflows(tmp_path):
    count = (2**32 + 900) // 50
    size = (84 + 50 * count) % 2**32
    (tmp_path / "m.stl").write_bytes(bytes(80) + count.to_bytes(4, "little") + bytes(size - 84))
    (tmp_path / "s.urdf").write_text(mesh("m.stl"))
    with pytest.raises(SceneError, match=rf"m\.stl: it counts {count:,} triangles in {size} bytes"):
        ssduck.load(tmp_path / "s.urdf", simulator="pybullet")


def limited(attributes):
    """A model whose joints have a limit by default."""
    return (
        '<mujoco><compiler angle="radian"/><default><joint limited="true" range="-1 1"/></default>'
        f'<worldbody><body name="b"><joint name="j" type="hinge" axis="0 0 1" {attributes}/>'
        '<geom type="sphere" size="1"/></body></worldbody></mujoco>'
    )


SPHERE = sdf("<sphere><radius>1</radius></sphere>")
# (the file, its text): PyBullet prints these texts by C's printf.
PRINTED = {
    "a type": ("s.urdf", urdf().replace("</robot>", '<joint name="j" type="%n"/></robot>')),
    "a link": ("s.urdf", urdf().replace('"base"', '"%s%s%n"')),
    "an attribute": ("s.urdf", urdf('<box size="1 1 1" a="%p"/>')),
    "a mesh": ("s.urdf", mesh("%n.obj")),
    "a type of a geom": ("s.xml", mjcf('type="%p.%p"')),
    "a uri": ("s.sdf", sdf("<mesh><uri>%s.obj</uri></mesh>")),
    "a model": ("s.sdf", SPHERE.replace('"m"', '"%n"')),
}
LONG = urdf(f'<box size="1 1 1" a="{"b" * 8191}"/>')
TWICE = '<mujoco><worldbody><body><body name="b"/><body name="b"/></body></worldbody></mujoco>'
# (the file, its text, words of the error)
REFUSED = {
    **{
        f"% in {name}": (*printed, "has a %, which PyBullet takes for a format")
        for name, printed in PRINTED.items()
    },
    **{
        f"{inner} for a text": (
            "s.sdf",
            SPHERE.replace("</link>", f"<pose>{inner}</pose></link>"),
            "a <pose> has a <.*> where a text is due",
        )
        for inner in ("<plane/>", "0 <diffuse>1 1 1</diffuse>")
    },
    "a long element": ("s.urdf", LONG, r"an element has 8,2.. bytes: .*would read another model"),
    "two bodies of one name": ("s.xml", TWICE, "2 bodies have the name 'b'"),
    "a limit without a range": ("s.xml", limited(""), "the limited joint 'j' has no range"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_pybullet_would_take_otherwise_is_an_error(tmp_path, name):
    file, text, words = REFUSED[name]
    (tmp_path / file).write_text(text)
    with pytest.raises(SceneError, match=words):
        ssduck.load(tmp_path / file, simulator="pybullet")


BEFORE, BEHIND = urdf().split("<collision>")
CUT = f"{BEFORE}{' ' * (8191 - len(BEFORE))}<collision>{BEHIND}"
PERCENT = "<!-- 100 % --><description>100 % new</description></robot>"
# (the file, its text, a mesh beside it)
READ = {
    "a long comment": ("s.urdf", mesh("m.obj"), f"#{'-' * 3000}\n{CUBE}"),
    "faces of two corners": ("s.urdf", mesh("m.obj"), f"f \nf 1\nf 1 99\n{CUBE}"),
    "faces before vertices of their own object": (
        "s.urdf",
        mesh("m.obj"),
        f"o {'a' * (PIECE - 3)}\nf 1 2 9\n{FAR}{CUBE}",
    ),
    "a long line that is cut between its parts": ("s.urdf", CUT, ""),
    "% that is not printed": ("s.urdf", urdf().replace("</robot>", PERCENT), ""),
    "no limit": ("s.xml", limited('limited="false"'), ""),
    "a range": ("s.xml", limited('range="-1 1"'), ""),
}


@pytest.mark.parametrize("name", READ)
def test_what_is_right_is_read(tmp_path, name):
    file, text, content = READ[name]
    (tmp_path / file).write_text(text)
    (tmp_path / "m.obj").write_text(content)
    with ssduck.load(tmp_path / file, simulator="pybullet") as ss:
        (body,) = ss.worlds[0]
        if name == "faces of two corners":  # they are left out
            assert body.aabb[1] == pytest.approx([1.0, 1.0, 1.0], abs=0.01)


ACCESSOR = (
    '<technique_common><accessor source="#a" count="3" stride="3">'
    '<param name="X" type="float"/></accessor></technique_common>'
)
COLLADA = (
    '<COLLADA version="1.4.1"><asset><unit meter="1"/></asset><library_geometries><geometry id="g">'
    '<mesh><source id="p"><float_array id="a" count="9">0 0 0 1 0 0 0 1 0</float_array>'
    f'{ACCESSOR}</source><vertices id="v"><input semantic="POSITION" source="#p"/></vertices>'
    '<triangles count="1"><input semantic="VERTEX" source="#v" offset="0"/><p>0 1 2</p></triangles>'
    '</mesh></geometry></library_geometries><library_visual_scenes><visual_scene id="s">'
    '<node id="n"><instance_geometry url="#g"/></node></visual_scene></library_visual_scenes>'
    '<scene><instance_visual_scene url="#s"/></scene></COLLADA>'
)
# (old, new, words of the error): each crashes PyBullet 3.2.7, or makes it take all memory
DAMAGES = [
    ('<asset><unit meter="1"/></asset>', "", "<COLLADA> has no <asset>"),
    ("library_geometries", "library", "<COLLADA> has no <library_geometries>"),
    ('<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>', "", "no <vertices>"),
    ("<p>0 1 2</p>", "", "<triangles> has no <p>"),
    (
        '"1"><input semantic="VERTEX" source="#v" offset="0"/><p>0 1 2',
        '"0"><input semantic="VERTEX" source="#v" offset="0"/><p>',
        "<p> is empty",
    ),
    ("<p>0", "<p><!-- a -->0", "<p> is empty"),
    ("<p>0", "<p><?a?>0", "<p> is empty"),
    ("<p>0", "<p>0<!-- a -->", "has fewer corners than it counts"),
    ('"9">0', '"9"><!-- a -->0', "has not the numbers that it counts"),
    ("0 1 2</p>", "0 1 99999999</p>", "refers to a missing vertex"),
    ("0 1 2</p>", "0 1 -99999999</p>", "refers to a missing vertex"),
    ("0 1 2</p>", "0 1 x</p>", "invalid literal"),
    ('count="1"', 'count="99999999"', "has fewer corners than it counts"),
    ('count="9"', 'count="99999999"', "has not the numbers that it counts"),
    ("0 0 0 1 0 0 0 1 0", "", "has not the numbers that it counts"),
    (ACCESSOR, "", "a <source> has no <accessor>"),
    ('source="#p"', 'source="#x"', "there is no <source> 'x'"),
    ('source="#v"', 'source="#x"', "there is no <source> 'x'"),
    ('<source id="p">', "<source>", "a <source> has no id"),
    ('semantic="VERTEX" ', "", "a <input> has no semantic"),
    ('offset="0"', 'offset="99"', "an offset is 99"),
    ("<COLLADA ", '<!DOCTYPE a [<!ENTITY b "c">]><COLLADA ', "<!DOCTYPE> is not supported"),
    ("</COLLADA>", "", "it is no XML"),
    (
        '<triangles count="1"><input semantic="VERTEX"',
        '<triangles count="1"><input semantic="NORMAL"',
        "<triangles> has no <input> of vertices",
    ),
    ('<unit meter="1"/>', "<unit/>", "a <unit> has no meter"),
    ("</COLLADA>", "<scene><instance_visual_scene/></scene></COLLADA>", "has no url"),
    ("technique_common>", "technique>", "a <source> has no <accessor>"),
    ('<visual_scene id="s">', "<visual_scene>", "a <visual_scene> has no id"),
    (
        "<mesh><source",
        '<mesh xmlns:n="http://www.collada.org/2005/11/COLLADASchema"><n:source',
        "it is no XML|its elements have a prefix",
    ),
]


@sampled(("old", "new", "words"), DAMAGES, every=3)
def test_a_damaged_collada_file(tmp_path, old, new, words):
    (tmp_path / "s.urdf").write_text(mesh("m.dae"))
    (tmp_path / "m.dae").write_text(COLLADA)
    with ssduck.load(tmp_path / "s.urdf", simulator="pybullet"):
        pass
    assert old in COLLADA
    (tmp_path / "m.dae").write_text(COLLADA.replace(old, new))
    with pytest.raises(SceneError, match=rf"m.dae: .*{words}"):
        ssduck.load(tmp_path / "s.urdf", simulator="pybullet")


EMPTY = (
    '<geometry id="e"><mesh><source id="q"><float_array id="b" count="0"/>'
    '</source><vertices id="w"><input semantic="POSITION" source="#q"/></vertices></mesh></geometry>'
)


def test_a_collada_file_with_an_empty_geometry(tmp_path):
    """Exporters write these, and PyBullet reads no source of them, as in a hip of the ANYmal."""
    text = COLLADA.replace("</library_geometries>", f"{EMPTY}</library_geometries>")
    text = text.replace(
        "</visual_scene>", '<node><instance_geometry url="#e"/></node></visual_scene>'
    )
    (tmp_path / "m.dae").write_text(text)
    (tmp_path / "s.urdf").write_text(mesh("m.dae"))
    with ssduck.load(tmp_path / "s.urdf", simulator="pybullet") as ss:
        rows = ss.sql("SELECT xmin, ymin, zmin, xmax, ymax, zmax FROM shapes").fetchall()
    assert rows == [pytest.approx((0, 0, 0, 1, 1, 0), abs=1e-9)]


@pytest.mark.slow
def test_entities_that_grow(tmp_path):
    """Ten entities of ten of the one before; PyBullet takes none of them for another text."""
    grown = "".join(f'<!ENTITY a{n} "{f"&a{n - 1};" * 10}">' for n in range(1, 12))
    text = f'<!DOCTYPE r [<!ENTITY a0 "lol">{grown}]>' + urdf(more="<x>&a11;</x>")
    (tmp_path / "s.urdf").write_text(text)
    with ssduck.load(tmp_path / "s.urdf") as ss:
        assert ss.eval("SELECT id FROM s AS list;") == ["s"]


def test_a_name_that_no_file_can_have():
    for name in ("a\0.urdf", "x" * 5000 + ".urdf", "\ud800.urdf"):
        with pytest.raises((UnknownNameError, SceneError)):
            ssduck.load(name)
