"""A zygote for all tests of a process, whose workers run Python of tests, too."""

import pytest

from ssduck.limits import Limits
from ssduck.sandbox import SandboxedInterpreter, opening
from tests.support.taken_over import HookedZygote


@pytest.fixture(scope="session")
def zygote():
    zygote = HookedZygote()
    yield zygote
    zygote.close()


@pytest.fixture(scope="module")
def kitchen(zygote):
    """The kitchen in a sandbox whose programs have half a second."""
    limits = Limits.strict(seconds=0.5)
    with opening.load("kitchen", limits=limits, zygote=zygote) as ss:
        yield ss


@pytest.fixture(scope="module")
def empty(zygote):
    with SandboxedInterpreter(limits=Limits.strict(seconds=0.5), zygote=zygote) as ss:
        yield ss
