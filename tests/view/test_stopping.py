"""A query that its page no longer waits for is ended, and holds up nothing."""

import json
import threading

import pytest

import ssduck
from ssduck.errors import SelectScriptError

pytest.importorskip("websockets", reason="the extra view is not installed")
from ssduck.view import answers, scans, sealed
from tests.support.viewing import asked, opened

# It does not end before the limit of time.
LONG = "SELECT count(*) FROM range(9000000) a, range(9000000) b WHERE a.range + b.range = 7"
STOPPED = "the program was stopped"


class Running:
    """Long queries: whether one has begun and ended, and their errors."""

    def __init__(self, ask, is_long):
        self.began, self.ended = threading.Event(), threading.Event()
        self.errors = []
        self._ask, self._is_long = ask, is_long

    def __call__(self, *arguments, **options):
        if not self._is_long(*arguments):
            return self._ask(*arguments, **options)
        self.began.set()
        try:
            answer = self._ask(*arguments, **options)
        except SelectScriptError as error:
            self.errors.append(error.message)
            raise
        else:
            self.errors += [answer["error"]["message"]] if "error" in answer else []
            return answer
        finally:
            self.ended.set()


def is_sealed_long(_box, _stop, method, _viewer, question):
    """Whether a sandbox is asked for what takes long; a search is what goes on."""
    if method == "answer":
        return question.get("text") == LONG
    return method == "advance_scan"


@pytest.fixture(scope="module", params=["sealed", "here"])
def place(request):
    """Whether pages are answered in a sandbox, or in this process, as on other systems."""
    with pytest.MonkeyPatch.context() as patch:
        if request.param == "here":
            patch.setattr(sealed.PageSandboxes, "of", classmethod(lambda *_: None))
        yield request.param


@pytest.fixture
def running(monkeypatch, place):
    if place == "sealed":
        running = Running(sealed._asked, is_sealed_long)
        monkeypatch.setattr(sealed, "_asked", running)
    else:
        running = Running(answers.value_to_show, lambda _ss, text, _language: text == LONG)
        monkeypatch.setattr(answers, "value_to_show", running)
        monkeypatch.setattr(scans, "value_to_show", running)
    return running


@pytest.fixture(scope="module")
def url(place):
    with ssduck.load("kitchen") as ss, ss.view() as served:
        ss.run(0.1)
        with opened(served.url) as socket:  # the sandboxes start
            asked(socket, type="ask", text="1;")
        yield served.url


def begin(socket, running, kind="ask"):
    """Asks what takes long, and waits until it runs."""
    socket.send(json.dumps({"type": kind, "id": 1, "text": LONG, "language": "sql"}))
    assert running.began.wait(30)


def messages_until(socket, last):
    """Returns the answers by their ids, until that of the last one is there."""
    found = {}
    while last not in found:
        message = socket.recv(timeout=30)
        if isinstance(message, str) and "id" in (answer := json.loads(message)):
            found[answer["id"]] = answer
    return found


@pytest.mark.slow
def test_a_query_ends_when_its_page_asks_anew(url, running):
    with opened(url) as socket:
        begin(socket, running)
        socket.send(json.dumps({"type": "ask", "id": 2, "text": "40 + 2;"}))
        found = messages_until(socket, 2)
    assert found[1]["error"]["message"] == STOPPED
    assert found[2]["rows"] == [[42]]
    assert running.errors == [STOPPED]


def test_only_the_last_of_many_queries_runs(url, running):
    with opened(url) as socket:
        begin(socket, running)
        for id in range(2, 100):
            socket.send(json.dumps({"type": "ask", "id": id, "text": LONG, "language": "sql"}))
        socket.send(json.dumps({"type": "ask", "id": 100, "text": "40 + 2;"}))
        found = messages_until(socket, 100)
    assert sorted(found) == list(range(1, 101))
    assert found.pop(100)["rows"] == [[42]]
    assert all("took" not in answer["error"]["message"] for answer in found.values())


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["ask", "scan"])
def test_a_query_ends_when_its_page_has_gone(url, running, kind):
    with opened(url) as socket, opened(url) as other:
        begin(socket, running, kind)
        socket.close()
        assert asked(other, type="ask", text="40 + 2;")["rows"] == [[42]]
        assert running.ended.wait(30)
    assert running.errors == [STOPPED]


@pytest.mark.slow
def test_a_query_ends_when_the_page_is_closed(running):
    with ssduck.load("kitchen") as ss, ss.view() as served:
        with opened(served.url) as socket:
            begin(socket, running)
            served.close()
        assert running.errors == [STOPPED]


@pytest.mark.slow
def test_a_query_goes_on_when_another_page_asks_or_goes(url, running):
    with opened(url) as socket:
        begin(socket, running)
        with opened(url) as other:
            other.send(json.dumps({"type": "ask", "id": 3, "text": "40 + 2;"}))
        assert not running.ended.wait(0.3)


def test_a_query_delays_no_control(url, running):
    with opened(url) as socket:
        begin(socket, running)
        assert asked(socket, type="control", action="pause")["error"]  # it is stepped elsewhere
        assert asked(socket, type="track", first=-1, count=1)["none"]
        assert not running.ended.is_set()
