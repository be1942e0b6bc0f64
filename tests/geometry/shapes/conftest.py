"""Fixtures of the tests in this folder."""

import pytest

from tests.support.stage import Stage


@pytest.fixture(scope="module")
def pair():
    """Two unit boxes a and b; b is put where a test wants it."""
    made = Stage()
    made.box("a")
    made.box("b", (5, 0, 0))
    world = made.open()
    ss, slow = made.interpreters(sim=world)
    yield ss, slow, world["b"]
    made.close()


@pytest.fixture(scope="module")
def row():
    """Boxes in a row: 0 and 1 collide, 1 and 2 touch, 3 is alone; all on a floor."""
    made = Stage()
    made.box("floor", (0, 0, -1), [20.0, 20.0, 0.5])
    for n, x in enumerate((0.0, 0.9, 1.9, 5.0)):
        made.box(f"b{n}", (x, 0, 0))
    world = made.open()
    ss, slow = made.interpreters(sim=world)
    for interpreter in (ss, slow):
        interpreter.add_variable("half", 0.5)
    yield ss, slow, world
    made.close()
