"""How tests ask the server of a page, and what its messages are."""

import json
import struct
from urllib.parse import urlsplit

import pytest

pytest.importorskip("websockets", reason="the extra view is not installed")
from websockets.sync.client import connect

from tools.browser import chromium

IN_CHROMIUM = pytest.mark.skipif(chromium() is None, reason="there is no Chromium")

SCENE, POSES, TRACK = 1, 2, 3


def opened(url, **headers):
    """Returns a connection as the page makes it."""
    parts = urlsplit(url)
    headers = {"Origin": f"http://{parts.netloc}", **headers}
    address = f"ws://{parts.netloc}/socket?{parts.query}"
    return connect(address, additional_headers=headers, max_size=None, proxy=None)


def asked(socket, **question):
    """Sends a question, and returns its answer."""
    question = {"id": 7, **question}
    socket.send(json.dumps(question))
    return told(socket, id=question["id"])


def told(socket, **expected):
    """Returns the next message of JSON that has what is expected."""
    while True:
        message = socket.recv(timeout=60)
        content = json.loads(message) if isinstance(message, str) else {}
        if expected.items() <= content.items():
            return content


def binary(socket, kind):
    """Returns the next binary message of a kind."""
    while True:
        message = socket.recv(timeout=60)
        if isinstance(message, bytes) and struct.unpack_from("<I", message)[0] == kind:
            return message
