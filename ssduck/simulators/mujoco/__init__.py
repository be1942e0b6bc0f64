"""MuJoCo behind the interface of `ssduck.simulators`.

`backend` is the entry point: it loads MJCF files and wraps simulations of the user's. `simulator`
runs one, and reads its bodies through the modules beside it. Nothing else in ssduck imports MuJoCo,
which is optional: the extra `mujoco` installs it.
"""
