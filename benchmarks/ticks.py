"""Measures taking a tick against bare Python loops over PyBullet's getters.

`python -m benchmarks ticks` takes some seconds. There are two loops: `all getters` reads all that a
tick contains: pose, velocity and box of every body and link. `the tick's own` makes exactly the
calls of the tick (no boxes; movable bodies only) and ignores the results.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager

import pybullet

import ssduck
from benchmarks.timing import medians, text_of
from ssduck.simulators.pybullet.simulator import PyBulletSimulator
from ssduck.simulators.scenes import find_scene


def bodies(client: int) -> list[int]:
    """Returns the numbers of the bodies of a client."""
    count = pybullet.getNumBodies(client)
    return [pybullet.getBodyUniqueId(index, client) for index in range(count)]


def all_getters(client: int) -> Callable[[], object]:
    """Returns a loop over pose, velocity and box of every body and link."""
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
    """Returns a loop of the calls that the tick itself makes."""
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
    """Yields the shipped kitchen at rest, and its client."""
    world = ssduck.World.load(find_scene("kitchen")).step(240)
    yield world, world.ticker.simulator.client  # type: ignore[attr-defined]
    world.close()


@contextmanager
def boxes(count: int, *, owned: bool) -> Iterator[tuple[ssduck.World, int]]:
    """Yields a world of falling boxes and its client, to which ssduck may be attached only."""
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
    """Returns the PyBullet numbers of the movable bodies."""
    member_bodies = (member.body for member in world.snapshot.entities)
    return {body.handle for body in member_bodies if body is not None and body.movable}


SCENES: dict[str, Callable[[], AbstractContextManager[tuple[ssduck.World, int]]]] = {
    "kitchen": kitchen,
    "1,000 boxes": lambda: boxes(1000, owned=True),
    "1,000 boxes, attached": lambda: boxes(1000, owned=False),
}


def rows() -> Iterator[tuple[str, str, str, str, str, str]]:
    """Yields a row for each scene: the tick, both loops, and the ratios of the tick to them."""
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
            text_of(times["tick"]),
            text_of(times["all"]),
            f"{times['tick'] / times['all']:.2f}",
            text_of(times["own"]),
            f"{times['tick'] / times['own']:.2f}",
        )


HEADER = ("taking a tick", "ssduck", "all getters", "ratio", "the tick's own", "ratio")
