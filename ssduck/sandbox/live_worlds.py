"""Worlds of this process in a sandbox: copies there, which get what is new before each question."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from ssduck.errors import UnsupportedError
from ssduck.interpreter.interpreter import Interpreter
from ssduck.interpreter.mirrors import WorldFeed, WorldNews
from ssduck.sandbox.references import SandboxedWorld
from ssduck.world.batches.batch_world import BatchWorld
from ssduck.world.world import World


@dataclass(frozen=True)
class _Live:
    """A world of an interpreter of this process."""

    owner: Interpreter
    world: World
    is_past: bool = False  # whether its copy goes to recorded ticks
    is_own: bool = False  # whether the interpreter is there for it alone


class LiveWorlds:
    """The worlds of this process that programs in a sandbox ask.

    Their ticks are recorded here, from when they are added.
    """

    def __init__(self) -> None:
        self._worlds: dict[str, _Live] = {}
        self._feeds: dict[str, WorldFeed] = {}
        self._sensed = set[str]()

    def add(
        self,
        name: str,
        world: World,
        owner: Interpreter | None = None,
        *,
        is_past: bool = False,
    ) -> None:
        """Adds a world, which an interpreter of this process records.

        Args:
            name: the name of its copy.
            world: the world.
            owner: the interpreter; None for one of its own, with the default recording.
            is_past: whether the copy goes to recorded ticks; else it is of the last tick.
        """
        if isinstance(world, BatchWorld):
            raise UnsupportedError(f"{name!r} is a batch of worlds, which a sandbox cannot have")
        before = self._worlds.get(name)
        if before is not None:
            if before == _Live(owner or before.owner, world, is_past, is_own=owner is None):
                return
            self.remove(name)
        live = _Live(owner or Interpreter(), world, is_past, is_own=owner is None)
        if live.is_own:
            live.owner.add_variable(name, world)
        self._worlds[name] = live

    def __contains__(self, name: object) -> bool:
        """Checks whether a world has a name."""
        return name in self._worlds

    def __getitem__(self, name: str) -> World:
        return self._worlds[name].world

    def remove(self, name: str) -> None:
        """Removes a world, if there is one of that name; it goes on, and is not recorded here."""
        self._feeds.pop(name, None)
        live = self._worlds.pop(name, None)
        if live is not None and live.is_own:
            live.owner.close()

    def name_of(self, world: Any) -> str:
        """Returns the name of a world of the sandbox, or of the copy of one of this process."""
        if isinstance(world, SandboxedWorld):
            return world.name
        for name, live in self._worlds.items():
            if live.world is world:
                return name
        raise UnsupportedError(
            f"{world!r} is a world of this process: add it as a variable of the sandbox first"
        )

    def begin_anew(self) -> None:
        """Sends everything again: the process of the sandbox is another one."""
        self._feeds.clear()

    def update(self, ask: Callable[..., Any]) -> None:
        """Sends what is new to the sandbox, which a function asks."""
        self._sensed.clear()
        for name, live in self._worlds.items():
            feed = self._feeds.pop(name, None)
            if feed is None or not feed.is_up_to_date:
                feed = WorldFeed(live.owner, live.world, name, is_past=live.is_past)
                ask("worker.copy_world", vars(feed.description))
            news = feed.news()
            self._feeds[name] = feed
            if news is not None:
                try:
                    ask("worker.update_world", name, vars(news))
                except BaseException:
                    del self._feeds[name]  # the copy may lack something
                    raise

    def sensed(self, name: str) -> dict[str, Any]:
        """Returns the last tick of a world with what its sensors perceive; once for a question."""
        if name not in self._feeds:
            raise UnsupportedError(f"{name!r} is no world of this process")
        if name in self._sensed:
            raise UnsupportedError("what sensors perceive is copied once for each question")
        self._sensed.add(name)
        feed = self._feeds.pop(name)
        news = feed.news(is_sensed=True)
        assert isinstance(news, WorldNews)
        self._feeds[name] = feed
        return vars(news)

    def close(self) -> None:
        """Removes all worlds."""
        for name in list(self._worlds):
            self.remove(name)
