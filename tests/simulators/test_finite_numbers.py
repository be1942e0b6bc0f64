"""Numbers of shapes and poses that are not finite in PyBullet are errors, not boxes of NaN."""

import struct

import numpy as np
import pybullet
import pytest

import ssduck
from ssduck.errors import SceneError
from ssduck.world import World
from tests.support.bodies import solid
from tests.support.urdf import collision, link, robot
from tools.fuzzing.models import COLLISION_MESH, DAE, OBJ, stl


def mesh(kind, number):
    """A mesh in which a coordinate of a vertex is a number."""
    if kind == "obj":
        return OBJ.replace("v 1 0 0", f"v {number} 0 0").encode()
    if kind == "dae":
        return DAE.replace(">0 0 0 1 0", f">0 0 0 {number} 0").encode()
    with np.errstate(over="ignore"):
        packed = struct.pack("<f", np.float32(float(number)))
    content = bytearray(stl())
    content[96:100] = packed
    return bytes(content)


@pytest.mark.parametrize("concave", ["no", "yes"])
@pytest.mark.parametrize("kind", ["obj", "stl", "dae"])
@pytest.mark.parametrize("number", ["nan", "inf", "-1e39"])
def test_a_mesh(tmp_path, kind, number, concave):
    (tmp_path / f"m.{kind}").write_bytes(mesh(kind, number))
    (tmp_path / "x.urdf").write_text(COLLISION_MESH % (concave, f"m.{kind}"))
    with pytest.raises(SceneError, match=r"x\.urdf: 'x' has a (mesh|hull) with .* not finite"):
        ssduck.load(tmp_path / "x.urdf")


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["obj", "stl", "dae"])
def test_large_numbers_are_numbers(tmp_path, kind):
    (tmp_path / f"m.{kind}").write_bytes(mesh(kind, "1e6"))
    (tmp_path / "x.urdf").write_text(COLLISION_MESH % ("no", f"m.{kind}"))
    with ssduck.load(tmp_path / "x.urdf") as ss:
        lengths = ss.sql("SELECT greatest(xmax - xmin, ymax - ymin) FROM x.shapes").fetchall()
    assert lengths[0][0] == pytest.approx(1e6, rel=1e-3)


def test_a_plane_without_a_normal(tmp_path):
    plane = collision('<plane normal="b"/>')
    (tmp_path / "x.urdf").write_text(robot(link("base", shapes=plane)))
    with pytest.raises(SceneError, match="has a plane with numbers that are not finite"):
        ssduck.load(tmp_path / "x.urdf")


@pytest.mark.filterwarnings("ignore:.*PyBullet leaves a free")
def test_a_joint_without_an_axis(tmp_path):
    body = '<body name="a"><geom size="1"/>{}</body>'
    inner = '<body name="b"><joint name="j" type="hinge" axis="hfield"/><geom size="1"/></body>'
    model = f"<mujoco><worldbody>{body.format(inner)}</worldbody></mujoco>"
    (tmp_path / "x.xml").write_text(model.replace("<geom", '<geom type="sphere"'))
    with pytest.raises(SceneError, match="has no pose at the joint 'j'"):
        ssduck.load(tmp_path / "x.xml", simulator="pybullet")


def test_an_attached_client_warns(tmp_path):
    (tmp_path / "m.obj").write_bytes(mesh("obj", "nan"))
    client = pybullet.connect(pybullet.DIRECT)
    try:
        file = str(tmp_path / "m.obj")
        concave = pybullet.GEOM_FORCE_CONCAVE_TRIMESH
        solid(client, pybullet.GEOM_MESH, 0.0, fileName=file, flags=concave)
        with pytest.warns(UserWarning, match="with numbers that are not finite: its boxes"):
            World.attach(client).tick()
    finally:
        pybullet.disconnect(client)
