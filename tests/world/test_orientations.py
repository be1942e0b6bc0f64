"""Quaternions that users give: PyBullet's, ssduck's and SciPy's, against PyBullet and SciPy."""

import math
import warnings

import pybullet
import pytest
from scipy.spatial.transform import Rotation

from ssduck.errors import ArgumentError, ProgramWarning, StateError
from ssduck.world.orientations import orientation_of
from tests.support.stage import Stage
from tests.support.warned import heard

HALF = math.sqrt(0.5)
TURNED = Rotation.from_euler("xyz", [0.1, -0.4, 2.0])


@pytest.fixture(scope="module")
def cube():
    """A cube of the user's own client, and a function that gives its orientation there."""
    with Stage() as stage:
        body = stage.box("cube", half=0.1, mass=1)
        entity = stage.open()["cube"]

        def there():
            return pybullet.getBasePositionAndOrientation(body, physicsClientId=stage.client)[1]

        yield entity, there


def is_turned(found, expected):
    """Whether a quaternion x, y, z, w is a rotation."""
    return (Rotation.from_quat(found) * expected.inv()).magnitude() == pytest.approx(0, abs=1e-6)


@pytest.mark.parametrize(
    "given",
    [
        {"orientation": TURNED},
        {"xyzw": TURNED.as_quat()},
        {"xyzw": pybullet.getQuaternionFromEuler([0.1, -0.4, 2.0])},
        {"xyzw": 7 * TURNED.as_quat()},
        {"wxyz": TURNED.as_quat(scalar_first=True).tolist()},
        {"orientation": TURNED.as_quat(scalar_first=True)},
    ],
)
def test_each_form_is_the_same_rotation(cube, given):
    entity, there = cube
    entity.move(wxyz=[1, 0, 0, 0])
    entity.move([0, 0, 1], **given)
    assert is_turned(there(), TURNED)


@pytest.mark.parametrize(
    ("now", "given", "is_told"),
    [
        (TURNED, [0, 0, HALF, HALF], True),  # a turn about z by PyBullet
        (TURNED, [0, HALF, 0, HALF], True),
        (TURNED, [0, 0, -HALF, HALF], True),
        (TURNED, TURNED.as_quat().tolist(), True),  # read from PyBullet, and given back
        (TURNED, (-TURNED.as_quat()).tolist(), True),
        (Rotation.identity(), [0, 0, 0, 1], True),
        (TURNED, [0, 0, 0, 1], True),  # nothing, or half a turn about z
        (TURNED, [HALF, 0, 0, HALF], True),  # a quarter turn, about x or z
        (TURNED, [1, 0, 0, 0], True),  # half a turn about x, or nothing
        (TURNED, [0.9, 0.1, 0.2, 0.3], True),
        (TURNED, [0.5, 0.5, 0.5, 0.5], False),  # the same in either order
        (TURNED, TURNED.as_quat(scalar_first=True).tolist(), False),
        (Rotation.identity(), [1, 0, 0, 0], False),
    ],
)
def test_what_may_be_the_other_order_is_told_of(cube, now, given, is_told):
    entity, there = cube
    entity.move(orientation=now)
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        entity.move(orientation=given)
    assert [one.category for one in told] == [ProgramWarning] * is_told
    for one in told:
        assert "write xyzw=[…] for one of these, else wxyz=[…]" in str(one.message)
        assert one.filename == __file__
    w, x, y, z = given
    assert is_turned(there(), Rotation.from_quat([x, y, z, w]))


def test_what_a_handle_tells_needs_no_warning(stage):
    one, _ = (stage.sphere(name, radius=0.1, mass=1) for name in ("one", "other"))
    world = stage.open()
    world["other"].move(wxyz=TURNED.as_quat(scalar_first=True))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        world["one"].move([0, 0, 1], world["other"].orientation)
    assert is_turned(pybullet.getBasePositionAndOrientation(one, stage.client)[1], TURNED)
    with pytest.warns(ProgramWarning, match="^one: the orientation"):
        world["one"].move([0, 0, 1], pybullet.getQuaternionFromEuler([0.3, -0.4, 2.0]))


@pytest.mark.parametrize(
    ("given", "is_told"),
    [([0.9, 0.1, 0.2, 0.3], False), ([1, 0, 0, 0], False), ([0, 0, HALF, HALF], True)],
)
def test_without_known_ones_only_the_likelier_order_is_told_of(given, is_told):
    """As for MuJoCo, whose quaternions are w, x, y, z."""
    known = TURNED.as_quat(scalar_first=True)
    _, told = heard(lambda: orientation_of(given, None, None, known, "cube"))
    assert len(told) == is_told


def test_what_is_no_orientation_is_an_error(cube):
    entity, there = cube
    before = there()
    with pytest.raises(ArgumentError, match="give one of orientation, wxyz and xyzw"):
        entity.move(wxyz=[1, 0, 0, 0], xyzw=[0, 0, 0, 1])
    for wrong in ({"xyzw": [0, 0, 0, 0]}, {"xyzw": [0, 1]}, {"orientation": Rotation.identity(2)}):
        with pytest.raises(StateError):
            entity.move(**wrong)
    assert there() == before
