"""What the sandboxes of a page send is data, whoever runs there."""

import pytest

import ssduck
from ssduck import Recording
from ssduck.errors import LimitError

pytest.importorskip("websockets", reason="the extra view is not installed")
from ssduck.interpreter.stopping import StopRequest
from ssduck.sandbox import processes
from ssduck.view.live import LiveSource
from ssduck.view.sealed import PageSandboxes
from tests.support.taken_over import HookedZygote

pytestmark = pytest.mark.slow

QUESTION = {"type": "ask", "text": "1 + 1;"}
# What answers instead, as Python.
FORGED = {
    "a number": "5",
    "nothing": "None",
    "no JSON": "'{'",
    "a list": "'[1]'",
    "nested lists": "'[' * 5000",
    "a long number": "'{\"rows\": ' + '1' * 5000 + '}'",
    "many lists": "'[' + '[],' * 2_000_000 + '[]]'",
    "bytes": "b'{}'",
    "an array": "__import__('numpy').zeros(3)",
}
FORGE = """
from ssduck.view.sealed import AnswersInside
AnswersInside.answer = AnswersInside.advance_scan = lambda *_: {}
"""


@pytest.fixture(scope="module")
def zygote():
    zygote = HookedZygote()
    yield zygote
    zygote.close()


@pytest.fixture
def ss(zygote, monkeypatch):
    monkeypatch.setattr(processes, "_shared", [zygote])
    with ssduck.load("kitchen") as ss:
        ss.run(0.1)
        yield ss


@pytest.fixture
def page(ss):
    page = PageSandboxes(LiveSource(ss, ss["kitchen"], "kitchen"))
    yield page
    page.close()


def test_forged_answers_are_errors(page):
    answers, stop = page.answers(), StopRequest()
    scan = answers.scan(QUESTION, stop)
    for forged in FORGED.values():
        for use in ("present", "scan"):
            page.sandbox(use).ask("worker.python", FORGE.format(forged))
        assert answers.answer(QUESTION, stop)["error"]["type"] == "LimitError"
        with pytest.raises(LimitError):
            scan.advance(0.1)


def test_a_search_sees_the_ticks_with_which_it_began(ss, page):
    ss.record("kitchen", Recording(ticks=20))
    ss.run(0.1)
    first, *_, last = ss.past("kitchen").times
    scan = page.answers().scan({"type": "scan", "text": "z(kitchen.table);"}, StopRequest())
    ss.run(1.0)
    while scan.advance(0.1):
        pass
    ((*times, _),) = scan.progress["runs"]
    assert times == [first, last]


def test_a_search_ends_when_the_world_is_recorded_anew(ss, page):
    question, stop = {"type": "scan", "text": "z(kitchen.table);"}, StopRequest()
    scan = page.answers().scan(question, stop)
    ss.record("kitchen", Recording(tables=("entities",)))
    ss.run(0.1)
    page.answers().scan(question, stop)  # another viewer sees the new ticks
    with pytest.raises(LimitError, match="recorded anew"):
        scan.advance(0.1)


def test_a_viewer_has_its_last_result_until_many_others_came(page):
    stop, download = StopRequest(), {"type": "download", "format": "csv"}
    viewers = [page.answers() for _ in range(20)]
    for viewer in viewers:
        viewer.answer(QUESTION, stop)
    first, last = (viewer.answer(download, stop) for viewer in (viewers[0], viewers[-1]))
    assert first != last
    assert last["name"] == "result.csv"
