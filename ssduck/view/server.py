"""Serves the page and its connections, in a thread of its own.

The server answers nothing without its token, refuses pages of other origins, and hosts of other
names, so that no other page in the browser of the user can ask.
"""

from __future__ import annotations

import asyncio
import contextlib
import http
import importlib.resources
import json
import math
import secrets
import sys
import threading
from bisect import bisect_right
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeAlias
from urllib.parse import parse_qs, urlsplit

from websockets.asyncio.server import Server, ServerConnection, serve
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response

from ssduck.errors import SelectScriptError, SimulatorError
from ssduck.interpreter.stopping import StopRequest
from ssduck.view.answers import Answers, error_message
from ssduck.view.frames import Frame, Poses, Track, poses_message, track_message
from ssduck.view.live import Simulation, Source, Ticks
from ssduck.view.sealed import SealedAnswers

AnyAnswers: TypeAlias = Answers | SealedAnswers


class SentTicks:
    """The recorded ticks that a page has.

    Attributes:
        sent_at: the time of the last message, s of the server's clock.
        is_complete: whether the page has all of them.
    """

    def __init__(self) -> None:
        self.sent_at = -math.inf
        self.is_complete = False
        # The numbers of the first and the last tick that the page has; 0 for none.
        self._first = self._last = 0
        self._firings = 0

    def message(self, ticks: Ticks | None, firings: list[tuple[str, float]]) -> Any:
        """Returns the message of what is new; None if nothing is."""
        numbers = [] if ticks is None else ticks.numbers.tolist()
        first, last = (numbers[0], numbers[-1]) if numbers else (0, 0)
        # The page goes on from what it has if that is a part of the ticks, or their beginning.
        goes_on = 0 < self._first <= first <= self._last <= last
        start = bisect_right(numbers, self._last) if goes_on else 0
        is_same = (first, last) == (self._first, self._last) and len(firings) == self._firings
        if is_same:
            return None
        self._first, self._last, self._firings = first, last, len(firings)
        return {
            "type": "ticks",
            "anew": not goes_on,
            "keep": start,
            "numbers": numbers[start:],
            "times": [] if ticks is None else ticks.times[start:].tolist(),
            "firings": firings,
        }


class Viewer:
    """A page that is connected.

    Attributes:
        news: is set when there may be something to send.
        time: the time that it shows, s; None for the present.
        is_local: whether the page has the poses of that time.
        shown: the time of the last frame that it got, s; None for the present.
        sent: the poses that it has; None if it needs all.
        questions: the questions that it waits for, with what ends their programs.
    """

    def __init__(self, connection: ServerConnection, answers: AnyAnswers) -> None:
        self.connection, self.answers = connection, answers
        self.news = asyncio.Event()
        self.time: float | None = None
        self.is_local = False
        self.shown: float | None = None
        self.frame: Frame | None = None
        self.sent: Poses | None = None
        self.ticks = SentTicks()
        self.status: dict[str, Any] | None = None
        self.questions: dict[asyncio.Task[None], StopRequest] = {}
        # The last query, and the last search for the changes of an answer.
        self._latest: dict[str, StopRequest] = {}

    def begin(self, question: dict[str, Any]) -> StopRequest:
        """Returns what ends the programs of a new question; ends the one that it supersedes."""
        stop, kind = StopRequest(), question.get("type")
        if kind in ("ask", "scan"):  # of these, a page waits for its last one only
            if kind in self._latest:
                self._latest[kind].make()
            self._latest[kind] = stop
        return stop

    def wait_for(self, task: asyncio.Task[None], stop: StopRequest) -> None:
        """Waits for the answer of a question."""
        self.questions[task] = stop
        task.add_done_callback(self.questions.pop)

    def leave(self) -> None:
        """Ends what the page waits for, as its connection is closed."""
        for task, stop in self.questions.items():
            task.cancel()
            stop.make()

    async def send(self, message: dict[str, Any]) -> None:
        """Sends a message as JSON."""
        await self.connection.send(json.dumps(message))

    def seek(self, question: dict[str, Any]) -> None:
        """Shows another time, as the page asks."""
        at = question.get("at")
        is_number = isinstance(at, int | float) and not isinstance(at, bool)
        # Neither infinite, nor NaN, nor an integer that no float can have.
        is_time = is_number and abs(at) <= sys.float_info.max  # type: ignore[arg-type]
        self.time = float(at) if is_time else None  # type: ignore[arg-type]
        # A page that showed poses of its own needs all of them.
        if self.is_local:
            self.sent = None
        self.is_local = question.get("local") is True and self.time is not None
        self.shown = math.nan
        self.news.set()


# The shortest real time between two updates of a page, s; a little less than a thirtieth, as timers
# are late.
PERIOD = 1.0 / 32.0
# The real time between two messages of recorded ticks, s.
TICKS_PERIOD = 0.25
# The real time between two messages of a scan, s.
SCAN_PERIOD = 0.1
# The largest number of ticks of a track.
MAX_TRACK = 4096
# The questions that a page may wait for; what it asks beyond them is read later.
MAX_WAITING = 32
# The largest question of a page, bytes.
MAX_QUESTION = 2_000_000
_LOCAL = ("127.0.0.1", "localhost")
_FILES = {"/page.js": "text/javascript", "/page.css": "text/css"}


class PageServer:
    """The server of a page.

    Args:
        source: what the page shows.
        answers: returns what answers the questions of another viewer.
        host: the address to listen at.
        port: the port; 0 for a free one.

    Attributes:
        url: the address of the page, with its token.
    """

    def __init__(
        self,
        source: Source,
        answers: Callable[[], AnyAnswers],
        host: str = "127.0.0.1",
        port: int = 0,
    ) -> None:
        self._source, self._host, self._answers = source, host, answers
        self._controls: Simulation | None = None
        self._token = secrets.token_urlsafe(24)
        self._viewers: set[Viewer] = set()
        # Queries wait for each other, and never for the simulation or for poses.
        self._queries = ThreadPoolExecutor(1, "ssduck view: queries")
        self._frames = ThreadPoolExecutor(1, "ssduck view: frames")
        self._scans = ThreadPoolExecutor(1, "ssduck view: scans")
        self._loop = asyncio.new_event_loop()
        self._is_woken = False
        self._thread = threading.Thread(
            target=self._loop.run_forever, name="ssduck view: server", daemon=True
        )
        self._thread.start()
        try:
            self._server: Server = asyncio.run_coroutine_threadsafe(
                self._start(port), self._loop
            ).result()
        except OSError as error:
            self._end_threads()
            raise SimulatorError(
                f"{host}:{port} cannot be listened at: {error.strerror}; choose another --port"
            ) from error
        self.port: int = self._server.sockets[0].getsockname()[1]
        shown = f"[{host}]" if ":" in host else host
        self.url = f"http://{shown}:{self.port}/?token={self._token}"

    async def _start(self, port: int) -> Server:
        return await serve(
            self._connected,
            self._host,
            port,
            process_request=self._respond,
            max_size=MAX_QUESTION,
            compression=None,
            server_header=None,
            close_timeout=1,
        )

    def set_controls(self, controls: Simulation) -> None:
        """Lets pages control a simulation."""
        self._controls = controls

    def wake(self) -> None:
        """Tells all pages that there is something new; any thread may call it, at any rate."""
        if self._is_woken or self._loop.is_closed():
            return
        self._is_woken = True
        with contextlib.suppress(RuntimeError):  # the loop was closed just now
            self._loop.call_soon_threadsafe(self._wake_viewers)

    def _wake_viewers(self) -> None:
        for viewer in self._viewers:
            viewer.news.set()

    def close(self) -> None:
        """Closes all connections, and ends the threads."""
        self._source.watch(None)

        async def stop() -> None:
            for viewer in self._viewers:
                viewer.leave()
            self._server.close()
            await self._server.wait_closed()

        asyncio.run_coroutine_threadsafe(stop(), self._loop).result()
        self._end_threads()

    def _end_threads(self) -> None:
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._queries.shutdown()
        self._frames.shutdown()
        self._scans.shutdown()
        self._loop.close()

    # -- who may ask --------------------------------------------------------------------------

    def _respond(self, connection: ServerConnection, request: Request) -> Response | None:
        """Refuses a request, answers it with a file, or lets it become a connection (None)."""
        try:
            address = urlsplit(request.path)
        except ValueError:  # brackets around what is no IPv6 address
            return connection.respond(http.HTTPStatus.BAD_REQUEST, "no address\n")
        hosts = request.headers.get_all("Host")
        if len(hosts) != 1 or not self._is_own(hosts[0]):
            return connection.respond(http.HTTPStatus.MISDIRECTED_REQUEST, "an unknown host\n")
        tokens = parse_qs(address.query).get("token", [])
        if len(tokens) != 1 or not secrets.compare_digest(tokens[0].encode(), self._token.encode()):
            return connection.respond(http.HTTPStatus.FORBIDDEN, "the token is missing or wrong\n")
        is_socket = address.path == "/socket"
        origins = request.headers.get_all("Origin")
        if (is_socket or origins) and origins != [f"http://{hosts[0]}"]:
            return connection.respond(http.HTTPStatus.FORBIDDEN, "a foreign origin\n")
        if is_socket:
            return None
        if address.path == "/":
            return self._page(hosts[0])
        if address.path in _FILES:
            content = _file(address.path.removeprefix("/"))
            return _response(content, _FILES[address.path], {})
        return connection.respond(http.HTTPStatus.NOT_FOUND, "there is no such page\n")

    def _is_own(self, host: str) -> bool:
        """Checks whether a request is for this server by a name that no other site can have."""
        name, _, port = host.rpartition(":")
        names = (*_LOCAL, self._host, f"[{self._host}]")
        return name in names and port == str(self.port)

    def _page(self, host: str) -> Response:
        nonce = secrets.token_urlsafe(16)
        policy = (
            "default-src 'none'; script-src 'self'; img-src 'self' data: blob:; "
            f"style-src 'self' 'nonce-{nonce}'; connect-src 'self' ws://{host}; "
            "base-uri 'none'; form-action 'none'; "
            "frame-ancestors 'self' http://127.0.0.1:* http://localhost:*"
        )
        text = _file("index.html").decode()
        text = text.replace("{{token}}", self._token).replace("{{nonce}}", nonce)
        return _response(text.encode(), "text/html", {"Content-Security-Policy": policy})

    # -- connections --------------------------------------------------------------------------

    async def _connected(self, connection: ServerConnection) -> None:
        viewer = Viewer(connection, self._answers())
        self._viewers.add(viewer)
        try:
            if len(self._viewers) == 1:
                await self._in(self._frames, lambda: self._source.watch(self.wake))
            sending = asyncio.create_task(self._send_news(viewer))
            try:
                await self._receive(viewer)
            finally:
                sending.cancel()
                with contextlib.suppress(asyncio.CancelledError, ConnectionClosed):
                    await sending
        except ConnectionClosed:
            pass
        finally:
            self._viewers.discard(viewer)
            if not self._viewers:
                await self._in(self._frames, lambda: self._source.watch(None))

    async def _in(self, executor: ThreadPoolExecutor, function: Callable[[], Any]) -> Any:
        return await self._loop.run_in_executor(executor, function)

    async def _send_news(self, viewer: Viewer) -> None:
        """Sends scene and poses whenever there are new ones: the latest, and what moved."""
        about = {**self._source.about, "type": "hello", "controls": self._controls is not None}
        await viewer.send(about)
        while True:
            started = self._loop.time()
            viewer.news.clear()
            await self._send_ticks(viewer, started)
            await self._send_frame(viewer)
            if self._controls is not None and self._controls.status != viewer.status:
                viewer.status = self._controls.status
                await viewer.send({"type": "status", **viewer.status})
            rest = PERIOD - (self._loop.time() - started)
            if rest > 0:
                await asyncio.sleep(rest)
            # From here on a tick wakes this task; one that came before has been seen.
            self._is_woken = False
            if not self._has_news(viewer):
                await self._wait_for_news(viewer)

    def _has_news(self, viewer: Viewer) -> bool:
        """Checks whether there is a frame or a status that a viewer did not get."""
        if self._controls is not None and self._controls.status != viewer.status:
            return True
        latest = self._source.latest
        return viewer.time is None and latest is not None and latest is not viewer.frame

    async def _wait_for_news(self, viewer: Viewer) -> None:
        """Waits for news; a page that lacks recorded ticks gets them though nothing is new."""
        if viewer.ticks.is_complete:
            await viewer.news.wait()
            return
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(viewer.news.wait(), TICKS_PERIOD)

    async def _send_frame(self, viewer: Viewer) -> None:
        """Sends the frame that a viewer looks at, unless the page has it."""
        at = viewer.time
        if at is not None and (viewer.is_local or at == viewer.shown):
            return
        frame = self._source.latest if at is None else None
        if frame is None:
            frame = await self._in(self._frames, lambda: self._source.frame(at))
        viewer.shown = at
        if viewer.frame is None or not viewer.frame.has_same_scene(frame):
            scene = await self._in(self._frames, lambda: self._source.scene(frame))
            await viewer.connection.send(scene)
            viewer.sent = None
        if frame is not viewer.frame or viewer.sent is None:
            await viewer.connection.send(poses_message(frame, viewer.sent))
            viewer.frame, viewer.sent = frame, frame.poses

    async def _send_ticks(self, viewer: Viewer, now: float) -> None:
        """Sends the recorded ticks that are new to a viewer, and the firings of triggers."""
        if now < viewer.ticks.sent_at + TICKS_PERIOD:
            viewer.ticks.is_complete = False
            return
        ticks = await self._in(self._frames, self._source.ticks)
        viewer.ticks.sent_at = now
        viewer.ticks.is_complete = True
        message = viewer.ticks.message(ticks, self._source.firings)
        if message is not None:
            await viewer.send(message)

    async def _receive(self, viewer: Viewer) -> None:
        """Receives questions until the connection is closed, and then ends what it waits for."""
        async with asyncio.TaskGroup() as group:
            try:
                async for message in viewer.connection:
                    await self._received(viewer, _parsed(message), group)
            except ConnectionClosed:
                pass
            finally:
                viewer.leave()

    async def _received(
        self, viewer: Viewer, question: dict[str, Any], group: asyncio.TaskGroup
    ) -> None:
        """Answers a question, or begins to: a query does not delay what comes after it."""
        kind, id = question.get("type"), question.get("id")
        if kind == "seek":
            viewer.seek(question)
        elif kind == "track":
            track = await self._in(self._frames, lambda: self._track(viewer, question))
            if track is None:
                await viewer.send({"none": True, "type": kind, "id": id})
            else:
                await viewer.connection.send(track_message(id, track))
        elif kind == "control":
            await viewer.send({**self._control(question), "type": kind, "id": id})
        else:
            stop = viewer.begin(question)
            work = self._scan if kind == "scan" else self._answer
            viewer.wait_for(group.create_task(work(viewer, question, stop)), stop)
            if len(viewer.questions) >= MAX_WAITING:
                await asyncio.wait(viewer.questions, return_when=asyncio.FIRST_COMPLETED)

    async def _answer(self, viewer: Viewer, question: dict[str, Any], stop: StopRequest) -> None:
        reply = await self._in(self._queries, lambda: viewer.answers.answer(question, stop))
        with contextlib.suppress(ConnectionClosed):
            await viewer.send({**reply, "type": question.get("type"), "id": question.get("id")})

    def _track(self, viewer: Viewer, question: dict[str, Any]) -> Track | None:
        """Returns recorded poses; None if there are none, or the scene is another one then."""
        first, count = question.get("first"), question.get("count")
        frame = viewer.frame
        if frame is None or type(first) is not int or type(count) is not int:
            return None
        if first < 0 or not 0 < count <= MAX_TRACK:
            return None
        try:
            return self._source.track(frame, first, count)
        except SelectScriptError:  # the world is recorded anew
            return None

    async def _scan(self, viewer: Viewer, question: dict[str, Any], stop: StopRequest) -> None:
        """Looks for the ticks at which an answer changes, and sends what is found bit by bit."""
        head = {"type": "scan", "id": question.get("id")}
        is_over = False
        try:
            scan = await self._in(self._scans, lambda: viewer.answers.scan(question, stop))
            while not is_over and not stop.is_made:
                is_over = not await self._in(self._scans, lambda: scan.advance(SCAN_PERIOD))
                await viewer.send(scan.progress | head | {"done": is_over})
        except SelectScriptError as error:
            with contextlib.suppress(ConnectionClosed):
                await viewer.send(head | {"error": error_message(error)})
        except ConnectionClosed:
            pass

    def _control(self, question: dict[str, Any]) -> dict[str, Any]:
        if self._controls is None:
            return {"error": {"message": "this simulation is stepped elsewhere"}}
        try:
            self._controls.control(question.get("action"), question.get("value"))
        except SelectScriptError as error:
            return {"error": {"message": str(error)}}
        return {}


def _parsed(message: str | bytes) -> dict[str, Any]:
    """Returns a question; one that is no JSON object has no type, and is refused."""
    try:
        question = json.loads(message)
    except (ValueError, RecursionError):
        return {}
    return question if isinstance(question, dict) else {}


def _file(name: str) -> bytes:
    return (importlib.resources.files("ssduck.view") / "page" / name).read_bytes()


def _response(content: bytes, type: str, more: dict[str, str]) -> Response:
    headers = Headers(
        {
            "Content-Type": f"{type}; charset=utf-8",
            "Content-Length": str(len(content)),
            "Cache-Control": "no-store",
            "Referrer-Policy": "no-referrer",
            "X-Content-Type-Options": "nosniff",
            "Connection": "close",
            **more,
        }
    )
    return Response(200, "OK", headers, content)
