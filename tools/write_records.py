"""Writes the records that `tests/recording/test_stored_records.py` opens.

`python -m tools.write_records FILE.tar.xz` records a small world in a folder and in a DuckDB file,
and copies the folder while its last rows are still in the log. What PyBullet itself says of each
tick is written beside the records, so that a later ssduck is compared with it.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import shutil
import tarfile
import tempfile
import time
from pathlib import Path
from typing import Any

import pybullet

import ssduck
from ssduck import Recording
from ssduck.schema import RECORDABLE

STEPS = 12
NAMES = ("floor", "ball", "arm")
_ARM = """
<robot name="arm">
  <link name="base">
    <inertial>
      <mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/>
    </inertial>
  </link>
  <link name="beam">
    <inertial>
      <origin xyz="0.2 0 0"/><mass value="0.5"/>
      <inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/>
    </inertial>
    <collision><origin xyz="0.2 0 0"/><geometry><box size="0.4 0.1 0.1"/></geometry></collision>
  </link>
  <joint name="hinge" type="revolute">
    <parent link="base"/><child link="beam"/>
    <axis xyz="0 1 0"/><limit lower="-2" upper="2" effort="10" velocity="10"/>
  </joint>
</robot>
"""


def main() -> None:
    """Writes the records, packed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("file", type=Path)
    packed: Path = parser.parse_args().file
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        expected = write_records(place)
        (place / "expected.json").write_text(json.dumps(expected), "utf-8")
        with tarfile.open(packed, "w:xz") as archive:
            for path in sorted(place.rglob("*")):
                if path.is_file():
                    _add(archive, path, path.relative_to(place))
    print(f"{packed}: {packed.stat().st_size} bytes")


def write_records(place: Path) -> list[dict[str, Any]]:
    """Records a small world in `place`; returns what PyBullet says of each tick."""
    client = pybullet.connect(pybullet.DIRECT)
    bodies = _load(client)
    world = ssduck.World.attach(client, dict(zip(bodies, NAMES, strict=True)))
    world.tick(steps=0)
    recording = Recording(tables=RECORDABLE, flush_every=0.1)
    expected = []
    with ssduck.Interpreter(place / "run.duckdb", recording=recording) as ss:
        ss.add_variable("lab", world)
        with ss.record_to(place / "run", recording=recording):
            for _ in range(STEPS):
                world.step()
                expected.append(_state(client, bodies, world.snapshot.number))
            # The first tick and the others; a part comes only when the recording is closed.
            while ssduck.episodes(place / "run")[-1].last_tick != expected[-1]["tick"]:
                time.sleep(0.05)
            shutil.copytree(place / "run", place / "unfinished")
    pybullet.disconnect(client)
    return expected


def _load(client: int) -> list[int]:
    """Loads a floor, a ball that falls onto it, and an arm that sinks."""
    pybullet.setGravity(0, 0, -9.81, client)
    shapes = [
        pybullet.createCollisionShape(
            pybullet.GEOM_BOX, halfExtents=[2, 2, 0.1], physicsClientId=client
        ),
        pybullet.createCollisionShape(pybullet.GEOM_SPHERE, radius=0.1, physicsClientId=client),
    ]
    bodies = [
        pybullet.createMultiBody(mass, shape, -1, [0, 0, height], physicsClientId=client)
        for mass, shape, height in ((0, shapes[0], -0.1), (1, shapes[1], 0.101))
    ]
    with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stdout(io.StringIO()):
        file = Path(folder) / "arm.urdf"
        file.write_text(_ARM, "utf-8")
        arm = pybullet.loadURDF(str(file), [0, 1, 1], useFixedBase=True, physicsClientId=client)
    pybullet.setJointMotorControl2(
        arm, 0, pybullet.VELOCITY_CONTROL, force=0, physicsClientId=client
    )
    return [*bodies, arm]


def _state(client: int, bodies: list[int], tick: int) -> dict[str, Any]:
    """Returns what PyBullet says of the ball and the arm at a tick."""
    _, ball, arm = bodies
    position, turned = pybullet.getBasePositionAndOrientation(ball, client)
    beam = pybullet.getLinkState(arm, 0, computeForwardKinematics=1, physicsClientId=client)
    angle, speed = pybullet.getJointState(arm, 0, client)[:2]
    contacts = pybullet.getContactPoints(ball, bodies[0], physicsClientId=client)
    return {
        "tick": tick,
        "ball": [*position, turned[3], *turned[:3]],
        "beam": [*beam[4], beam[5][3], *beam[5][:3]],
        "hinge": [angle, speed],
        "touching": bool(contacts),
        "forces": [contact[9] for contact in contacts if contact[8] <= 0],
    }


def _add(archive: tarfile.TarFile, path: Path, name: Path) -> None:
    """Adds a file without the owner and the date of this machine."""
    info = tarfile.TarInfo(name.as_posix())
    info.size = path.stat().st_size
    with path.open("rb") as file:
        archive.addfile(info, file)


if __name__ == "__main__":
    main()
