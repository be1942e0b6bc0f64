"""Records that many tests open: written once by the present code, and copied.

They are kept in pytest's cache, below a hash of all that may change what is written: the package, the
scenes, the helpers of the tests and the versions of the libraries. So a run after a change writes them
anew, and one without a change, or another process of the same run, copies them.
"""

import contextlib
import hashlib
import shutil
import sys
import time
from functools import cache
from importlib.metadata import distributions
from pathlib import Path

import ssduck

try:
    import fcntl
except ImportError:  # Windows: two processes may write the same record
    fcntl = None

TESTS = Path(__file__).resolve().parents[1]
SUFFIXES = {".py", ".toml", ".urdf", ".sdf", ".xml", ".obj", ".stl"}
LIBRARIES = ("duckdb", "numpy", "pyarrow", "sqlglot", "pybullet", "pybullet-arm64", "mujoco")
# A run may copy records of a hash for so long after it has begun, in seconds.
UNUSED = 24 * 3600


class Archive:
    """The records of a hash.

    Args:
        folder: where archives are; those of other hashes are removed a day after they were made.
    """

    def __init__(self, folder):
        self._place = Path(folder) / _hash()
        self._place.mkdir(parents=True, exist_ok=True)
        for other in Path(folder).iterdir():
            if other != self._place and time.time() - other.stat().st_mtime > UNUSED:
                shutil.rmtree(other, ignore_errors=True)

    def copy(self, write, to, *arguments):
        """Copies what a function writes, and returns the folder of the copy.

        Args:
            write: a function of a module, which gets an empty folder and the arguments; it writes
                the same each time.
            to: the folder.
        """
        kept = self._place / "-".join([write.__module__, write.__qualname__, *map(str, arguments)])
        with self._locked():
            if not kept.exists():
                unfinished = self._place / "unfinished"
                shutil.rmtree(unfinished, ignore_errors=True)
                unfinished.mkdir()
                write(unfinished, *arguments)
                unfinished.rename(kept)
        return shutil.copytree(kept, to, dirs_exist_ok=True)

    @contextlib.contextmanager
    def _locked(self):
        with (self._place / "lock").open("w") as lock:
            if fcntl is not None:
                fcntl.flock(lock, fcntl.LOCK_EX)  # until the file is closed
            yield


@cache
def _hash():
    """A hash of the code that writes records."""
    hashed = hashlib.sha256()
    package = Path(ssduck.__file__).parent
    for folder in (package, TESTS, TESTS.parent / "scenes"):
        for path in sorted(path for path in folder.rglob("*") if path.suffix in SUFFIXES):
            hashed.update(path.read_bytes())
    installed = {each.name: each.version for each in distributions() if each.name in LIBRARIES}
    hashed.update(repr((sys.version, sorted(installed.items()))).encode())
    return hashed.hexdigest()[:20]
