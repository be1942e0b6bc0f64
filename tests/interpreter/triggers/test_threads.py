"""Triggers in several threads, and their cost."""

import gc
import threading
import weakref

import pytest

import ssduck
from tests.support.cases import sampled
from tests.support.timing import HANGS
from tests.support.triggering import HEIGHT, state, until

# -- threads and locks ---------------------------------------------------------------------------


@pytest.mark.slow
def test_queries_and_steps_in_two_threads(ss, sim):
    """The interpreter's lock comes before the worlds': triggers are told under none."""
    ended, results, errors = threading.Event(), [], []

    def ask():
        try:
            while not ended.is_set():
                results.append(ss.eval("SELECT a.this FROM a=sim, b=sim AS list;"))
                ss.sql("SELECT max(z) FROM sim.entities").fetchall()
        except BaseException as error:
            errors.append(error)
            raise

    ss.add_trigger("t", HEIGHT, 0, lambda _: ss.eval(HEIGHT))
    thread = threading.Thread(target=ask, daemon=True)
    thread.start()
    stepper = threading.Thread(target=lambda: sim.step(300), daemon=True)
    stepper.start()
    stepper.join(HANGS)
    assert not stepper.is_alive(), "a deadlock"
    ended.set()
    thread.join(HANGS)
    assert not thread.is_alive()
    assert not errors
    assert results
    assert state(ss, "t").evaluations == 301


@pytest.mark.slow
def test_two_threads_that_step(ss, sim):
    """Neither waits for the other's callbacks; all steps are run."""
    ss.add_trigger("t", HEIGHT, 0, lambda _: ss.eval(HEIGHT))
    threads = [threading.Thread(target=sim.step, args=(100,), daemon=True) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(HANGS)
        assert not thread.is_alive(), "a deadlock"
    assert sim.time == pytest.approx(200 / 240)
    before = state(ss, "t").evaluations
    sim.step()
    assert state(ss, "t").evaluations == before + 1


class Follower:
    """Wants a tick each so many seconds."""

    def __init__(self, period):
        self.period = period
        self.times = []
        self.free = []

    def due(self, world):
        return (len(self.times) + 1) * self.period

    def ticked(self, world):
        if world.reached(self.due(world)):
            self.times.append(round(world.time, 9))
        # Another thread can have the world's lock now.
        thread = threading.Thread(target=self._try, args=(world,))
        thread.start()
        thread.join()

    def _try(self, world):
        self.free.append(world.lock.acquire(timeout=HANGS))
        world.lock.release()


def test_followers(sim):
    follower = Follower(0.05)
    sim.follow(follower)
    sim.follow(follower)
    before = sim.snapshot.number
    sim.step(36, every=None)
    assert follower.times == [0.05, 0.1, 0.15]
    assert sim.snapshot.number == before + 3
    sim.tick()
    assert follower.free == [True] * 4
    sim.unfollow(follower)
    sim.step(36)
    assert len(follower.free) == 4


@pytest.mark.slow
def test_a_world_does_not_keep_its_followers(sim):
    follower = Follower(0.05)
    gone = weakref.ref(follower)
    sim.follow(follower)
    del follower
    gc.collect()
    assert gone() is None
    before = sim.snapshot.number
    sim.step(240, every=None)
    assert sim.snapshot.number == before + 1


@pytest.mark.slow
@sampled("queue", [None, 1], every=2)
def test_triggers_keep_nothing_alive(queue):
    ss = ssduck.load("kitchen")
    world = ss.call_variable("kitchen")
    got = []
    ss.add_trigger("t", "SELECT this FROM kitchen;", 0, got.append, queue=queue)
    world.step(2)
    until(lambda: got)
    gone = weakref.ref(ss), weakref.ref(world)
    del ss
    gc.collect()
    assert gone[0]() is None
    got.clear()
    world.step(2)
    assert got == []
    del world
    gc.collect()
    until(lambda: gone[1]() is None)
