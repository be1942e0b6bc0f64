"""Copies of attached clients and of past ticks."""

import numpy as np
import pybullet
import pybullet_data
import pytest

import ssduck
from ssduck.errors import UnsupportedError
from tests.support.bodies import create_linked_body, solid
from tests.support.environments import MOTORS, constraints, dynamics, farthest, relations, state
from tests.support.urdf import box_obj

# -- clients of others ---------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("steps", [0, 100, 300])
def test_bodies_of_others_go_on_alike(menagerie, steps):
    """What touches nothing to the last digits; what rests or rolls finds its contacts anew."""
    menagerie.step(steps)
    with pytest.warns(UserWarning, match=MOTORS):
        copy = menagerie.excerpt(menagerie)
    assert farthest(menagerie, copy) < 1e-12
    assert dynamics(copy) == dynamics(menagerie)
    assert constraints(copy) == constraints(menagerie)
    again = copy.excerpt(copy)
    menagerie.step(480)
    before, free = state(menagerie), ("ground", "arm", "first", "second")
    for world in (copy, again):
        world.step(480)
        after = state(world)
        for name in free if steps else before:
            assert after[name] == pytest.approx(before[name], abs=1e-6)
        for entity in menagerie:
            moved = np.abs(np.array(world[entity.name].position) - entity.position)
            assert moved.max() < 0.02  # one rolls


@pytest.mark.long
def test_hulls_and_meshes_of_others(client, tmp_path):
    """Their margins are others, so that they rest elsewhere by a 100th of a millimetre."""
    pybullet.setGravity(0, 0, -9.81, client)
    corners = [[x, y, z] for x in (-0.1, 0.1) for y in (-0.05, 0.05) for z in (-0.08, 0.08)]
    file = tmp_path / "crate.obj"
    file.write_text(box_obj((-0.1, -0.1, -0.1), (0.1, 0.1, 0.1)), encoding="utf-8")
    solid(client, pybullet.GEOM_BOX, 0, halfExtents=[9, 9, 0.1])
    solid(client, pybullet.GEOM_MESH, 1, [0, 0, 0.19], vertices=corners)
    solid(client, pybullet.GEOM_MESH, 1, [1, 0, 0.22], fileName=str(file), meshScale=[1, 2, 1])
    world = ssduck.World.attach(client, names={0: "ground", 1: "hull", 2: "mesh"})
    copy = world.excerpt(world)
    assert farthest(world, copy) < 1e-12
    names = ["ground", "hull", "mesh"]
    assert relations(copy, names) == relations(world, names)
    world.step(480)
    copy.step(480)
    assert farthest(world, copy) < 1e-3
    assert dynamics(copy) == dynamics(world)


@pytest.mark.slow
def test_models_of_others(kitchen):
    """The kitchen, of which nothing is known but what its client tells."""
    kitchen.step(60)
    bodies = [member for member in kitchen.snapshot.load_order if member.body is not None]
    names = {member.body.handle: member.name for member in bodies}
    world = ssduck.World.attach(kitchen.simulator.client, names=names)
    with pytest.warns(UserWarning, match="barrett_4918, roomba_625x: the motors are not known"):
        copy = world.excerpt(world)
    assert farthest(world, copy) < 1e-12
    assert dynamics(copy) == dynamics(world)
    pictures = [one.render(160, 120, kitchen.camera).astype(int) for one in (world, copy)]
    assert np.abs(pictures[0] - pictures[1]).mean() < 0.01


def test_constraints_come_with_both_of_their_bodies(menagerie):
    assert len(constraints(menagerie.excerpt(["first", "second"]))) == 2
    assert [told[0] for told in constraints(menagerie.excerpt(["first"]))] == [
        pybullet.JOINT_POINT2POINT
    ]
    assert constraints(menagerie.excerpt(["second"])) == []


def test_a_number_that_another_body_has_by_now(client, menagerie):
    """A body that went since the tick is made of what is known of it."""
    numbers = {member.name: member.body.handle for member in menagerie.snapshot.load_order}
    ball = menagerie["ball"].position
    pybullet.removeBody(numbers["ball"], client)
    assert solid(client, pybullet.GEOM_BOX, 1, halfExtents=[1, 1, 1]) == numbers["ball"]
    with pytest.warns(UserWarning, match="ball: only shapes, links, joints and masses are known"):
        copy = menagerie.excerpt(["ball"])
    assert copy["ball"].position == pytest.approx(ball)
    assert copy["ball"].aabb[0] == pytest.approx([p - 0.1 for p in ball])
    assert copy["ball"].mass == 1.0


def test_spherical_joints(client):
    own = {"physicsClientId": client}
    ball = pybullet.createCollisionShape(pybullet.GEOM_SPHERE, radius=0.1, **own)
    number = create_linked_body(
        client,
        0,
        ball,
        linkPositions=[[0.3, 0, 0]],
        linkInertialFramePositions=[[0.2, 0, 0]],
        linkJointTypes=[pybullet.JOINT_SPHERICAL],
    )
    turn = pybullet.getQuaternionFromEuler([0.3, 0.2, 0.5])
    pybullet.resetJointStateMultiDof(number, 0, turn, [0.1, 0.2, 0.3], physicsClientId=client)
    world = ssduck.World.attach(client)
    copy = world.excerpt(world)
    assert farthest(world, copy) < 1e-12
    world.step(240)
    copy.step(240)
    assert farthest(world, copy) < 1e-6


def test_soft_bodies_are_refused(client):
    pybullet.resetSimulation(pybullet.RESET_USE_DEFORMABLE_WORLD, physicsClientId=client)
    path = f"{pybullet_data.getDataPath()}/cloth_z_up.obj"
    pybullet.loadSoftBody(path, mass=1, useMassSpring=1, physicsClientId=client)
    with (
        pytest.warns(UserWarning, match="does not give back all shapes"),
        pytest.warns(UserWarning, match="a velocity that is no number"),
    ):
        world = ssduck.World.attach(client, names={0: "cloth"})
    with pytest.raises(UnsupportedError, match="'cloth' is soft"):
        world.excerpt(world)


def test_meshes_without_a_file_are_copied(client, tmp_path):
    """A concave one whose file is gone, and the hull of points."""
    file = tmp_path / "bowl.obj"
    file.write_text(box_obj((-0.1, -0.1, -0.1), (0.1, 0.1, 0.1)), encoding="utf-8")
    number = solid(
        client, pybullet.GEOM_MESH, 0, fileName=str(file), flags=pybullet.GEOM_FORCE_CONCAVE_TRIMESH
    )
    file.unlink()
    points = [[0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 3]]
    hull = solid(client, pybullet.GEOM_MESH, 1, [5, 0, 0], vertices=points)
    world = ssduck.World.attach(client, names={number: "bowl", hull: "hull"})
    copy = world.excerpt(world)
    assert copy["bowl"].aabb[0] == pytest.approx([-0.1, -0.1, -0.1])
    assert np.array(copy["hull"].aabb) == pytest.approx(np.array(world["hull"].aabb), abs=1e-3)


@pytest.mark.slow
def test_what_stands_in_for_a_shape_is_told_of(client):
    number = solid(
        client,
        pybullet.GEOM_HEIGHTFIELD,
        0,
        heightfieldData=[0.0, 1.0] * 8,
        numHeightfieldRows=4,
        numHeightfieldColumns=4,
    )
    with pytest.warns(UserWarning, match="bounding boxes") as caught:
        world = ssduck.World.attach(client, names={number: "field"})
    assert [w.filename for w in caught] == [__file__]
    with pytest.warns(UserWarning, match="field: not all shapes are given back") as caught:
        copy = world.excerpt(world)
    assert [w.filename for w in caught] == [__file__]
    assert copy["field"].aabb[0] == pytest.approx(world["field"].aabb[0])
    with ssduck.Interpreter() as ss:  # it is marked in the copy, too
        ss.add_variable("copy", copy)
        assert ss.sql("SELECT exact FROM copy.shapes").fetchall() == [(False,)]


# -- other ticks ---------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_recorded_tick(recorded):
    ss, half = recorded
    copy = ss.eval("SELECT obj FROM kitchen{0.5} AS environment;")
    assert copy.time == pytest.approx(0.5)
    here = state(copy)
    assert max(np.abs(here[name] - half[name]).max() for name in half) < 1e-9
    some = ss.eval("SELECT obj FROM kitchen{0.5} WHERE isRobot(this) AS environment;")
    assert {entity.kind for entity in some} == {"robot"}
    assert some.step(240).time == pytest.approx(1.5)


@pytest.mark.slow
def test_a_tick_of_which_joints_are_not_recorded(kitchen):
    """Their positions are told by where the links are."""
    ss = ssduck.Interpreter()
    ss.add_variable("kitchen", kitchen)
    ss.record("kitchen", ssduck.Recording(tables=()))
    kitchen.step(60)
    positions = [j.position for j in kitchen["barrett_4918"].joints]
    kitchen.step(60)
    kitchen["barrett_4918"].move(joints={"j1": 0.1, "j4": 1.0})
    with pytest.warns(UserWarning, match="barrett_4918: velocities of joints are not recorded"):
        copy = ss.eval(
            "SELECT obj FROM kitchen{0.25} WHERE id(this) == 'barrett_4918' AS environment;"
        )
    assert [j.position for j in copy["barrett_4918"].joints] == pytest.approx(positions, abs=1e-9)


@pytest.mark.slow
def test_an_opened_record_makes_a_world_of_what_is_recorded(recorded, tmp_path):
    ss, half = recorded
    ss.export(tmp_path / "run")
    opened = ssduck.open(tmp_path / "run")
    with pytest.warns(UserWarning, match="not recorded|are known") as told:
        copy = opened.eval("SELECT obj FROM kitchen{0.5} AS environment;")
    said = [str(one.message) for one in told]
    assert len(said) == 2
    assert {one.filename for one in told} == {__file__}
    assert said[0].startswith("fridge, cooker, barrett_4918")
    assert "only shapes, links, joints and masses are known" in said[0]
    assert said[1].startswith("gravity and time step are not recorded")
    here = state(copy)
    assert max(np.abs(here[name] - half[name]).max() for name in half) < 1e-9
    copy.step(120)
    at_the_end = state(opened.worlds[0])
    for name in ("table", "cup_905a", "kitchen", "barrett_4918"):
        assert here[name][4:7] == pytest.approx(at_the_end[name][4:7], abs=2e-3)


@pytest.mark.slow
def test_a_what_if_world_goes_on(kitchen):
    what = kitchen.what_if({"cup_905a": [1, 0, 0, 0, 0.4, 0.1, 1.5]}, {"barrett_4918": {"j1": 0.2}})
    copy = what.excerpt(what)
    assert farthest(what, copy) < 1e-9
    before = copy["cup_905a"].position[2]
    copy.step(60)
    assert copy["cup_905a"].position[2] < before - 0.1
    assert next(j for j in copy["barrett_4918"].joints if j.name == "j1").position == (
        pytest.approx(0.2, abs=1e-2)
    )
