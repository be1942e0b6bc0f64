"""Model files with random mutations: URDF, SDF, MJCF, and URDF with an OBJ, STL or COLLADA mesh."""

from __future__ import annotations

import copy
import random
import struct
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np

COLLADA = "http://www.collada.org/2005/11/COLLADASchema"
OBJ = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nvt 0 0\nvn 0 0 1\nf 1 2 3\nf 1 2 4\nf 1 3 4\nf 2 3 4\n"
DAE = f"""<COLLADA xmlns="{COLLADA}" version="1.4.1">
<asset><unit meter="1"/><up_axis>Z_UP</up_axis></asset>
<library_geometries><geometry id="g" name="g"><mesh>
<source id="p"><float_array id="pa" count="12">0 0 0 1 0 0 0 1 0 0 0 1</float_array>
<technique_common><accessor source="#pa" count="4" stride="3"><param name="X" type="float"/>
<param name="Y" type="float"/><param name="Z" type="float"/></accessor></technique_common></source>
<source id="n"><float_array id="na" count="3">0 0 1</float_array>
<technique_common><accessor source="#na" count="1" stride="3"/></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<triangles count="4" material="mm"><input semantic="VERTEX" source="#v" offset="0"/>
<input semantic="NORMAL" source="#n" offset="1"/>
<p>0 0 1 0 2 0 0 0 1 0 3 0 0 0 2 0 3 0 1 0 2 0 3 0</p></triangles></mesh></geometry>
</library_geometries>
<library_visual_scenes><visual_scene id="s"><node id="nd"><matrix>1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1
</matrix><translate>0 0 1</translate><rotate>0 0 1 90</rotate><scale>1 1 1</scale>
<instance_geometry url="#g"/><node><instance_geometry url="#g"/></node></node></visual_scene>
</library_visual_scenes><scene><instance_visual_scene url="#s"/></scene></COLLADA>"""
INERTIAL = (
    '<inertial><origin xyz="0 0 0" rpy="0 0 0"/><mass value="1"/>'
    '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
)
URDF = f"""<robot name="r"><material name="w"><color rgba="1 1 1 1"/></material>
<link name="a">{INERTIAL}<contact><lateral_friction value="1"/><rolling_friction value="0"/>
<contact_cfm value="0"/><contact_erp value="0"/><stiffness value="10"/><damping value="1"/>
<friction_anchor/><inertia_scaling value="1"/></contact>
<visual name="v"><origin xyz="0 0 1" rpy="0 0 0"/><geometry><box size="1 1 1"/></geometry>
<material name="w"/></visual>
<collision name="c" concave="yes" group="1" mask="1"><origin xyz="0 0 0"/>
<geometry><mesh filename="m.obj" scale="1 1 1"/></geometry></collision>
<collision><geometry><capsule radius="1" length="1"/></geometry></collision>
<collision><geometry><plane normal="0 0 1"/></geometry></collision></link>
<link name="b">{INERTIAL}<visual><geometry><mesh filename="m.dae" scale="1 1 1"/></geometry>
<material name="x"><color rgba="1 0 0 1"/></material></visual>
<collision><geometry><cylinder radius="1" length="1"/></geometry></collision></link>
<link name="c">{INERTIAL}<visual><geometry><sphere radius="1"/></geometry></visual>
<collision><geometry><mesh filename="m.stl"/></geometry></collision></link><sensor name="s"/>
<joint name="j" type="revolute"><parent link="a"/><child link="b"/>
<origin xyz="0 0 1" rpy="0 1 0"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1" effort="1" velocity="1"/><dynamics damping="1" friction="1"/></joint>
<joint name="k" type="spherical"><parent link="b"/><child link="c"/><axis xyz="0 0 1"/></joint>
</robot>"""
SDF = """<sdf version="1.6"><world name="w"><gravity>0 0 -9.8</gravity><model name="m">
<static>0</static><pose>0 0 1 0 0 0</pose><link name="a"><pose>0 0 0 0 0 0</pose>
<inertial><pose>0 0 0 0 0 0</pose><mass>1</mass><inertia><ixx>1</ixx><ixy>0</ixy><ixz>0</ixz>
<iyy>1</iyy><iyz>0</iyz><izz>1</izz></inertia></inertial>
<collision name="c"><pose>0 0 0 0 0 0</pose><geometry><box><size>1 1 1</size></box></geometry>
</collision><visual name="v"><geometry><mesh><uri>m.obj</uri><scale>1 1 1</scale></mesh></geometry>
<material><diffuse>1 0 0 1</diffuse></material></visual></link>
<link name="b"><pose>0 0 1 0 0 0</pose><inertial><mass>1</mass><inertia><ixx>1</ixx><ixy>0</ixy>
<ixz>0</ixz><iyy>1</iyy><iyz>0</iyz><izz>1</izz></inertia></inertial>
<collision name="c"><geometry><cylinder><radius>1</radius><length>1</length></cylinder></geometry>
</collision><visual name="v"><geometry><sphere><radius>1</radius></sphere></geometry></visual>
</link><joint name="j" type="revolute"><parent>a</parent><child>b</child><axis><xyz>0 0 1</xyz>
<limit><lower>-1</lower><upper>1</upper><effort>1</effort></limit>
<dynamics><damping>1</damping><friction>1</friction></dynamics></axis></joint></model>
<model name="n"><link name="l"><inertial><mass>1</mass><inertia><ixx>1</ixx><ixy>0</ixy>
<ixz>0</ixz><iyy>1</iyy><iyz>0</iyz><izz>1</izz></inertia></inertial><collision name="c">
<geometry><mesh><uri>m.stl</uri><scale>1 1 1</scale></mesh></geometry></collision></link></model>
</world></sdf>"""
MJCF = """<mujoco model="m"><compiler angle="degree" inertiafromgeom="true"/>
<default><joint armature="1" damping="1"/>
<geom conaffinity="1" condim="3" contype="1" rgba="1 0 0 1" friction="1 1 1"/>
<motor ctrllimited="false"/></default>
<asset><mesh name="me" file="m.stl" scale="1 1 1"/>
<texture name="t" type="2d" builtin="flat" width="10" height="10"/>
<material name="mat" texture="t"/></asset>
<worldbody><geom name="floor" type="plane" size="5 5 1" pos="0 0 0"/>
<body name="a" pos="0 0 1" quat="1 0 0 0"><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
<joint name="j" type="hinge" axis="0 1 0" range="-40 40" pos="0 0 0"/>
<geom name="g" type="capsule" fromto="0 0 0 1 0 0" size="0.1"/><geom type="box" size="1 1 1"/>
<geom type="mesh" mesh="me"/><body name="b" pos="0 0 1">
<joint name="k" type="slide" axis="0 0 1" range="-1 1"/>
<geom type="cylinder" size="1 1"/><geom type="ellipsoid" size="1 1 1"/></body>
<site name="s" pos="0 0 0"/></body>
<body name="f"><freejoint/><geom type="sphere" size="1"/></body></worldbody>
<actuator><motor joint="j"/></actuator></mujoco>"""
VISUAL_MESH = (
    f'<robot name="r"><link name="a">{INERTIAL}<visual><geometry><mesh filename="%s"/></geometry>'
    "</visual></link></robot>"
)
COLLISION_MESH = (
    f'<robot name="r"><link name="a">{INERTIAL}<collision concave="%s"><geometry>'
    '<mesh filename="%s"/></geometry></collision></link></robot>'
)
# The formats, and the simulator of each; the meshes are parts of URDF files.
FORMATS = ("urdf", "sdf", "mjcf", "mujoco", "obj", "stl", "dae")
MODELS = {
    "urdf": ("x.urdf", URDF),
    "sdf": ("x.sdf", SDF),
    "mjcf": ("x.xml", MJCF),
    "mujoco": ("x.xml", MJCF),
}
# Values that take the place of others in XML.
_VALUES = (
    *("", " ", "nan", "inf", "-1", "0", "1", "1e30", "1e400", "a", "1 2", "1 2 3", "1 2 3 4"),
    *("0 0 0", "1e-30 1e-30 1e-30", "-1 -1 -1", "1,2,3", "0 0 0 0 0 0 1 1 1", "99999999999"),
    *("-2147483648", "2147483648", "x" * 1100, "x" * 70_000, "m.obj", "m.dae", "m.stl", "M.OBJ"),
    *("none.obj", ".obj", "..obj", "m.cdf", "true", "false", "yes", "world", "base", "fixed"),
    *("prismatic", "spherical", "planar", "floating", "continuous", "free", "ball", "hinge"),
    *("mesh", "hfield", "sdf", "capsule", "\u00e9", "%s%n%n", "#v", "#p", "#n", "#"),
)
# Bytes that are put into a mesh.
_PIECES = (
    *(b"f ", b"\n", b"v ", b"-1 ", b"0 ", b"/", b"\0", b"999999 ", b"1e39 ", b"nan ", b"g \n"),
    *(b"o \n", b"\r", b"x" * 1100, b"mtllib m.obj\n", b"usemtl a\n", b"\xff\xff\x7f\x7f"),
)
# Numbers of triangles that an STL file may claim.
_COUNTS = (0, 1, 5, 1 << 31, (1 << 31) + 4, (1 << 32) - 1, 85_899_346, 171_798_696)
# The longest file of which parts are copied, bytes.
_MAX_BYTES = 60_000


def stl() -> bytes:
    """Returns an STL file of four triangles."""
    triangles = np.zeros(4, dtype=[("normal", "<3f4"), ("corners", "<9f4"), ("more", "<u2")])
    triangles["corners"] = np.random.default_rng(1).random((4, 9))
    return b"\0" * 80 + struct.pack("<I", 4) + triangles.tobytes()


def write_mutant(folder: Path, format: str, seed: int) -> Path:
    """Writes a mutated model and the meshes that it names, and returns the model.

    Args:
        folder: the folder for the files.
        format: one of `FORMATS`.
        seed: says which mutations.
    """
    choices = random.Random(f"{format} {seed}")  # noqa: S311  # no secret
    meshes = {"obj": OBJ.encode(), "stl": stl(), "dae": DAE.encode()}
    for name, content in meshes.items():
        (folder / f"m.{name}").write_bytes(content)
    if format in MODELS:
        name, text = MODELS[format]
        (folder / name).write_bytes(_mutated_xml(text, choices))
        return folder / name
    mesh = f"x.{format}"
    if format == "dae":
        (folder / mesh).write_bytes(_mutated_xml(DAE, choices))
    else:
        (folder / mesh).write_bytes(_mutated_bytes(meshes[format], choices))
    model = folder / "x.urdf"
    is_drawn = choices.random() < 0.4
    concave = choices.choice(("no", "yes"))
    model.write_text(VISUAL_MESH % mesh if is_drawn else COLLISION_MESH % (concave, mesh))
    return model


def _mutated_xml(text: str, choices: random.Random) -> bytes:
    ET.register_namespace("", COLLADA)
    root = ET.fromstring(text)
    for _ in range(choices.choice((1, 1, 1, 2, 2, 3, 5))):
        _mutate(root, choices)
    return ET.tostring(root)


def _mutate(root: ET.Element, choices: random.Random) -> None:
    """Changes a random element."""
    elements = list(root.iter())
    parents = {child: parent for parent in elements for child in parent}
    element = choices.choice(elements)
    parent = parents.get(element)
    match choices.randrange(9):
        case 0 if parent is not None:
            parent.remove(element)
        case 1 if element.attrib:
            element.attrib.pop(choices.choice(list(element.attrib)))
        case 2 | 3 if element.attrib:
            element.set(choices.choice(list(element.attrib)), choices.choice(_VALUES))
        case 4 if element.attrib:
            other = choices.choice([each for each in elements if each.attrib])
            value = choices.choice(list(other.attrib.values()))
            element.set(choices.choice(list(element.attrib)), value)
        case 5:
            element.tag = choices.choice(elements).tag
        case 6 if parent is not None and len(ET.tostring(root)) < _MAX_BYTES:
            choices.choice(elements).append(copy.deepcopy(element))
        case 7:
            element.text = choices.choice(_VALUES)
        case 8 if parent is not None:
            place = list(parent).index(element)
            for _ in range(choices.choice((1, 2, 40))):
                parent.insert(place, copy.deepcopy(element))


def _mutated_bytes(content: bytes, choices: random.Random) -> bytes:
    mutated = bytearray(content)
    for _ in range(choices.choice((1, 1, 2, 4, 16))):
        place = choices.randrange(len(mutated) + 1)
        match choices.randrange(5):
            case 0 if mutated:
                mutated[min(place, len(mutated) - 1)] = choices.randrange(256)
            case 1:
                del mutated[place : place + choices.choice((1, 4, 50, 2000))]
            case 2:
                mutated[place:place] = choices.choice((*_PIECES, choices.randbytes(8)))
            case 3 if len(mutated) > 84:
                mutated[80:84] = struct.pack("<I", choices.choice(_COUNTS))
            case _:
                start = choices.randrange(len(mutated) + 1)
                mutated[place:place] = mutated[start : start + choices.choice((1, 10, 50))]
    return bytes(mutated)
