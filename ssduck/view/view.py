"""Opens the page of a world or a record: `view` and `view_record`."""

from __future__ import annotations

import contextlib
import html
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, Self

from ssduck.adapters.optional import library
from ssduck.errors import UnknownNameError, check_known
from ssduck.interpreter.interpreter import Interpreter
from ssduck.simulators.scenes import Camera
from ssduck.view.answers import Answers
from ssduck.view.live import LiveSource, RecordSource, Simulation, Source
from ssduck.view.sealed import PageSandboxes
from ssduck.world.world import World

_HEIGHT = 640


class View:
    """A page that is served until it is closed; a notebook shows it in place.

    Args:
        source: what it shows.
        reload: returns the world anew, for a world that the page runs; None for other worlds.
        host: the address to listen at.
        port: the port; 0 for a free one.

    Attributes:
        url: the address of the page, with the token without which nothing is answered.

    Raises:
        UnsupportedError: websockets is not installed.
        SimulatorError: the address cannot be listened at.
    """

    def __init__(
        self,
        source: Source,
        reload: Callable[[], World] | None = None,
        host: str = "127.0.0.1",
        port: int = 0,
    ) -> None:
        library("websockets", "view")
        from ssduck.view.server import AnyAnswers, PageServer

        with contextlib.ExitStack() as stack:
            stack.callback(source.close)
            answers: Callable[[], AnyAnswers] = partial(Answers, source)
            sandboxes = PageSandboxes.of(source)
            if sandboxes is not None:
                stack.callback(sandboxes.close)
                answers = sandboxes.answers
            self._server = PageServer(source, answers, host, port)
            stack.callback(self._server.close)
            if reload is not None:
                assert isinstance(source, LiveSource)
                simulation = Simulation(source, reload, self._server.wake)
                self._server.set_controls(simulation)
                stack.callback(simulation.close)
            self._stack = stack.pop_all()
        self.url = self._server.url

    def close_afterwards(self, stack: contextlib.ExitStack) -> None:
        """Closes what the page uses when the page is closed."""
        serving = self._stack
        self._stack = contextlib.ExitStack()
        self._stack.push(stack)
        self._stack.push(serving)

    def close(self) -> None:
        """Stops serving; the world goes on. A second call does nothing."""
        self._stack.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"<View {self.url}>"

    def _repr_html_(self) -> str:
        """Returns a frame with the page, for notebooks."""
        address = html.escape(self.url, quote=True)
        return f'<iframe src="{address}" width="100%" height="{_HEIGHT}" frameborder="0"></iframe>'


def view(
    ss: Interpreter, world: str | None = None, camera: Camera | None = None, **address: Any
) -> View:
    """Serves the page of a world; see `Interpreter.view`."""
    worlds = {each.name: each for each in ss.worlds}
    if not worlds:
        raise UnknownNameError("there is no world to view; add one with add_variable, or use load")
    name = next(iter(worlds)) if world is None else world
    check_known(name, worlds, f"there is no world {name!r}")
    if camera is not None:
        worlds[name].camera = camera
    return View(LiveSource(ss, worlds[name], name), **address)


def view_scene(load: Callable[[], World], **address: Any) -> View:
    """Serves the page of a world that the page itself loads, anew at each call, runs and closes."""
    with contextlib.ExitStack() as stack:
        ss = stack.enter_context(Interpreter())
        world = load()
        name = world.name
        ss.add_variable(name, world)
        source = LiveSource(ss, world, name)
        stack.callback(lambda: source.world.close())  # noqa: PLW0108  # the last one

        def reload() -> World:
            again = load()
            ss.add_variable(name, again)
            return again

        page = View(source, reload, **address)
        page.close_afterwards(stack.pop_all())
    return page


def view_record(path: str | Path, episode: int | None = None, **address: Any) -> View:
    """Serves the page of a record."""
    return View(RecordSource(path, episode), **address)
