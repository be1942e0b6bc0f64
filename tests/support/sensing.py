"""A mast that carries sensors, and scenes for them."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import ssduck
from tests.support import stage

pybullet = pytest.importorskip("pybullet")
backend = pytest.importorskip("ssduck.simulators.pybullet.simulator")

# What Bullet's rays are true to, metres: its convex hulls are 1 mm larger, its steps end at 0.1 mm.
EXACT = 5e-4

LASER = {"min_angle": -180, "max_angle": 180, "resolution": 1, "max_range": 20}

CAMERA = {"width": 64, "height": 48, "fov": 50, "max_range": 10}


class Stage(stage.Stage):
    """A stage whose world's sensors tests ask; it counts the rays that are cast."""

    def __init__(self):
        super().__init__()
        self.world = None
        self.casts = []

    def box(self, name, halves, position, **more):
        return super().box(name, position, halves, **more)

    def sphere(self, name, radius, position, **more):
        return super().sphere(name, position, radius, **more)

    def open(self, *, owned=True):
        """The world of what is there."""
        simulator = backend.PyBulletSimulator(self.client, owned=owned, names=self.names)
        cast = simulator.cast_rays

        def counted(starts, ends, through):
            self.casts.append(len(starts))
            return cast(starts, ends, through)

        simulator.cast_rays = counted
        self.world = ssduck.World(simulator)
        return self.world

    def seen(self, sensor):
        """The names of what a sensor perceives."""
        return [self.world.entity(id).name for id in sensor.reading.hits]


def evaluators(world):
    """Interpreters of both kinds with the world as `sim`."""
    for row_by_row in (False, True):
        with ssduck.Interpreter(row_by_row=row_by_row) as ss:
            ss.add_variable("sim", world)
            yield ss


POSES = [
    ([0, 0, 0], [1, 0, 0, 0]),
    ([1.2, -0.7, 0.4], [1, 0, 0, 0]),
    ([0.3, 0.2, 0.1], [0.9659258, 0, 0, 0.2588190]),
    ([-1.0, 1.0, 1.2], [0.8, 0.0, 0.6, 0.0]),
    ([2.5, -2.0, -0.5], [0.5, 0.5, -0.5, 0.5]),
]


def turned(orientation, vectors):
    return Rotation.from_quat(np.roll(orientation, -1)).apply(vectors)
