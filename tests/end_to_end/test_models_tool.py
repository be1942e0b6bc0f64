"""The command that compares model files with independent readers."""

import os

import numpy as np
import pytest

from tools import models
from tools.model_readers import MjcfReader, SdfReader, Shape

MJCF = """
<mujoco>
  <worldbody>
    <geom type="plane" size="1 1 .1"/>
    <body name="post" pos="0 .2 .5" euler="0 30 0">
      <geom type="capsule" size=".05 .2" mass="2"/>
      <body name="arm" pos=".3 0 .1">
        <joint name="turn" axis="0 1 0" range="-1 1" limited="true"/>
        <geom type="box" size=".2 .02 .03" euler="10 20 30" mass="1"/>
        <geom type="cylinder" size=".1 .05" euler="40 50 60" mass="1"/>
      </body>
    </body>
  </worldbody>
</mujoco>
"""
SDF = """
<sdf version="1.6"><model name="cart"><pose>1 0 0 0 0 0.5</pose>
  <link name="base"><inertial><mass>3</mass><inertia>
    <ixx>1</ixx><iyy>1</iyy><izz>1</izz><ixy>0</ixy><ixz>0</ixz><iyz>0</iyz></inertia></inertial>
    <collision name="c"><pose>0 0 .1 .2 .3 0</pose>
      <geometry><box><size>.4 .2 .1</size></box></geometry></collision></link>
</model></sdf>
"""


@pytest.mark.slow
@pytest.mark.parametrize(("name", "text"), [("post.xml", MJCF), ("cart.sdf", SDF)])
def test_a_model_is_the_same_for_the_reader(tmp_path, name, text):
    if name.endswith("xml"):
        pytest.importorskip("mujoco")
    (tmp_path / name).write_text(text)
    assert list(models.models_in(tmp_path, 1)) == [tmp_path / name]
    assert models.outcome(tmp_path / name) == ("the same", "")


@pytest.mark.slow
@pytest.mark.parametrize("part", ["frames", "boxes", "masses"])
def test_a_difference_is_told(tmp_path, monkeypatch, part):
    (tmp_path / "cart.sdf").write_text(SDF)

    class Wrong(SdfReader):
        def __init__(self, file):
            super().__init__(file)
            values = self.masses if part == "masses" else getattr(self._links, part)
            values[0, "base"] = values[0, "base"] + 0.01

    monkeypatch.setitem(models.READERS, ".sdf", Wrong)
    kind, about = models.outcome(tmp_path / "cart.sdf")
    assert kind == "differs"
    assert {"frames": "pose", "boxes": "box", "masses": "mass"}[part] in about


@pytest.mark.slow
def test_a_process_that_ends_is_a_row(tmp_path, monkeypatch):
    monkeypatch.setattr(models, "outcome", lambda _: os._exit(7))
    assert models.in_a_process(tmp_path / "any.urdf") == ("FAULT", "the process ends with 7")


def test_the_box_of_a_turned_cylinder():
    # Its axis is x: it is as long as that along x, and as wide as the disc along y and z.
    turn = np.array([[0, 0, 1, 0], [0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 0, 1]], float)
    box = Shape(np.array([[0, 0, -0.5], [0, 0, 0.5]]), 0.0, turn, 0.2).box()
    assert box == pytest.approx(np.array([[-0.5, -0.2, -0.2], [0.5, 0.2, 0.2]]))


def test_the_reader_knows_joints_by_their_limits(tmp_path):
    pytest.importorskip("mujoco")
    (tmp_path / "post.xml").write_text(MJCF)
    (limits,) = MjcfReader(tmp_path / "post.xml").joints.values()
    assert np.degrees(limits) == pytest.approx([-1.0, 1.0])
