"""`ssduck view`: the first line is the address of the page, which Ctrl-C ends."""

import signal
import subprocess
import sys
import urllib.request

import pytest

pytest.importorskip("websockets", reason="the extra view is not installed")


@pytest.mark.slow
def test_the_first_line_is_the_address():
    command = [sys.executable, "-m", "ssduck", "view", "kitchen", "--no-browser"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        url = process.stdout.readline().strip()
        try:
            assert url.startswith("http://127.0.0.1:")
            with urllib.request.urlopen(url, timeout=30) as reply:  # noqa: S310  # its own server
                assert "ssduck" in reply.read().decode()
        finally:
            process.send_signal(signal.SIGINT)
    assert process.returncode == 130
