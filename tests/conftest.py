"""What several test files need: a PyBullet client, models written on the spot, the kitchen's facts."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pybullet
import pytest
from hypothesis import settings

DATA = Path(__file__).parent / "data"

# The machines that run the tests are slow and shared; a failing example is found again.
settings.register_profile("ssduck", deadline=None, derandomize=True)
settings.load_profile("ssduck")


@pytest.fixture
def client():
    """A PyBullet client of the test's own."""
    number = pybullet.connect(pybullet.DIRECT)
    yield number
    if pybullet.isConnected(number):
        pybullet.disconnect(number)


@pytest.fixture(scope="session")
def kitchen_facts():
    """What the tutorial's kitchen is measured to be."""
    return tomllib.loads((DATA / "kitchen.toml").read_text(encoding="utf-8"))


@pytest.fixture
def write(tmp_path):
    """Writes a file into the test's folder and tells its path."""

    def written(name, text):
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
        return path

    return written


def link(name, *, mass=1.0, com=(0, 0, 0), rpy=(0, 0, 0), shapes=""):
    """A URDF link with an inertial frame, and collision elements."""
    return (
        f'<link name="{name}"><inertial><origin xyz="{_listed(com)}" rpy="{_listed(rpy)}"/>'
        f'<mass value="{mass}"/><inertia ixx="0.1" iyy="0.2" izz="0.25" ixy="0" ixz="0" iyz="0"/>'
        f"</inertial>{shapes}</link>"
    )


def collision(geometry, *, xyz=(0, 0, 0), rpy=(0, 0, 0)):
    """A URDF collision element; the geometry is XML."""
    return (
        f'<collision><origin xyz="{_listed(xyz)}" rpy="{_listed(rpy)}"/>'
        f"<geometry>{geometry}</geometry></collision>"
    )


def joint(name, kind, parent, child, *, xyz=(0, 0, 0), rpy=(0, 0, 0), axis=(0, 0, 1), limit=""):
    """A URDF joint; the limit is XML."""
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{_listed(xyz)}" rpy="{_listed(rpy)}"/><axis xyz="{_listed(axis)}"/>'
        f"{limit}</joint>"
    )


def robot(*parts, name="model"):
    """A URDF model."""
    return f'<robot name="{name}">{"".join(parts)}</robot>'


def box_obj(low, high, first=0, name=None):
    """An OBJ box: text, with vertex numbers that begin behind `first`."""
    corners = [
        (x, y, z) for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])
    ]
    faces = [(1, 2, 4, 3), (5, 7, 8, 6), (1, 5, 6, 2), (3, 4, 8, 7), (1, 3, 7, 5), (2, 6, 8, 4)]
    lines = [f"o {name}"] if name else []
    lines += [f"v {x} {y} {z}" for x, y, z in corners]
    lines += ["f " + " ".join(str(first + corner) for corner in face) for face in faces]
    return "\n".join(lines) + "\n"


def _listed(values):
    return " ".join(map(str, values))
