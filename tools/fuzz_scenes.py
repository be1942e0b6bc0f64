"""Checks what becomes of mutated model files, as a stranger may send them.

`python -m tools.fuzz_scenes [COUNT] [--seed N] [--format NAME ...] [--keep FOLDER]` loads COUNT
mutated files of each format under `Limits.strict()`: URDF, SDF and MJCF by PyBullet, MJCF by MuJoCo
("mujoco"), and URDF files with a mutated OBJ, STL or COLLADA mesh. 500 of each take some
hours on busy cores. The exit status is 1 if there are faults, whose files are kept in FOLDER.

Each file must be loaded, or be a `SceneError` or a `LimitError`. What is loaded is asked for its
boxes, drawn, and stepped; no box may be NaN.
"""

from __future__ import annotations

import argparse
import math
import shutil
import sys
import tempfile
import time
import warnings
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import ssduck
from ssduck import Limits
from ssduck.errors import LimitError, SceneError
from tools.fuzzing.models import FORMATS, write_mutant

# The number of files between two lines of progress.
REPORT_EVERY = 100
LOADED, CRASHED = "loaded", "crashed the sandbox"
BOXES = "SELECT xmin, ymin, zmin, xmax, ymax, zmax FROM {}.shapes"


def outcome(model: Path, format: str) -> str:
    """Loads and uses a model under strict limits, and returns what became of it."""
    simulator = "mujoco" if format == "mujoco" else "pybullet"
    try:
        with (
            warnings.catch_warnings(action="ignore"),
            ssduck.load(model, limits=Limits.strict(), simulator=simulator) as ss,
        ):
            return _used(ss, with_picture=simulator != "mujoco")  # it needs a graphics library
    except (SceneError, LimitError) as error:
        return CRASHED if "crashed" in error.message else type(error).__name__
    except Exception as error:  # noqa: BLE001  # what must not be
        return f"FAULT: {type(error).__name__}: {error}"[:200]


def _used(ss: ssduck.Interpreter, *, with_picture: bool) -> str:
    """Asks for boxes and for a picture, and makes steps."""
    boxes = ss.sql(BOXES.format("x")).fetchall()
    if any(number is None or math.isnan(number) for box in boxes for number in box):
        return "FAULT: a box is NaN"
    if with_picture:
        ss.eval("SELECT this FROM x AS image(32, 32);")
    ss["x"].step(3)
    return LOADED


class Fuzz:
    """Loads mutated files, and keeps those that are faults.

    Args:
        keep: the folder for the files of faults; None for none.

    Attributes:
        outcomes: how many files there were of each format and outcome.
        faults: the faults.
    """

    def __init__(self, keep: Path | None = None) -> None:
        self._keep = keep
        self.outcomes: Counter[tuple[str, str]] = Counter()
        self.faults: list[str] = []

    def add(self, format: str, seed: int) -> str:
        """Loads a file and returns what became of it."""
        with tempfile.TemporaryDirectory() as folder:
            text = outcome(write_mutant(Path(folder), format, seed), format)
            self.outcomes[format, text] += 1
            if text.startswith("FAULT"):
                self.faults.append(f"{format} {seed}: {text}")
                if self._keep is not None:
                    shutil.copytree(folder, self._keep / f"{format}-{seed}", dirs_exist_ok=True)
        return text


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command and returns its exit status."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("count", type=int, nargs="?", default=500, metavar="COUNT")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--format", choices=FORMATS, nargs="+", default=FORMATS)
    parser.add_argument("--keep", type=Path, metavar="FOLDER")
    options = parser.parse_args(arguments)
    fuzz, start = Fuzz(options.keep), time.monotonic()
    for format in options.format:
        for number in range(1, options.count + 1):
            fuzz.add(format, options.seed + number - 1)
            if number % REPORT_EVERY == 0 or number == options.count:
                took = time.monotonic() - start
                told = f"{number} of {options.count}, {len(fuzz.faults)} faults, {took:.0f} s"
                print(f"{format}: {told}", flush=True)
    for (format, text), count in sorted(fuzz.outcomes.items()):
        print(f"{format:8} {count:6}  {text}")
    print(*fuzz.faults, sep="\n")
    return 1 if fuzz.faults else 0


if __name__ == "__main__":
    sys.exit(main())
