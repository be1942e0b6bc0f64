"""Records have what is drawn of bodies, and the camera of their worlds."""

import numpy as np
import pybullet
import pytest

import ssduck
from ssduck.simulators.backends import drawn_shapes
from ssduck.simulators.scenes import Camera
from ssduck.world.pictures import framing_camera
from ssduck.world.world import World
from tests.support.bodies import solid


def drawn(world):
    """Returns what is drawn of each entity, as plain values."""
    return {
        info.name: [
            (
                shape.frame,
                shape.geometry.key,
                *np.asarray(shape.position).tolist(),
                *np.asarray(shape.orientation).tolist(),
                *(shape.colour or ()),
            )
            for shape in drawn_shapes(world.simulator, info.body)
        ]
        for info in world.snapshot.entities
        if info.body is not None
    }


@pytest.fixture(scope="module")
def kitchen(tmp_path_factory):
    """A world, what is drawn of it, and its records: a folder, a file, and copies of both."""
    place = tmp_path_factory.mktemp("visuals")
    with ssduck.load("kitchen", place / "run.duckdb") as ss:
        with ss.record_to(place / "run"):
            ss.run(0.02)
        ss.export(place / "exported")
        expected = drawn(ss["kitchen"]), ss["kitchen"].camera
    with ssduck.open(place / "run") as ss:
        ss.export(place / "again")
    return place, *expected


@pytest.mark.slow
@pytest.mark.parametrize("name", ["run", "run.duckdb", "exported", "again"])
def test_a_record_has_what_was_drawn(kitchen, name):
    place, expected, camera = kitchen
    with ssduck.open(place / name) as ss:
        world = ss.worlds[0]
        assert drawn(world) == expected
        assert world.camera == camera != Camera()
    colours = {row[9:] for rows in expected.values() for row in rows}
    assert len(colours) > 10


@pytest.mark.slow
def test_a_colour_that_is_not_finite_is_none(client, tmp_path):
    body = solid(client, pybullet.GEOM_BOX, 1, halfExtents=[0.1] * 3)
    pybullet.changeVisualShape(body, -1, rgbaColor=(np.nan, 0, 0, 1), physicsClientId=client)
    with ssduck.Interpreter(tmp_path / "run.duckdb") as ss:
        ss.add_variable("lab", ssduck.World.attach(client, names={body: "box"}))
        with ss.record_to(tmp_path / "run"):
            ss["lab"].step(3)
    pybullet.disconnect(client)
    for name in ("run", "run.duckdb"):
        with ssduck.open(tmp_path / name) as ss:
            (shape,) = drawn(ss.worlds[0])["box"]
            assert len(shape) == 9  # without a colour
            assert ss.eval("SELECT max(z(this)) FROM lab{} AS value;") == 0.0
        assert ssduck.check(tmp_path / name) == []


@pytest.mark.slow
def test_a_record_without_visuals_is_drawn_by_its_shapes_without_colours(tmp_path):
    entities = {"table": {"box": [1, 1, 0.1]}, "cup": {"sphere": 0.05}}
    poses = {"table": [0, 0, 0], "cup": [0, 0, 1]}
    ssduck.write_record(tmp_path / "run", entities, poses, [0.0])
    with ssduck.open(tmp_path / "run") as ss:
        world = ss.worlds[0]
        assert world.camera == framing_camera(world.snapshot)
        for info in world.snapshot.entities:
            if info.body is not None:
                shapes = drawn_shapes(world.simulator, info.body)
                assert [s.geometry for s in shapes] == [s.geometry for s in info.body.shapes]
                assert all(shape.colour is None for shape in shapes)
        ss.export(tmp_path / "copy")
    with ssduck.open(tmp_path / "copy") as ss:
        assert all(
            info.body.visuals is None for info in ss.worlds[0].snapshot.entities if info.body
        )


@pytest.mark.slow
def test_a_history_in_memory_reads_no_mesh_for_it():
    with ssduck.load("kitchen") as ss:
        rows = ss.sql("SELECT visuals FROM kitchen.entities_model").fetchall()
    assert rows
    assert all(visuals is None for (visuals,) in rows)


MODEL = """
<mujoco>
  <asset><material name="red" rgba="1 0 0 1"/></asset>
  <worldbody>
    <geom name="floor" type="plane" size="1 1 1"/>
    <body name="egg" pos="0 0 1">
      <freejoint/>
      <geom type="ellipsoid" size=".1 .2 .3" material="red"/>
      <geom type="box" size=".1 .1 .1" pos="0 0 .4" rgba="0 0 1 .5" contype="0" conaffinity="0"/>
      <geom type="sphere" size=".1" group="3"/>
      <geom type="sphere" size=".2" rgba="1 1 1 0"/>
    </body>
    <body name="plain" pos="1 0 1"><freejoint/><geom type="sphere" size=".1" group="4"/></body>
  </worldbody>
</mujoco>
"""


@pytest.mark.filterwarnings("ignore:egg. bounding boxes")
def test_mujocos_geoms_are_drawn_as_its_viewer_does():
    mujoco = pytest.importorskip("mujoco", reason="MuJoCo is not installed")
    model = mujoco.MjModel.from_xml_string(MODEL)
    world = World.attach(model, mujoco.MjData(model))
    bodies = {info.name: info.body for info in world.snapshot.entities}
    egg, box = drawn_shapes(world.simulator, bodies["egg"])
    assert egg.geometry.type == "mesh"
    assert egg.colour == (1, 0, 0, 1)
    lengths = np.linalg.norm(egg.geometry.vertices / [0.1, 0.2, 0.3], axis=1)
    assert np.allclose(lengths, 1.0)
    assert box.geometry.type == "box"
    assert box.colour == (0, 0, 1, 0.5)
    assert box.position.tolist() == [0, 0, 0.4]
    (plain,) = drawn_shapes(world.simulator, bodies["plain"])  # what collides, as nothing is drawn
    assert plain.geometry.type == "sphere"
