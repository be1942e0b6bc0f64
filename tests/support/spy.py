"""A simulator that counts its reads."""

from collections import Counter

from ssduck.errors import SimulatorError


class Spy:
    """A simulator that counts the reads of another one, by method, and the bodies read."""

    def __init__(self, simulator):
        self._simulator = simulator
        self.read = Counter()

    def __getattr__(self, name):
        return getattr(self._simulator, name)

    broken = ()

    def read_link_poses(self, bodies):
        self._check("frames")
        self.read["frames"] += 1
        self.read["bodies"] += len(bodies)
        return self._simulator.read_link_poses(bodies)

    def _check(self, reading):
        if reading in self.broken:
            raise SimulatorError("broken")

    def read_joints(self, bodies):
        self._check("joints")
        self.read["joints"] += 1
        return self._simulator.read_joints(bodies)

    def read_contacts(self):
        self._check("contacts")
        self.read["contacts"] += 1
        return self._simulator.read_contacts()
