"""Resets and new models leave nothing behind: no memory, no clients, no threads."""

import gc
import threading
from pathlib import Path

import pybullet
import pytest

from ssduck.gym import QueryWrapper
from ssduck.world.world import World
from tests.support.cases import generated
from tests.support.gym_environments import Drop, Push

RESETS = generated(25)


def kilobytes():
    """The resident memory of this process."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmRSS"))


def clients():
    """The number of connected clients of PyBullet."""
    return sum(map(pybullet.isConnected, range(64)))


def counts():
    """The numbers of objects, of threads and of clients."""
    gc.collect()
    worlds = sum(isinstance(one, World) for one in gc.get_objects())
    return worlds, threading.active_count(), clients()


def no_more(before):
    """Whether there are as many as before, or fewer: a thread of another test may end meanwhile."""
    return all(now <= then for now, then in zip(counts(), before, strict=True))


def resets(env, action, number):
    """Resets an environment, with a step after each reset."""
    for _ in range(number):
        env.reset()
        env.step(action)


@pytest.mark.long
@pytest.mark.parametrize(
    ("environment", "options", "success", "action"),
    [
        (Push, {}, "x(sim.ball) > 0.02", [1.0]),
        (Push, {"rebuilds": True}, "x(sim.ball) > 0.02", [1.0]),
        (Drop, {}, "z(sim.body_1) < 0.2", 0),
        (Drop, {"reconnects": True}, "z(sim.body_1) < 0.2", 0),
    ],
)
def test_resets_leave_nothing(environment, options, success, action):
    with QueryWrapper(environment(**options), success=success) as first:
        resets(first, action, 1)  # starts the thread that all interpreters share
    del first
    outside = counts()
    env = QueryWrapper(environment(**options), success=success)

    resets(env, action, 20)
    before, memory = counts(), kilobytes()
    resets(env, action, RESETS)
    assert no_more(before)
    # A model and its tables take more than this for each reset.
    assert kilobytes() - memory < RESETS * 100
    env.close()
    del env
    assert no_more(outside)
