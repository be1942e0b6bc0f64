"""Fixtures of all tests: a PyBullet client, files written on the spot, the kitchen of many modules.

The folders follow the packages of `ssduck`; `end_to_end` tests the whole, `support` holds what several
files use. `python -m pytest` runs all but the `long` cases, in a process for each core; `-n 0` runs in
one process, for a debugger or `-s`. `make test` leaves out those that are marked `slow`, too; `make
long` runs the `long` ones, and those that generate their cases with more of them. A test may run beside
any other, in any order: it keeps its files in `tmp_path` and closes what it opens.
"""

import gc
import os
import shutil
import signal
import tempfile
from importlib.util import find_spec
from pathlib import Path

import pytest
from hypothesis import settings

from ssduck.errors import UnsupportedError
from tests.support.archive import Archive
from tests.support.cases import factor, generated, mark_all_but_pairs
from tests.support.times import Times

# A file system in memory, and the free bytes that tests may need in it.
MEMORY = Path("/dev/shm")  # noqa: S108
NEEDED = 4 << 30
PYBULLET = ("pybullet", "pybullet_data")

# The machines that run the tests are slow and shared; a failing example is found again.
settings.register_profile("few", deadline=None, derandomize=True, max_examples=generated(15))
# Each night draws other examples.
settings.register_profile("many", deadline=None, print_blob=True, max_examples=generated(100))
settings.load_profile("many" if factor() > 1 else "few")


def pytest_configure(config):
    """Let signals reach the processes of tests that a background job or nohup would ignore."""
    config.pluginmanager.register(Times(config))
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:
        signal.signal(signal.SIGHUP, signal.SIG_DFL)
    _keep_temporary_files_in_memory()


def _keep_temporary_files_in_memory():
    """Let temporary files not wait for a disk, unless TMPDIR says where they go.

    Records are flushed to the disk each second and at each close: a fifth of the tests' time.
    """
    if "TMPDIR" in os.environ or not os.access(MEMORY, os.W_OK):
        return
    if shutil.disk_usage(MEMORY).free >= NEEDED:
        os.environ["TMPDIR"] = str(MEMORY)  # the tests' processes have it, too
        tempfile.tempdir = None  # it is read anew


NO_PYBULLET = "PyBullet is not installed"  # there are wheels for few platforms; MuJoCo has the rest


def _skip_without_pybullet(error):
    """Skip what needs PyBullet where that is not installed."""
    while error is not None and find_spec("pybullet") is None:
        is_told = isinstance(error, UnsupportedError) and "PyBullet" in str(error)
        if is_told or (isinstance(error, ImportError) and error.name in PYBULLET):
            pytest.skip(NO_PYBULLET)
        error = error.__cause__ or error.__context__


@pytest.hookimpl(wrapper=True)
def pytest_runtest_setup():
    """Skip tests that need PyBullet, in their fixtures or themselves."""
    try:
        return (yield)
    except Exception as error:
        _skip_without_pybullet(error)
        raise


pytest_runtest_call = pytest_runtest_setup


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report(collector):
    """Skip modules of tests that import it."""
    report = yield
    told = (NO_PYBULLET, *(f"No module named '{name}'" for name in PYBULLET))
    is_told = report.failed and any(text in str(report.longrepr) for text in told)
    if is_told and find_spec("pybullet") is None:
        report.outcome, report.longrepr = "skipped", (str(collector.path), 0, NO_PYBULLET)
    return report


@pytest.hookimpl(wrapper=True)
def pytest_collection():
    """Keep the garbage collector from going through what is being collected."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.enable()


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    """Let `make long` find the modules that generate cases, and those that few others stand for."""
    mark_all_but_pairs(items)
    for item in items:
        if hasattr(item, "module") and hasattr(item.module, "generated"):
            item.add_marker(pytest.mark.generated)


def pytest_collection_finish():
    """Keep it from going through that later, which stays to the end, and let it work more rarely.

    Parsed statements are cycles: with Python's threshold most of them outlive a young collection, and
    the old ones, which go through everything, take a sixth of the tests' time.
    """
    gc.collect()
    gc.freeze()
    gc.set_threshold(20_000)


def pytest_unconfigure():
    """Let Python collect it at exit: extension modules tell of what is left then."""
    gc.unfreeze()


@pytest.fixture(scope="session", autouse=True)
def temporary_files(tmp_path_factory):
    """Keeps the temporary files of tests that end processes in the folder that pytest removes."""
    folder = str(tmp_path_factory.mktemp("temporary"))
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TMPDIR", folder)
        patch.setattr(tempfile, "tempdir", folder)
        yield


@pytest.fixture
def client():
    """A PyBullet client of the test's own."""
    pybullet = pytest.importorskip("pybullet")  # there are wheels for few versions of Python
    number = pybullet.connect(pybullet.DIRECT)
    yield number
    if pybullet.isConnected(number):
        pybullet.disconnect(number)


@pytest.fixture
def stage():
    """A PyBullet client that the test fills with shapes."""
    from tests.support.stage import Stage  # it needs PyBullet

    with Stage() as stage:
        yield stage


@pytest.fixture(scope="module")
def ss():
    """An interpreter with a kitchen of the module's own."""
    import ssduck  # where it is used: `--help` needs it not

    with ssduck.load("kitchen") as ss:
        yield ss


@pytest.fixture(scope="session")
def archive(request):
    """Records that are written once, and copied."""
    return Archive(request.config.cache.mkdir("records"))


@pytest.fixture(scope="session")
def loaded_kitchen():
    """The simulation of the kitchen that modules share, which nothing may change."""
    import ssduck  # where it is used: `--help` needs it not

    with ssduck.load("kitchen") as ss:
        yield ss.call_variable("kitchen")


@pytest.fixture(scope="module")
def shared_kitchen(loaded_kitchen):
    """The world of a kitchen that other modules see, too; a module that changes it is told."""
    before = whole_state(loaded_kitchen)
    yield loaded_kitchen
    assert whole_state(loaded_kitchen) == before, "this module changes the kitchen of all"


def whole_state(world):
    """What the simulator says of each body, and the world's tick."""
    import pybullet

    client, numbers = world.simulator.client, range(pybullet.getNumBodies(world.simulator.client))
    poses = [pybullet.getBasePositionAndOrientation(number, client) for number in numbers]
    joints = [
        pybullet.getJointState(number, joint, client)[:2]
        for number in numbers
        for joint in range(pybullet.getNumJoints(number, client))
    ]
    handles = [(entity.name, entity.enabled) for entity in world]
    return world.snapshot.number, world.time, poses, joints, handles


@pytest.fixture
def write(tmp_path):
    """Writes a file into the test's folder and tells its path."""

    def written(name, text):
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
        return path

    return written
