"""Poses of SDF files: what PyBullet reads otherwise is put right, compared with SciPy's rotations."""

import numpy as np
import pybullet
import pytest
from scipy.spatial.transform import Rotation

from tests.support.bodies import client_of
from tests.support.models import sdf_link, sdf_model, sdf_of

# Nothing is ignored of frames to which poses are relative.
pytestmark = pytest.mark.filterwarnings("error:.*PyBullet ignores <frame>")


def frame(pose):
    """The matrix (4, 4) of a pose of SDF: x y z roll pitch yaw."""
    matrix = np.eye(4)
    matrix[:3, 3] = pose[:3]
    matrix[:3, :3] = Rotation.from_euler("xyz", pose[3:]).as_matrix()
    return matrix


def placed(link):
    """The matrix (4, 4) of a link or an entity."""
    matrix = np.eye(4)
    matrix[:3, 3] = link.position
    w, *xyz = link.orientation
    matrix[:3, :3] = Rotation.from_quat([*xyz, w]).as_matrix()
    return matrix


def words(pose):
    return " ".join(map(repr, pose))


def posed(link, pose, **attributes):
    """A link with a pose."""
    told = "".join(f' {key}="{value}"' for key, value in attributes.items())
    return link.replace(">", f"><pose{told}>{pose}</pose>", 1)


MODEL, BASE, ARM, FRAME = (
    (1.0, 2.0, 3.0, 0.1, 0.2, 0.3),
    (0.0, 0.5, 2.0, 0.4, -0.3, 1.0),
    (0.3, -0.2, 0.7, -0.5, 0.6, 0.2),
    (0.2, 0.1, -0.4, 0.7, 0.1, -0.6),
)
LIMIT = "<limit><lower>-1</lower><upper>1</upper></limit>"


def hinge(axis="<xyz>0 1 0</xyz>", more="", child="arm", kind="revolute"):
    return (
        f'<joint name="j" type="{kind}">{more}<parent>base</parent><child>{child}</child>'
        f"<axis>{axis}{LIMIT}</axis></joint>"
    )


@pytest.fixture
def links(load):
    """Loads one model of some parts, and returns where its links are, by name."""

    def found(*parts, version="1.7", around=()):
        text = sdf_of(*around, sdf_model("m", *parts, pose=words(MODEL))).replace("1.6", version)
        _, world = load('[[body]]\nsdf = "a.sdf"\nfixed = true\n', a_sdf=text)
        (entity,) = world
        return {link.name: placed(link) for link in entity.links} | {"": client_of(world)}

    return found


def same(first, second):
    return first == pytest.approx(second, abs=1e-6)


def test_the_base_link_may_come_last(links):
    arm, base = posed(sdf_link("arm"), words(ARM)), posed(sdf_link("base"), words(BASE))
    found = links(arm, base, hinge())
    assert same(found["base"], frame(MODEL) @ frame(BASE))
    assert same(found["arm"], frame(MODEL) @ frame(ARM))


def test_poses_relative_to_links_joints_and_frames(links):
    arm = posed(sdf_link("arm"), words(ARM), relative_to="f")
    hand = posed(sdf_link("hand"), words(BASE), relative_to="j")
    found = links(
        posed(sdf_link("base"), words(BASE)),
        f'<frame name="f" attached_to="base"><pose>{words(FRAME)}</pose></frame>',
        arm,
        hand,
        hinge(),
        hinge(child="hand", kind="fixed").replace('"j"', '"k"'),
    )
    expected = frame(MODEL) @ frame(BASE) @ frame(FRAME) @ frame(ARM)
    assert same(found["arm"], expected)
    assert same(found["hand"], expected @ frame(BASE))


def test_degrees_and_quaternions(links):
    degrees = words((*BASE[:3], *np.degrees(BASE[3:]).tolist()))
    quaternion = Rotation.from_euler("xyz", ARM[3:]).as_quat().tolist()
    arm = posed(sdf_link("arm"), words((*ARM[:3], *quaternion)), rotation_format="quat_xyzw")
    found = links(posed(sdf_link("base"), degrees, degrees="true"), arm, hinge())
    assert same(found["base"], frame(MODEL) @ frame(BASE))
    assert same(found["arm"], frame(MODEL) @ frame(ARM))


def test_shapes_and_masses_relative_to_others(links):
    shape = (
        f'<collision name="c"><pose relative_to="base">{words(FRAME)}</pose><geometry>'
        "<box><size>1 2 3</size></box></geometry></collision>"
    )
    found = links(sdf_link("base"), posed(f'<link name="arm">{shape}</link>', words(ARM)), hinge())
    (box,) = pybullet.getCollisionShapeData(0, 0, found[""])
    place = frame((*box[5], *Rotation.from_quat(box[6]).as_euler("xyz")))
    assert same(place, np.linalg.inv(frame(ARM)) @ frame(FRAME))


@pytest.mark.parametrize(
    ("version", "axis", "seen_from"),
    [
        ("1.7", "<xyz>0 1 0</xyz>", "joint"),
        ("1.7", '<xyz expressed_in="__model__">0 1 0</xyz>', "model"),
        ("1.7", '<xyz expressed_in="base">0 1 0</xyz>', "base"),
        ("1.6", "<xyz>0 1 0</xyz><use_parent_model_frame>1</use_parent_model_frame>", "model"),
        ("1.6", "<xyz>0 1 0</xyz><use_parent_model_frame>0</use_parent_model_frame>", "joint"),
        ("1.4", "<xyz>0 1 0</xyz>", "model"),
    ],
)
@pytest.mark.parametrize("turn", [(0, 0, 0), (0.3, 0.2, 0.1)])
def test_axes(links, version, axis, seen_from, turn):
    """The pose of the joint turns the axis."""
    pose = f"<pose>0 0 0 {words(turn)}</pose>"
    base, arm = posed(sdf_link("base"), words(BASE)), posed(sdf_link("arm"), words(ARM))
    found = links(base, arm, hinge(axis, more=pose), version=version)
    frames = {"model": frame(MODEL), "base": frame(MODEL) @ frame(BASE)}
    frames["joint"] = frame(MODEL) @ frame(ARM) @ frame((0, 0, 0, *turn))
    pybullet.resetJointState(0, 0, 0.5, physicsClientId=found[""])
    moved = Rotation.from_quat(pybullet.getLinkState(0, 0, physicsClientId=found[""])[5])
    turned = moved * Rotation.from_matrix(found["arm"][:3, :3]).inv()
    assert same(turned.as_rotvec() / 0.5, frames[seen_from][:3, :3] @ [0, 1, 0])


def test_a_model_relative_to_another_and_its_placement_frame(load):
    first = sdf_model("one", posed(sdf_link("base"), words(BASE)), pose=words(MODEL))
    second = (
        f'<model name="two" placement_frame="l"><pose relative_to="f">{words(ARM)}</pose>'
        f"{posed(sdf_link('l'), words(BASE))}</model>"
    )
    between = f'<frame name="f" attached_to="one"><pose>{words(FRAME)}</pose></frame>'
    _, world = load('[[body]]\nsdf = "a.sdf"\n', a_sdf=sdf_of(first, between, second))
    assert same(placed(world["two"]), frame(MODEL) @ frame(FRAME) @ frame(ARM))


@pytest.mark.slow
def test_empty_poses(links):
    link = posed(sdf_link("base"), "").replace('name="c">', 'name="c"><pose/>', 1)
    assert same(links(link)["base"], frame(MODEL))


@pytest.mark.slow
def test_a_turned_base_in_a_turned_scene(load):
    text = sdf_of(sdf_model("m", posed(sdf_link(), words(BASE)), pose=words(MODEL)))
    pose = "position = [3, 2, 1]\norientation = [0.5, 0.5, 0.5, 0.5]\n"
    _, world = load(f'[[body]]\nsdf = "a.sdf"\n{pose}', a_sdf=text)
    around = frame((3.0, 2.0, 1.0, 0, 0, 0))
    around[:3, :3] = [[0, 0, 1], [1, 0, 0], [0, 1, 0]]
    assert same(placed(world["m"]), around @ frame(MODEL) @ frame(BASE))
    copy = world.excerpt(world)
    assert same(placed(copy["m"]), placed(world["m"]))
