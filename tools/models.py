"""Compares what ssduck makes of model files with what independent readers do.

`python -m tools.models FOLDER …` loads the URDF, SDF and MJCF files of folders, at most `--most` of
each folder with files, each in a process of its own. It compares the names of links, their poses at
four configurations (the first, and three at random), their masses, and the boxes of their shapes
with those of yourdfpy, MuJoCo, ElementTree and trimesh (`tools/model_readers.py`), and prints
a table. `pip install yourdfpy pycollada` installs what is not among the development dependencies.
The exit status is 1 if a file differs, or is a fault: it ends its process or takes too long, or its
error is not of ssduck. `--rows` writes a line for each file.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import re
import sys
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, Protocol

import numpy as np

import ssduck
from ssduck.errors import SelectScriptError
from ssduck.simulators.scenes import find_scene
from tools.model_readers import Array, Key, Links, MjcfReader, SdfReader, UrdfReader

TIMEOUT = 120.0
CONFIGURATIONS = 4
# The errors from which on poses and boxes differ, m and components of rotation matrices, and the
# relative error of masses.
POSE, BOX, MASS = 1e-5, 2e-4, 1e-6
ENDINGS = (".urdf", ".sdf", ".world", ".xml", ".mjcf")
OUTCOMES = ("the same", "differs", "not compared", "error", "FAULT")
# The names of what has none in a file.
NAMELESS = re.compile(r"world|body_\d+")


class Reader(Protocol):
    """A reader of model files."""

    masses: dict[Key, float | None]
    joints: Any

    def at(self, positions: dict[str, float]) -> Links:
        """Returns the links at positions of the joints."""


READERS: dict[str, Callable[[Path], Reader]] = {
    ".urdf": UrdfReader,
    ".sdf": SdfReader,
    ".world": SdfReader,
}


def models_in(folder: Path, most: int) -> Iterator[Path]:
    """Returns the model files of a folder and of those in it."""
    taken: Counter[Path] = Counter()
    for file in sorted(folder.rglob("*")):
        if file.suffix in ENDINGS and file.is_file() and taken[file.parent] < most:
            text = file.read_text(errors="replace")
            is_mjcf = re.search(r"<mujoco[\s>]", text) is not None and "<worldbody" in text
            if is_mjcf or (file.suffix not in (".xml", ".mjcf") and "<xacro:" not in text):
                taken[file.parent] += 1
                yield file


def outcome(file: Path) -> tuple[str, str]:
    """Loads a model and returns what became of it: an outcome, and what it is about."""
    try:
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always")
            ss = ssduck.load(file)
    except SelectScriptError as error:
        return "error", error.message
    except Exception as error:  # noqa: BLE001  # what must not be
        return "FAULT", f"{type(error).__name__}: {error}"
    with ss:
        try:
            reader = READERS.get(file.suffix, MjcfReader)(file)
            reader.at({})
        except Exception as error:  # noqa: BLE001  # a reader of others has any
            return "not compared", f"{type(error).__name__}: {error}"
        try:
            differences = list(_differences(ss, find_scene(file).name, reader, file.suffix))
        except Exception as error:  # noqa: BLE001  # what must not be
            return "FAULT", f"{type(error).__name__}: {error}"
    if not differences:
        return "the same", ""
    notes = [str(warning.message).splitlines()[0] for warning in told]
    return "differs", "; ".join(differences[:4] + notes)


def _differences(ss: ssduck.Interpreter, name: str, reader: Reader, ending: str) -> Iterator[str]:
    rng, world = np.random.default_rng(0), ss[name]
    for number in range(CONFIGURATIONS):
        # Joints whose limits exclude 0 begin at a limit.
        positions = {
            joint.name: joint.position
            for entity in world
            for joint in entity.joints
            if joint.name in reader.joints
        }
        if number:
            positions = {name: rng.uniform(*reader.joints[name]) for name in positions}
            for entity in world:
                own = {joint.name for joint in entity.joints} & positions.keys()
                if own:
                    entity.move(joints={joint: positions[joint] for joint in own})
        ours, masses = _links(ss, name, ending)
        theirs = reader.at(positions)
        if not number:
            yield from _other_names(ours.frames.keys(), theirs.frames.keys())
            yield from _other_masses(masses, reader.masses)
        where = f"configuration {number}: "
        both = ours.frames.keys() & theirs.frames.keys()
        yield from _worst(where + "pose", ours.frames, theirs.frames, sorted(both), POSE)
        yield from _worst(where + "box", ours.boxes, theirs.boxes, sorted(both), BOX)


def _links(ss: ssduck.Interpreter, name: str, ending: str) -> tuple[Links, dict[Key, float]]:
    """Returns the links of a world, and their masses."""
    links, masses, keys = Links(), {}, {}
    entities = {entity.id: number for number, entity in enumerate(ss[name])}
    rows = ss.sql(
        "SELECT entity, link, name, mass, x, y, z, qw, qx, qy, qz "
        f"FROM \"{name}\".links WHERE kind = 'link' ORDER BY entity, link"
    ).fetchall()
    for entity, link, own, mass, *pose in rows:
        # A URDF file has one model; the names of an MJCF file's bodies are unique.
        key = entities[entity] if ending in (".sdf", ".world") else 0, own
        keys[entity, link] = key
        masses[key] = mass
        links.frames[key] = np.eye(4)
        links.frames[key][:3, 3], links.frames[key][:3, :3] = pose[:3], _matrix(*pose[3:])
        links.boxes[key] = np.array([])
    rows = ss.sql(
        "SELECT entity, link, min(xmin), min(ymin), min(zmin), max(xmax), max(ymax), max(zmax) "
        f'FROM "{name}".shapes GROUP BY entity, link'
    ).fetchall()
    for entity, link, *box in rows:
        links.boxes[keys[entity, link]] = np.array(box, float).reshape(2, 3)
    return links, masses


def _matrix(w: float, x: float, y: float, z: float) -> Array:
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def _other_names(ours: Any, theirs: Any) -> Iterator[str]:
    if missing := sorted(key for key in theirs - ours if not NAMELESS.fullmatch(key[1])):
        yield f"{len(missing)} links are missing: {missing[0][1]}, say"
    if added := sorted(key for key in ours - theirs if not NAMELESS.fullmatch(key[1])):
        yield f"{len(added)} links are not in the file: {added[0][1]}, say"


def _other_masses(ours: dict[Key, float], theirs: dict[Key, float | None]) -> Iterator[str]:
    for key, mass in theirs.items():
        # A base that cannot move has no mass.
        if mass is not None and ours.get(key) and abs(ours[key] - mass) > MASS * max(1.0, mass):
            yield f"the mass of {key[1]} is {ours[key]:.6g}, not {mass:.6g}"
            return


def _worst(
    what: str,
    ours: dict[Key, Array],
    theirs: dict[Key, Array],
    keys: Sequence[Key],
    tolerance: float,
) -> Iterator[str]:
    worst, whose = 0.0, ""
    for key in keys:
        if ours[key].shape != theirs[key].shape:
            yield f"{what} of {key[1]}: {len(ours[key])} in ssduck, {len(theirs[key])} in the file"
            return
        if ours[key].size and not np.isnan(theirs[key]).any():
            error = float(np.abs(ours[key] - theirs[key]).max())
            if error > worst:
                worst, whose = error, key[1]
    if worst > tolerance:
        yield f"{what} of {whose} is off by {worst:.3g}"


def _answer(pipe: Connection, file: Path) -> None:
    pipe.send(outcome(file))


def in_a_process(file: Path) -> tuple[str, str]:
    """Returns what became of a model that a process of its own loads."""
    context = multiprocessing.get_context("fork")
    pipe, other = context.Pipe()
    process = context.Process(target=_answer, args=(other, file), daemon=True)
    process.start()
    other.close()
    result = "FAULT", f"it takes more than {TIMEOUT:g} s"
    try:
        if pipe.poll(TIMEOUT):
            result = pipe.recv()
    except EOFError:
        process.join()
        result = "FAULT", f"the process ends with {process.exitcode}"
    finally:
        process.kill()
        process.join()
        pipe.close()
    return result


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command and returns its exit status."""
    parser = argparse.ArgumentParser(description="Compare model files with independent readers.")
    parser.add_argument("folders", type=Path, nargs="+", metavar="FOLDER")
    parser.add_argument("--most", type=int, default=20, help="of the files in one folder")
    parser.add_argument("--rows", type=Path, metavar="FILE", help="a line of JSON for each file")
    options = parser.parse_args(arguments)
    print(f"| folder | files | {' | '.join(OUTCOMES)} |\n|{'---|' * (len(OUTCOMES) + 2)}")
    is_bad = False
    for folder in options.folders:
        counts: Counter[str] = Counter()
        for file in models_in(folder, options.most):
            kind, about = in_a_process(file)
            counts[kind] += 1
            if kind in ("differs", "FAULT"):
                print(f"  {kind}: {file.relative_to(folder)}: {about}", file=sys.stderr, flush=True)
            if options.rows is not None:
                with options.rows.open("a") as rows:
                    rows.write(json.dumps([str(file), kind, about]) + "\n")
        columns = (str(counts[kind]) for kind in OUTCOMES)
        print(f"| {folder.name} | {counts.total()} | {' | '.join(columns)} |", flush=True)
        is_bad |= bool(counts["differs"] or counts["FAULT"])
    return int(is_bad)


if __name__ == "__main__":
    sys.exit(main())
