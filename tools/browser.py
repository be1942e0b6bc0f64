"""Drives a headless Chromium by its DevTools protocol over a websocket."""

from __future__ import annotations

import base64
import contextlib
import io
import json
import os
import re
import shutil
import signal
import subprocess
import time
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from PIL import Image
from websockets.sync.client import connect

TIMEOUT = 180.0


def chromium() -> str | None:
    """Returns the path of Chromium; None if it is not installed."""
    return next(
        filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None
    )


class ProtocolError(Exception):
    """The browser refused a call, as for a page that is just loaded again."""


class Browser:
    """A Chromium without a network beyond this computer.

    Args:
        folder: an empty folder for its files.
    """

    def __init__(self, folder: Path) -> None:
        path = chromium()
        assert path is not None
        self._process = subprocess.Popen(  # noqa: S603
            [
                path,
                *("--headless=new", "--no-sandbox", "--no-first-run"),
                *("--remote-debugging-port=0", f"--user-data-dir={folder}", "--disable-extensions"),
                "--window-size=1280,800",
                "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1",
                "about:blank",
            ],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        lines = []
        assert self._process.stderr is not None
        for line in self._process.stderr:
            lines.append(line)
            found = re.search(r"ws://\S+", line)
            if found:
                break
        else:
            raise RuntimeError("".join(lines))
        self._stack = contextlib.ExitStack()
        connection = connect(found[0], max_size=None, proxy=None)
        self._socket = self._stack.enter_context(connection)
        self._next = 0
        self.messages: list[dict[str, Any]] = []

    def call(self, method: str, session: str | None = None, **parameters: Any) -> Any:
        """Calls a method of the protocol, and returns its result."""
        self._next += 1
        number = self._next
        message = {"id": number, "method": method, "params": parameters}
        self._socket.send(json.dumps(message | ({} if session is None else {"sessionId": session})))
        while True:
            reply = json.loads(self._socket.recv(timeout=TIMEOUT))
            if reply.get("id") == number:
                if "error" in reply:
                    raise ProtocolError(reply["error"]["message"])
                return reply["result"]
            self.messages.append(reply)

    def open(self, url: str) -> Page:
        """Opens a page in a tab of its own."""
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        page = Page(self, target, session)
        page.call("Runtime.enable")
        page.call("Page.enable")
        page.call("Page.navigate", url=url)
        return page

    def close(self) -> None:
        """Ends the browser with all of its processes."""
        self._stack.close()
        os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()
        if self._process.stderr is not None:
            self._process.stderr.close()


class Page:
    """A tab."""

    def __init__(self, browser: Browser, target: str, session: str) -> None:
        self._browser, self._target, self._session = browser, target, session

    def call(self, method: str, **parameters: Any) -> Any:
        """Calls a method of the protocol for this tab, and returns its result."""
        return self._browser.call(method, self._session, **parameters)

    def value(self, expression: str) -> Any:
        """Returns the value of an expression of JavaScript."""
        result = self.call(
            "Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True
        )
        assert "exceptionDetails" not in result, result["exceptionDetails"]
        return result["result"].get("value")

    def wait(self, expression: str) -> Any:
        """Waits until an expression is true, and returns its value."""
        end = time.monotonic() + TIMEOUT
        while time.monotonic() < end:
            # A page that is just loaded again has no value yet.
            with contextlib.suppress(ProtocolError):
                value = self.value(expression)
                if value:
                    return value
            time.sleep(0.02)
        raise TimeoutError(f"{expression}: {self.errors()}")

    def errors(self) -> list[Any]:
        """Returns the errors of the page so far."""
        return [
            m["params"]
            for m in self._browser.messages
            if m.get("method") in ("Runtime.exceptionThrown", "Runtime.consoleAPICalled")
        ]

    def click(self, x: float, y: float) -> None:
        for kind in ("mousePressed", "mouseReleased"):
            self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)

    def resize(self, width: int, height: int) -> None:
        """Gives the page another size, pixels."""
        self.call(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=1,
            mobile=False,
        )

    def ask(self, text: str) -> None:
        """Types a query, runs it, and waits for the answer."""
        # In one step: the answer of an earlier query, asked again, does not count once this runs.
        before = self.value(f"__ss.type({json.dumps(text)}); __ss.run(); __ss.answers")
        self.wait(f"__ss.answers > {before}")

    def picture(self) -> npt.NDArray[np.uint8]:
        """Returns the pixels of a page of ssduck once all is drawn, (height, width, 3)."""
        frames = self.value("__ss.frames")
        self.value(
            "new Promise(done => requestAnimationFrame(() => requestAnimationFrame(() => done(0))))"
        )
        assert frames <= self.value("__ss.frames")
        return self.screenshot()

    def screenshot(self) -> npt.NDArray[np.uint8]:
        """Returns the pixels of any page as it is, (height, width, 3)."""
        data = self.call("Page.captureScreenshot", format="png")["data"]
        return np.asarray(Image.open(io.BytesIO(base64.b64decode(data))).convert("RGB"))

    def close(self) -> None:
        self._browser.call("Target.closeTarget", targetId=self._target)
