"""The shell at a terminal: keys, completion, history, Ctrl-C and Ctrl-D."""

import os
import re
import signal
import subprocess
import sys
import time

import pytest

import ssduck
from ssduck.shell.session import Session
from tests.support.command_line import LINUX, environment
from tests.support.timing import HANGS
from tools import draw_shell

pytest.importorskip("prompt_toolkit", reason="the extra shell is not installed")

from prompt_toolkit.document import Document
from prompt_toolkit.input import create_pipe_input
from prompt_toolkit.output import DummyOutput

from ssduck.shell.terminal import NameCompleter, history_path, prompt_session, run_terminal


@pytest.fixture(scope="module")
def ss():
    with ssduck.load("hall") as loaded:
        yield loaded


@pytest.fixture
def session(ss, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    handler = signal.getsignal(signal.SIGINT)
    yield Session(ss)
    signal.signal(signal.SIGINT, handler)


def press(session, keys, *, with_history=True):
    with create_pipe_input() as pipe:
        pipe.send_text(keys)
        prompt = prompt_session(
            session, with_history=with_history, input=pipe, output=DummyOutput()
        )
        run_terminal(session, prompt)


KEYS = [
    ("1 + 1;\r\x04", "2\n"),
    ("1 +\r1;\r\x04", "2\n"),
    ("1 + \x031;\r\x04", "1\n"),
    (".mode sql\rSELECT 3 AS n;\r.quit\r", "n\n-\n3\n"),
    ("\x04", ""),
]


@pytest.mark.parametrize(("keys", "out"), KEYS)
def test_keys(session, capsys, keys, out):
    press(session, keys)
    assert capsys.readouterr() == (out, "")


def test_the_history_is_kept_across_sessions(session, tmp_path, capsys):
    press(session, "40 + 2;\r\x04")
    assert history_path() == tmp_path / "ssduck" / "history"
    assert "40 + 2;" in history_path().read_text()
    assert history_path().stat().st_mode & 0o077 == 0
    capsys.readouterr()
    press(Session(session.ss), "\x1b[A\r\x04")
    assert capsys.readouterr().out == "42\n"


def test_the_history_is_switched_off(session):
    press(session, "40 + 2;\r\x04", with_history=False)
    assert not history_path().exists()


def test_a_history_that_cannot_be_written_is_a_warning(session, tmp_path, capsys):
    (tmp_path / "ssduck").write_text("a file")
    press(session, "7;\r\x04")
    out, err = capsys.readouterr()
    assert out == "7\n"
    assert err.startswith("warning: ")


def completions(session, text):
    return [each.text for each in NameCompleter(session).get_completions(Document(text), None)]


def test_completion(session):
    assert completions(session, "SELECT hall.goa") == ["goal"]
    assert completions(session, ".s") == ["schema", "step"]
    session.language = "sql"
    assert completions(session, "SELECT * FROM contac") == ["contacts", "contacts_history"]


@LINUX
@pytest.mark.long
def test_a_pseudo_terminal(tmp_path):
    import pty

    own, other = pty.openpty()
    env = environment() | {
        "XDG_STATE_HOME": str(tmp_path),
        "TERM": "xterm",
        "PROMPT_TOOLKIT_NO_CPR": "1",
    }
    command = [sys.executable, "-m", "ssduck", "shell", "hall"]
    process = subprocess.Popen(
        command, stdin=other, stdout=other, stderr=other, env=env, start_new_session=True
    )
    os.close(other)
    seen = ""

    def read_until(wanted):
        nonlocal seen
        end = time.monotonic() + HANGS
        while wanted not in seen:
            assert time.monotonic() < end, seen
            seen += os.read(own, 65536).decode(errors="replace")
        seen = seen.partition(wanted)[2]

    try:
        read_until("hall>")
        os.write(own, b"20 + 22;\r")
        read_until("42")
        read_until("hall>")
        os.write(own, b".mode sql\r")
        read_until("hall sql>")
        os.write(own, b"SELECT count(*) FROM range(10000000) a, range(10000000) b;\r")
        time.sleep(1.0)
        process.send_signal(signal.SIGINT)
        read_until("interrupted")
        read_until("hall sql>")
        os.write(own, b"SELECT 6 * 7 AS product;\r")
        read_until("42")
        read_until("hall sql>")
        os.write(own, b"\x04")
        assert process.wait(HANGS) == 0
    finally:
        process.kill()
        process.wait()
        os.close(own)


def texts(path):
    return re.findall(r"<text[^>]*>([^<]*)</text>", path.read_text(encoding="utf-8"))


@pytest.mark.slow
def test_the_manuals_picture_of_the_shell_is_up_to_date(tmp_path):
    drawn = texts(draw_shell.draw(tmp_path))
    assert len(drawn) > 20
    assert drawn == texts(draw_shell.IMAGES / "shell.svg")
