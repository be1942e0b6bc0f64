"""Pictures and segmentations, in a process of its own: MuJoCo chooses its OpenGL when imported."""

import os
import subprocess
import sys

import pytest

import ssduck
from ssduck.errors import UnsupportedError

mujoco = pytest.importorskip("mujoco")

LIGHT = '<light pos="0 0 5"/>'
SCENE = """<mujoco><visual><global offwidth="10" offheight="10"/></visual><worldbody>
<light pos="0 0 5"/><geom name="floor" type="plane" size="5 5 .1" rgba="0 0 1 1"/>
<body name="red" pos="0 0 .5"><geom type="sphere" size=".3" rgba="1 0 0 1"/><site size=".2" pos="0 0 .5"/></body>
<body name="green" pos="0 1 .5"><freejoint/><geom type="box" size=".3 .3 .3" rgba="0 1 0 1"/></body>
</worldbody></mujoco>"""
CODE = f"""
import mujoco, numpy as np, ssduck, sys
from ssduck.schema import link_id
from ssduck.simulators.scenes import Camera
model = mujoco.MjModel.from_xml_string({SCENE!r})
data = mujoco.MjData(model)
mujoco.mj_forward(model, data)
world = ssduck.World.attach(model, data)
camera = Camera(eye=(3.0, 0.0, 0.5), target=(0.0, 0.0, 0.5), fov=40.0)
try:
    picture = world.render(80, 60, camera, shadow=False)
except ssduck.errors.UnsupportedError as error:
    print("none", error)
    sys.exit()
ids = world.segmentation(80, 60, camera)
ids_of = {{entity.name: entity.id for entity in world}}
# A pinhole camera: pixels for each metre at a distance of 1 m.
focal = 30 / np.tan(np.radians(20))
red = ids == ids_of["red"]
centre = np.argwhere(red).mean(axis=0)
assert abs(centre - (29.5, 39.5)).max() < 1.0, centre
radius = np.sqrt(red.sum() / np.pi)
assert abs(radius - focal * 0.3 / np.sqrt(3.0**2 - 0.3**2)) < 1.0, radius
green = ids == ids_of["green"]
# y is to the right, as the camera looks along -x.
assert abs(np.argwhere(green)[:, 1].mean() - (39.5 + focal * 1.0 / 2.85)) < 2.0
for name, channel in (("red", 0), ("green", 1), ("world", 2)):
    pixels = picture[ids == ids_of[name]]
    assert len(pixels) and (pixels.argmax(axis=1) == channel).mean() > 0.9, name
links = world.segmentation(80, 60, camera, links=True)
for name in ("red", "green"):
    assert set(links[ids == ids_of[name]].tolist()) == {{link_id(ids_of[name], 0)}}
assert (ids == 0).any()  # above the horizon; the site is no entity
assert (model.vis.global_.offwidth, model.vis.global_.offheight) == (10, 10)
copy = world.excerpt(["world", "green"])
assert set(np.unique(copy.segmentation(80, 60, camera))) == {{0, copy["world"].id, copy["green"].id}}
# Without a light, the headlight shines from the camera: what faces it has its full colour.
dark = mujoco.MjModel.from_xml_string({SCENE.replace(LIGHT, "")!r})
lit = ssduck.World.attach(dark, mujoco.MjData(dark)).render(80, 60, camera, shadow=False)
assert lit[30, 40, 0] > 240, lit[30, 40]
assert lit[ids == ids_of["green"]][:, 1].max() > 200
print("drawn")
"""


@pytest.mark.slow
def test_pictures_show_what_a_pinhole_camera_sees():
    environment = {**os.environ, "MUJOCO_GL": "egl"}
    done = subprocess.run(
        [sys.executable, "-c", CODE], env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    if done.stdout.startswith("none"):
        pytest.skip(done.stdout)
    assert done.stdout.strip() == "drawn"


def test_a_machine_without_opengl_is_told(monkeypatch):
    class Renderer:
        def __init__(self, *_):
            raise mujoco.FatalError("no OpenGL")

    monkeypatch.setattr(mujoco, "Renderer", Renderer)
    model = mujoco.MjModel.from_xml_string(SCENE)
    world = ssduck.World.attach(model, mujoco.MjData(model))
    with pytest.raises(UnsupportedError, match=r"MuJoCo cannot draw: no OpenGL; .* MUJOCO_GL"):
        world.render(20, 20)
    assert model.vis.global_.offwidth == 10


DRAWS_TWICE = """
import ssduck
for _ in range(2):
    with ssduck.load(r"{}", simulator="mujoco") as ss:
        try:
            ss.eval("SELECT this FROM ball AS image(8, 8);")
        except ssduck.SelectScriptError as error:
            print(error.message[:28])
"""


@pytest.mark.long
@pytest.mark.skipif(sys.platform != "linux", reason="the library of windows needs no screen there")
def test_pictures_without_a_screen_are_errors_each_time(tmp_path):
    """MuJoCo ends the process if it is asked for OpenGL again."""
    (tmp_path / "ball.xml").write_text("<mujoco><worldbody><geom size='1'/></worldbody></mujoco>")
    others = ("DISPLAY", "WAYLAND_DISPLAY")
    env = {name: value for name, value in os.environ.items() if name not in others}
    code = DRAWS_TWICE.format(tmp_path / "ball.xml")
    command = [sys.executable, "-c", code]
    done = subprocess.run(
        command, env={**env, "MUJOCO_GL": "glfw"}, capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stdout) == (0, "AS image: MuJoCo cannot draw\n" * 2)
