"""Ray and Spark give what this machine's processes give, also if a worker is killed midway."""

import shutil
import tempfile
from pathlib import Path

import pytest

import ssduck
from ssduck.errors import EvaluationError, ProgramWarning, UnsupportedError
from ssduck.lakes.answers import answer_table
from ssduck.lakes.engines import How
from tests.support.lake_questions import PROGRAMS, KillingQuestion

QUESTION = PROGRAMS["last tick"]
DOUBT = "count(SELECT id FROM sim WHERE id=='cpu' AS list);"
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
    # The paths of its sockets have at most 107 bytes.
    with tempfile.TemporaryDirectory(prefix="ray", dir="/tmp", ignore_cleanup_errors=True) as place:
        options = {"include_dashboard": False, "_node_ip_address": "127.0.0.1"}
        ray.init(num_cpus=2, log_to_driver=False, _temp_dir=place, **options)
        yield ray
        ray.shutdown()


@pytest.fixture(scope="module")
def spark(request):
    pytest.importorskip("pyspark", reason="PySpark is not installed: pip install 'ssduck[spark]'")
    if shutil.which("java") is None:
        pytest.skip("Spark needs Java: openjdk-17-jre-headless")
    # Its workers have to find the tests.
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", str(Path(request.config.rootpath)))
        yield
    from pyspark.sql import SparkSession

    session = SparkSession.getActiveSession()
    if session is not None:
        session.stop()


def answers_after_a_kill(lake, tmp_path, engine, **engines):
    """Returns the answers to a question that kills one of the processes that answer it."""
    question = KillingQuestion(QUESTION, mark=str(tmp_path / "killed"))
    how = How(engine, batch=1, resume=tmp_path / "kept", progress=False, **engines)
    answered = lake._answered(question, None, how)
    table = answer_table(answered)
    assert (tmp_path / "killed").exists()
    return table


@pytest.fixture(params=["ray", "spark"])
def engine(request):
    request.getfixturevalue(request.param)
    return request.param


def test_the_same_answers(engine, folder):
    lake = ssduck.lake(folder)
    wanted = lake.ask(QUESTION, processes=1)
    assert lake.ask(QUESTION, engine=engine, batch=2).equals(wanted)


def test_doubts_are_told(engine, folder):
    with pytest.warns(ProgramWarning, match="'cpu'") as told:
        ssduck.lake(folder).ask(DOUBT, engine=engine, batch=2)
    assert [one.category for one in told].count(ProgramWarning) == 1


def test_a_killed_worker(engine, folder, tmp_path):
    lake = ssduck.lake(folder)
    wanted = lake.ask(QUESTION, processes=1)
    assert answers_after_a_kill(lake, tmp_path, engine).equals(wanted)


@pytest.mark.long
def test_a_killed_process_of_this_machine_is_an_error(folder, tmp_path):
    lake = ssduck.lake(folder)
    wanted = lake.ask(QUESTION, processes=1)
    with pytest.raises(EvaluationError, match="a process was killed"):
        answers_after_a_kill(lake, tmp_path, "local", processes=2)
    # The second time, what was answered is read, and the rest is asked.
    assert answers_after_a_kill(lake, tmp_path, "local", processes=2).equals(wanted)


@pytest.mark.parametrize("name", ["ray", "spark"])
def test_missing_engines_say_what_to_install(folder, monkeypatch, name):
    monkeypatch.setitem(
        __import__("sys").modules, {"ray": "ray", "spark": "pyspark.sql"}[name], None
    )
    with pytest.raises(UnsupportedError, match=rf"ssduck\[{name}\]"):
        ssduck.lake(folder).ask("1;", engine=name)
