"""AS environment: new, running worlds of selected entities; worlds that are saved as scenes."""

from __future__ import annotations

import gc
import os
import warnings
from pathlib import Path

import numpy as np
import pybullet
import pytest

import ssduck
from ssduck.errors import (
    ArgumentError,
    RemovedEntityError,
    SceneError,
    SelectScriptError,
    SimulatorError,
    UnknownNameError,
    UnsupportedError,
)
from ssduck.simulators.scenes import shipped_scenes
from ssduck.sql.relations.registry import RELATIONS
from tests.support.bodies import create_linked_body
from tests.support.cases import sampled
from tests.support.urdf import box_obj, collision, joint, link, robot

# Nothing that these rest on moves, and nothing else touches them.
CLOSED = ("kitchen", "sink", "toaster", "knife_block")


def state(world):
    """All numbers of all entities, by name."""
    return {
        entity.name: np.array(
            [
                *entity.pose,
                *entity.velocity,
                *np.ravel(entity.aabb),
                entity.mass,
                entity.enabled,
                entity.visible,
                *(number for j in entity.joints for number in (j.position, j.velocity)),
                *(number for one in entity.links for number in (*one.position, one.mass)),
            ]
        )
        for entity in world
    }


def farthest(first, second, names=None):
    """By how much the worlds' numbers differ at most; of these entities only."""
    a, b = state(first), state(second)
    names = a.keys() if names is None else names
    assert set(names) == b.keys()
    return max((float(np.abs(a[name] - b[name]).max()) for name in names), default=0.0)


def told_relations():
    """Relations of one entity or two, as programs write them."""
    for name, relation in RELATIONS.items():
        needed = [p for p in relation.parameters if not p.optional]
        if name != "tick" and all(p.type in ("entity", "place") for p in needed):
            yield name, len(needed)


# What these tell depends on what else is there: on what rays meet, and on the solver.
OF_THE_REST = {
    *("isSensing", "sensingAmount", "sensingEnvIDs", "inContact", "contactForce", "force"),
    "environmentID",  # which counts entities
}
ONE = sorted(name for name, count in told_relations() if count == 1)
TWO = sorted(name for name, count in told_relations() if count == 2)


def by_name(value):
    """A value with names for entities, which are of different worlds."""
    if isinstance(value, ssduck.Entity):
        return value.name
    if isinstance(value, list | tuple):
        return [by_name(part) for part in value]
    if isinstance(value, dict):
        return {key: by_name(part) for key, part in value.items()}
    return value


def rounded(value):
    """Numbers in it to 1e-6; a pose that is set comes back a little off."""
    if isinstance(value, float):
        return round(value, 6) + 0.0
    if isinstance(value, list):
        return [rounded(part) for part in value]
    if isinstance(value, dict):
        return {key: rounded(part) for key, part in value.items()}
    return value


def relations(world, names, *, skipped=frozenset()):
    """What all relations tell of some entities."""
    ss = ssduck.Interpreter()
    ss.add_variable("w", world)
    ss.add_variable("names", list(names))
    told = {}
    for name in ONE:
        if name not in skipped:
            program = f"SELECT id(this), {name}(this) FROM w WHERE id(this) IN names AS list;"
            told[name] = by_name(ss.eval(program))
    for name in TWO:
        if name not in skipped:
            told[name] = by_name(
                ss.eval(
                    f"SELECT id(a.this), id(b.this), {name}(a.this, b.this) FROM a = w, b = w "
                    "WHERE id(a.this) IN names AND id(b.this) IN names AS list;"
                )
            )
    return told


@pytest.fixture
def kitchen():
    ss = ssduck.load("kitchen")
    yield ss.call_variable("kitchen")
    ss.close()


# -- what there is -----------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("scene", shipped_scenes())
def test_an_excerpt_of_all_is_the_same_and_stays_so(scene):
    ss = ssduck.load(scene)
    world = ss.call_variable(scene)
    copy = ss.eval(f"SELECT obj FROM {scene} AS environment;")
    assert copy is not world
    assert [(e.name, e.kind) for e in copy] == [(e.name, e.kind) for e in world]
    assert (copy.time, copy.timestep, copy.camera) == (0.0, world.timestep, world.camera)
    assert farthest(world, copy) == 0.0
    world.step(480)
    copy.step(480)
    assert copy.time == world.time == pytest.approx(2.0)
    assert farthest(world, copy) < 1e-6


@pytest.mark.slow
@pytest.mark.parametrize("chosen", [None, CLOSED], ids=["all", "some"])
def test_relations_agree(kitchen, chosen):
    names = [entity.name for entity in kitchen] if chosen is None else list(chosen)
    copy = kitchen.excerpt(names)
    skipped = OF_THE_REST if chosen else frozenset()
    assert relations(copy, names, skipped=skipped) == relations(kitchen, names, skipped=skipped)


@pytest.mark.slow
def test_what_is_closed_in_itself_goes_on_alike(kitchen):
    copy = kitchen.excerpt(CLOSED)
    assert farthest(kitchen, copy, CLOSED) == 0.0
    kitchen.step(480)
    copy.step(480)
    assert farthest(kitchen, copy, CLOSED) < 1e-6


@pytest.mark.slow
def test_after_steps_an_excerpt_begins_alike_and_goes_on_nearly_so(kitchen):
    """Bodies of several shapes find their contacts anew, and no two runs of those agree."""
    kitchen.step(240)
    copy = kitchen.excerpt(kitchen)
    assert copy.time == kitchen.time
    assert farthest(kitchen, copy) < 1e-12
    kitchen.step(480)
    copy.step(480)
    for entity in kitchen:
        assert copy[entity.name].position == pytest.approx(entity.position, abs=1e-3)


def test_it_holds_exactly_what_is_selected(kitchen):
    ss = ssduck.Interpreter()
    ss.add_variable("kitchen", kitchen)
    near = ss.eval(
        "roomba = SELECT obj FROM kitchen WHERE id(this) == 'roomba_625x' AS value;"
        "SELECT obj FROM kitchen WHERE distance(roomba, this) <= 1.5 AS environment;"
    )
    asked = ss.eval("SELECT id(this) FROM kitchen WHERE distance(roomba, this) <= 1.5 AS list;")
    assert [entity.name for entity in near] == asked
    assert farthest(kitchen, near, asked) < 1e-12
    assert isinstance(near["roomba_625x"], ssduck.Robot)
    assert type(near["table"]) is ssduck.KinBody


def test_a_sensor_brings_its_body_and_a_body_no_sensor(kitchen):
    kitchen["fridge_webcam"].power(False)
    with_body = kitchen.excerpt(["fridge_webcam"])
    assert [entity.name for entity in with_body] == ["fridge_webcam", "fridge"]
    assert not with_body["fridge_webcam"].powered
    assert [entity.name for entity in kitchen.excerpt(["fridge"])] == ["fridge"]


def test_nothing_selected_is_an_empty_world_of_the_same_settings(client):
    pybullet.setGravity(0, 0, -1.5, client)
    pybullet.setTimeStep(0.01, client)
    pybullet.setPhysicsEngineParameter(numSolverIterations=20, physicsClientId=client)
    ss = ssduck.Interpreter()
    ss.add_variable("w", ssduck.World.attach(client))
    empty = ss.eval("SELECT obj FROM w WHERE mass(this) > 1000 AS environment;")
    assert len(empty) == 0
    assert empty.simulator.parameters() == pybullet.getPhysicsEngineParameters(client)
    assert empty.step(3).time == pytest.approx(0.03)


def test_neither_knows_of_the_other(kitchen):
    copy = kitchen.excerpt(kitchen)
    before = state(kitchen)
    copy["table"].move([5, 5, 5])
    copy["barrett_4918"].move(joints={"j1": 0.1})
    copy["can"].enabled = False
    copy["mixer"].visible = False
    copy.remove("shaker")
    copy.step(10)
    after = state(kitchen.tick())
    assert all(np.array_equal(after[name], before[name]) for name in before)
    kitchen.close()
    assert copy.step(1).time == pytest.approx(11 / 240)
    with pytest.raises(SimulatorError, match="closed"):
        kitchen.step(1)


def test_what_was_switched_off_is_so_there(kitchen):
    kitchen["can"].enabled = False
    kitchen["mixer"].visible = False
    copy = kitchen.excerpt(["can", "mixer", "kitchen"])
    assert {e.name: (e.enabled, e.visible) for e in copy} == {
        "can": (False, True),
        "mixer": (True, False),
        "kitchen": (True, True),
    }
    copy["mixer"].visible = True
    third = copy.excerpt(copy)
    assert {e.name: (e.enabled, e.visible) for e in third} == {
        "can": (False, True),
        "mixer": (True, True),
        "kitchen": (True, True),
    }


def test_motors_hold_where_they_do(kitchen):
    """Not where joints happen to be: the arm sags under its weight."""
    kitchen.step(240)
    copy = kitchen.excerpt(["barrett_4918"])
    held = {kitchen.simulator.loaded.motor_positions[handle].__repr__() for handle in (2,)}
    assert held == {repr(positions) for positions in copy.simulator.loaded.motor_positions.values()}
    copy["barrett_4918"].move(joints={"j1": 0.1})
    again = copy.excerpt(copy)
    (held,) = again.simulator.loaded.motor_positions.values()
    assert 0.1 in held.values()


# -- clients of others -------------------------------------------------------------------------


TILTED = pybullet.getQuaternionFromEuler([0.3, 0.2, 0.1])


@pytest.fixture
def menagerie(client):
    """A world of bodies of all sorts in a client of the user's; some of them touch the ground."""
    pybullet.setGravity(0, 0, -9.81, client)
    bodies = create_solids(client) | create_arm(client) | create_tied_boxes(client)
    return ssduck.World.attach(client, names={number: name for name, number in bodies.items()})


def create_shape(client, kind, **size):
    return pybullet.createCollisionShape(kind, physicsClientId=client, **size)


def create_box(client):
    return create_shape(client, pybullet.GEOM_BOX, halfExtents=[0.1, 0.2, 0.05])


def create_solids(client):
    """Creates bodies without links, one with other dynamics and one of another colour."""
    own = {"physicsClientId": client}
    ground = create_shape(client, pybullet.GEOM_BOX, halfExtents=[20, 20, 0.1])
    ball = create_shape(client, pybullet.GEOM_SPHERE, radius=0.1)
    cylinder = create_shape(client, pybullet.GEOM_CYLINDER, radius=0.05, height=0.2)
    capsule = create_shape(client, pybullet.GEOM_CAPSULE, radius=0.05, height=0.2)
    offset = {"baseInertialFramePosition": [0.02, 0, 0.01], "baseOrientation": TILTED}
    lying = {"baseOrientation": pybullet.getQuaternionFromEuler([0.3, np.pi / 2, 0.1])}
    create = pybullet.createMultiBody
    bodies = {
        "ground": create(0, ground, **own),
        "box": create(2, create_box(client), basePosition=[0, 0, 0.5], **offset, **own),
        "ball": create(1, ball, basePosition=[1, 0, 0.5], **own),
        "cylinder": create(1, cylinder, basePosition=[2, 0, 0.3], **lying, **own),
        "capsule": create(1, capsule, basePosition=[3, 0, 0.3], **own),
    }
    pybullet.changeDynamics(
        bodies["ball"],
        -1,
        lateralFriction=0.9,
        rollingFriction=0.01,
        restitution=0.7,
        localInertiaDiagonal=[0.01, 0.02, 0.03],
        **own,
    )
    pybullet.resetBaseVelocity(bodies["ball"], [1, 0, 0], [0, 0, 3], client)
    pybullet.changeVisualShape(bodies["box"], -1, rgbaColor=[1, 0, 0, 0.5], **own)
    return bodies


def create_arm(client):
    """Creates a fixed body of three links; two of its joints move."""
    box = create_box(client)
    ball = create_shape(client, pybullet.GEOM_SPHERE, radius=0.1)
    straight = [0, 0, 0, 1]
    arm = pybullet.createMultiBody(
        0,
        box,
        basePosition=[8, 0, 3],
        linkMasses=[1, 0.5, 0.3],
        linkCollisionShapeIndices=[box, box, ball],
        linkVisualShapeIndices=[-1] * 3,
        linkPositions=[[0.3, 0, 0], [0, 0.5, 0], [0, 0, 0.3]],
        linkOrientations=[TILTED, straight, straight],
        linkInertialFramePositions=[[0.05, 0, 0], [0, 0, 0], [0, 0, 0]],
        linkInertialFrameOrientations=[TILTED, straight, straight],
        linkParentIndices=[0, 1, 1],
        linkJointTypes=[pybullet.JOINT_REVOLUTE, pybullet.JOINT_PRISMATIC, pybullet.JOINT_FIXED],
        linkJointAxis=[[0, 0, 1], [1, 0, 0], [0, 0, 0]],
        physicsClientId=client,
    )
    pybullet.resetJointState(arm, 0, 0.4, 0.2, client)
    pybullet.resetJointState(arm, 1, 0.05, -0.1, client)
    return {"arm": arm}


def create_tied_boxes(client):
    """Creates a box that hangs from a point of the world, and one that is fixed to it."""
    own = {"physicsClientId": client}
    box = create_box(client)
    first = pybullet.createMultiBody(1, box, basePosition=[10, 0, 3], **own)
    second = pybullet.createMultiBody(1, box, basePosition=[10, 0.6, 3], **own)
    point = pybullet.JOINT_POINT2POINT
    pybullet.createConstraint(
        first, -1, -1, -1, point, [0, 0, 0], [0, -0.2, 0], [10, -0.2, 3.1], **own
    )
    tie = pybullet.createConstraint(
        first, -1, second, -1, pybullet.JOINT_FIXED, [0] * 3, [0, 0.3, 0], [0, -0.3, 0], **own
    )
    pybullet.changeConstraint(tie, maxForce=200, **own)
    return {"first": first, "second": second}


def dynamics(world):
    """What PyBullet tells of the links: masses, inertias, friction and so on; colours."""
    client = world.simulator.client
    return {
        member.name: (
            [
                np.round([*told[:2], *told[2], *told[3], *told[4], *told[5:10]], 12).tolist()
                for i in range(-1, len(member.body.joints))
                for told in [pybullet.getDynamicsInfo(member.body.handle, i, client)]
            ],
            [
                pybullet.getJointInfo(member.body.handle, i, client)[6]
                for i in range(len(member.body.joints))
            ],
            [
                entry[7]
                for entry in pybullet.getVisualShapeData(member.body.handle, physicsClientId=client)
            ],
        )
        for member in world.snapshot.load_order
        if member.body is not None
    }


def constraints(world):
    """What PyBullet tells of the constraints."""
    client = world.simulator.client
    numbers = [
        pybullet.getConstraintUniqueId(i, physicsClientId=client)
        for i in range(pybullet.getNumConstraints(client))
    ]
    return [pybullet.getConstraintInfo(number, client)[4:] for number in numbers]


MOTORS = "arm: the motors are not known"


@pytest.mark.parametrize("steps", [0, 100, 300])
def test_bodies_of_others_go_on_alike(menagerie, steps):
    """Contacts are carried over, as each link has one shape, and that is a primitive."""
    menagerie.step(steps)
    with pytest.warns(UserWarning, match=MOTORS):
        copy = menagerie.excerpt(menagerie)
    assert farthest(menagerie, copy) < 1e-12
    assert dynamics(copy) == dynamics(menagerie)
    assert constraints(copy) == constraints(menagerie)
    again = copy.excerpt(copy)
    menagerie.step(480)
    for world in (copy, again):
        world.step(480)
        assert farthest(menagerie, world) < 1e-6


@pytest.mark.slow
def test_relations_of_bodies_of_others_agree(menagerie):
    menagerie.step(300)
    with pytest.warns(UserWarning, match=MOTORS):
        copy = menagerie.excerpt(menagerie)
    names = [entity.name for entity in menagerie]
    ours, theirs = relations(copy, names), relations(menagerie, names)
    for name in ("inContact", "contactForce"):
        del ours[name], theirs[name]  # the force is that of a step, and there was none yet
    assert rounded(ours) == rounded(theirs)


@pytest.mark.slow
def test_hulls_and_meshes_of_others(client, tmp_path):
    """Their margins are others, so that they rest elsewhere by a 100th of a millimetre."""
    own = {"physicsClientId": client}
    pybullet.setGravity(0, 0, -9.81, client)
    corners = [[x, y, z] for x in (-0.1, 0.1) for y in (-0.05, 0.05) for z in (-0.08, 0.08)]
    file = tmp_path / "crate.obj"
    file.write_text(box_obj((-0.1, -0.1, -0.1), (0.1, 0.1, 0.1)), encoding="utf-8")
    ground = pybullet.createCollisionShape(pybullet.GEOM_BOX, halfExtents=[9, 9, 0.1], **own)
    hull = pybullet.createCollisionShape(pybullet.GEOM_MESH, vertices=corners, **own)
    mesh = pybullet.createCollisionShape(
        pybullet.GEOM_MESH, fileName=str(file), meshScale=[1, 2, 1], **own
    )
    pybullet.createMultiBody(0, ground, **own)
    pybullet.createMultiBody(1, hull, basePosition=[0, 0, 0.19], **own)
    pybullet.createMultiBody(1, mesh, basePosition=[1, 0, 0.22], **own)
    world = ssduck.World.attach(client, names={0: "ground", 1: "hull", 2: "mesh"})
    copy = world.excerpt(world)
    assert farthest(world, copy) < 1e-12
    names = ["ground", "hull", "mesh"]
    assert relations(copy, names) == relations(world, names)
    world.step(480)
    copy.step(480)
    assert farthest(world, copy) < 1e-3
    assert dynamics(copy) == dynamics(world)


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
    shape = pybullet.createCollisionShape(
        pybullet.GEOM_BOX, halfExtents=[1, 1, 1], physicsClientId=client
    )
    assert pybullet.createMultiBody(1, shape, physicsClientId=client) == numbers["ball"]
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
    plane = "cloth_z_up.obj"
    import pybullet_data

    pybullet.resetSimulation(pybullet.RESET_USE_DEFORMABLE_WORLD, physicsClientId=client)
    path = f"{pybullet_data.getDataPath()}/{plane}"
    pybullet.loadSoftBody(path, mass=1, useMassSpring=1, physicsClientId=client)
    with pytest.warns(UserWarning, match="does not give back all shapes"):
        world = ssduck.World.attach(client, names={0: "cloth"})
    with pytest.raises(UnsupportedError, match="'cloth' is soft"):
        world.excerpt(world)


def test_a_concave_mesh_without_a_file_is_copied(client, tmp_path):
    file = tmp_path / "bowl.obj"
    file.write_text(box_obj((-0.1, -0.1, -0.1), (0.1, 0.1, 0.1)), encoding="utf-8")
    shape = pybullet.createCollisionShape(
        pybullet.GEOM_MESH,
        fileName=str(file),
        flags=pybullet.GEOM_FORCE_CONCAVE_TRIMESH,
        physicsClientId=client,
    )
    number = pybullet.createMultiBody(0, shape, physicsClientId=client)
    file.unlink()
    world = ssduck.World.attach(client, names={number: "bowl"})
    copy = world.excerpt(world)
    assert copy["bowl"].aabb[0] == pytest.approx([-0.1, -0.1, -0.1])


def test_what_stands_in_for_a_shape_is_told_of(client):
    shape = pybullet.createCollisionShape(
        pybullet.GEOM_HEIGHTFIELD,
        heightfieldData=[0.0, 1.0] * 8,
        numHeightfieldRows=4,
        numHeightfieldColumns=4,
        physicsClientId=client,
    )
    number = pybullet.createMultiBody(0, shape, physicsClientId=client)
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


# -- other ticks -------------------------------------------------------------------------------


@pytest.fixture
def recorded(kitchen):
    """The kitchen, recorded each 60 steps for a second, and what it was like at half of it."""
    ss = ssduck.Interpreter()
    ss.add_variable("kitchen", kitchen)
    ss.record("kitchen", ssduck.Recording(tables=("joints", "links")))
    for _ in range(2):
        kitchen.step(60)
    half = state(kitchen)
    for _ in range(2):
        kitchen.step(60)
    return ss, half


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


# -- errors ------------------------------------------------------------------------------------


@pytest.mark.slow
def test_entities_of_other_worlds_and_ticks(kitchen, client, recorded):
    ss, _ = recorded
    other = ssduck.World.attach(client, name="other")
    with pytest.raises(ArgumentError, match="in world 'kitchen', not in 'other'"):
        other.excerpt([kitchen["table"]])
    with pytest.raises(UnknownNameError, match="did you mean 'table'"):
        kitchen.excerpt(["tabel"])
    with pytest.raises(SelectScriptError, match="several ticks"):
        ss.eval("SELECT obj FROM kitchen{-0.5} AS environment;")
    with pytest.raises(SelectScriptError, match="no column holds an entity"):
        ss.eval("SELECT x(this) FROM kitchen AS environment;")
    copy = kitchen.excerpt(["table", "can"])
    can = copy["can"]
    copy.remove(can)
    with pytest.raises(RemovedEntityError):
        copy.excerpt([can])


def test_entities_of_two_worlds(kitchen):
    ss = ssduck.Interpreter()
    ss.add_variable("kitchen", kitchen)
    ss.add_variable("other", kitchen.excerpt(["table"]))
    with pytest.raises(SelectScriptError, match="entities of one world"):
        ss.eval("SELECT obj(a.this), obj(b.this) FROM a = kitchen, b = other AS environment;")


# -- removing, OpenRAVE's names ----------------------------------------------------------------


def test_removing(kitchen, client):
    copy = kitchen.excerpt(kitchen)
    copy.remove("fridge_webcam")
    copy.remove(copy["roomba_625x"])
    gone = {"fridge_webcam", "roomba_625x", *(e.name for e in kitchen if "roomba" in e.name)}
    assert [e.name for e in copy] == [e.name for e in kitchen if e.name not in gone]
    again = copy.excerpt(copy)
    assert [e.name for e in again] == [e.name for e in copy]
    shape = pybullet.createCollisionShape(pybullet.GEOM_SPHERE, radius=0.1, physicsClientId=client)
    number = pybullet.createMultiBody(1, shape, physicsClientId=client)
    theirs = ssduck.World.attach(client, names={number: "ball"})
    with pytest.raises(UnsupportedError, match="client of yours"):
        theirs.remove("ball")
    with pytest.raises(UnsupportedError, match="what-if"):
        kitchen.what_if().remove("can")


def test_cloning_nothing(kitchen):
    assert len(kitchen.CloneSelf(8)) == 0
    clone = kitchen.CloneSelf(1)
    assert len(clone) == len(kitchen)
    clone.Destroy()
    with pytest.raises(SimulatorError):
        clone.step()


# -- what they take ----------------------------------------------------------------------------


def memory():
    pages = Path("/proc/self/statm").read_text(encoding="ascii").split()[1]
    return int(pages) * os.sysconf("SC_PAGE_SIZE") / 1e6


def connected():
    return sum(map(pybullet.isConnected, range(1024)))


@pytest.mark.slow
def test_closed_worlds_and_forgotten_ones_give_all_back(kitchen):
    chosen = ["kitchen", "table", "cup_905a", "roomba_625x"]
    gc.collect()  # what other tests have left
    before = connected()
    for number in range(60):
        copy = kitchen.excerpt(chosen)
        assert connected() <= before + 1
        if number % 2:
            copy.close()
        del copy
        if number == 10:
            gc.collect()
            first = memory()
    assert connected() == before
    gc.collect()
    assert memory() - first < 100  # a client takes some ten: 50 of them would be more


@pytest.mark.slow
def test_worlds_in_circles_make_room(kitchen, monkeypatch):
    """What waits for the collector holds a client; there are so many only."""
    copy = kitchen.excerpt(["table"])
    copy.myself = copy
    used = copy.simulator.client
    del copy
    assert pybullet.isConnected(used)
    real, answers = pybullet.connect, iter([-1])
    monkeypatch.setattr(pybullet, "connect", lambda mode: next(answers, None) or real(mode))
    kitchen.excerpt(["table"])
    assert not pybullet.isConnected(used) or used == connected()
    monkeypatch.setattr(pybullet, "connect", lambda _: -1)
    with pytest.raises(SimulatorError, match="could not make another client"):
        kitchen.excerpt(["table"])


# -- scenes ------------------------------------------------------------------------------------


@sampled("steps", [0, 120], every=2)
def test_a_saved_kitchen_is_the_same(kitchen, tmp_path, steps):
    kitchen.step(steps)
    kitchen["can"].enabled = False
    kitchen["mixer"].visible = False
    kitchen["fridge_webcam"].power(False)
    file = kitchen.save(tmp_path / "saved")
    assert file == tmp_path / "saved" / "scene.toml"
    assert "\neye = [3.55, -4.1, 3.45]\n" in file.read_text(encoding="utf-8")
    loaded = ssduck.load(tmp_path / "saved").call_variable("kitchen")
    assert loaded.time == pytest.approx(kitchen.time)
    assert loaded.camera == kitchen.camera
    assert [(e.name, e.kind) for e in loaded] == [(e.name, e.kind) for e in kitchen]
    assert farthest(kitchen, loaded) < 1e-12
    specs = [[e.spec for e in world if e.kind == "sensor"] for world in (kitchen, loaded)]
    assert [s.name for s in specs[0]] == [s.name for s in specs[1]]
    assert not loaded["fridge_webcam"].powered
    ours, theirs = loaded.simulator.loaded.motor_positions, kitchen.simulator.loaded.motor_positions
    assert list(ours.values()) == list(theirs.values())
    again = ssduck.load(loaded.save(tmp_path / "again")).worlds[0]
    assert farthest(loaded, again) < 1e-12


def test_saved_bodies_of_others(menagerie, tmp_path):
    menagerie.step(100)
    with pytest.warns(UserWarning, match=MOTORS):
        menagerie.save(tmp_path / "saved")
    with pytest.warns(UserWarning, match=MOTORS):
        copy = menagerie.excerpt(menagerie)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        loaded = ssduck.load(tmp_path / "saved").worlds[0]
    assert farthest(menagerie, loaded) < 1e-6
    assert dynamics(loaded) == dynamics(menagerie)
    assert constraints(loaded) == constraints(menagerie)
    copy.step(20)
    loaded.step(20)
    first, second = state(copy), state(loaded)
    for name in ("ground", "arm", "first", "second"):  # which touch nothing
        assert first[name] == pytest.approx(second[name], abs=1e-6)


def test_saved_names_are_made_fit(client, write, tmp_path):
    """Of links and joints without names, of several of one name, of odd ones."""
    text = robot(
        link("a", shapes=collision('<sphere radius="0.1"/>')),
        link("b"),
        joint("j", "revolute", "a", "b", limit='<limit lower="-1" upper="1" effort="5"/>'),
        name='rob\u00f6ter "x"',
    ).replace('"rob\u00f6ter "x""', "'rob\u00f6ter \"x\"'")
    number = pybullet.loadURDF(str(write("r.urdf", text)), physicsClientId=client)
    pybullet.resetJointState(number, 0, 0.25, physicsClientId=client)
    names = {number: 'odd "name" \\ \t/..'}
    world = ssduck.World.attach(client, names=names, name='the "world"; 2')
    world.add_sensor("range_finder", 'odd "name" \\ \t/..', "eye", "b", max_range=2.0)
    with pytest.warns(UserWarning, match="the motors are not known"):
        world.save(tmp_path / "saved")
    loaded = ssduck.load(tmp_path / "saved").worlds[0]
    assert loaded.name == "the__world___2"  # a variable
    assert farthest(world, loaded) < 1e-12
    assert loaded['odd "name" \\ \t/..'].joints[0].upper == 1.0


def test_a_joint_beyond_its_limit_is_saved_where_it_is(client, write, tmp_path):
    """Solvers leave joints there."""
    text = robot(
        link("a", mass=0, shapes=collision('<sphere radius="0.1"/>')),
        link("b"),
        joint("j", "revolute", "a", "b", limit='<limit lower="-1" upper="1" effort="5"/>'),
    )
    number = pybullet.loadURDF(str(write("r.urdf", text)), physicsClientId=client)
    pybullet.resetJointState(number, 0, 1.0009, physicsClientId=client)
    world = ssduck.World.attach(client)
    with pytest.warns(UserWarning, match="the motors are not known"):
        world.save(tmp_path / "saved")
    assert ssduck.load(tmp_path / "saved").worlds[0]["model"].joints[0].position == 1.0009


def test_nothing_is_saved_over(kitchen, tmp_path):
    (tmp_path / "mine").write_text("mine", encoding="utf-8")
    with pytest.raises(SceneError, match="not empty"):
        kitchen.save(tmp_path)
    with pytest.raises(SceneError, match="mine"):
        kitchen.save(tmp_path / "mine")


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ('[[constraint]]\ntype = "glue"\non = "a"', r"constraint\[0\].type: no such constraint"),
        ('[[constraint]]\ntype = "fixed"\non = "b"', r"constraint\[0\].on: the scene has no body"),
        (
            '[[constraint]]\ntype = "fixed"\non = "a"\nlink = "x"',
            r"constraint\[0\].on_link: 'a' has no link 'x'",
        ),
        ("[engine]\niterations = 0", "engine.iterations: 0 is less than 1"),
        ("[engine]\nsubsteps = 1.5", "engine.substeps: 1.5 is no whole number"),
    ],
)
def test_mistakes_in_what_scenes_say(write, text, told):
    write("a.urdf", robot(link("base", shapes=collision('<sphere radius="0.1"/>'))))
    path = write("s.toml", f'[[body]]\nname = "a"\nurdf = "a.urdf"\n{text}\n')
    with pytest.raises(SceneError, match=told):
        ssduck.load(path)
