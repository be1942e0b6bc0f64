"""Taking a tick, against bare Python loops over PyBullet's getters.

Two loops are measured. `all getters` asks what a user must ask to know what a tick knows: pose,
velocity and box of every body and link. `the tick's own` makes exactly the calls that the tick
makes (no boxes; not those bodies that cannot move), and does nothing with the results.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager

import pybullet

import ssduck
from benchmarks.timing import medians, shown
from ssduck.simulators.pybullet.simulator import PyBulletSimulator
from ssduck.simulators.scenes import find_scene


def bodies(client: int) -> list[int]:
    """The numbers of a client's bodies."""
    count = pybullet.getNumBodies(client)
    return [pybullet.getBodyUniqueId(index, client) for index in range(count)]


def all_getters(client: int) -> Callable[[], object]:
    """The loop of a user: pose, velocity and box of every body and link."""
    links = {body: list(range(pybullet.getNumJoints(body, client))) for body in bodies(client)}

    def loop() -> object:
        state = {}
        for body, indices in links.items():
            pose = pybullet.getBasePositionAndOrientation(body, client)
            velocity = pybullet.getBaseVelocity(body, client)
            box = pybullet.getAABB(body, -1, client)
            states = boxes = None
            if indices:
                states = pybullet.getLinkStates(body, indices, 1, 1, client)
                boxes = [pybullet.getAABB(body, link, client) for link in indices]
            state[body] = (pose, velocity, box, states, boxes)
        return state

    return loop


def own_getters(client: int, moving: set[int]) -> Callable[[], object]:
    """The calls that the tick itself makes."""
    links = {body: list(range(pybullet.getNumJoints(body, client))) for body in moving}

    def loop() -> object:
        state = {}
        for body, indices in links.items():
            pose = pybullet.getBasePositionAndOrientation(body, client)
            velocity = pybullet.getBaseVelocity(body, client)
            states = pybullet.getLinkStates(body, indices, 1, 1, client) if indices else None
            state[body] = (pose, velocity, states)
        return state

    return loop


@contextmanager
def kitchen() -> Iterator[tuple[ssduck.World, int]]:
    """The shipped kitchen, settled."""
    world = ssduck.World.load(find_scene("kitchen")).step(240)
    yield world, world._simulator.client  # type: ignore[attr-defined]
    world.close()


@contextmanager
def boxes(count: int, *, owned: bool) -> Iterator[tuple[ssduck.World, int]]:
    """Falling boxes in a world of ssduck's, or in a client that ssduck is attached to."""
    client = pybullet.connect(pybullet.DIRECT)
    shape = pybullet.createCollisionShape(
        pybullet.GEOM_BOX, halfExtents=[0.1, 0.2, 0.3], physicsClientId=client
    )
    for number in range(count):
        place = [number % 30, number // 30, 1.0]
        pybullet.createMultiBody(1, shape, basePosition=place, physicsClientId=client)
    yield ssduck.World(PyBulletSimulator(client, owned=owned)), client
    pybullet.disconnect(client)


def movable(world: ssduck.World) -> set[int]:
    """The PyBullet numbers of the bodies that can move."""
    found = (member.body for member in world.snapshot.members)
    return {body.handle for body in found if body is not None and body.movable}


SCENES: dict[str, Callable[[], AbstractContextManager[tuple[ssduck.World, int]]]] = {
    "kitchen": kitchen,
    "1,000 boxes": lambda: boxes(1000, owned=True),
    "1,000 boxes, attached": lambda: boxes(1000, owned=False),
}


def rows() -> Iterator[tuple[str, str, str, str, str, str]]:
    """One row a scene: tick, both loops, and the ratios of the tick to them."""
    for name, scene in SCENES.items():
        with scene() as (world, client):
            ways = {
                "tick": world.tick,
                "all": all_getters(client),
                "own": own_getters(client, movable(world)),
            }
            times = medians(ways, 300 if name == "kitchen" else 100)
        yield (
            name,
            shown(times["tick"]),
            shown(times["all"]),
            f"{times['tick'] / times['all']:.2f}",
            shown(times["own"]),
            f"{times['tick'] / times['own']:.2f}",
        )


HEADER = ("taking a tick", "ssduck", "all getters", "ratio", "the tick's own", "ratio")
