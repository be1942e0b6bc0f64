"""Ray and Spark give what this machine's processes give, also if a worker is killed midway."""

import os
import shutil
import signal
from pathlib import Path

import pytest

import ssduck
from ssduck.errors import EvaluationError, UnsupportedError
from ssduck.lakes import engines
from tests.support.lake_questions import PROGRAMS

QUESTION = PROGRAMS["last tick"]
pytestmark = [
    pytest.mark.slow,
    # Those of the engines' own code.
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
    pytest.mark.filterwarnings("ignore::FutureWarning"),
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
]


@pytest.fixture(scope="module")
def ray():
    ray = pytest.importorskip("ray", reason="Ray is not installed: pip install 'ssduck[ray]'")
    yield ray
    ray.shutdown()


@pytest.fixture(scope="module")
def spark():
    pytest.importorskip("pyspark", reason="PySpark is not installed: pip install 'ssduck[spark]'")
    if shutil.which("java") is None:
        pytest.skip("Spark needs Java: openjdk-17-jre-headless")
    yield
    from pyspark.sql import SparkSession

    session = SparkSession.getActiveSession()
    if session is not None:
        session.stop()


def killed_once(question, entries, answer=engines.answer_episodes):
    """Answers episodes; the first process that answers some is killed."""
    mark = Path(entries[0].path).parent / "killed"
    try:
        mark.touch(exist_ok=False)
    except FileExistsError:
        return answer(question, entries)
    os.kill(os.getpid(), signal.SIGKILL)


def test_ray(ray, folder):
    lake = ssduck.lake(folder)
    wanted = lake.ask(QUESTION, processes=1)
    options = {"num_cpus": 2, "include_dashboard": False, "_node_ip_address": "127.0.0.1"}
    assert lake.ask(QUESTION, engine="ray", batch=2, options=options).equals(wanted)


def test_a_killed_worker_of_ray(ray, folder, monkeypatch):
    lake = ssduck.lake(folder)
    wanted = lake.ask(QUESTION, processes=1)
    monkeypatch.setattr(engines, "answer_episodes", killed_once)
    assert lake.ask(QUESTION, engine="ray", batch=2).equals(wanted)
    assert (folder.parent / "killed").exists()


def test_spark(spark, folder):
    lake = ssduck.lake(folder)
    wanted = lake.ask(QUESTION, processes=1)
    assert lake.ask(QUESTION, engine="spark", batch=2).equals(wanted)


def test_a_killed_process_of_this_machine_is_an_error(folder, tmp_path, monkeypatch):
    lake = ssduck.lake(folder)
    wanted = lake.ask(QUESTION, processes=1)
    with monkeypatch.context() as patch:
        patch.setattr(engines, "answer_episodes", killed_once)
        with pytest.raises(EvaluationError, match="a process was killed"):
            lake.ask(QUESTION, processes=2, batch=1, resume=tmp_path / "kept")
    assert lake.ask(QUESTION, processes=2, batch=1, resume=tmp_path / "kept").equals(wanted)


@pytest.mark.parametrize("engine", ["ray", "spark"])
def test_missing_engines_say_what_to_install(folder, monkeypatch, engine):
    monkeypatch.setitem(
        __import__("sys").modules, {"ray": "ray", "spark": "pyspark.sql"}[engine], None
    )
    with pytest.raises(UnsupportedError, match=rf"ssduck\[{engine}\]"):
        ssduck.lake(folder).ask("1;", engine=engine)
