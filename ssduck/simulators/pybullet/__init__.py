"""PyBullet behind the interface of `ssduck.simulators`.

`backend` is the entry point: it makes, copies and saves simulations. `simulator` runs one, and
reads its bodies through the modules beside it. Nothing else in ssduck imports PyBullet, which has
wheels for few platforms: the extra `pybullet` builds it elsewhere.
"""

from importlib.util import find_spec

from ssduck.errors import UnsupportedError

if find_spec("pybullet") is None:
    raise UnsupportedError(
        "PyBullet is not installed: it loads scenes, URDF and SDF files, and copies records. "
        "pip install 'ssduck[pybullet]' builds it where it has no wheel; MuJoCo (pip install "
        "'ssduck[mujoco]') loads MJCF files, and World.attach takes MuJoCo simulations"
    )
