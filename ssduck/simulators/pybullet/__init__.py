"""PyBullet behind the interface of `ssduck.simulators`.

`backend` is the entry point: it makes, copies and saves simulations. `simulator` runs one, and
reads its bodies through the modules beside it. Nothing else in ssduck imports PyBullet, which has
wheels for few platforms. Two distributions have its module: `pybullet`, and `pybullet-arm64`, a
maintained fork with wheels for more of them.
"""

from importlib import metadata
from importlib.util import find_spec

from ssduck.errors import UnsupportedError, warn

_DISTRIBUTIONS = ("pybullet", "pybullet-arm64")


def warn_of_two_distributions() -> None:
    """Warns if two distributions have the module: one has overwritten the files of the other."""
    found = [one for name in _DISTRIBUTIONS for one in metadata.distributions(name=name)]
    versions = {one.name: one.version for one in reversed(found)}  # the first one is imported
    if len(versions) > 1:
        listed = " and ".join(f"{name} {versions[name]}" for name in sorted(versions))
        warn(
            f"{listed} are both installed, and have the same module: Python imports the one that "
            f"was installed last. pip uninstall -y {' '.join(_DISTRIBUTIONS)}, and install ssduck "
            "again, which takes one"
        )


if find_spec("pybullet") is None:
    raise UnsupportedError(
        "PyBullet is not installed: it loads SDF files and scenes that conserve energy, and runs "
        "copies of recorded ticks. pip install 'ssduck[pybullet]' builds it where it has no wheel; "
        "MuJoCo loads MJCF files, and scenes of URDF files and primitives"
    )
warn_of_two_distributions()
